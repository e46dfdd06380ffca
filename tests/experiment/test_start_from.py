"""Starting from another run's agent: what is taken over, what is refused, and what the experiment then is."""

from pathlib import Path
from typing import Any

import pytest
from support.states import assert_same_state
from support.toy_runs import run_of, toy

from karolos.core import Signature
from karolos.core.seeding import SeedTree
from karolos.environments.build import build_environment
from karolos.errors import UsageError
from karolos.experiment.start_from import apply, find, pinned
from karolos.launchers.experiment import Experiment
from karolos.plugins.contracts.case import state_differences
from karolos.records import RunFolder, checkpoint
from karolos.specification import Spec, spec_from_dict
from karolos.training.assembly import make_agent

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy(agent={"precision": "float32"})


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return run_of(TOY, tmp_path_factory.mktemp("runs"))


def spec(start: str, *overrides: str, **changes: Any) -> Spec:
    return spec_from_dict({**TOY, **changes}, [f"agent.start_from={start}", *overrides])


def signature(of: Spec) -> Signature:
    return build_environment(of.recipe(randomize=False)).signature


@pytest.mark.parametrize("name", ["sac", "td3", "ddpg"])
def test_weights_and_statistics_are_taken_over_and_optimisers_are_not(name, tmp_path):
    small = {**TOY, "agent": {"name": name, "hidden": [8]}}
    folder = run_of(small, tmp_path)
    wanted = spec(folder.id, agent={"name": name, "hidden": [8]})
    start = find(wanted, tmp_path)
    assert start is not None
    agent = make_agent(wanted, signature(wanted), SeedTree(5))
    fresh = agent.state()
    apply(start, agent)
    state = agent.state()
    for key in agent.learned:
        assert_same_state(state[key], start.state[key])
    for key in state.keys() - set(agent.learned):
        assert_same_state(state[key], fresh[key])
    assert state_differences(state["policy"], fresh["policy"])


def test_a_run_that_starts_from_another_says_so_and_begins_where_that_ended(source):
    runs = source.path.parent
    wanted = {**TOY, "name": "onward", "agent": {**TOY["agent"], "start_from": source.id, "start_checkpoint": "last"}}
    folder = run_of(toy(wanted, training={"replay_ratio": 0}), runs)
    (event,) = [event for event in folder.events() if event["event"] == "started_from"]
    assert (event["run"], event["checkpoint"], event["steps"]) == (source.id, "last", 80)
    before, after = (checkpoint.load(run.checkpoints, "last")[0]["agent"] for run in (source, folder))
    assert_same_state(before["policy"], after["policy"])  # nothing was learned since
    assert folder.spec()["agent"]["start_sha256"] == event["sha256"]


def test_the_experiment_is_what_was_started_from_wherever_it_lies(source):
    runs = source.path.parent
    by_id, by_path = pinned(spec(source.id), runs), pinned(spec(str(source.path)), Path("elsewhere"))
    assert by_id.hash() == by_path.hash()
    assert by_id.hash() != spec_from_dict(TOY).hash()
    assert spec_from_dict(by_id.dump()).hash() == by_id.hash()
    assert pinned(spec_from_dict(TOY), runs).hash() == spec_from_dict(TOY).hash()


def test_a_checkpoint_that_is_another_by_now_is_refused(source):
    with pytest.raises(UsageError, match="not the one this spec was first run with"):
        find(spec(source.id, f"agent.start_sha256={'f' * 64}"), source.path.parent)


def test_other_layouts_are_refused_and_both_are_shown(source):
    wide = spec(source.id, environment={"name": "toy", "dimensions": 3})
    with pytest.raises(UsageError, match="other observations, actions or goals") as caught:
        pinned(wide, source.path.parent)
    text = str(caught.value)
    for told in ("observation is [position 3 1] here and [position 2 1] there", "goal 2", "displacement 3"):
        assert told in text
    assert "override" in text  # where it was set


def test_another_agent_and_other_networks_are_refused(source):
    with pytest.raises(UsageError, match="the agent is td3, and the run's agent is sac"):
        find(spec(source.id, agent={"name": "td3"}), source.path.parent)
    with pytest.raises(UsageError, match=r"agent.hidden is \[16\] here and \[8\] in the run"):
        find(spec(source.id, "agent.hidden=[16]"), source.path.parent)


@pytest.mark.parametrize(("name", "told"), [("nobody", "'nobody'"), ("x" * 300, "not a run folder")])
def test_a_run_that_is_not_there_is_refused_before_a_folder_is_made(tmp_path, name, told):
    with pytest.raises(UsageError, match=told):
        Experiment(spec(name)).run(tmp_path)
    assert not [path for path in tmp_path.iterdir() if path.is_dir()]


def test_robots_in_cartesian_control_take_over_from_each_other():
    layouts = set()
    for robot in ("panda", "ur5", "iiwa"):
        part = {"name": robot, "control": "cartesian"}
        found = signature(spec_from_dict({"robot": part, "task": "pick_place", "agent": "sac"}))
        layouts.add((found.observation, found.action, found.desired_goal))
    assert len(layouts) == 1
