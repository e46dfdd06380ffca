"""The common part of karolos's agents: seeds, device, inputs, optimisers and state."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Annotated, Any, ClassVar, Self
from zlib import crc32

import numpy as np
import torch
from numpy import int64
from numpy.typing import NDArray
from pydantic import Field as Setting
from pydantic import model_validator
from torch import Tensor

from ..core import (
    Agent,
    AgentSettings,
    Batch,
    Deployed,
    Discrete,
    Experience,
    FloatArray,
    Layout,
    Output,
    SeedTree,
    Signature,
    State,
)
from ..core.schedules import Linear
from ..errors import UsageError
from .inputs import INPUT_CLIP, NONE_MISSING, Normaliser, TensorBatch, tensor_batch
from .layers import LAYER_NORM_EPSILON
from .networks import MLP, array_of
from .optimisation import Adam

Hidden = Annotated[tuple[Annotated[int, Setting(ge=1, le=65_536)], ...], Setting(min_length=1, max_length=32)]
"""Units of each hidden layer."""


def joint_columns(layout: Layout | Discrete) -> tuple[tuple[int, ...], ...]:
    """For each joint that the layout describes its columns; empty if it describes none."""
    if isinstance(layout, Discrete):
        return ()
    columns, fields = np.arange(layout.size), [field for field in layout.fields if field.joints]
    tables = [columns[layout.slice(field.name)].reshape(field.joints, -1) for field in fields]
    return tuple(map(tuple, np.concatenate(tables, 1).tolist())) if tables else ()


class OptimiserSettings(AgentSettings):
    """Settings of every agent that optimises with Adam."""

    learning_rate: float = Setting(1e-3, gt=0, description="learning rate of all networks (Adam)")
    learning_rate_end: float | None = Setting(
        None, ge=0, description="learning rate after learning_rate_updates, reached linearly; null: constant"
    )
    learning_rate_updates: int | None = Setting(
        None, ge=1, description="updates of the agent until learning_rate_end; policy_delay has no influence"
    )
    fine_goal: float | None = Setting(
        None,
        gt=0,
        le=100,
        description="a further input of the networks: desired minus achieved goal, divided by its standard deviation, "
        "multiplied by this and bounded by tanh, if observations have the achieved goal; null: none",
    )
    gradient_norm: float | None = Setting(None, gt=0, description="clip gradients to this norm; null: no clipping")

    @model_validator(mode="after")
    def _schedule_is_whole(self) -> Self:
        if (self.learning_rate_end is None) != (self.learning_rate_updates is None):
            raise ValueError("learning_rate_end and learning_rate_updates go together: give both or neither")
        return self

    @property
    def rate(self) -> Linear:
        """The learning rate by the number of the agent's updates."""
        if self.learning_rate_end is None:
            return Linear(self.learning_rate, self.learning_rate, 0)
        return Linear(self.learning_rate, self.learning_rate_end, self.learning_rate_updates or 0)


