"""Overrides on the command line."""

from __future__ import annotations

import pytest
from support.spec_files import GOOD, problems_of, write

from karolos.spec import load_spec

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
    ("override", "expected"),
    [
        ("agent.lr=1", "override agent.lr=1: agent.lr: no such key; allowed: name, learning_rate"),
        ("agent.discount=2", "override agent.discount=2: agent.discount: should be less than 1, not 2"),
        ("agnt.discount=2", "override agnt.discount=2: agnt: no such key; did you mean 'agent'?"),
        ("seeds=[0,1", "override seeds=[0,1: column 11: not valid YAML"),
        ("seeds=[0, *x]", "override seeds=[0, *x]: column 11: not valid YAML: found undefined alias 'x'"),
        (
            "training={steps: 1, steps: 2}",
            "override training={steps: 1, steps: 2}: column 21: duplicate key 'steps', first at",
        ),
        ("training.steps", "override training.steps: has no =; write path.to.key=value"),
        ("=3", "override =3: '' is not a path of keys"),
        ("agent..discount=1", "override agent..discount=1: 'agent..discount' is not a path of keys"),
        ("extends=x.yaml", "override extends=x.yaml: extends: cannot be overridden"),
        ("name=#1", "override name=#1: name: the value is a comment"),
        ("name=../x", "override name=../x: name: '../x' is not allowed"),
        ("name=!!python/name:os.system", "override name=!!python/name:os.system: column 6: the tag "),
        ("training.steps.x=1", "override training.steps.x=1: training.steps: should be an integer, not a mapping"),
    ],
)
def test_bad_override_is_named(path, override, expected):
    (line,) = problems_of(path, override)
    assert line.startswith(expected), line


def test_every_bad_override_is_told_after_the_file(tmp_path):
    path = write(tmp_path, "s.yaml", GOOD + "seed: 1\n")
    found = problems_of(path, "training.steps=x", "agent.discount=x")
    assert [line.split(": ")[0] for line in found] == [
        "s.yaml:4:1", "override training.steps=x", "override agent.discount=x",
    ]  # fmt: skip
