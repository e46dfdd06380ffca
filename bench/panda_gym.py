"""Success with the zoo's settings on panda-gym's stacking, sliding and flipping in a given time, by two rules."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from importlib import import_module
from statistics import fmean
from time import monotonic
from typing import Any, Literal

import gymnasium
import numpy as np

from karolos.core import FloatArray

from .side_by_side import Row, require

SETTINGS = {"batch_size": 2048, "buffer_size": 1_000_000, "gamma": 0.95, "learning_rate": 1e-3, "tau": 0.05}
HINDSIGHT = {"n_sampled_goal": 4, "goal_selection_strategy": "future"}
NETWORKS = {"net_arch": [512, 512, 512], "n_critics": 2}
"""Those of TQC for every task of panda-gym: rl-baselines3-zoo, hyperparams/tqc.yml, with its TimeFeatureWrapper."""
STILL = 0.02
"""m/s below which something is at rest."""
Task = Literal["stack", "slide", "flip"]


def measure(*, task: Task = "stack", minutes: float = 10.0, episodes: int = 100, seed: int = 0) -> Iterator[Row]:
    """Success at the last step of an episode after this many minutes of training, by both rules.

    Ours: `stack` one cube on the other within 1.5 cm, let go and at rest, wherever they are; `slide` the puck within 5
    cm and at rest; `flip` within 15 degrees.
    """
    hint = "pip install stable-baselines3 sb3-contrib, and panda-gym with --no-deps, in an environment beside karolos"
    for module in ("panda_gym", "sb3_contrib"):
        require(module, hint=hint)
    import_module("panda_gym")  # registers its environments
    engine = import_module("panda_gym.pybullet").PyBullet
    engine.create_box = _untextured(engine.create_box)
    flip: Any = import_module("panda_gym.envs.tasks.flip")
    flip.angle_distance = _angle_distance
    contributed, wrappers = import_module("sb3_contrib"), import_module("sb3_contrib.common.wrappers")
    her = import_module("stable_baselines3").HerReplayBuffer
    environment = wrappers.TimeFeatureWrapper(gymnasium.make(f"Panda{task.title()}-v3"))
    model = contributed.TQC(
        "MultiInputPolicy",
        environment,
        seed=seed,
        device="cpu",
        replay_buffer_class=her,
        replay_buffer_kwargs=HINDSIGHT,
        policy_kwargs=NETWORKS,
        learning_starts=1000,
        **SETTINGS,
    )
    end = monotonic() + 60 * minutes
    model.learn(10**9, callback=lambda _known, _all: monotonic() < end)
    theirs, ours, stacked = [], [], MEASURES[task]
    for episode in range(episodes):
        observed, _ = environment.reset(seed=10_000 * (seed + 1) + episode)
        over, info = False, dict[str, Any]()
        while not over:
            action, _ = model.predict(observed, deterministic=True)
            observed, _, terminated, truncated, info = environment.step(action)
            over = terminated or truncated
        theirs.append(bool(info["is_success"]))
        ours.append(stacked(environment.unwrapped, observed))
    environment.close()
    case = f"panda-gym {task}, TQC after {minutes:g} min and {model.num_timesteps:,} steps"
    yield Row(f"{case}, its measure", fmean(theirs), "success at the end")
    yield Row(f"{case}, ours", fmean(ours), "success at the end")


def _untextured(create_box: Callable[..., None]) -> Callable[..., None]:
    """Boxes without pictures: the wheel of panda-gym lacks that of the cube which is flipped."""

    def create(*arguments: Any, texture: object = None, **options: Any) -> None:  # noqa: ARG001
        create_box(*arguments, **options)

    return create


def _angle_distance(one: FloatArray, other: FloatArray) -> Any:
    """That of panda-gym by row: on batches its own is that of all pairs of rows, which no relabelling can use."""
    return 1 - np.sum(one * other, axis=-1) ** 2


def _stacked(environment: Any, _: Mapping[str, Any]) -> bool:
    sim, robot = environment.sim, environment.robot
    lower, upper = (np.array(sim.get_base_position(name)) for name in ("object1", "object2"))
    if lower[2] > upper[2]:
        lower, upper = upper, lower
    off = upper - lower
    moving = max(float(np.linalg.norm(sim.get_base_velocity(name))) for name in ("object1", "object2"))
    held = robot.get_fingers_width() < 0.045 and float(np.linalg.norm(robot.get_ee_position() - upper)) < 0.05
    return bool(np.hypot(off[0], off[1]) < 0.015 and abs(off[2] - 0.04) < 0.01 and moving < STILL and not held)


def _slid(environment: Any, observed: Mapping[str, Any]) -> bool:
    off = float(np.linalg.norm(observed["achieved_goal"] - observed["desired_goal"]))
    return off < 0.05 and float(np.linalg.norm(environment.sim.get_base_velocity("object"))) < STILL


def _flipped(_: Any, observed: Mapping[str, Any]) -> bool:
    cosine = abs(float(np.dot(observed["achieved_goal"], observed["desired_goal"])))
    return bool(2 * np.arccos(min(cosine, 1.0)) < np.radians(15))


MEASURES: Mapping[str, Callable[[Any, Mapping[str, Any]], bool]] = {
    "stack": _stacked,
    "slide": _slid,
    "flip": _flipped,
}
