"""An environment of gymnasium's as one of karolos's."""

import pickle
from typing import Any

import numpy as np
import pytest

from karolos.buffers.uniform import Uniform
from karolos.core import Discrete, Transitions
from karolos.core.seeding import SeedTree
from karolos.environments.gymnasium.adapter import Gymnasium
from karolos.errors import KarolosError, PluginError, UsageError
from karolos.plugins.contracts import check

POINT = "support.goal_environments:Point-v0"
ENDING = "support.goal_environments:Ending-v0"


def make(**settings: Any) -> Gymnasium:
    return Gymnasium(Gymnasium.Settings(**settings))


def play(environment: Gymnasium, seed: int, action: list[float]) -> list[Any]:
    steps = [environment.reset(seed)]
    while not (steps[-1].terminated or steps[-1].truncated):
        steps.append(environment.step(np.array(action, np.float32)))
    return steps


def test_discrete_actions_become_labels_and_the_pole_falls():
    environment = make(id="CartPole-v1")
    assert environment.signature.action == Discrete(("0", "1"))
    steps = play(environment, 1, [1])
    assert steps[-1].terminated
    assert not steps[-1].truncated
    assert steps[0].observation.shape == (4,)
    with pytest.raises(RuntimeError, match="over"):
        environment.step(np.zeros(1))
    with pytest.raises(ValueError, match="from 0 to 1"):
        environment.step(np.array([2.0]))


def test_box_actions_are_rescaled():
    environment = make(id="Pendulum-v1")
    assert environment._converted(np.array([1.0]))[0] == 2.0
    assert environment._converted(np.array([-0.5]))[0] == -1.0
    with pytest.raises(ValueError, match="finite"):
        environment.step(np.array([np.nan]))


def test_measures_are_numbers_of_the_last_info():
    measures = {"is_success": {"better": "larger"}, "force": {"unit": "N", "better": "smaller"}}
    environment = make(id=POINT, goals=True, measures=measures)
    assert [one.unit for one in environment.signature.measures] == ["1", "N"]
    end = play(environment, 0, [0.0, 0.0])[-1]
    np.testing.assert_array_equal(environment.measures(), np.array([end.success, np.nan], np.float32))
    environment._info = {"force": "much"}
    with pytest.raises(UsageError, match="other values than numbers"):
        environment.measures()


def test_own_limit_of_steps_truncates():
    assert make(id="support.faulty_environments:Limited-v0").signature.max_steps == 4
    steps = play(make(id="Pendulum-v1", max_steps=7), 0, [0.0])
    assert len(steps) == 8
    assert steps[-1].truncated


def test_a_step_that_diverges_has_no_reward_and_repeats_the_state_before(monkeypatch):
    environment = make(id="Pendulum-v1")
    environment.reset(0)
    before = environment.step(np.zeros(1, np.float32))
    broken = (np.full(3, np.nan), -1.0, False, False, {})
    monkeypatch.setattr(environment._env, "step", lambda action: broken)
    after = environment.step(np.zeros(1, np.float32))
    assert after.diverged
    assert after.truncated
    assert before.reward < 0 == after.reward
    np.testing.assert_array_equal(after.observation, before.observation)


@pytest.mark.parametrize(("threshold", "success"), [(5.0, True), (500.0, False)])
def test_success_is_a_return_at_the_end(threshold, success):
    steps = play(make(id="CartPole-v1", success_return=threshold), 1, [1])
    assert bool(steps[-1].success) is success
    assert not any(step.success for step in steps[:-1])


