"""Twin delayed deterministic policy gradient (Fujimoto et al. 2018, arXiv 1802.09477)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

from numpy import int64
from numpy.typing import NDArray
from pydantic import Field as Setting

from ..core import Agent, Batch, FloatArray, Signature, State
from ..deployed import Deployed
from ..seeding import SeedTree
from .deterministic import LEARNED, Deterministic, DeterministicSettings, Variant


class TD3(Agent):
    """DDPG with three cures for overestimated values: two critics, delayed policy updates, noise on target actions.

    Off-policy, continuous actions in [-1, 1].

    Raises:
        UsageError: the environment takes discrete actions.
    """

    class Settings(DeterministicSettings):
        target_noise: float = Setting(0.2, ge=0, description="standard deviation of noise on targets' actions")
        noise_clip: float = Setting(0.5, ge=0, description="largest such noise")
        policy_delay: int = Setting(2, ge=1, description="critic updates for each update of policy and targets")

    on_policy: ClassVar[bool] = False
    learned: ClassVar[tuple[str, ...]] = LEARNED

    def __init__(self, settings: TD3.Settings, signature: Signature, seeds: SeedTree, device: str = "cpu") -> None:
        self.settings, self.discount = settings, settings.discount
        variant = Variant(
            "td3",
            critics=2,
            target_noise=settings.target_noise,
            noise_clip=settings.noise_clip,
            policy_delay=settings.policy_delay,
        )
        self.core = Deterministic(settings, variant, signature, seeds, device)

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
