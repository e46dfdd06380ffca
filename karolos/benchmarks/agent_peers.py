"""stable-baselines3 on the benchmark's tasks, at the settings in peers.yaml."""

from __future__ import annotations

import operator
from collections.abc import Mapping
from functools import partial
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from statistics import fmean
from typing import Any, cast

import gymnasium
import numpy as np

from ..environments.build import build_environment
from ..environments.gymnasium.export import GoalEnv
from ..files import parse_object, write_json
from ..spec import Spec
from ..spec.yaml_text import read
from .side_by_side import require_modules

PEER = "stable-baselines3"


def _recipes() -> dict[str, dict[str, Any]]:
    """The contents of peers.yaml, by names of specs."""
    document, _ = read((files(__package__) / "peers.yaml").read_text("utf-8"), "peers.yaml")
    assert document is not None
    return cast("dict[str, dict[str, Any]]", document.plain())


RECIPES = _recipes()


def require() -> None:
    """Raise a MachineError unless stable-baselines3 is installed."""
    require_modules("pip install stable-baselines3, in an environment of its own beside karolos", "stable_baselines3")


def numbers_of_steps(name: str, spec: Spec) -> tuple[int, ...]:
    """Steps that the peer makes: those of the spec, then those that its settings are tuned for if they differ.

    Empty if there is no recipe of this name.
    """
    if name not in RECIPES:
        return ()
    steps = spec.training.steps
    return tuple(dict.fromkeys((steps, RECIPES[name].get("steps", steps))))


def value(name: str, spec: Spec, steps: int, seed: int, unit: str, folder: Path) -> float:
    """The peer's figure after some steps and over as many test episodes as the spec has.

    A figure that is stored in `folder` is not computed again.

    Args:
        name: of the recipe.
        spec: determines the environment and the number of episodes.
        steps: that the peer makes.
        seed: of the peer's generators.
        unit: "return" or "success".
        folder: runs folder; the figures are stored in its folder `peers`.
    """
    path = folder / "peers" / f"{name}-{steps}-s{seed}.json"
    if path.exists():
        known = parse_object(path.read_bytes()) or {}
        if unit in known:
            return float(known[unit])
    recipe = RECIPES[name]
    tuned = recipe.get("tuned", {}) if steps == recipe.get("steps") else {}
    model = _model(recipe | {"settings": recipe["settings"] | tuned}, spec, seed)
    model.learn(steps)
    found = _test(model, _one(spec), spec.testing.episodes, seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, found)
    return found[unit]


def _one(spec: Spec) -> Any:
    if spec.environment.name == "gymnasium":
        return gymnasium.make(spec.environment.settings.id)
    return GoalEnv(build_environment(spec.recipe(randomize=False)))


def _model(recipe: Mapping[str, Any], spec: Spec, seed: int) -> Any:
    library = import_module("stable_baselines3")
    vectors = import_module("stable_baselines3.common.vec_env")
    settings = dict(recipe["settings"])
    for name in recipe.get("linear", ()):
        settings[name] = partial(operator.mul, settings[name])  # of the fraction of steps that is left
    if "noise" in recipe:
        noises = import_module("stable_baselines3.common.noise")
        columns = _one(spec).action_space.shape
        settings["action_noise"] = noises.NormalActionNoise(np.zeros(columns), np.full(columns, recipe["noise"]))
    if recipe.get("hindsight"):
        settings |= hindsight()
    many = vectors.DummyVecEnv([lambda: _one(spec)] * recipe.get("environments", 1))
    kind = getattr(library, recipe["algorithm"])
    goals = spec.environment.name != "gymnasium"
    return kind("MultiInputPolicy" if goals else "MlpPolicy", many, seed=seed, device="cpu", **settings)


def hindsight() -> dict[str, Any]:
    """Settings of a replay buffer with hindsight."""
    library = import_module("stable_baselines3")
    relabelling = {"n_sampled_goal": 4, "goal_selection_strategy": "future"}
    return {"replay_buffer_class": library.HerReplayBuffer, "replay_buffer_kwargs": relabelling}


def _test(model: Any, environment: Any, episodes: int, seed: int) -> dict[str, float]:
    """Mean return, and fraction of episodes with success at the end, of the deterministic policy."""
    results = [play(model, environment, 10_000 * (seed + 1) + episode) for episode in range(episodes)]
    environment.close()
    return dict(zip(("return", "success"), map(fmean, zip(*results, strict=True)), strict=True))


def play(model: Any, environment: Any, seed: int) -> tuple[float, bool]:
    """Return of an episode of the deterministic policy, and whether its last step is a success."""
    observation, _ = environment.reset(seed=seed)
    total, success, over = 0.0, False, False
    while not over:
        action, _ = model.predict(observation, deterministic=True)
        observation, reward, terminated, truncated, info = environment.step(action)
        total += float(reward)
        success = bool(info.get("is_success", False))
        over = bool(terminated or truncated)
    return total, success
