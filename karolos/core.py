"""The vocabulary of karolos: what flows between environments, buffers and agents, and the interfaces of the parts.

Conventions, said once: SI units (m, s, kg, N, rad), quaternions x y z w, float32 arrays in memory that is shared or
stored, any number of leading axes (none for one environment, one for several). An episode ends as `terminated` (the
world has no future: no value beyond) or `truncated` (time is up: the value goes on). Continuous actions lie in [-1, 1].
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, model_validator
from pydantic import Field as Setting
from typing_extensions import TypeVar

from .errors import KarolosError, UsageError

if TYPE_CHECKING:
    from .deployed import Deployed
    from .seeding import SeedTree

Array = NDArray[Any]
FloatArray = NDArray[np.float32]
BoolArray = NDArray[np.bool_]
State = dict[str, Any]
"""What a stateful part hands out and takes back: nested dicts of arrays, tensors, numbers and strings; no objects."""


class Settings(BaseModel):
    """Base of every plugin's nested `Settings`: frozen, and every key is known."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class AgentSettings(Settings):
    """Base of every agent's nested `Settings`."""

    start_from: str | None = Setting(
        None, description="run id or folder of a run whose agent to go on from: what it learned, not its optimisers"
    )
    start_checkpoint: Literal["best", "last"] = Setting("best", description="which of that run's checkpoints")
    start_sha256: str | None = Setting(
        None,
        pattern="^[0-9a-f]{64}$",
        description="of that checkpoint's agent; null: whatever is found, and noted here",
    )

    @model_validator(mode="after")
    def _start_is_whole(self) -> Any:
        if self.start_from is None and self.start_sha256 is not None:
            raise ValueError("start_sha256 says what start_from must find: give start_from too")
        return self

    def identity(self) -> dict[str, Any]:
        """What results depend on: what was started from, wherever it lies."""
        return self.model_dump(mode="json", exclude={"start_from", "start_checkpoint"})


@dataclass(frozen=True)
class Field:
    """A named run of numbers in a flat vector."""

    name: str
    size: int
    unit: str = "1"


@dataclass(frozen=True)
class Layout:
    """The fields of a flat float32 vector, in order, so that parts can be addressed by name."""

    fields: tuple[Field, ...] = ()

    def __post_init__(self) -> None:
        names = [field.name for field in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"a layout names a field twice: {names}")

    @property
    def size(self) -> int:
        return sum(field.size for field in self.fields)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(field.name for field in self.fields)

    def slice(self, name: str) -> slice:
        """Where the field lies in the vector. Raises KeyError for a name the layout does not have."""
        start = 0
        for field in self.fields:
            if field.name == name:
                return slice(start, start + field.size)
            start += field.size
        raise KeyError(f"no field {name!r}; the layout has {', '.join(self.names) or 'none'}")

    def __add__(self, other: Layout) -> Layout:
        return Layout(self.fields + other.fields)


@dataclass(frozen=True)
class Discrete:
    """A discrete action set: an action is the index of one of these labels."""

    labels: tuple[str, ...]

    @property
    def size(self) -> int:
        """Columns that one stored action takes."""
        return 1


class GoalRule(ABC):
    """When a goal is reached and what that is worth.

    Pure, vectorised over leading axes and picklable: environment, buffer and tests share one. `achieved` may carry more
    columns than `desired` names.
    """

    reward_range: tuple[float, float] = (-np.inf, np.inf)
    """The smallest and largest reward of one step."""

    @abstractmethod
    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        """Reward of arriving at `achieved` (..., a) when `desired` (..., d) is asked for: shape (...)."""

    @abstractmethod
    def success(self, achieved: Array, desired: Array) -> BoolArray:
        """Whether the goal holds: shape (...)."""

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:  # noqa: ARG002 (part of the interface)
        """Whether arriving there ends the episode: shape (...). By default reaching a goal ends nothing."""
        return np.zeros(np.shape(achieved)[:-1], np.bool_)

    def distance(self, achieved: Array, desired: Array) -> FloatArray | None:  # noqa: ARG002 (part of the interface)
        """How far from the goal that is, in m: shape (...); inf where it does not count. None: the rule knows none."""
        return None


