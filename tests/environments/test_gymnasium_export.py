"""Robots with tasks in gymnasium."""

import subprocess
import sys
import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.rig import ENGINES

from karolos.environments.build import build_environment
from karolos.environments.gymnasium.export import GoalEnv, RobotTaskEnv
from karolos.errors import UsageError
from karolos.evaluation.playing import evaluate
from karolos.evaluation.policies import expert_policy
from karolos.gym import environment_ids
from karolos.specification import spec_from_dict

IDS = sorted(environment_ids())
SHOWN = [name for name in IDS if name.startswith("karolos/Panda")]
"""Each task with one robot."""
DIFFERENT = ["karolos/UR5Reach-v1", "karolos/PandaThrow-v1", "karolos/PandaInsert-v1"]
"""Rewards of the goals alone, ends at a goal, and a part of the reward that does not depend on the goal."""


def test_every_pair_of_the_registry_has_an_id():
    assert {"karolos/PandaReach-v1", "karolos/PandaPush-v2"} <= set(IDS)
    assert set(IDS) <= set(gymnasium.registry)


def test_an_id_whose_episodes_became_longer_stays_and_gymnasium_says_that_there_is_a_newer_one():
    with pytest.warns(DeprecationWarning, match="PandaPush-v1 is out of date.*upgrading to version `v2`"):
        older = gymnasium.make("karolos/PandaPush-v1")
    steps = [one.spec.max_episode_steps for one in (older, gymnasium.make("karolos/PandaPush-v2"))]
    assert steps == [50, 75]


@pytest.mark.parametrize("name", ["karolos/PandaPush-v2", "karolos/PandaPickPlace-v2"])
def test_the_expert_solves_what_was_too_short_for_it(name):
    environment = gymnasium.make(name).unwrapped._environment
    assert evaluate(environment, expert_policy(environment), episodes=24, seed=0).success_end == 1
    environment.close()


@pytest.mark.parametrize("name", SHOWN)
def test_environment_passes_gymnasiums_own_check(name):
    environment = gymnasium.make(name).unwrapped
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is (-)?infinity")  # how far things fly has no bound
        check_env(environment)
    environment.close()


def goal_env(**environment: object) -> GoalEnv:
    spec = spec_from_dict({"environment": environment, "agent": "dqn", "buffer": "uniform"})
    return GoalEnv(build_environment(spec.recipe(randomize=False)))


@pytest.mark.filterwarnings("ignore::UserWarning")  # unbounded observations, no id
def test_an_environment_without_a_robot_passes_the_check_too_if_it_has_goals():
    check_env(goal_env(name="bit_flip", bits=6))
    with pytest.raises(UsageError, match="no goals"):
        goal_env(name="gymnasium", id="CartPole-v1", reward_range=[0, 1])


@pytest.mark.parametrize("name", DIFFERENT)
def test_rewards_and_ends_are_those_of_the_goals_one_by_one_and_together(name):
    environment = gymnasium.make(name).unwrapped
    environment.reset(seed=3)
    environment.action_space.seed(0)
    steps, over = [], False
    while not over:
        steps.append(environment.step(environment.action_space.sample()))
        over = steps[-1][2] or steps[-1][3]
    for state, reward, terminated, truncated, info in steps:
        goals = state["achieved_goal"], state["desired_goal"], info
        assert environment.compute_reward(*goals) == pytest.approx(reward, abs=1e-6)
        assert environment.compute_terminated(*goals) == terminated
        assert environment.compute_truncated(*goals) == truncated
    achieved, desired = (np.stack([step[0][key] for step in steps]) for key in ("achieved_goal", "desired_goal"))
    rewards = np.array([step[1] for step in steps], np.float32)
    computed = environment.compute_reward(achieved, desired, [step[4] for step in steps])
    np.testing.assert_allclose(computed, rewards, atol=1e-6)
    extra = [step[4].get("extra_reward", 0.0) for step in steps]
    for unknown in ({}, None):
        np.testing.assert_allclose(environment.compute_reward(achieved, desired, unknown) + extra, rewards, atol=1e-5)
    np.testing.assert_array_equal(environment.compute_terminated(achieved, desired, None), [s[2] for s in steps])
    assert steps[-1][2] or steps[-1][3]
    environment.close()


def test_the_spec_says_how_many_steps_an_episode_has():
    environment = gymnasium.make("karolos/PandaReach-v1", max_steps=7)
    assert environment.spec.max_episode_steps == environment.unwrapped.spec.max_episode_steps == 7
    assert gymnasium.make(environment.spec).spec.max_episode_steps == 7


def test_a_limit_of_steps_from_outside_holds_or_is_refused():
    shorter = gymnasium.make("karolos/PandaReach-v1", max_episode_steps=2)
    shorter.reset(seed=0)
    assert [shorter.step(shorter.action_space.sample())[3] for _ in range(2)] == [False, True]
    longer = gymnasium.make("karolos/PandaReach-v1", max_episode_steps=60)
    for environment in (longer, gymnasium.wrappers.TimeLimit(gymnasium.make("karolos/PandaReach-v1"), 60)):
        with pytest.raises(UsageError, match="60 steps has no effect: episodes end after 50; give max_steps=60"):
            environment.reset()


def test_a_film_has_the_control_rate():
    assert gymnasium.make("karolos/PandaReach-v1").metadata["render_fps"] == 24
    assert gymnasium.make("karolos/PandaReach-v1", substeps=5).metadata["render_fps"] == 48


def test_a_window_is_offered_by_the_engine_that_has_one(monkeypatch):
    monkeypatch.setitem(RobotTaskEnv.metadata, "render_modes", ["human", "rgb_array"])
    for engine in ENGINES:
        modes = RobotTaskEnv("panda", "reach", engine=engine).metadata["render_modes"]
        assert ("human" in modes) == (engine == "bullet")


@pytest.mark.parametrize("imports", ["karolos.gym, gymnasium", "gymnasium"])
def test_registering_needs_no_order_of_imports_and_imports_no_physics(imports):
    module = "" if "karolos" in imports else "karolos.gym:"
    code = (
        f"import sys, {imports}\n"
        "assert not {'pybullet', 'mujoco', 'torch', 'yaml', 'sqlalchemy', 'pydantic'} & set(sys.modules)\n"
        f"env = gymnasium.make('{module}karolos/PandaReach-v1', control='joint', threshold=0.1)\n"
        "assert env.action_space.shape == (7,)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


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
def test_setting_that_makes_no_sense_is_named(settings, message):
    with pytest.raises(UsageError, match=message):
        gymnasium.make("karolos/PandaReach-v1", **settings)


def test_seed_begins_one_episode_and_what_follows_it_hangs_on_it():
    environment = gymnasium.make("karolos/PandaReach-v1").unwrapped
    goals = [environment.reset(seed=4)[0]["desired_goal"], environment.reset()[0]["desired_goal"]]
    again = [environment.reset(seed=4)[0]["desired_goal"], environment.reset()[0]["desired_goal"]]
    np.testing.assert_array_equal(goals, again)
    assert not np.array_equal(*goals)
    environment.close()


def test_stable_baselines_learns_from_hindsight_without_an_adapter():
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
