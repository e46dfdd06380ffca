"""Plugins with settings alone, for tests of the registry and of specs."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, model_validator
from pydantic import Field as Setting

from karolos.core import Agent, Buffer, Field, Layout, Settings, Signature, Step
from karolos.environments.distributions import Distribution


class Fake:
    """Can be built from anything, as far as putting a spec's parts together goes."""

    signature = Signature(Layout((Field("seen", 1),)), Layout((Field("done", 1),)), 10)
    discount = 0.9

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def close(self) -> None: ...

    reset = step = receive = draw = prepare = fit = build = apply = act = read = observe = achieved = close
    learn = add = cut = sample = state = load_state = __len__ = close


class Arm(Fake):
    """An arm."""

    class Settings(Settings):
        control: Literal["joint", "cartesian"] = Setting("cartesian", description="what an action moves")
        step: float = Setting(0.05, gt=0, description="m per control step")


class OtherArm(Fake):
    class Settings(Settings):
        speed: float = Setting(1.0, gt=0, description="rad/s")


class Reach(Fake):
    class Settings(Settings):
        threshold: float = Setting(0.05, gt=0, description="m")
        reward: Literal["sparse", "dense"] = Setting("sparse", description="what a step is worth")
        box: tuple[float, float, float] | None = Setting(None, description="m")
        visible: bool = Setting(True, description="whether the goal is drawn")


class RobotTask(Fake):
    class Settings(Settings):
        substeps: int = Setting(10, ge=1, description="physics steps per control step")

    declared: ClassVar[dict[str, object]] = {}

    def reset(self, seed: int) -> Step:
        nothing = np.zeros(0, np.float32)
        return Step(np.zeros(1, np.float32), nothing, nothing, 0.0, False, False, False)

    step = reset

    def parameters(self) -> Any:
        return np.zeros(0, np.float32)

    def randomize(self, distributions: dict[str, object]) -> None:
        assert not distributions


class Point(Fake):
    class Settings(Settings):
        dimensions: int = Setting(2, ge=1, description="of the space")
        label: str = Setting("point", description="shown in pictures")


class Decay(Settings):
    rate: float = Setting(0.5, gt=0, le=1, description="per million steps")
    floor: float = Setting(0.0, ge=0, description="smallest value")


class Learner(Fake, Agent):
    """Learns from replay."""

    on_policy = False

    class Settings(Settings):
        learning_rate: float = Setting(1e-3, gt=0, description="of all networks")
        discount: float = Setting(0.98, ge=0, lt=1, description="per step")
        hidden: tuple[int, ...] = Setting((256, 256), description="units per layer")
        entropy: float | Literal["auto"] = Setting("auto", description="target in nats")
        decay: Decay | bool = Setting(False, description="of the learning rate")


class Latest(Fake, Agent):
    """Learns from its latest actions."""

    on_policy = True

    class Settings(Settings):
        clip: float = Setting(0.2, gt=0, description="of the probability ratio")


class Hindsight(Settings):
    strategy: Literal["future", "final"] = Setting("future", description="which goals")
    ratio: float = Setting(0.8, ge=0, le=1, description="share of relabelled transitions")


class Replay(Fake, Buffer):
    on_policy = False

    class Settings(Settings):
        capacity: int = Setting(1_000_000, ge=1, description="transitions")
        hindsight: Hindsight | None = Setting(None, description="relabelling")


class Rollout(Fake, Buffer):
    on_policy = True

    class Settings(Settings):
        pass


class Local(Fake):
    class Settings(Settings):
        processes: int = Setting(1, ge=0, description="worker processes")
        environments: int = Setting(8, ge=1, description="per process")

        def identity(self) -> dict[str, Any]:
            return {"environments": max(self.processes, 1) * self.environments}


class Normal(Fake):
    class Settings(Settings):
        mean: float = Setting(description="in the parameter's unit")
        std: float = Setting(ge=0, description="in the parameter's unit")


class Interval(Fake):
    class Settings(Settings):
        low: float = Setting(description="in the parameter's unit")
        high: float = Setting(description="in the parameter's unit")

        @model_validator(mode="after")
        def _ordered(self) -> Interval.Settings:
            if self.low > self.high:
                raise ValueError(f"low {self.low:g} lies above high {self.high:g}")
            return self


class WithoutSettings:
    pass


class WithName:
    class Settings(BaseModel):
        name: str = "x"


class Unfinished:
    """Has settings, and nothing that its kind asks for."""

    class Settings(Settings):
        pass


class Abstract(Unfinished, Distribution):
    """Says that it is a distribution, and draws nothing."""


def not_a_class() -> None:
    pass


FAKES = {
    "robots": {"arm": "Arm", "other_arm": "OtherArm"},
    "tasks": {"reach": "Reach"},
    "environments": {"robot_task": "RobotTask", "point": "Point"},
    "agents": {"learner": "Learner", "latest": "Latest"},
    "buffers": {"uniform": "Replay", "rollout": "Rollout"},
    "orchestrators": {"local": "Local"},
    "distributions": {"normal": "Normal", "interval": "Interval"},
}
