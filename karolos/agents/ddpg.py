"""Deep deterministic policy gradient (Lillicrap et al. 2015, arXiv 1509.02971)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from numpy import int64
from numpy.typing import NDArray

from ..core import Agent, Batch, FloatArray, Signature, State
from ..deployed import Deployed
from ..seeding import SeedTree
from .deterministic import LEARNED, Deterministic, DeterministicSettings, Variant


class DDPG(Agent):
    """A deterministic policy that climbs the value its critic gives to actions.

    Off-policy, continuous actions in [-1, 1]. By default it explores with Gaussian noise and a share of uniform
    actions, as OpenAI's hindsight experiments did (Plappert et al. 2018), not with the paper's Ornstein-Uhlenbeck
    process, which is `noise: {kind: ornstein_uhlenbeck}`.

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(DeterministicSettings):
        """As of every agent with a deterministic policy."""

    on_policy: ClassVar[bool] = False
    learned: ClassVar[tuple[str, ...]] = LEARNED

    def __init__(self, settings: DDPG.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        self.settings, self.discount = settings, settings.discount
        self.core = Deterministic(settings, Variant("ddpg"), signature, seeds, device)

    def act(
        self,
        observation: FloatArray,
        desired_goal: FloatArray,
        *,
        explore: bool,
        environments: NDArray[int64] | None = None,
    ) -> FloatArray:
        return self.core.act(observation, desired_goal, explore=explore, environments=environments)

    def begin_episodes(self, environments: NDArray[int64]) -> None:
        self.core.noise.begin(environments)

    def learn(self, batch: Batch) -> Mapping[str, Any]:
        return self.core.learn(batch)

    def deployed(self) -> Deployed:
        return self.core.deployed()

    def state(self) -> State:
        return self.core.state()

    def load_state(self, state: State) -> None:
        self.core.load_state(state)
