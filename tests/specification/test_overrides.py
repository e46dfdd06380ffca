"""Overrides on the command line."""

from __future__ import annotations

import pytest
from support.spec_files import GOOD, write

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