@dataclass(frozen=True)
class Signature:
    """What an environment takes and gives: all that an agent or a buffer may know of it. Picklable."""

    observation: Layout
    action: Layout | Discrete
    max_steps: int
    """Steps after which an episode is truncated."""
    reward_range: tuple[float, float] = (-np.inf, np.inf)
    achieved_goal: Layout = Layout()
    desired_goal: Layout = Layout()
    goal_rule: GoalRule | None = None
    """None: the environment has no goals, and both goal layouts are empty."""
    parameters: Layout = Layout()
    """What domain randomization draws at each reset, in the order in which `Environment.parameters` gives it."""


def random_actions(signature: Signature, size: int, generator: np.random.Generator) -> FloatArray:
    """Uniform actions (size, action.size), for warm-up and for the floor that a random policy sets."""
    if isinstance(signature.action, Discrete):
        return generator.integers(len(signature.action.labels), size=(size, 1)).astype(np.float32)
    return generator.uniform(-1, 1, (size, signature.action.size)).astype(np.float32)


class Step(NamedTuple):
    """What an environment gives back after a reset or a step. Leading axes: none, or one over environments."""

    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    reward: Any
    terminated: Any
    truncated: Any
    success: Any
    """Whether the goal holds now. After a reset: reward 0, neither terminated nor truncated."""
    diverged: Any = False
    """Whether the simulation left all sense (NaN, an object far away). The step is truncated then, its values are those
    of the last sound one, and it is no experience: training counts it and keeps it from the buffer."""


class Transitions(NamedTuple):
    """One transition of each of n environments, as they come from collecting. All arrays have the leading axis n.

    Successive calls that name the same environment continue its episode until terminated or truncated.
    """

    environment: NDArray[np.int64]
    observation: FloatArray
    achieved_goal: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    reward: FloatArray
    next_observation: FloatArray
    next_achieved_goal: FloatArray
    terminated: BoolArray
    truncated: BoolArray


class Batch(NamedTuple):
    """n transitions to learn from, goals possibly relabelled; arrays with the leading axis n.

    Target of a value: reward + discount * (1 - terminated) * value(next_observation, desired_goal).
    """

    observation: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    reward: FloatArray
    next_observation: FloatArray
    terminated: FloatArray
    """1 where no value lies beyond, else 0. Truncated transitions carry 0."""
    discount: FloatArray
    """gamma ** (environment steps between observation and next_observation)."""
    weight: FloatArray
    """Importance weights; 1 for uniform sampling."""
    slot: NDArray[np.int64]
    """Where each transition lies in the buffer, for `Buffer.update_priorities`."""
    demonstrated: FloatArray | None = None
    """1 where an expert took the action, else 0; None: the buffer holds no demonstrations."""


class Rollout(NamedTuple):
    """What n environments played under one policy: at most T successive transitions of each, in their order.

    Arrays with the leading axes (T, n). Where an environment has fewer than T, the rows after its last are not
    `stored`.
    """

    observation: FloatArray
    desired_goal: FloatArray
    action: FloatArray
    """As the agent gave them, before they were clipped to what the environment takes."""
    reward: FloatArray
    next_observation: FloatArray
    terminated: BoolArray
    """No value lies beyond."""
    ended: BoolArray
    """The row after this one does not continue its episode: terminated, truncated, cut short, or nothing follows."""
    stored: BoolArray


Experience = TypeVar("Experience", Batch, Rollout, default=Batch)
"""What an agent learns from and a buffer gives: a Batch of old transitions, or (on-policy) a whole Rollout."""