class TorchAgent(Agent[Experience]):
    """An agent whose state consists of the attributes in `stored`, its optimisers and its generator.

    Args:
        settings: with `discount`, and those of the optimiser.
        input_clip: bound of normalised inputs.
    """

    stored: tuple[str, ...]
    """Attributes that learning or acting depends on: tensors, counters, and parts with `state` and `load_state`."""
    optimisers: dict[str, Adam]
    critics_see_more: ClassVar[bool] = False
    """Whether critics use the fields of `environment.critic_observes`."""
    arrays: ClassVar[int] = 8
    """Number of arrays of a network's size: parameters, targets, gradients, moments of Adam. Measured."""

    def __init__(
        self, settings: Any, signature: Signature, seeds: SeedTree, device: str, *, input_clip: float = INPUT_CLIP
    ) -> None:
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        seen = signature.observation.acting.size
        goals = seen + signature.desired_goal.size
        if settings.fine_goal and not signature.observed_goal[0]:
            what = "what is achieved of the goal is not among the observations"
            raise UsageError(what, setting="agent.fine_goal", hint="set agent.fine_goal: null")
        self.missing = signature.observed_goal if settings.fine_goal else ((), ())
        """Columns of goals and of observations whose difference enters the networks, see `Signature.observed_goal`."""
        self.inputs: int = goals + len(self.missing[0])
        """Columns of a policy's input."""
        self.critic_only = signature.observation.size - seen
        """Further columns of a critic's input."""
        if self.critic_only and not self.critics_see_more:
            what = f"{type(self).__name__} has no critic that observes more than its policy"
            raise UsageError(what, setting="environment.critic_observes", hint="set it to [], or choose sac")
        self.normaliser = Normaliser(
            self.inputs + self.critic_only,
            device,
            clip=input_clip,
            missing=slice(goals, self.inputs) if self.missing[0] else NONE_MISSING,
            fine=settings.fine_goal or 1.0,
            alike=joint_columns(signature.observation.acting),
        )
        self.weights_generator = torch.Generator().manual_seed(seeds.child("weights").integer())
        """Samples the weights of the networks, on the CPU."""
        self.generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())

    @torch.inference_mode()
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[int64] | None = None,
    ) -> FloatArray:
        inputs = self.network_input(observation, desired_goal)
        action: FloatArray = (self.explore(inputs, environments) if explore else self.best(inputs)).cpu().numpy()
        return action

    @abstractmethod
    def explore(self, inputs: Tensor, environments: NDArray[int64] | None) -> Tensor:
        """Exploring actions (n, a) for normalised inputs (n, i)."""

    @abstractmethod
    def best(self, inputs: Tensor) -> Tensor:
        """Actions (n, a) without exploration for normalised inputs (n, i)."""

    def network_input(self, observation: FloatArray, desired_goal: FloatArray) -> Tensor:
        """Observations (..., o) and goals (..., g), joined and normalised: (n, i). The statistics stay unchanged.

        Columns that only critics observe may be missing, and are ignored.
        """
        return self.normaliser(self.unscaled(observation, desired_goal))

    def unscaled(self, observation: FloatArray, desired_goal: FloatArray) -> Tensor:
        """`network_input` before it is normalised."""
        goals, seen = self.missing
        parts = [observation[..., : self.inputs - desired_goal.shape[-1] - len(goals)], desired_goal]
        if goals:
            parts.append(desired_goal[..., goals] - observation[..., seen])
        return torch.cat([torch.from_numpy(part) for part in parts], -1).flatten(0, -2).to(self.device)

    def begin_update(self, batch: Batch, update: int) -> TensorBatch:
        """Set the learning rates of this update (the first is 0); returns its batch on the device."""
        for optimiser in self.optimisers.values():
            optimiser.learning_rate = self.settings.rate(update)
        return tensor_batch(batch, self.normaliser, self.device, update, self.critic_only, self.missing)

    def adam(self, vector: Tensor, *, epsilon: float = 1e-8) -> Adam:
        """An optimiser as the settings say."""
        return Adam(vector, self.settings.learning_rate, epsilon=epsilon, norm=self.settings.gradient_norm)

    def policy_arrays(self, network: MLP, output: Output, columns: slice = slice(None)) -> Deployed:
        """Normaliser and network for use outside karolos, as copies on the CPU.

        Args:
            network: without members.
            output: how the network's outputs become an action.
            columns: of the outputs that the action needs.
        """
        layers, joints = network.arrays(columns)
        statistics = self.normaliser.shift, self.normaliser.scale
        shift, scale = (array_of(part[: self.inputs]) for part in statistics)
        epsilon = LAYER_NORM_EPSILON if network.shape.layer_norm else None
        missing = np.array(self.missing, np.int64)
        return Deployed(shift, scale, self.normaliser.clip, tuple(layers), output, epsilon, missing, joints)

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        values = {name: getattr(self, name) for name in self.stored}
        for name, value in values.items():
            if not isinstance(value, int):
                values[name] = value.clone() if isinstance(value, Tensor) else value.state()
        optimisers = {name: optimiser.state() for name, optimiser in self.optimisers.items()}
        return {**values, "optimisers": optimisers, "generator": self.generator.get_state()}

    def load_state(self, state: State) -> None:
        """The state may come from another device. Its random numbers cannot be continued here, so others are sampled.

        Raises:
            UsageError: the state is of networks of another shape.
        """
        for name in self.stored:
            value = getattr(self, name)
            if isinstance(value, int):
                setattr(self, name, int(state[name]))
            elif isinstance(value, Tensor):
                value.copy_(torch.as_tensor(state[name]))
            else:
                value.load_state(state[name])
        for name, optimiser in self.optimisers.items():
            optimiser.load_state(state["optimisers"][name])
        drawn = torch.as_tensor(state["generator"])
        if len(drawn) == len(self.generator.get_state()):
            self.generator.set_state(drawn)
        else:
            self.generator.manual_seed(crc32(drawn.numpy().tobytes()))


def value_bounds(signature: Signature, discount: float, *, clip: bool) -> tuple[float, float]:
    """The least and the largest value that the declared reward range allows; infinite without `clip`."""
    if not clip:
        return -math.inf, math.inf
    low, high = signature.reward_range
    forever = 1 / (1 - discount)  # the return of a reward of 1 at each step; a termination can leave a single step
    return min(low, low * forever), max(high, high * forever)
