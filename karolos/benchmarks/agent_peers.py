"""stable-baselines3 on the benchmark's tasks, at the settings that rl-baselines3-zoo tuned for them.

Source of the settings: https://github.com/DLR-RM/rl-baselines3-zoo, hyperparams/{dqn,ppo,sac,td3,ddpg}.yml. For
reaching they are those of Fetch (sac.yml, FetchReach), also for TD3 and DDPG. DQN with hindsight and
PPO on reaching are not tuned there and get karolos's own settings. The number of steps is that of karolos.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from statistics import fmean
from typing import Any

import gymnasium
import numpy as np

from ..environments.build import build_environment
from ..environments.gymnasium_export import GoalEnv
from ..errors import MachineError
from ..files import parse_object, write_json
from ..spec import Spec

PEER = "stable-baselines3"


@dataclass(frozen=True)
class _Recipe:
    """An algorithm of stable-baselines3 and its settings for one task."""

    algorithm: str
    settings: dict[str, Any]
    environments: int = 1
    noise: float = 0.0
    """Standard deviation of Gaussian noise on exploring actions."""
    hindsight: bool = False
    falling: tuple[str, ...] = ()
    """Settings that fall linearly to 0 over the run."""


_PENDULUM: dict[str, Any] = {
    "gamma": 0.98,
    "learning_rate": 1e-3,
    "buffer_size": 200_000,
    "train_freq": 1,
    "gradient_steps": 1,
    "policy_kwargs": {"net_arch": [400, 300]},
}
_REACH: dict[str, Any] = {"gamma": 0.95, "learning_rate": 1e-3, "batch_size": 256, "learning_starts": 1000}

_DISCRETE: dict[str, Any] = {
    "learning_rate": 1e-3,
    "buffer_size": 1_000_000,
    "learning_starts": 300,
    "tau": 0.05,
    "target_update_interval": 1,
    "exploration_final_eps": 0.05,
    "policy_kwargs": {"net_arch": [256, 256]},
}

RECIPES = {
    "cartpole_dqn": _Recipe(
        "DQN",
        {
            "learning_rate": 2.3e-3,
            "batch_size": 64,
            "buffer_size": 100_000,
            "learning_starts": 1000,
            "gamma": 0.99,
            "target_update_interval": 10,
            "train_freq": 256,
            "gradient_steps": 128,
            "exploration_fraction": 0.16,
            "exploration_final_eps": 0.04,
            "policy_kwargs": {"net_arch": [256, 256]},
        },
    ),
    "cartpole_ppo": _Recipe(
        "PPO",
        {
            "n_steps": 32,
            "batch_size": 256,
            "gae_lambda": 0.8,
            "gamma": 0.98,
            "n_epochs": 20,
            "learning_rate": 1e-3,
            "clip_range": 0.2,
        },
        environments=8,
        falling=("learning_rate", "clip_range"),
    ),
    "pendulum_sac": _Recipe("SAC", {"learning_rate": 1e-3}),
    "pendulum_td3": _Recipe("TD3", _PENDULUM, noise=0.1),
    "pendulum_ddpg": _Recipe("DDPG", _PENDULUM, noise=0.1),
    "pendulum_ppo": _Recipe(
        "PPO",
        {
            "n_steps": 1024,
            "gae_lambda": 0.95,
            "gamma": 0.9,
            "n_epochs": 10,
            "learning_rate": 1e-3,
            "clip_range": 0.2,
            "use_sde": True,
            "sde_sample_freq": 4,
        },
        environments=4,
    ),
    "bit_flip": _Recipe(
        "DQN",
        {**_DISCRETE, "gamma": 0.98, "batch_size": 128, "train_freq": 4, "exploration_fraction": 5 / 20},
        hindsight=True,
    ),
    "panda_reach_dqn": _Recipe(
        "DQN",
        {**_DISCRETE, "gamma": 0.95, "batch_size": 256, "train_freq": 2, "exploration_fraction": 5 / 6},
        hindsight=True,
    ),
    "panda_reach_ppo": _Recipe(
        "PPO",
        {"n_steps": 50, "batch_size": 50, "n_epochs": 10, "gamma": 0.95, "learning_rate": 1e-3},
        environments=8,
    ),
    "panda_reach_sac": _Recipe("SAC", _REACH, hindsight=True),
    "panda_reach_td3": _Recipe("TD3", _REACH, noise=0.2, hindsight=True),
    "panda_reach_ddpg": _Recipe("DDPG", _REACH, noise=0.2, hindsight=True),
}


def require() -> None:
    """Raise a MachineError where stable-baselines3 is not installed."""
    if find_spec("stable_baselines3") is None:
        raise MachineError(
            f"{PEER} is not installed, so there is no peer to train",
            hint="pip install stable-baselines3, in an environment of its own beside karolos",
        )


def value(name: str, spec: Spec, seed: int, unit: str, folder: Path) -> float | None:
    """The peer's figure after the spec's steps and over its test episodes; None where there is no recipe.

    A figure that is stored in `folder` is not computed again.

    Args:
        name: of the recipe.
        spec: determines the environment, the steps and the episodes.
        seed: of the peer's generators.
        unit: "return" or "success".
        folder: runs folder; the figures are stored in its folder `peers`.
    """
    recipe = RECIPES.get(name)
    if recipe is None:
        return None
    path = folder / "peers" / f"{name}-{spec.training.steps}-s{seed}.json"
    if path.exists():
        known = parse_object(path.read_bytes()) or {}
        if unit in known:
            return float(known[unit])
    model = _model(recipe, spec, seed)
    model.learn(spec.training.steps)
    found = _test(model, _one(spec), spec.testing.episodes, seed)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, found)
    return found[unit]


def _one(spec: Spec) -> Any:
    if spec.environment.name == "gymnasium":
        return gymnasium.make(spec.environment.settings.id)
    return GoalEnv(build_environment(spec.recipe(randomize=False)))


def _model(recipe: _Recipe, spec: Spec, seed: int) -> Any:
    library = import_module("stable_baselines3")
    vectors = import_module("stable_baselines3.common.vec_env")
    settings = dict(recipe.settings)
    for name in recipe.falling:
        settings[name] = partial(operator.mul, settings[name])  # of the share of steps that is left
    if recipe.noise:
        noises = import_module("stable_baselines3.common.noise")
        columns = _one(spec).action_space.shape
        settings["action_noise"] = noises.NormalActionNoise(np.zeros(columns), np.full(columns, recipe.noise))
    if recipe.hindsight:
        settings["replay_buffer_class"] = library.HerReplayBuffer
        settings["replay_buffer_kwargs"] = {"n_sampled_goal": 4, "goal_selection_strategy": "future"}
    many = vectors.DummyVecEnv([lambda: _one(spec)] * recipe.environments)
    kind = getattr(library, recipe.algorithm)
    goals = spec.environment.name != "gymnasium"
    return kind("MultiInputPolicy" if goals else "MlpPolicy", many, seed=seed, device="cpu", **settings)


def _test(model: Any, environment: Any, episodes: int, seed: int) -> dict[str, float]:
    """Mean return, and share of episodes with success at some step, of the deterministic policy."""
    returns, successes = [], []
    for episode in range(episodes):
        observation, _ = environment.reset(seed=10_000 * (seed + 1) + episode)
        total, reached, over = 0.0, False, False
        while not over:
            action, _ = model.predict(observation, deterministic=True)
            observation, reward, terminated, truncated, info = environment.step(action)
            total += float(reward)
            reached |= bool(info.get("is_success", False))
            over = bool(terminated or truncated)
        returns.append(total)
        successes.append(reached)
    environment.close()
    return {"return": fmean(returns), "success": fmean(successes)}
