"""Robots with tasks in gymnasium."""

from __future__ import annotations

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from karolos.environments.build import build_environment
from karolos.environments.gymnasium_export import GoalEnv, environment_ids
from karolos.errors import UsageError
from karolos.spec import Spec

IDS = sorted(environment_ids())


def test_every_pair_of_the_registry_has_an_id() -> None:
    assert "karolos/PandaReach-v1" in IDS
    assert set(IDS) <= set(gymnasium.registry)


@pytest.mark.parametrize("name", IDS)
def test_environment_passes_gymnasiums_own_check(name: str) -> None:
    environment = gymnasium.make(name).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is (-)?infinity")  # how far things fly has no bound
        check_env(environment)
    environment.close()


def goal_env(**environment: object) -> GoalEnv:
    spec = Spec.from_dict({"environment": environment, "agent": "dqn", "buffer": "uniform"})
    return GoalEnv(build_environment(spec.recipe(randomize=False)))


@pytest.mark.filterwarnings("ignore::UserWarning")  # unbounded observations, no id
def test_an_environment_without_a_robot_passes_the_check_too_if_it_has_goals() -> None:
    check_env(goal_env(name="bit_flip", bits=6))
    with pytest.raises(UsageError, match="no goals"):
        goal_env(name="gymnasium", id="CartPole-v1", reward_range=[0, 1])


@pytest.mark.parametrize("name", IDS)
def test_rewards_and_ends_are_those_of_the_goals_one_by_one_and_together(name: str) -> None:
    environment = gymnasium.make(name).unwrapped
    environment.reset(seed=3)
    environment.action_space.seed(0)
    steps, over = [], False
    while not over:
        steps.append(environment.step(environment.action_space.sample()))
        over = steps[-1][2] or steps[-1][3]
    for state, reward, terminated, truncated, info in steps:
        goals = state["achieved_goal"], state["desired_goal"], info
        assert environment.compute_reward(*goals) == reward
        assert environment.compute_terminated(*goals) == terminated
        assert environment.compute_truncated(*goals) == truncated
    achieved, desired = (np.stack([step[0][key] for step in steps]) for key in ("achieved_goal", "desired_goal"))
    infos = [step[4] for step in steps]
    np.testing.assert_array_equal(
        environment.compute_reward(achieved, desired, infos), np.array([step[1] for step in steps], np.float32)
    )
    np.testing.assert_array_equal(environment.compute_terminated(achieved, desired, infos), [s[2] for s in steps])
    np.testing.assert_array_equal(environment.compute_truncated(achieved, desired, infos), [s[3] for s in steps])
    assert steps[-1][2] or steps[-1][3]
    environment.close()


def in_a_process_of_its_own(code: str) -> None:
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_id_that_names_its_module_needs_no_import() -> None:
    in_a_process_of_its_own(
        "import gymnasium\n"
        "env = gymnasium.make('karolos:karolos/PandaReach-v1', control='joint', threshold=0.1)\n"
        "assert env.action_space.shape == (7,)\n"
    )


def test_registering_imports_no_physics() -> None:
    in_a_process_of_its_own(
        "import sys, gymnasium, karolos\n"
        "assert 'karolos/PandaReach-v1' in gymnasium.registry\n"
        "assert not {'pybullet', 'torch', 'yaml', 'sqlalchemy', 'pydantic'} & set(sys.modules)\n"
    )


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"contrl": "joint"}, "did you mean 'control'"),
        ({"threshold": -1}, "task.threshold"),
        ({"randomization": {"task.gravty": {"name": "normal", "mean": -9.8, "std": 1}}}, "did you mean 'task.gravity'"),
        ({"randomization": {"task.gravity": {"name": "normal", "mean": -9.8, "std": -1}}}, "task.gravity.std"),
        ({"render_mode": "ascii"}, "render mode"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*render_mode")
def test_setting_that_makes_no_sense_is_named(settings: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        gymnasium.make("karolos/PandaReach-v1", **settings)


def test_seed_begins_one_episode_and_what_follows_it_hangs_on_it() -> None:
    environment = gymnasium.make("karolos/PandaReach-v1").unwrapped
    goals = [environment.reset(seed=4)[0]["desired_goal"], environment.reset()[0]["desired_goal"]]
    again = [environment.reset(seed=4)[0]["desired_goal"], environment.reset()[0]["desired_goal"]]
    np.testing.assert_array_equal(goals, again)
    assert not np.array_equal(*goals)
    environment.close()


def test_stable_baselines_learns_from_hindsight_without_an_adapter() -> None:
    baselines = pytest.importorskip("stable_baselines3")
    environment = gymnasium.make("karolos/PandaReach-v1")
    agent = baselines.SAC(
        "MultiInputPolicy",
        environment,
        replay_buffer_class=baselines.HerReplayBuffer,
        learning_starts=110,
        batch_size=32,
        policy_kwargs={"net_arch": [16]},
        seed=0,
    )
    agent.learn(150)
    assert agent.num_timesteps == 150
    environment.close()