class Environment(ABC):
    """One environment: a world that is reset with a seed and then takes actions until its episode ends.

    The same seed and the same actions give the same episode, bit for bit, in a fresh and in a used environment.
    """

    signature: Signature

    @abstractmethod
    def reset(self, seed: int) -> Step:
        """Begin the episode that `seed` (non-negative) determines."""

    @abstractmethod
    def step(self, action: Array) -> Step:
        """Take one action: (action.size,) float32, or an index for a discrete set. Raises RuntimeError after an end."""

    def parameters(self) -> FloatArray:
        """The values domain randomization drew for this episode, as `signature.parameters` lays them out."""
        return np.zeros(0, np.float32)

    def render(self, width: int = 640, height: int = 480) -> NDArray[np.uint8]:
        """A picture of the world as it is now: (height, width, 3)."""
        raise NotImplementedError(f"{type(self).__name__} has no pictures")

    def close(self) -> None:  # noqa: B027 (nothing to free by default)
        """Free what the environment holds. Safe to call twice."""


class Agent(ABC, Generic[Experience]):
    """A reinforcement-learning algorithm: acts, and learns from what it is given. Owns no buffer, file or environment.

    `Agent` alone learns from batches; an on-policy one is an `Agent[Rollout]`.
    """

    Settings: ClassVar[type[BaseModel]]
    on_policy: ClassVar[bool]
    """Whether it must learn from its own latest actions only (PPO) or can learn from old ones (replay)."""
    learned: ClassVar[tuple[str, ...]] = ()
    """Keys of its state that hold what it has learned, which an agent of the same kind can start from."""

    discount: float

    @abstractmethod
    def __init__(self, settings: Any, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None: ...

    @abstractmethod
    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[np.int64] | None = None,
    ) -> FloatArray:
        """Actions (n, a) for observations (n, o) and goals (n, g). Without exploration it is deterministic.

        Continuous ones lie in [-1, 1], but for those of an exploring on-policy agent: they are stored as they are, and
        clipped for the environment.

        Args:
            observation: (n, o).
            desired_goal: (n, g).
            explore: act as in training.
            environments: whose rows these are, (n,), for exploration that remembers; None: 0 .. n - 1.
        """

    def begin_episodes(self, environments: NDArray[np.int64]) -> None:
        """New episodes begin in these environments. Nothing to do where exploration remembers nothing of the old."""

    @abstractmethod
    def learn(self, batch: Experience) -> Mapping[str, Any]:
        """One gradient update from a batch, or all those that a rollout is good for.

        Returns named scalars as tensors on the device, read by whoever needs a number. May hold "priorities": (n,) one
        non-negative number for each transition, the size of its error; and "updates": how many updates it took, if not
        one.
        """

    def deployed(self) -> Deployed:
        """How it acts without exploration, as plain arrays, for use outside karolos.

        Raises:
            UsageError: this kind of agent cannot be written down so.
        """
        raise UsageError(
            f"{type(self).__name__} cannot be exported", hint="its class would have to say how it acts: `deployed`"
        )

    @abstractmethod
    def state(self) -> State:
        """Everything that `load_state` needs to go on bit for bit: weights, optimisers, statistics, generators."""

    @abstractmethod
    def load_state(self, state: State) -> None: ...

    def start_from(self, state: State) -> None:
        """Take over what another agent of the same kind has learned; optimisers and generators stay as they are.

        Raises:
            UsageError: this kind of agent does not say what it learns, or the state is of networks of another shape.
        """
        if not self.learned:
            raise UsageError(
                f"{type(self).__name__} cannot start from another run's agent",
                where="agent.start_from",
                hint="its class would have to name what it learns: `learned`",
            )
        self.load_state({**self.state(), **{key: state[key] for key in self.learned}})


