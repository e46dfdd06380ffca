"""Policies: saved agents with their environments, experts and random actions; what cannot be had is refused."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from support.toy_runs import run_of, toy

import karolos
from karolos.core import Array
from karolos.environments.gymnasium.export import GoalEnv
from karolos.environments.toy import Toy
from karolos.errors import MachineError, NoSuchRunError, SpecError, UsageError
from karolos.evaluation.playing import load_expert, load_player, play
from karolos.evaluation.policies import SavedAgent, expert_policy, has_window, load_agent, random_policy
from karolos.export import NumpyPolicy
from karolos.export.export import export_policy
from karolos.records import RunFolder
from karolos.records.shipped import FOLDER
from karolos.specification import Spec, load_spec, spec_from_dict

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy(
    environment={"name": "toy", "max_steps": 7, "reward": "dense"},
    training={"steps": 60, "replay_ratio": 2},
    testing={"interval": 30, "episodes": 4},
)


def reach(**changes: Any) -> Spec:
    return spec_from_dict({"name": "reach", "robot": "panda", "task": "reach", "agent": "sac", **changes})


def test_the_expert_of_a_spec_solves_its_task_without_randomization():
    gravity = {"task.gravity": {"name": "normal", "mean": -9.81, "std": 1.0}}
    with load_expert(reach(randomization=gravity)) as player:
        assert player.environment.signature.parameters.size == 0
        moments = play(player.environment, player.policy, episodes=3, seed=0)
        ends = [moment.success for moment in moments if moment.over]
    assert ends == [True, True, True]


def test_an_environment_without_a_task_has_no_expert():
    with pytest.raises(UsageError, match="there is no expert for this environment"), load_expert(spec_from_dict(TOY)):
        pass
    with pytest.raises(UsageError, match="tasks have experts"):
        expert_policy(Toy(Toy.Settings()))


def test_a_window_needs_an_environment_that_has_one_and_a_display(monkeypatch):
    with (
        pytest.raises(MachineError, match="environment toy has no window"),
        load_expert(spec_from_dict(TOY), window=True),
    ):
        pass
    monkeypatch.delenv("DISPLAY", raising=False)
    bullet = reach(environment={"name": "robot_task", "engine": "bullet"})
    with pytest.raises(MachineError, match="no display"), load_expert(bullet, window=True):
        pass
    assert [has_window(one) for one in (spec_from_dict(TOY), reach())] == [False, False]


def test_a_random_policy_fills_the_action_range_and_is_determined_by_its_seed():
    environment = Toy(Toy.Settings())
    step = environment.reset(0)

    def actions(seed: int) -> Array:
        policy = random_policy(environment, seed)
        return np.array([policy.act(step) for _ in range(200)])

    np.testing.assert_array_equal(actions(1), actions(1))
    assert not np.array_equal(actions(1), actions(2))
    assert actions(1).shape == (200, 2)
    assert actions(1).min() < -0.9
    assert actions(1).max() > 0.9


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return run_of(TOY, tmp_path_factory.mktemp("runs"))


def test_a_saved_policy_plays_without_exploration_and_the_same_each_time(folder):
    def totals() -> list[float]:
        with load_player(folder, "last") as player:
            assert (player.spec.name, player.note) == ("toy", None)
            seed = player.spec.testing.seed
            return [moment.total for moment in play(player.environment, player.policy, episodes=2, seed=seed)]

    assert totals() == totals()
    assert len(set(totals())) > 8, "the point moves"


def test_a_number_that_is_not_finite_is_refused_by_its_name(folder, tmp_path):
    saved = load_agent(folder, "last")
    export_policy(folder, tmp_path, checkpoint="last", onnx=False)
    for values in (np.array([0, np.nan]), np.array([[0, 0], [0, -np.inf]])):
        with pytest.raises(UsageError, match=r"act: observation\[1\], which is position\[1\], is not finite"):
            saved.act(values, np.zeros_like(values))
        with pytest.raises(UsageError, match=r"goal\[1\]"):
            saved.act(np.zeros_like(values), values)
        with pytest.raises(ValueError, match=r"desired_goal\[1\] is not finite"):
            NumpyPolicy(tmp_path / "policy.npz")(np.zeros_like(values), values)


@pytest.mark.parametrize("name", ["panda_reach_dqn", "panda_insert_blind"])
def test_the_environment_of_a_shipped_spec_passes_gymnasiums_check_with_its_settings(name):
    environment, spec = karolos.make(name), load_spec(name)
    assert spec.task is not None
    assert environment.spec is not None
    assert environment.spec.max_episode_steps == spec.task.settings.max_steps
    assert environment.metadata["render_fps"] == 240 / spec.environment.settings.substeps
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message=".*is (-)?infinity")
        check_env(environment)


def test_a_file_a_spec_a_run_and_what_gymnasium_makes_of_it_again_are_one_environment(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("extends: karolos:panda_push.yaml\n")
    made = [karolos.make(one) for one in (file, load_spec("panda_push"), "shipped:panda_push", FOLDER / "panda_push")]
    made.append(karolos.load("panda_push").environment())
    again: Any = gymnasium.make(made[0].spec, render_mode="rgb_array").unwrapped  # type: ignore[arg-type]
    starts = [environment.reset(seed=3)[0] for environment in (*made, again)]
    for start in starts[1:]:
        assert start.facts.differences(starts[0].facts) == []
        np.testing.assert_array_equal(start["observation"], starts[0]["observation"])


def test_what_training_draws_is_drawn_on_demand():
    gravity = {"task.gravity": {"name": "uniform", "low": -11, "high": -9}}
    spec = reach(randomization=gravity)
    assert "parameters" not in karolos.make(spec).reset(seed=0)[1]
    assert -11 <= karolos.make(spec, randomize=True).reset(seed=0)[1]["parameters"]["task.gravity"] <= -9


@pytest.mark.parametrize(
    ("name", "error", "told"),
    [
        ("panda_psh", NoSuchRunError, "'panda_psh' is neither a spec nor a run; did you mean 'panda_push'"),
        ("zzz", NoSuchRunError, "neither a spec nor a run; .*panda_pick"),
        ("zzz.yaml", SpecError, "zzz.yaml: there is no such file"),
    ],
)
def test_a_name_that_means_nothing_is_refused(name, error, told, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=told):
        karolos.make(name)


@pytest.fixture(scope="module")
def policy() -> SavedAgent:
    return karolos.load("panda_reach")


def begun(**settings: Any) -> Any:
    return GoalEnv.reset(gymnasium.make("karolos.gym:karolos/PandaReach-v1", **settings).unwrapped, seed=0)[0]  # type: ignore[arg-type]


def test_a_policy_succeeds_in_its_environment(policy):
    environment, succeeded = karolos.make("panda_reach"), 0
    for seed in range(10):
        observation, info = environment.reset(seed=seed)
        over = False
        while not over:
            observation, _, terminated, truncated, info = environment.step(policy.act(observation))
            over = terminated or truncated
        succeeded += info["is_success"]
    assert succeeded == 10


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"substeps": 20}, "there are 12 actions per second here and 24 there"),
        ({"tool_step": 0.01}, "an action of 1 in tool_position_change is 0.01 m here and 0.017 m there"),
        ({"base": "centred"}, "robot.base=centred here"),
        ({"control": "joint"}, "action is .joint_changes 7"),
    ],
)
def test_an_observation_of_another_environment_is_refused_in_one_line(settings, told, policy):
    own = policy.environment()._environment
    same = {"substeps": own.settings.substeps, "tool_step": own.robot.settings.tool_step}
    assert policy.act(begun(**same)).shape == (3,), "the task's length and threshold are no reason"
    with pytest.raises(UsageError, match=f"^act: panda_reach.*{told}.*environment") as refused:
        policy.act(begun(**(same | settings)))
    assert "\n" not in str(refused.value)


def test_of_plain_arrays_the_sizes_are_checked(policy):
    observation = policy.environment().reset(seed=0)[0]
    plain = dict(observation)
    np.testing.assert_array_equal(policy.act(plain), policy.act(plain["observation"], plain["desired_goal"]))
    with pytest.raises(UsageError, match="no 'desired_goal', only observation"):
        policy.act({"observation": plain["observation"]})
    with pytest.raises(UsageError, match=r"observation has the shape \(2,\)"):
        policy.act([0, 0], plain["desired_goal"])


def test_what_critics_alone_observe_may_be_there():
    environment = karolos.make("panda_insert_blind")
    facts = environment.facts
    assert facts.signature.observation.size > facts.signature.observation.acting.size
    seen: list[tuple[int, ...]] = []

    class Agent:
        def act(self, observation: Any, goal: Any, **_: Any) -> Any:
            seen.append((observation.shape, goal.shape))
            return np.zeros((1, 6))

    saved = SavedAgent("run", "best", "", 0, 0.0, {}, load_spec("panda_insert_blind"), facts, Agent())  # type: ignore[arg-type]
    saved.act(environment.reset(seed=0)[0])
    assert seen == [((1, facts.signature.observation.acting.size), (1, facts.signature.desired_goal.size))]
