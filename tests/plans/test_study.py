"""Trials drawn, told and taken up again from the journal; nothing is run."""

import math

import pytest
from support import run_samples
from support.sweep_samples import LEARNING_RATE, sweep_spec

from karolos.errors import UsageError
from karolos.experiment.check import check_parts
from karolos.plans.objectives import directions, measure, nominal_steps, so_far
from karolos.plans.study import STARTUP_TRIALS, Study
from karolos.records.evaluation import Evaluation
from karolos.specification import spec_from_dict
from karolos.system.files import append_lines

CONDITIONAL = {
    **LEARNING_RATE,
    "buffer.hindsight": {"choice": {"off": None, "on": {"strategy": "final"}}},
    "buffer.hindsight.ratio": {"float": [0.2, 0.8], "when": {"buffer.hindsight": "on"}},
}


def study(folder, space=CONDITIONAL, **sweep) -> Study:
    spec = spec_from_dict(sweep_spec(space, **sweep))
    return Study(folder / "journal.log", spec.sweep, "line", 200, directions(spec))


def finish(one: Study, count: int) -> None:
    """So many more trials, of which a low learning rate is the best."""
    for _ in range(count):
        trial = one.ask()
        trial.end(values=[-math.log10(trial.drawn["agent.learning_rate"])])


@pytest.mark.parametrize("sampler", ["tpe", "random", "gp"])
def test_an_interrupted_sweep_draws_what_it_would_have_drawn_and_a_dry_run_shows(tmp_path, sampler):
    for name in ("whole", "broken"):
        (tmp_path / name).mkdir()
    whole = study(tmp_path / "whole", sampler=sampler)
    finish(whole, 13)
    assert [trial.drawn for trial in whole.trials()][:STARTUP_TRIALS] == Study.draws(whole._sweep, STARTUP_TRIALS)
    finish(study(tmp_path / "broken", sampler=sampler), 11)
    again = study(tmp_path / "broken", sampler=sampler)
    finish(again, 2)
    assert [trial.drawn for trial in again.trials()] == [trial.drawn for trial in whole.trials()]


def test_trials_left_open_are_taken_up_with_what_they_had_drawn(tmp_path):
    first = study(tmp_path)
    finish(first, 1)
    left = first.ask()
    again = study(tmp_path)
    (open_trial,) = again.unfinished()
    assert (open_trial.number, open_trial.drawn) == (1, left.drawn)
    open_trial.end(values=[0.5])
    assert [trial.state for trial in again.trials()] == ["complete", "complete"]
    assert not again.unfinished()


def test_a_journal_whose_last_line_is_torn_is_read_on(tmp_path):
    finish(study(tmp_path), 2)
    journal = tmp_path / "journal.log"
    with journal.open("a") as file:
        file.write('{"op_code": 4, "worker')
    append_lines(journal, ())
    again = study(tmp_path)
    finish(again, 1)
    assert len(study(tmp_path).trials()) == 3


def test_a_parameter_is_drawn_only_where_its_condition_holds(tmp_path):
    one = study(tmp_path, sampler="random")
    finish(one, 12)
    seen = {trial.drawn["buffer.hindsight"] for trial in one.trials()}
    assert seen == {"on", "off"}
    for trial in one.trials():
        assert ("buffer.hindsight.ratio" in trial.drawn) == (trial.drawn["buffer.hindsight"] == "on")


def test_a_grid_goes_through_its_combinations_in_order(tmp_path):
    space = {"agent.discount": {"choice": [0.8, 0.9]}, "buffer.n_step": {"int": [1, 2]}}
    one = study(tmp_path, space, sampler="grid")
    for _ in range(3):
        one.ask().end(values=[0.0])
    again = study(tmp_path, space, sampler="grid")
    again.ask().end(values=[0.0])
    drawn = [(trial.drawn["agent.discount"], trial.drawn["buffer.n_step"]) for trial in again.trials()]
    assert drawn == [("0.8", 1), ("0.8", 2), ("0.9", 1), ("0.9", 2)]


