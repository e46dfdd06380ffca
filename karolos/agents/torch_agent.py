"""What the agents of karolos share: seeds, device, inputs, optimisers, metrics and state."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core import FLOAT_BYTES, Agent, Batch, Experience, FloatArray, MemoryNeed, RunSize, Signature, State
from ..core.deployed import Deployed, Layer, Output
from ..core.seeding import SeedTree
from .inputs import INPUT_CLIP, Normaliser, TensorBatch, tensor_batch, to_array
from .layers import LAYER_NORM_EPSILON
from .networks import MLP
from .optimisation import Adam

ALL_OBSERVED = 500
"""The batches of this many first updates all enter the statistics of the normaliser."""
OBSERVED_EVERY = 4
"""Later one batch in this many does: the statistics hardly move, and it takes 2 % of an update."""
REPORT_EVERY = 8
"""One update in this many computes its metrics, which takes 2 % of an update."""
LOG_STD_BOUNDS = (-5.0, 2.0)
"""Of a Gaussian policy: below, log probabilities explode; above, actions are corners only."""

Metrics = dict[str, Tensor | Callable[[], Tensor]]
"""Named scalars, some of them not computed yet."""


class TorchAgent(Agent[Experience]):
    """An agent whose state consists of the attributes in `stored`, its optimisers and its generator.

    Args:
        settings: with `discount`, and those of the optimiser.
        signature: of the environment.
        seeds: of this agent.
        device: cpu or cuda.
        input_clip: bound of normalised inputs.
    """

    stored: tuple[str, ...]
    """Attributes that learning or acting depends on: tensors, counters, and parts with `state` and `load_state`."""
    optimisers: dict[str, Adam]
    arrays: ClassVar[int] = 8
    """Arrays of the size of a network that it holds: parameters, targets, gradients, moments of Adam. Measured."""

    def __init__(
        self, settings: Any, signature: Signature, seeds: SeedTree, device: str, *, input_clip: float = INPUT_CLIP
    ) -> None:
        self.settings, self.device, self.discount = settings, torch.device(device), settings.discount
        self.inputs = signature.observation.size + signature.desired_goal.size
        """Columns of a network's input."""
        self.normaliser = Normaliser(self.inputs, device, clip=input_clip)
        self.weights_generator = torch.Generator().manual_seed(seeds.child("weights").integer())
        """Draws the weights of the networks, on the CPU."""
        self.generator = torch.Generator(self.device).manual_seed(seeds.child("noise").integer())

    def network_input(self, observation: FloatArray, desired_goal: FloatArray) -> Tensor:
        """Observations (n, o) and goals (n, g) side by side, normalised; the statistics stay unchanged."""
        rows = torch.cat((torch.from_numpy(observation), torch.from_numpy(desired_goal)), 1)
        return self.normaliser(rows.to(self.device))

    def adam(self, vector: Tensor, *, epsilon: float = 1e-8) -> Adam:
        """An optimiser as the settings say."""
        return Adam(vector, self.settings.learning_rate, epsilon=epsilon, norm=self.settings.gradient_norm)

    def set_learning_rates(self, update: int) -> None:
        """Set those of this update; the first is 0."""
        rate = self.settings.rate(update)
        for optimiser in self.optimisers.values():
            optimiser.learning_rate = rate

    def begin_update(self, batch: Batch, update: int) -> TensorBatch:
        """Set the learning rates and return the batch as tensors. Most batches do not enter the statistics."""
        self.set_learning_rates(update)
        observe = update < ALL_OBSERVED or update % OBSERVED_EVERY == 0
        return tensor_batch(batch, self.normaliser, self.device, observe=observe)

    def report(self, metrics: Mapping[str, Any], turn: int) -> dict[str, Any]:
        """Priorities, and in one turn of `REPORT_EVERY` the computed metrics and the learning rates."""
        if turn % REPORT_EVERY:
            return {"priorities": metrics["priorities"]}
        return {name: value() if callable(value) else value for name, value in metrics.items()} | self.learning_rates()

    def learning_rates(self) -> dict[str, Tensor]:
        """The learning rate of each optimiser, as metrics."""
        one = len(self.optimisers) == 1
        return {
            "learning_rate" if one else f"{name}_learning_rate": torch.tensor(optimiser.learning_rate)
            for name, optimiser in self.optimisers.items()
        }

    def policy_arrays(self, network: MLP, output: Output, columns: slice = slice(None)) -> Deployed:
        """Normaliser and network for use outside karolos, as copies on the CPU.

        Args:
            network: without members.
            output: how the network's outputs become an action.
            columns: of the outputs that the action needs.
        """
        parts = [to_array(part.detach()).copy() for part in network.named.values()]
        layers = [Layer(weight, bias.reshape(-1)) for weight, bias in zip(parts[::2], parts[1::2], strict=True)]
        layers[-1] = Layer(layers[-1].weight[columns], layers[-1].bias[columns])
        shift, scale = (to_array(part).copy() for part in (self.normaliser.shift, self.normaliser.scale))
        epsilon = LAYER_NORM_EPSILON if network.shape.layer_norm else None
        return Deployed(shift, scale, self.normaliser.clip, tuple(layers), output, epsilon)

    @classmethod
    def memory(cls, settings: Any, signature: Signature, size: RunSize) -> Iterator[MemoryNeed]:
        inputs = signature.observation.size + signature.desired_goal.size + signature.action.size
        weights = sum((before + 1) * after for before, after in pairwise((inputs, *settings.hidden, 1)))
        what = f"an agent with networks of {' x '.join(map(str, settings.hidden))} units"
        yield MemoryNeed(cls.arrays * weights * FLOAT_BYTES, what, "agent.hidden")
        if not cls.on_policy:
            activations = 2 * size.batch_size * sum(settings.hidden) * FLOAT_BYTES
            yield MemoryNeed(activations, f"a batch of {size.batch_size:,} transitions", "training.batch_size")

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        values = {name: getattr(self, name) for name in self.stored}
        for name, value in values.items():
            if not isinstance(value, int):
                values[name] = value.clone() if isinstance(value, Tensor) else value.state()
        optimisers = {name: optimiser.state() for name, optimiser in self.optimisers.items()}
        return {**values, "optimisers": optimisers, "generator": self.generator.get_state()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
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
        self.generator.set_state(torch.as_tensor(state["generator"]))


def value_bounds(signature: Signature, discount: float, *, clip: bool) -> tuple[float, float]:
    """The least and the largest value that the declared reward range allows; infinite without `clip`."""
    if not clip:
        return -math.inf, math.inf
    low, high = signature.reward_range
    forever = 1 / (1 - discount)  # the return of a reward of 1 at each step; a termination can leave a single step
    return min(low, low * forever), max(high, high * forever)


def saturation(action: Tensor) -> Tensor:
    """Fraction of the action's numbers beyond +- 0.99."""
    return (action.abs() > 0.99).float().mean()
