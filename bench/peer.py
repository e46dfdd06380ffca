"""What stable-baselines3 learns on a spec of `bench/agents`, at the settings in `peers.yaml`."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from functools import partial
from importlib import import_module
from pathlib import Path
from statistics import fmean
from typing import Any

import gymnasium
import numpy as np
import yaml

from karolos.environments.build import build_environment
from karolos.environments.gymnasium.export import GoalEnv
from karolos.errors import UsageError
from karolos.specification import Spec, load_spec

from .side_by_side import Row, require

PEERS = Path(__file__).parent / "peers.yaml"


def measure(*, spec: Path, seeds: int = 5, steps: int | None = None) -> Iterator[Row]:
    """One row per seed: mean return, or share of success at the end, over as many test episodes as the spec has.

    Args:
        spec: file whose name peers.yaml has; determines environment and episodes.
        steps: of the peer; by default those of the spec.

    Raises UsageError for another spec, MachineError where stable-baselines3 is missing.
    """
    require("stable_baselines3", hint="pip install stable-baselines3, in an environment of its own beside karolos")
    loaded, recipe = load_spec(spec), yaml.safe_load(PEERS.read_text("utf-8")).get(spec.stem)
    if recipe is None:
        raise UsageError(f"{PEERS.name} has no settings for {spec.stem}")
    steps = loaded.training.steps if steps is None else steps
    library, vectors = import_module("stable_baselines3"), import_module("stable_baselines3.common.vec_env")
    make = partial(_environment, loaded)
    settings = recipe["settings"] | (recipe.get("tuned", {}) if steps == recipe.get("steps") else {})
    for name in recipe.get("linear", ()):
        settings[name] = partial(operator.mul, settings[name])  # of the fraction of steps that is left
    if "noise" in recipe:
        noise, columns = import_module("stable_baselines3.common.noise"), make().action_space.shape
        settings["action_noise"] = noise.NormalActionNoise(np.zeros(columns), np.full(columns, recipe["noise"]))
    if recipe.get("hindsight"):
        settings["replay_buffer_class"] = library.HerReplayBuffer
        settings["replay_buffer_kwargs"] = {"n_sampled_goal": 4, "goal_selection_strategy": "future"}
    has_return = loaded.environment.name == "gymnasium"
    policy, unit = ("MlpPolicy", "return") if has_return else ("MultiInputPolicy", "success at the end")
    for seed in range(seeds):
        training = vectors.DummyVecEnv([make] * recipe.get("environments", 1))
        model = getattr(library, recipe["algorithm"])(policy, training, seed=seed, device="cpu", **settings)
        model.learn(steps)
        returns, successes = _tested(model, vectors.DummyVecEnv([make]), loaded.testing.episodes, seed)
        case = f"{spec.stem}, stable-baselines3 after {steps:,} steps, seed {seed}"
        yield Row(case, fmean(returns if has_return else successes), unit)


def _environment(spec: Spec) -> Any:
    if spec.environment.name == "gymnasium":
        return gymnasium.make(spec.environment.settings.id)
    return GoalEnv(build_environment(spec.recipe(randomize=False)))


def _tested(model: Any, environment: Any, episodes: int, seed: int) -> tuple[list[float], list[bool]]:
    """Return of each test episode of the deterministic policy, and whether its last step is a success."""
    successes = []

    def step(known: dict[str, Any], _: dict[str, Any]) -> None:
        if known["done"]:
            successes.append(bool(known["info"].get("is_success", False)))

    evaluate = import_module("stable_baselines3.common.evaluation").evaluate_policy
    environment.seed(10_000 * (seed + 1))
    returns, _ = evaluate(model, environment, episodes, callback=step, return_episode_rewards=True, warn=False)
    environment.close()
    return returns, successes
