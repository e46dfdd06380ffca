"""The `sweep` of a spec: its search space against the settings of the plugins, and the specs of its trials."""

import pytest
from support.spec_files import GOOD, REFUSED, problems_of, write

from karolos.errors import SpecError
from karolos.specification import load_spec, spec_from_dict, spec_of_trial

pytestmark = pytest.mark.usefixtures("fake_plugins")

SPACE = """\
sweep:
  space:
    agent.learning_rate: {float: [1e-5, 1e-2], log: true}
    agent.hidden: {choice: [[64, 64], [256]]}
    buffer.hindsight: {choice: {off: null, on: {strategy: final}}}
    buffer.hindsight.ratio: {float: [0.5, 0.9], when: {buffer.hindsight: on}}
"""


@pytest.fixture
def path(tmp_path):
    return write(tmp_path, "s.yaml", GOOD + SPACE)


def test_a_spec_with_a_sweep_dumps_and_loads_as_itself(path):
    spec = load_spec(path)
    assert spec_from_dict(spec.dump()) == spec
    assert spec.dump()["sweep"]["space"]["buffer.hindsight"]["choice"] == {"off": None, "on": {"strategy": "final"}}


def test_a_sweep_is_no_part_of_the_experiment(path):
    spec = load_spec(path)
    assert spec.hash() == spec.alone().hash()
    assert "sweep" not in spec.alone().dump()
    assert spec.alone().origins == spec.origins


@pytest.mark.parametrize("override", REFUSED["searches"])
def test_a_search_that_cannot_be_is_told_before_it_begins(path, override):
    (problem,) = problems_of(path, override)
    assert problem.startswith("override sweep")
    assert all(words in problem for words in REFUSED["searches"][override]), problem


def test_the_place_of_a_value_out_of_range_is_that_of_the_value(tmp_path):
    text = GOOD + "sweep:\n  space:\n    agent.discount: {float: [0.5, 1.5]}\n    task.threshold: {choice: [0.1, -1]}\n"
    problems = problems_of(write(tmp_path, "s.yaml", text))
    assert [problem.partition(": ")[0] for problem in problems] == ["s.yaml:6:35", "s.yaml:7:36"]


def test_a_parameter_is_tried_with_every_plugin_that_it_may_belong_to(tmp_path):
    text = GOOD + "sweep:\n  space:\n    robot.name: {choice: [arm, other_arm]}\n    robot.step: {float: [0.1, 0.2]"
    (problem,) = problems_of(write(tmp_path, "a.yaml", text + "}\n"))
    assert "robot.step: no such key" in problem
    load_spec(write(tmp_path, "b.yaml", text + ", when: {robot.name: arm}}\n"))


def test_an_inherited_parameter_is_replaced_or_dropped(path, tmp_path):
    above = "extends: s.yaml\nsweep: {space: {agent.learning_rate: {choice: [0.1, 0.2]}, agent.hidden: null}}\n"
    sweep = load_spec(write(tmp_path, "above.yaml", above)).sweep
    assert sweep.space["agent.learning_rate"].labels == ["0.1", "0.2"]
    assert set(sweep.space) == {"agent.learning_rate", "buffer.hindsight", "buffer.hindsight.ratio"}


def test_a_trial_is_the_spec_with_what_was_drawn(path):
    spec = load_spec(path)
    drawn = {"buffer.hindsight.ratio": 0.6, "buffer.hindsight": "on", "agent.hidden": "[256]"}
    trial = spec_of_trial(spec, drawn, "s-t003", (4, 5), "trial 3").dump()
    assert (trial["name"], trial["seeds"], trial.get("sweep")) == ("s-t003", [4, 5], None)
    assert trial["buffer"]["hindsight"] == {"strategy": "final", "ratio": 0.6}
    assert trial["agent"]["hidden"] == [256]
    assert trial["agent"]["learning_rate"] == 1e-3


def test_another_plugin_is_drawn_before_its_settings(tmp_path):
    text = GOOD + (
        "sweep:\n  space:\n    robot.speed: {float: [1, 2], when: {robot.name: other_arm}}\n"
        "    robot.name: {choice: [arm, other_arm]}\n"
    )
    spec = load_spec(write(tmp_path, "s.yaml", text))
    drawn = {"robot.speed": 1.5, "robot.name": "other_arm"}
    assert spec_of_trial(spec, drawn, "t", (0,), "trial 0").dump()["robot"] == {"name": "other_arm", "speed": 1.5}
    assert spec.sweep.order() == ["robot.name", "robot.speed"]


def test_values_that_do_not_go_together_are_told_of_their_trial(tmp_path):
    text = "environment: point\nagent: learner\nsweep: {space: {agent.discount: {float: [0.1, 0.9]}}}\n"
    spec = load_spec(write(tmp_path, "s.yaml", text))
    with pytest.raises(SpecError, match=r"trial 7: agent\.discount"):
        spec_of_trial(spec, {"agent.discount": 2.0}, "t", (0,), "trial 7")


def test_a_grid_has_every_combination_once_and_no_more(tmp_path):
    text = GOOD + (
        "sweep:\n  sampler: grid\n  space:\n"
        "    agent.learning_rate: {float: [1e-4, 1e-2], log: true, points: 3}\n"
        "    buffer.hindsight: {choice: {off: null, on: {}}}\n"
        "    buffer.hindsight.ratio: {float: [0.2, 0.8], points: 2, when: {buffer.hindsight: on}}\n"
    )
    found = list(load_spec(write(tmp_path, "s.yaml", text)).sweep.combinations())
    assert len(found) == 3 * (1 + 2)
    assert found[0] == {"agent.learning_rate": 1e-4, "buffer.hindsight": "off"}
    assert sorted({one["agent.learning_rate"] for one in found}) == pytest.approx([1e-4, 1e-3, 1e-2])


@pytest.mark.parametrize("most", [100_001, 100_000_000])
def test_a_grid_of_too_many_combinations_is_refused_where_it_is_declared(tmp_path, most):
    text = GOOD + "sweep: {sampler: grid, space: {training.batch_size: {int: [1, %d]}}}\n"
    assert len(load_spec(write(tmp_path, "s.yaml", text % 100_000)).sweep.space) == 1
    with pytest.raises(SpecError, match=r"s.yaml:\d+:\d+: sweep: a grid of more than 100,000 combinations"):
        load_spec(write(tmp_path, "s.yaml", text % most))
