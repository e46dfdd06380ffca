"""Bad specs: one clear line for each mistake, at its place."""

from __future__ import annotations

import os

import pytest
from support.spec_files import GOOD, problems_of, write

from karolos.errors import PluginError, SpecError
from karolos.spec import load_spec, spec_from_dict

pytestmark = pytest.mark.usefixtures("fake_plugins")

CASES = {
    "misspelt top key": (
        "robot: arm\ntaks: reach\nagent: learner\n",
        "s.yaml:2:1: taks: no such key; did you mean 'task'?",
    ),
    "misspelt setting": (
        "robot: arm\ntask: reach\nagent: {name: learner, lerning_rate: 1}\n",
        "s.yaml:3:24: agent.lerning_rate: no such key; did you mean 'learning_rate'? allowed: name, learning_rate,",
    ),
    "misspelt key of a section": (
        GOOD + "training:\n  step: 5\n",
        "s.yaml:5:3: training.step: no such key; did you mean 'steps'?",
    ),
    "misspelt key of a nested setting": (
        GOOD + "buffer: {name: uniform, hindsight: {ratios: .5}}\n",
        "s.yaml:4:37: buffer.hindsight.ratios: no such key; did you mean 'ratio'? allowed: strategy, ratio",
    ),
    "misspelt name": (
        "robot: arm\ntask: reach\nagent: learnr\n",
        "s.yaml:3:8: agent.name: no agent is called 'learnr'; did you mean 'learner'? installed agents: latest",
    ),
    "misspelt choice": (
        "robot: {name: arm, control: jiont}\ntask: reach\nagent: learner\n",
        "s.yaml:1:29: robot.control: should be 'joint' or 'cartesian', not 'jiont'; did you mean 'joint'?",
    ),
    "text for a number": (
        GOOD + "training: {steps: lots}\n",
        "s.yaml:4:19: training.steps: should be an integer, not 'lots'",
    ),
    "number in quotes": (
        GOOD + "training: {steps: '5'}\n",
        "s.yaml:4:19: training.steps: should be an integer, not '5'",
    ),
    "fraction for a count": (
        GOOD + "training: {steps: 2.5}\n",
        "s.yaml:4:19: training.steps: should be an integer, not 2.5",
    ),
    "truth for a number": (
        GOOD + "training: {steps: true}\n",
        "s.yaml:4:19: training.steps: should be an integer, not true",
    ),
    "word for a truth": (
        "robot: arm\ntask: {name: reach, visible: no}\nagent: learner\n",
        "s.yaml:2:30: task.visible: should be true or false, not 'no'",
    ),
    "number for a word": (
        "environment: {name: point, label: 3}\nagent: learner\n",
        "s.yaml:1:35: environment.label: should be a string, not 3",
    ),
    "list for a section": (GOOD + "training: [1]\n", "s.yaml:4:11: training: should be a mapping, not a list"),
    "number for a part": (
        "robot: 3\ntask: reach\nagent: learner\n",
        "s.yaml:1:8: robot: should be the name of a robot",
    ),
    "part without a name": (
        "robot: {step: 1}\ntask: reach\nagent: learner\n",
        "s.yaml:1:1: robot.name: should name a robot",
    ),
    "out of range": (
        "robot: arm\ntask: reach\nagent: {name: learner, discount: 1.0}\n",
        "s.yaml:3:34: agent.discount: should be less than 1, not 1.0",
    ),
    "infinite": (
        "robot: arm\ntask: reach\nagent: {name: learner, learning_rate: .inf}\n",
        "s.yaml:3:39: agent.learning_rate: should be a finite number",
    ),
    "negative seed": (GOOD + "seeds: [0, -1]\n", "s.yaml:4:12: seeds[1]: should be greater than or equal to 0, not -1"),
    "no seeds": (GOOD + "seeds: []\n", "s.yaml:4:8: seeds: should contain at least one seed"),
    "seed named twice": (GOOD + "seeds: [1, 2, 1]\n", "s.yaml:4:8: seeds: contains the seed 1 twice"),
    "one seed, not a list": (GOOD + "seeds: 1\n", "s.yaml:4:8: seeds: should be a list, not 1"),
    "list too long": (
        "robot: arm\ntask: {name: reach, box: [1, 2, 3, 4]}\nagent: learner\n",
        "s.yaml:2:26: task.box: should have at most 3 items, not 4",
    ),
    "list element of the wrong type": (
        "robot: arm\ntask: reach\nagent: {name: learner, hidden: [64, wide]}\n",
        "s.yaml:3:37: agent.hidden[1]: should be an integer, not 'wide'",
    ),
    "name that is a path": (
        GOOD + "name: ../evil\n",
        "s.yaml:4:7: name: '../evil' is not allowed; give `name`: at most 64 letters",
    ),
    "name too long": (GOOD + f"name: {'x' * 65}\n", "s.yaml:4:7: name: "),
    "name with a trailing newline": (GOOD + 'name: "x\\n"\n', "s.yaml:4:7: name: "),
    "no agent": ("robot: arm\ntask: reach\n", "s.yaml:1:1: agent: is missing; name a learning algorithm"),
    "nothing to learn in": (
        "agent: learner\n",
        "s.yaml:1:1: has no environment; give robot and task, or environment",
    ),
    "robot without a task": ("robot: arm\nagent: learner\n", "s.yaml:1:1: robot: requires a task; add task"),
    "task without a robot": ("agent: learner\ntask: reach\n", "s.yaml:2:1: task: requires a robot; add robot"),
    "robot_task without its parts": (
        "environment: robot_task\nagent: learner\n",
        "s.yaml:1:1: environment: robot_task requires a robot and a task; add robot and task",
    ),
    "randomization that names no owner": (
        GOOD + "randomization: {gravity: {name: normal, mean: 1, std: 1}}\n",
        "s.yaml:4:17: randomization.gravity: 'gravity' is not allowed; write robot.<parameter> or task.<parameter>",
    ),
    "missing setting of a distribution": (
        GOOD + "randomization:\n  task.gravity: {name: normal, mean: 1}\n",
        "s.yaml:5:3: randomization.task.gravity.std: is missing",
    ),
    "settings that do not fit together": (
        GOOD + "randomization:\n  task.gravity: {name: interval, low: 2, high: 1}\n",
        "s.yaml:5:17: randomization.task.gravity: low 2 lies above high 1",
    ),
    "on-policy agent with replay": (
        "robot: arm\ntask: reach\nagent: latest\n",
        "s.yaml:3:1: buffer: agent 'latest' learns from its own latest actions only, buffer 'uniform' replays old ones",
    ),
    "off-policy agent with rollouts": (
        GOOD + "buffer: rollout\n",
        "s.yaml:4:1: buffer: agent 'learner' learns from replay, buffer 'rollout' forgets all but the latest actions",
    ),
    "duplicate key": (GOOD + "robot: other_arm\n", "s.yaml:4:1: duplicate key 'robot', first at"),
    "tag": (GOOD + "name: !!python/name:os.system x\n", "s.yaml:4:7: the tag "),
    "broken YAML": (GOOD + "seeds: [0\n", "s.yaml:5:1: not valid YAML: expected ',' or ']'"),
    "empty file": ("", "s.yaml:1:1: the file is empty; give at least robot, task and agent"),
    "only comments": ("# robot: arm\n", "s.yaml:1:1: the file is empty"),
    "not a mapping": ("- robot\n", "s.yaml:1:1: a spec is a mapping of keys to values"),
    "merge key of YAML 1.1": (GOOD + "training: {<<: {steps: 1}}\n", "s.yaml:4:12: training.<<: no such key"),
    "a sweep without a space": (GOOD + "sweep: {trials: 3}\n", "s.yaml:4:1: sweep.space: is missing"),
}


