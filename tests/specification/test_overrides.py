"""Overrides on the command line."""

from __future__ import annotations

import pytest
from support.spec_files import GOOD, problems_of, write

from karolos.specification import load_spec

pytestmark = pytest.mark.usefixtures("fake_plugins")


@pytest.fixture
def path(tmp_path):
    return write(tmp_path, "s.yaml", GOOD + "randomization: {task.gravity: {name: normal, mean: 1, std: 2}}\n")


@pytest.mark.parametrize(
    ("override", "where", "value"),
    [
        ("agent.learning_rate=1e-4", ("agent", "learning_rate"), 1e-4),
        ("seeds=[0,1]", ("seeds",), [0, 1]),
        ("robot.control=joint", ("robot", "control"), "joint"),
        ("agent={name: learner, discount: .9}", ("agent", "discount"), 0.9),
        ("training.steps=1e6", ("training", "steps"), 1_000_000),
        ("buffer.hindsight.ratio=0.5", ("buffer", "hindsight", "ratio"), 0.5),
        ("buffer.hindsight={}", ("buffer", "hindsight", "ratio"), 0.8),
        ("orchestrator.processes=0", ("orchestrator", "processes"), 0),
        ("environment.substeps=5", ("environment", "substeps"), 5),
        ("randomization.task.gravity.mean=3", ("randomization", "task.gravity", "mean"), 3.0),
        ("randomization.robot.mass={name: normal, mean: 1, std: 0}", ("randomization", "robot.mass", "std"), 0.0),
        ("name=a.b", ("name",), "a.b"),
    ],
)
def test_override_replaces_one_value(path, override, where, value):
    found = load_spec(path, [override]).dump()
    for key in where:
        found = found[key]
    assert found == value


def test_later_overrides_win(path):
    assert load_spec(path, ["training.steps=1", "training.steps=2"]).training.steps == 2


def test_override_of_a_name_drops_what_the_other_plugin_does_not_have(path):
    spec = load_spec(path, ["robot.step=0.3", "robot=other_arm"])
    assert spec.robot.dump() == {"name": "other_arm", "speed": 1.0}


def test_override_of_the_same_name_keeps_the_settings(path):
    assert load_spec(path, ["robot.step=0.3", "robot=arm"]).robot.settings.step == 0.3


def test_empty_value_leaves_out(path):
    assert load_spec(path, ["randomization="]).randomization == {}


@pytest.mark.parametrize(
    ("overrides", "places"),
    [
        (["seeds=[1]", "robot="], ["override robot="]),
        (["agent=latest", "name=other"], ["override agent=latest"]),
        (["environment=point"], ["override environment=point"] * 3),
        (["seeds=[1]", "buffer=rollout", "robot="], ["override buffer=rollout", "override robot="]),
    ],
)
def test_what_an_override_contradicts_is_reported_at_the_override(path, overrides, places):
    assert [line.split(": ")[0] for line in problems_of(path, *overrides)] == places


def test_what_was_wrong_without_the_override_stays_where_it_is(tmp_path):
    path = write(tmp_path, "s.yaml", "task: reach\nagent: learner\nbuffer: rollout\n")
    assert [line.split(": ")[0] for line in problems_of(path, "seeds=[1]")] == ["s.yaml:1:1", "s.yaml:3:1"]


def test_of_a_broken_plugin_that_an_override_replaces_nothing_is_said(path, fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    path.write_text(path.read_text().replace("arm", "broken"))
    (line,) = problems_of(path, "robot=arm", "buffer=rollout")
    assert line.startswith("override buffer=rollout: ")