@pytest.mark.parametrize(
    ("settings", "where"),
    [
        ({"id": "CartPol-v1"}, "environment.id"),
        ({"id": "CartPole"}, "environment.id"),
        ({"id": "nowhere:Foo-v1"}, "environment.id"),
        ({"id": "a b"}, "environment.id"),
        ({"id": "CartPole-v1", "kwargs": {"foo": 1}}, "environment.kwargs"),
        ({"id": "karolos.gym:karolos/PandaReach-v1"}, "environment.goals"),
        ({"id": "FrozenLake-v1", "kwargs": {"map_name": "9x9"}}, "environment.kwargs"),
        ({"id": "CartPole-v1", "goals": True}, "environment.goals"),
        ({"id": "support.goal_environments:Endless-v0", "flatten_goals": True}, "environment.max_steps"),
        ({"id": POINT, "goals": True, "kwargs": {"fault": "reward"}}, "environment.goals"),
        ({"id": POINT, "goals": True, "kwargs": {"fault": "one goal"}}, "environment.goals"),
        ({"id": POINT, "goals": True, "kwargs": {"dense": True}}, "environment.success_reward"),
        ({"id": POINT, "goals": True, "success_reward": -2}, "environment.success_reward"),
        ({"id": "karolos.gym:karolos/PandaReach-v1", "goals": True, "max_steps": 60}, "environment.max_steps"),
        ({"id": "support.faulty_environments:Limited-v0", "max_steps": 11}, "environment.max_steps"),
        ({"id": "support.goal_environments:Pictures-v0"}, "environment.id"),
    ],
)
def test_what_cannot_work_is_one_clear_line_about_a_setting(settings, where):
    with pytest.raises(KarolosError) as caught:
        make(**settings)
    assert caught.value.setting == where
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("nowhere:Foo-v1", "Python finds no module 'nowhere'; put the folder of its file into PYTHONPATH"),
        ("support.nowhere:Foo-v1", "Python finds no module 'support.nowhere'; put"),
        ("CartPole", "names no version, and gymnasium takes the newest; write CartPole-v1"),
    ],
)
def test_an_id_that_gymnasium_does_not_find_is_told_with_what_to_do(name, told):
    with pytest.raises(KarolosError, match=told):
        make(id=name)


@pytest.mark.parametrize("file", ["envs.py", "./envs.py", "mine/envs.py", "..\\mine\\envs.py"])
def test_a_file_in_place_of_a_module_is_refused(file):
    with pytest.raises(ValueError, match='write "envs:Point-v0", and put its folder into PYTHONPATH'):
        Gymnasium.Settings(id=f"{file}:Point-v0")


def test_goals_may_be_taken_as_observations():
    environment = make(id="karolos.gym:karolos/PandaReach-v1", flatten_goals=True)
    assert environment.signature.max_steps == 50
    assert set(environment.signature.observation.names) == {"achieved_goal", "desired_goal", "observation"}
    assert environment.reset(0).observation.shape == (environment.signature.observation.size,)
    environment.close()


GOAL_ENVIRONMENTS = [
    {"id": POINT},
    {"id": POINT, "kwargs": {"dense": True}, "success_reward": -0.15},
    {"id": POINT, "kwargs": {"ends": True}, "goal_terminates": True},
    {"id": ENDING},
    {"id": "karolos.gym:karolos/PandaReach-v1"},
]


@pytest.mark.parametrize("settings", GOAL_ENVIRONMENTS, ids=str)
def test_hindsight_relabels_the_goals_of_anybodys_environment(settings):
    environment = make(**settings, goals=True)
    signature = environment.signature
    buffer = Uniform(
        Uniform.Settings.model_validate({"capacity": 500, "hindsight": {"ratio": 1.0, "min_displacement": 0}}),
        signature,
        SeedTree(1),
        environments=1,
        discount=0.9,
    )
    reached: dict[bytes, Any] = {}
    generator = np.random.default_rng(0)
    for seed in range(5):
        step = environment.reset(seed)
        while not (step.terminated or step.truncated):
            action = generator.uniform(-1, 1, signature.action.size).astype(np.float32)
            before, step = step, environment.step(action)
            reached[step.observation.tobytes()] = step.achieved_goal
            values = (0, *before[:3], action, step.reward, *step[:2], step.terminated, step.truncated)
            buffer.add(Transitions(*(np.array(value)[None] for value in values)))
    batch = buffer.sample(256)
    unwrapped = environment._env.unwrapped
    for index in range(256):
        goal, reward = batch.desired_goal[index], batch.reward[index]
        achieved = reached[batch.next_observation[index].tobytes()]
        assert reward == pytest.approx(unwrapped.compute_reward(achieved, goal, {}), abs=1e-6)
        near = np.linalg.norm(achieved - goal) < 0.15
        ends = settings["id"] == ENDING or settings.get("goal_terminates", False)
        assert batch.terminated[index] == (ends and near)
    assert batch.reward.max() == 0.0
    environment.close()