class Buffer(ABC, Generic[Experience]):
    """Stores transitions and gives batches; an on-policy one is a `Buffer[Rollout]` and gives each rollout once."""

    Settings: ClassVar[type[BaseModel]]
    on_policy: ClassVar[bool]

    @abstractmethod
    def __init__(
        self, settings: Any, signature: Signature, seeds: SeedTree, *, environments: int, discount: float
    ) -> None: ...

    @abstractmethod
    def add(self, transitions: Transitions) -> None:
        """Store one transition of each environment named."""

    @abstractmethod
    def cut(self, environments: NDArray[np.int64]) -> None:
        """End the running episodes of these environments as they stand; the next transition begins a new one."""

    @abstractmethod
    def sample(self, size: int) -> Experience:
        """`size` transitions; a rollout is given as a whole, with `size = len(buffer)`.

        The arrays are valid until the next call; those of a rollout until the next `add`.
        """

    def keep(self, episodes: Sequence[Transitions], share: float | None = None) -> None:  # noqa: ARG002 (interface)
        """Store demonstrations for good, beside the environments' transitions.

        Args:
            episodes: whole ones, each with its steps along the leading axis; `environment` is not looked at.
            share: of each batch that comes from demonstrations; None: they are sampled as all else is.

        Raises:
            UsageError: this buffer has no place for them.
        """
        raise UsageError(
            f"{type(self).__name__} keeps no demonstrations",
            where="demonstrations",
            hint="use a replay buffer, e.g. uniform, and an agent that learns from it",
        )

    def metrics(self) -> Mapping[str, float]:
        """Numbers about what is stored, for whoever watches a run; nothing by default."""
        return {}

    def update_priorities(self, slot: NDArray[np.int64], priorities: FloatArray) -> None:
        """Tell the sampler how large the errors of a batch were. Nothing to do where sampling is uniform."""

    @abstractmethod
    def __len__(self) -> int:
        """Transitions that can be sampled now: none of a rollout before it is complete."""

    @abstractmethod
    def state(self) -> State: ...

    @abstractmethod
    def load_state(self, state: State) -> None: ...


class Failure(NamedTuple):
    """An environment that raised, or a worker that died or hung: these environments have lost their episodes."""

    environment: NDArray[np.int64]
    error: KarolosError


class Received(NamedTuple):
    """What an orchestrator gives back: the environments that answered, in ascending order, and their steps."""

    environment: NDArray[np.int64]
    step: Step
    updates: NDArray[np.int64]
    """The gradient updates behind the policy that chose each action, as `Orchestrator.step` was told; -1 after a
    reset. What has been learned since is the policy lag."""
    failures: tuple[Failure, ...] = ()

    @property
    def failed(self) -> NDArray[np.int64]:
        """The environments that have lost their episodes, in ascending order."""
        return np.unique(np.concatenate([np.zeros(0, np.int64), *(failure.environment for failure in self.failures)]))


class Orchestrator(ABC):
    """Many environments, addressed by id 0 .. size - 1, each with at most one command under way.

    Failure. An environment that raises, or whose worker dies or hangs, loses its episode, whether it was busy or idle.
    The next `receive` names it in `failed`, with the reason in `failures`, and gives no answer of it. It is idle then
    and has no episode before it is reset, which builds it anew, with a new worker where the old one is gone. A loop
    therefore cuts the lost episodes short in its buffer (`buffer.cut(received.failed)`), forgets what it counted of
    them, notes the failures and resets these environments with fresh seeds; the reset may fail as any command may.
    What goes on failing raises from `receive`, so that no loop has to count.
    """

    signature: Signature
    size: int

    @abstractmethod
    def reset(self, environments: Sequence[int] | NDArray[np.int64], seeds: Sequence[int]) -> None:
        """Begin an episode in each environment named, with the seed that stands beside it. Does not wait."""

    @abstractmethod
    def step(self, environments: Sequence[int] | NDArray[np.int64], actions: FloatArray, *, updates: int = 0) -> None:
        """Hand each environment named its row of actions. Does not wait.

        `updates` says how many gradient updates the policy behind the actions had seen, and comes back with the step.
        """

    @abstractmethod
    def receive(self, at_least: int | None = None) -> Received:
        """Wait for all commands under way (lockstep), or until `at_least` environments have answered or failed (async).

        Gives all that has answered by then; 0 does not wait. The arrays are the caller's to keep.
        """

    @abstractmethod
    def parameters(self, environments: Sequence[int] | NDArray[np.int64]) -> FloatArray:
        """What domain randomization drew for the running episodes: (n, signature.parameters.size)."""

    def describe(self) -> dict[str, Any]:
        """How the environments share the machine, and what led to it, for the record; JSON-able."""
        return {}

    @abstractmethod
    def close(self) -> None:
        """End workers and free shared memory. Safe to call twice."""

    def __enter__(self) -> Orchestrator:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
