"""`extends` and overrides: what is laid over what, and which files may be read."""

import pytest
from support.spec_files import GOOD, problems_of, write

from karolos.specification import Spec, load_spec

pytestmark = pytest.mark.usefixtures("fake_plugins")


def at(spec: Spec, path: str) -> object:
    """A value of the spec's dump; the keys of its path are separated by spaces."""
    found = spec.dump()
    for key in path.split():
        found = found[key]
    return found


NORMAL = "{task.gravity: {name: normal, mean: 1, std: 2}}"
MERGED = {
    "mapping by mapping": (
        ["training: {steps: 7, batch_size: 8}\nseeds: [1, 2]"],
        "training: {steps: 9}\nseeds: [3]",
        {"training steps": 9, "training batch_size": 8, "seeds": [3]},
    ),
    "later files first": (
        ["training: {steps: 1, batch_size: 1, warmup_episodes: 1}", "training: {steps: 2, batch_size: 2}"],
        "training: {steps: 3}",
        {"training steps": 3, "training batch_size": 2, "training warmup_episodes": 1},
    ),
    "settings of the same part, also from shorthand": (
        ["agent: {name: learner, discount: 0.5}"],
        "agent: learner\nrobot: {step: 0.1}",
        {"agent discount": 0.5, "robot name": "arm", "robot step": 0.1},
    ),
    "a part of another name as a whole": (
        ["robot: {name: arm, step: 0.2}"],
        "robot: other_arm",
        {"robot": {"name": "other_arm", "speed": 1.0}},
    ),
    "a distribution of another name as a whole": (
        [f"randomization: {NORMAL}"],
        "randomization: {task.gravity: {name: interval, low: 0, high: 1}}",
        {"randomization task.gravity": {"name": "interval", "low": 0.0, "high": 1.0}},
    ),
}
"""How files are merged: what a spec extends, the spec, and what comes of it."""


@pytest.mark.parametrize("how", MERGED)
def test_the_file_itself_wins_over_what_it_extends(tmp_path, how):
    below, above, expected = MERGED[how]
    names = ["good.yaml", *(f"{place}.yaml" for place in range(len(below)))]
    for name, text in zip(names, [GOOD, *below], strict=True):
        write(tmp_path, name, text)
    spec = load_spec(write(tmp_path, "s.yaml", f"extends: [{', '.join(names)}]\n{above}\n"))
    assert {path: at(spec, path) for path in expected} == expected


def test_null_drops_what_is_inherited(tmp_path):
    drawn = "{task.gravity: {name: normal, mean: 1, std: 2}, task.mass: {name: normal, mean: 1, std: 2}}"
    write(tmp_path, "base.yaml", GOOD + f"randomization: {drawn}\ntraining: {{steps: 7}}\n")
    text = "extends: base.yaml\nrandomization: {task.mass: null}\ntraining: null\n"
    spec = load_spec(write(tmp_path, "s.yaml", text))
    assert list(spec.randomization) == ["task.gravity"]
    assert spec.training.steps == 100_000
    text = "extends: base.yaml\nrobot: null\ntask: null\nrandomization: null\nenvironment: point\n"
    spec = load_spec(write(tmp_path, "s.yaml", text))
    assert (spec.robot, spec.task, spec.environment.name, spec.randomization) == (None, None, "point", {})


def test_problem_of_an_extended_file_is_told_there(tmp_path):
    write(tmp_path, "bases/base.yaml", GOOD + "training: {steps: none}\n")
    path = write(tmp_path, "s.yaml", "extends: bases/base.yaml\nseeds: [-1]\n")
    found = problems_of(path)
    assert found[0].startswith("s.yaml:2:9: seeds[0]")
    assert found[1].startswith("bases/base.yaml:4:19: training.steps")


def test_circle_is_refused_with_its_members(tmp_path):
    write(tmp_path, "a.yaml", "extends: b.yaml\n")
    write(tmp_path, "b.yaml", "extends: c.yaml\n")
    write(tmp_path, "c.yaml", "extends: a.yaml\n")
    (line,) = problems_of(tmp_path / "a.yaml")
    assert line.startswith("c.yaml:1:10: extends: is a circle: a.yaml -> b.yaml -> c.yaml -> a.yaml")
    (line,) = problems_of(write(tmp_path, "self.yaml", "extends: self.yaml\n"))
    assert "circle: self.yaml -> self.yaml" in line


def test_a_base_that_is_extended_again_and_again_is_no_circle_and_is_read_once(tmp_path):
    write(tmp_path, "f0.yaml", GOOD)
    for number in range(1, 16):
        write(tmp_path, f"f{number}.yaml", f"extends: [f{number - 1}.yaml, f{number - 1}.yaml]\n")
    assert load_spec(tmp_path / "f15.yaml").robot.name == "arm"