@pytest.mark.parametrize("settings", GOAL_ENVIRONMENTS, ids=str)
def test_anybodys_goal_environment_keeps_the_promises_of_an_environment(settings):
    if "karolos" not in settings["id"]:  # may begin at its goal
        settings = {**settings, "kwargs": {**settings.get("kwargs", {}), "apart": True}}
    check("environments", "gymnasium", **settings, goals=True)


def test_a_goal_rule_goes_to_other_processes_without_its_environment():
    environment = make(id=POINT, goals=True)
    rule = pickle.loads(pickle.dumps(environment.signature.goal_rule))
    achieved = np.zeros((2, 3, 2), np.float32)
    desired = achieved + np.array([0.1, 0.0, 0.2], np.float32)[:, None]
    np.testing.assert_array_equal(rule.reward(achieved, desired), [[0, 0, -1]] * 2)
    np.testing.assert_array_equal(rule.success(achieved, desired), [[True, True, False]] * 2)
    assert not rule.terminated(achieved, desired).any()


@pytest.mark.parametrize(("ends", "said"), [(True, None), (False, True)])
def test_whether_a_goal_ends_an_episode_is_said_or_refused(ends, said):
    environment = make(id=POINT, goals=True, kwargs={"ends": ends}, goal_terminates=said)

    def go_to_the_goal() -> None:
        step = environment.reset(0)
        while True:
            way = np.clip((step.desired_goal - step.achieved_goal) / 0.2, -1, 1)
            step = environment.step(way.astype(np.float32))

    with pytest.raises(PluginError, match="reaches its goal") as caught:
        go_to_the_goal()
    assert caught.value.setting == "environment.goal_terminates"


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        *(({"id": name}, "id") for name in ("a:b:X", ":X", "x:", "")),
        ({"id": POINT, "goals": True, "flatten_goals": True}, "goals"),
        ({"id": POINT, "goals": True, "success_return": 1}, "goals"),
        ({"id": POINT, "success_reward": 1}, "goals"),
        ({"id": POINT, "kwargs": {"max_episode_steps": 3}}, "set max_steps"),
    ],
)
def test_an_id_has_at_most_one_module_and_settings_that_exclude_each_other_are_refused(settings, told):
    with pytest.raises(ValueError, match=told):
        Gymnasium.Settings(**settings)


@pytest.mark.parametrize("module", ["runs.a-s0-1.evil", "runs.a-s0-1", "runs.evil", "a-s0-1.evil", "named.evil", "own"])
def test_a_module_in_a_folder_of_runs_is_not_imported(tmp_path, monkeypatch, module):
    run = tmp_path / "runs" / "a-s0-1"
    run.mkdir(parents=True)
    (run / "run.json").touch()
    for place in (run / "evil.py", run / "__init__.py", run.parent / "evil.py", run.parent / "own.py"):
        place.write_text("raise RuntimeError('imported')")
    (tmp_path / "named").symlink_to(run)
    monkeypatch.syspath_prepend(run.parent)
    monkeypatch.syspath_prepend(tmp_path)
    is_own = module == "own"  # a module on the path, beside runs: --runs .
    with pytest.raises(
        UsageError, match="cannot be made" if is_own else "lies in a folder of runs and is not imported"
    ):
        make(id=f"{module}:X-v0")