def test_the_pruner_gives_up_a_trial_below_the_median_after_the_warm_up_only(tmp_path):
    one = study(tmp_path, LEARNING_RATE, pruner={"warmup": 0.5, "startup": 1})
    good = one.ask()
    assert not any(good.is_hopeless(1.0, step) for step in (50, 100, 150))
    good.end(values=[1.0])
    bad = one.ask()
    assert not bad.is_hopeless(0.0, 50)
    assert bad.is_hopeless(0.0, 100)
    bad.end()
    assert [trial.state for trial in one.trials()] == ["complete", "pruned"]
    assert [trial.number for trial in one.front()] == [0]


def test_several_objectives_give_a_front(tmp_path):
    one = study(tmp_path, LEARNING_RATE, objective=["success_end", "steps_to_95"])
    for values in ([0.5, 100.0], [0.9, 400.0], [0.4, 150.0]):
        one.ask().end(values=values)
    assert [trial.number for trial in one.front()] == [0, 1]


def test_a_measure_says_itself_what_is_better_and_one_that_is_not_there_is_refused():
    spec = spec_from_dict(sweep_spec(LEARNING_RATE, objective=["measures.final_distance", "success_end"]))
    assert directions(spec) == ("minimize", "maximize")
    unknown = spec_from_dict(sweep_spec(LEARNING_RATE, objective="measures.distance"))
    with pytest.raises(UsageError, match=r"no objective 'measures\.distance'; did you mean 'measures\.final_distance'"):
        check_parts(unknown)


def test_importance_finds_what_matters(tmp_path):
    one = study(tmp_path, {**LEARNING_RATE, "agent.discount": {"float": [0.5, 0.9]}}, sampler="random")
    finish(one, 2)
    assert set(one.figures()) == {"history", "parallel"}
    finish(one, 40)
    [axes, *_] = one.figures()["importances"].axes
    names = [label.get_text() for label in axes.get_yticklabels()]
    shares = dict(zip(names, (bar.get_width() for bar in axes.patches), strict=True))
    assert shares["agent.learning_rate"] > 0.6 > shares["agent.discount"]


def result(steps: int, successes: int, value: float = -1.0) -> Evaluation:
    miss = {"unit": "m", "better": "smaller", "values": (None, 2.0, 3.0)}
    return run_samples.result(steps, successes, 10, value=value, measures={"miss": miss})


TESTS = {0: [result(100, 2), result(200, 10)], 1: [result(100, 4), result(200, 8)]}


@pytest.mark.parametrize(
    ("objective", "value"),
    [
        ("success_end", 0.9),
        ("mean_success_any", 0.6),
        ("return", -1.0),
        ("measures.miss", 2.5),
        ("steps_to_50", 200),
        ("steps_to_95", (200 + 2 * 200) / 2),  # the second never gets there: twice its steps
    ],
)
def test_objectives_are_means_over_seeds(objective, value):
    assert measure(objective, TESTS, 200) == pytest.approx(value)


def test_a_final_test_is_what_a_run_is_reported_by():
    finals = {0: result(200, 7, -3.0), 1: result(200, 5, -5.0)}
    assert measure("success_end", TESTS, 200, finals) == pytest.approx(0.6)
    assert measure("return", TESTS, 200, finals) == pytest.approx(-4.0)
    assert measure("mean_success_end", TESTS, 200, finals) == measure("mean_success_end", TESTS, 200)
    assert measure("steps_to_50", TESTS, 200, finals) == measure("steps_to_50", TESTS, 200)


def test_what_the_pruner_compares_is_better_in_the_objectives_own_direction():
    assert so_far("success_end", TESTS, 1) == pytest.approx(0.3)
    assert so_far("mean_success_end", TESTS, 2) == pytest.approx(0.6)
    assert so_far("steps_to_95", TESTS, 1) == pytest.approx(0.7)
    assert math.isnan(measure("return", {0: [result(100, 1, math.nan)]}, 100))


def test_tests_of_different_rounds_stand_for_the_same_step():
    assert [nominal_steps(steps, 100, 250) for steps in (100, 108, 204, 250, 256)] == [100, 100, 200, 250, 250]