@pytest.mark.parametrize("target", ["../other/x.yaml", "{}/other/x.yaml", "link.yaml"])
def test_any_file_may_be_extended(tmp_path, target):
    write(tmp_path, "other/base.yaml", GOOD)
    other = write(tmp_path, "other/x.yaml", "extends: base.yaml\n")
    path = write(tmp_path, "plain/s.yaml", f"extends: {target.format(tmp_path)}\n")
    (tmp_path / "plain" / "link.yaml").symlink_to(other)
    assert load_spec(path).robot.name == "arm"


def test_shipped_spec_is_extended_by_its_name_from_anywhere(tmp_path):
    path = write(tmp_path, "s.yaml", "extends: karolos:panda_reach.yaml\n")
    found = problems_of(path, "agent.discount=1.5")
    assert found, "the fake plugins lack the settings of the real ones"
    assert all(line.startswith(("karolos:panda_reach.yaml:", "karolos:bases/", "override")) for line in found)


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("bsae.yaml", "s.yaml:1:10: extends: bsae.yaml: there is no such file; did you mean base.yaml?"),
        (".", "s.yaml:1:10: extends: .: is a folder, not a spec file"),
        ("3", "s.yaml:1:10: extends: should be a path, or a list of paths"),
        ("[base.yaml, {}]", "s.yaml:1:22: extends: should be a path"),
        ('"x\\0.yaml"', "s.yaml:1:10: extends: x\\x00.yaml: there is no such file"),
        ('"\\ud800.yaml"', "s.yaml:1:10: extends: \\ud800.yaml: there is no such file"),
        ("loop.yaml", "s.yaml:1:10: extends: loop.yaml: cannot be read: Too many levels of symbolic links"),
        ("/dev/null", "s.yaml:1:10: extends: /dev/null: is not an ordinary file"),
        ("karolos:panda_raech.yaml", "s.yaml:1:10: extends: karolos:panda_raech.yaml: there is no such file; did you"),
        ("panda_reach.yaml", "s.yaml:1:10: extends: panda_reach.yaml: there is no such file; did you mean karolos:pan"),
        ("empty.yaml", "empty.yaml:1:1: the file is empty"),
        ("broken.yaml", "broken.yaml:2:1: not valid YAML"),
    ],
)
def test_file_that_cannot_be_extended_is_told_alone(tmp_path, target, expected):
    write(tmp_path, "base.yaml", GOOD)
    write(tmp_path, "empty.yaml", "")
    write(tmp_path, "broken.yaml", "a: [\n")
    (tmp_path / "loop.yaml").symlink_to("loop.yaml")
    found = problems_of(write(tmp_path, "s.yaml", f"extends: {target}\n"))
    assert len(found) == 1, "an unread base must not make its keys look missing"
    assert found[0].startswith(expected)


@pytest.fixture
def path(tmp_path):
    return write(tmp_path, "s.yaml", f"{GOOD}randomization: {NORMAL}\n")


@pytest.mark.parametrize(
    ("overrides", "where", "value"),
    [
        (["agent.learning_rate=1e-4"], "agent learning_rate", 1e-4),
        (["seeds=[0,1]"], "seeds", [0, 1]),
        (["robot.control=joint"], "robot control", "joint"),
        (["agent={name: learner, discount: .9}"], "agent discount", 0.9),
        (["training.steps=1e6"], "training steps", 1_000_000),
        (["buffer.hindsight.ratio=0.5"], "buffer hindsight ratio", 0.5),
        (["buffer.hindsight={}"], "buffer hindsight ratio", 0.8),
        (["orchestrator.processes=0"], "orchestrator processes", 0),
        (["environment.substeps=5"], "environment substeps", 5),
        (["randomization.task.gravity.mean=3"], "randomization task.gravity mean", 3.0),
        (["randomization.robot.mass={name: normal, mean: 1, std: 0}"], "randomization robot.mass std", 0.0),
        (["name=a.b"], "name", "a.b"),
        (["randomization="], "randomization", {}),
        (["training.steps=1", "training.steps=2"], "training steps", 2),
        # another plugin does not have the settings, the same one keeps them
        (["robot.step=0.3", "robot=other_arm"], "robot", {"name": "other_arm", "speed": 1.0}),
        (["robot.step=0.3", "robot=arm"], "robot step", 0.3),
        (["buffer.capacity=777", "agent=latest", "buffer.name=rollout"], "buffer", {"name": "rollout"}),  # of no name
        (["buffer.capacity=777", "buffer.name=uniform"], "buffer capacity", 777),
    ],
)
def test_an_override_replaces_one_value_and_the_last_one_wins(path, overrides, where, value):
    assert at(load_spec(path, overrides), where) == value


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
    path = write(tmp_path, "t.yaml", "robot: arm\ntask: reach\n")
    assert problems_of(path, "seeds=[1]")[0].startswith("t.yaml:1:1: agent: is missing")


def test_of_a_broken_plugin_that_an_override_replaces_nothing_is_said(path, fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    path.write_text(path.read_text().replace("arm", "broken"))
    (line,) = problems_of(path, "robot=arm", "buffer=rollout")
    assert line.startswith("override buffer=rollout: ")