@pytest.mark.parametrize("case", CASES)
def test_each_mistake_is_one_line_at_its_place(tmp_path, case):
    text, expected = CASES[case]
    found = problems_of(write(tmp_path, "s.yaml", text))
    assert len(found) == 1, found
    assert found[0].startswith(expected), found[0]


def test_all_mistakes_are_told_in_the_order_of_the_file(tmp_path):
    text = "robot: {name: arm, stp: 1}\ntask: reech\nagent: {name: learner, discount: 2}\n"
    text += "training: {steps: 0}\nseed: [1]\n"
    found = problems_of(write(tmp_path, "s.yaml", text))
    assert [line.split(": ")[1] for line in found] == [
        "robot.stp", "task.name", "agent.discount", "training.steps", "seed",
    ]  # fmt: skip


def test_union_mistake_is_told_once(tmp_path):
    path = write(tmp_path, "s.yaml", GOOD.replace("learner", "{name: learner, entropy: high}"))
    (line,) = problems_of(path)
    assert line.startswith("s.yaml:3:33: agent.entropy: should be a number or 'auto', not 'high'")
    path = write(tmp_path, "s.yaml", GOOD.replace("learner", "{name: learner, decay: {rate: 2}}"))
    (line,) = problems_of(path)
    assert line.startswith("s.yaml:3:38: agent.decay.rate: should be less than or equal to 1, not 2")


