"""A number where a distribution is expected."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.spec_files import problems_of, write

from karolos.errors import SpecError, UsageError
from karolos.specification import load_spec
from karolos.training.assembly import check_parts

REACH = "robot: panda\ntask: reach\nagent: sac\n"


def test_a_number_is_a_distribution_of_one_value(tmp_path: Path) -> None:
    plain = load_spec(write(tmp_path, "s.yaml", REACH + "randomization: {task.gravity: -5}\n"))
    drawn = {"name": "choice", "values": [-5.0], "weights": None}
    assert plain.dump()["randomization"] == {"task.gravity": drawn}
    written = "randomization: {task.gravity: {name: choice, values: [-5]}}\n"
    assert plain.hash() == load_spec(write(tmp_path, "t.yaml", REACH + written)).hash()
    override = "randomization.task.gravity=-5"
    assert plain.hash() == load_spec(write(tmp_path, "u.yaml", REACH), [override]).hash()


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ("true", "s.yaml:4:31: randomization.task.gravity: should be a number, the name of a distribution, or a"),
        ("[1, 2]", "s.yaml:4:31: randomization.task.gravity: should be a number, the name of a distribution, or a"),
        (".inf", "s.yaml:4:31: randomization.task.gravity.values[0]: should be a finite number"),
    ],
)
def test_other_values_are_refused(tmp_path: Path, value: str, expected: str) -> None:
    (line,) = problems_of(write(tmp_path, "s.yaml", REACH + f"randomization: {{task.gravity: {value}}}\n"))
    assert line.startswith(expected)


def test_a_value_that_the_parameter_never_takes_is_refused_before_a_run(tmp_path: Path) -> None:
    path = write(tmp_path, "s.yaml", REACH + "randomization: {task.gravity: -50}\n")
    with pytest.raises(UsageError, match=r"s\.yaml:4:\d+: randomization\.task\.gravity: .* allowed is -20 to 0 m/s2"):
        check_parts(load_spec(path))


@pytest.mark.parametrize(
    ("override", "example"), [("task.gravity=-5", "task.gravity"), ("robot.link_mas=2", "robot.link_mass")]
)
def test_a_parameter_among_the_settings_is_told_where_it_goes_and_a_misspelt_one_is_not_repeated(
    tmp_path: Path, override: str, example: str
) -> None:
    (line,) = problems_of(write(tmp_path, "s.yaml", REACH), override)
    part, name = ("task", "reach") if "task" in override else ("robot", "panda")
    hint = f"is set as e.g. randomization: {{{example}: NUMBER}}; `karolos inspect {part} {name}` shows all"
    assert "no such key" in line
    assert line.endswith(hint)


def test_an_agent_that_needs_another_buffer_is_told_at_its_override_with_a_spec_that_has_both() -> None:
    with pytest.raises(SpecError) as caught:
        load_spec("panda_reach", ["training.steps=5", "agent=ppo"])
    line = str(caught.value)
    assert line.startswith("override agent=ppo: buffer: agent 'ppo' learns from its own latest actions only")
    assert line.endswith("e.g. buffer=on_policy; the spec panda_reach_ppo shows the settings of both")
    assert load_spec("panda_reach_ppo").buffer.name == "on_policy"


def test_a_number_of_seeds_means_the_first_ones(tmp_path: Path) -> None:
    path = write(tmp_path, "s.yaml", REACH + "seeds: 3\n")
    assert load_spec(path).seeds == (0, 1, 2)
    assert load_spec(path, ["seeds=1"]) == load_spec(path, ["seeds=[0]"])


def test_a_home_folder_in_a_path_is_refused(tmp_path: Path) -> None:
    (line,) = problems_of(write(tmp_path, "s.yaml", REACH.replace("sac", "{name: sac, start_from: ~/x}")))
    assert line.startswith("s.yaml:3:32: agent.start_from: ~/x: ~ and variables are not replaced")