def test_another_environment_takes_no_robot_task_or_randomization(tmp_path):
    text = GOOD + "environment: point\nrandomization: {task.gravity: {name: normal, mean: 1, std: 1}}\n"
    found = problems_of(write(tmp_path, "s.yaml", text))
    assert [line.split(": ")[1] for line in found] == ["robot", "task", "randomization"]
    assert "requires environment robot_task, not 'point'" in found[0]


def test_missing_file_is_told_with_a_similar_name(tmp_path):
    write(tmp_path, "reach.yaml", GOOD)
    assert problems_of(tmp_path / "raech.yaml") == ["raech.yaml: there is no such file; did you mean reach.yaml?"]
    assert problems_of(tmp_path / "none" / "x.yaml") == ["x.yaml: there is no such file"]


def test_folder_is_no_spec(tmp_path):
    write(tmp_path, "specs/reach.yaml", GOOD)
    assert problems_of(tmp_path / "specs") == ["specs: is a folder, not a spec file; it contains reach.yaml"]


def test_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.yaml")
    assert problems_of(tmp_path / "pipe.yaml") == ["pipe.yaml: is not an ordinary file"]


def test_text_in_another_encoding_is_refused(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(GOOD.encode() + "name: Gr\xfcn\n".encode("latin-1"))
    assert problems_of(path) == ["s.yaml:4: is not UTF-8 text; save the file in UTF-8"]


def test_byte_order_mark_is_no_part_of_the_first_key(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
    assert load_spec(path).robot is not None


def test_alias_bomb_is_refused(tmp_path):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 10)]
    (line,) = problems_of(write(tmp_path, "s.yaml", "\n".join(lines)))
    assert "aliases expanded" in line


def test_huge_file_is_not_read(tmp_path):
    (line,) = problems_of(write(tmp_path, "s.yaml", "x: " + "y" * 2_000_000))
    assert line == "s.yaml: longer than 256 kB"


def test_file_name_that_is_no_name_asks_for_one(tmp_path):
    (line,) = problems_of(write(tmp_path, "my spec.yaml", GOOD))
    assert line.startswith("my spec.yaml:1:1: name: 'my spec' is not allowed; give `name`")


def test_control_characters_do_not_reach_the_message(tmp_path):
    (line,) = problems_of(write(tmp_path, "s.yaml", GOOD + '"\\e[31m": 1\n'))
    assert line.isprintable()


def test_broken_plugin_is_told_at_the_place_that_names_it(tmp_path, fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot", distribution="shaky")
    path = write(tmp_path, "s.yaml", GOOD.replace("arm", "broken"))
    with pytest.raises(PluginError, match=r"s\.yaml:1:8: robot\.name: robot 'broken' of shaky 1\.0") as caught:
        load_spec(path)
    assert isinstance(caught.value.__cause__, ModuleNotFoundError)


def test_broken_distribution_is_not_taken_for_the_buffer_of_that_name(tmp_path, fake_plugins):
    fake_plugins("distributions", "uniform", "no_such_module_anywhere:Uniform")
    path = write(tmp_path, "s.yaml", GOOD + "buffer: uniform\nrandomization: {task.gravity: {name: uniform}}\n")
    with pytest.raises(PluginError, match=r"s\.yaml:5:38: randomization\.task\.gravity\.name: distribution 'uniform'"):
        load_spec(path)


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ({"robot": "arm", "task": "reach", "agent": "learnr"}, "dict: agent.name: no agent is called 'learnr'"),
        ({"robot": "arm", "task": "reach", "agent": object()}, "dict: agent: a spec cannot contain a object"),
        ({"robot": "arm", "task": "reach", "agent": "learner", 3: 4}, "dict: the key 3 is not a string"),
        ({"extends": "x.yaml"}, "dict: extends: a dictionary has no file to extend from"),
        ({}, "dict: has no environment"),
    ],
)
def test_mistakes_in_a_dictionary_are_told(spec, expected):
    with pytest.raises(SpecError) as caught:
        spec_from_dict(spec)
    assert str(caught.value).startswith(expected)


def test_endless_dictionary_is_refused():
    loop: dict = {"robot": "arm"}
    loop["task"] = loop
    with pytest.raises(SpecError, match="nested deeper"):
        spec_from_dict(loop)
