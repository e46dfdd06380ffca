"""`karolos suite`: nothing is trained twice, mistakes have positions, and specs share a budget."""

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from karolos_cli.plans import suite
from support.commands import call
from support.compared_runs import contender
from support.fake_launcher import FakeLauncher
from support.processes import killed_when, wait_for
from support.transfer_samples import LINE

from karolos.comparison import compare
from karolos.comparison.scores import reaching
from karolos.errors import KarolosError, SpecError, UsageError
from karolos.experiment.events import RunStarted
from karolos.launchers.runs import Home
from karolos.plans import suite as training
from karolos.plans.suite import SuiteJob, SuitePlan
from karolos.plans.suite_report import Entry, SuiteReport, suite_report, verdict
from karolos.records import RunFolder, scan
from karolos.specification import load_spec, spec_from_dict
from karolos.specification.suite import load_suite

app = typer.Typer()
app.command()(suite)
SUITE = {"specs": ["fast.yaml", {"spec": "slow.yaml", "overrides": {"training.steps": 600, "testing.interval": 150}}]}
COMMAND = ("mine.yaml", "seeds=[0]", "--runs", "runs", "--resume", "--json")
SAME = ("spec", "steps", "success_end", "mean_return", "measures")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    line = {key: value for key, value in LINE.items() if key not in ("name", "transfer")}
    for name, speed in (("fast", 0.3), ("slow", 0.15)):
        environment = {**LINE["environment"], "speed": speed}
        Path(f"{name}.yaml").write_text(yaml.safe_dump({**line, "environment": environment}))
    Path("mine.yaml").write_text(yaml.safe_dump(SUITE))
    return tmp_path


def trained(monkeypatch: pytest.MonkeyPatch, *options: str) -> tuple[list[dict[str, Any]], list[str]]:
    """The rows of the suite executed in this process, and the names of the runs that were started."""
    launcher = FakeLauncher()
    monkeypatch.setattr("karolos.plans.plan.make_launcher", lambda *_: launcher)
    code, out, err = call(app, *COMMAND, *options)
    assert code == 0, err
    return [json.loads(row) for row in out.splitlines()], [path.name.partition("-")[0] for path in launcher.started]


def test_a_measure_that_no_spec_has_is_refused_before_anything_runs(folder):
    Path("mine.yaml").write_text(yaml.safe_dump({**SUITE, "measures": ["final_distanse"]}))
    with pytest.raises(
        UsageError, match=r"mine: measures: no spec has the measure .*; did you mean 'final_distance'\?"
    ):
        training.fitted(load_suite("mine.yaml"))


def folders(runs: Path) -> dict[str, RunFolder]:
    return {run.description()["name"]: run for run in scan(runs) if isinstance(run, RunFolder)}


def test_a_suite_killed_on_local_and_resumed_trains_nothing_twice_and_reports_the_same(folder, monkeypatch):
    whole, started = trained(monkeypatch)
    assert started == ["fast", "slow"]
    assert [row["success_end"]["seeds"] for row in whole] == [[row["success_end"]["value"]] for row in whole]
    shutil.move("runs", "undisturbed")
    first = folders(Path("undisturbed"))["fast"]
    shutil.copytree(first.path, Path("runs", first.id))
    command = [sys.executable, "-m", "karolos_cli", "suite", *COMMAND]
    one_thread = {**os.environ, "OMP_NUM_THREADS": "1"}
    killed_when(lambda: list(Path("runs").glob("slow-*/tests.jsonl")), command, env=one_thread)
    slow = folders(Path("runs"))["slow"]
    wait_for(lambda: slow.summary().state in ("stopped", "lost"))  # when its driver is gone
    again, started = trained(monkeypatch, "--beside", "undisturbed")
    assert started == ["slow"]
    assert len(folders(Path("runs"))) == len(list(Path("runs").glob("*/run.json"))) == 2
    for row, before in zip(again, whole, strict=True):
        assert row["beside"]["runs"] == before["runs"]
        assert row["improvement"]["probability"] == 0.5
        assert {key: row[key] for key in SAME} == {key: before[key] for key in SAME}
    short = trained(monkeypatch, "training.steps=150", "agent=td3", "--beside", "undisturbed")[0]
    assert all(abs(row["beside"]["steps"] - row["steps"]) <= 15 for row in short)
    page = Path("runs/suites/mine-seeds-0-training.steps-150-agent-td3/report.html").read_text()
    assert "undisturbed has other settings: agent, training.steps" in page
    page = Path("runs/suites/mine-seeds-0/report.html").read_text()
    assert f'href="../../{again[1]["runs"][0]}"' in page


def test_mistakes_are_shown_where_they_are(folder):
    Path("fast.yaml").write_text("robot: panda\ntask: reach\nagent: {name: sac, discont: 1}\n")
    entries = "  - fast.yaml\n  - none.yaml\n  - {spec: slow.yaml, overrides: {agent.learning_rate: fast}}\n"
    Path("mine.yaml").write_text(f"specs:\n{entries}  - slow.yaml\n  - slow.yaml\n")
    with pytest.raises(SpecError) as refused:
        load_suite("mine.yaml", ["training.steps=-1"])
    found = [str(problem).split(": ")[:2] for problem in refused.value.problems]
    assert found == [
        ["fast.yaml:3:20", "agent.discont"],
        ["mine.yaml:3:5", "specs"],
        ["mine.yaml:4:56", "agent.learning_rate"],
        ["mine.yaml:6:5", "specs[4]"],
        ["override training.steps=-1", "training.steps"],
    ]
    Path("mine.yaml").write_text("specs:\n  - {spec: slow.yaml, steps: 4}\nmeasure: [x]\n")
    with pytest.raises(SpecError) as refused:
        load_suite("mine.yaml")
    assert [str(problem).split(": ")[0] for problem in refused.value.problems] == ["mine.yaml:2:23", "mine.yaml:3:1"]
    Path("mine.yaml").write_text("specs: [slow.yaml, slow.yaml]\n")
    with pytest.raises(SpecError, match=r"^mine.yaml:1:20: specs\[1\]: two specs are called slow; give"):
        load_suite("mine.yaml")


@pytest.mark.parametrize(
    ("overrides", "left", "said"),
    [
        (
            ["agent=ppo"],
            ["panda_push", "ur5_insert_demos", "bit_flip"],
            ("hindsight", "demonstrations", "replay_ratio"),
        ),
        (["agent=dqn"], ["bit_flip"], ("panda_push is left out: override agent=dqn: agent: dqn chooses one",)),
        (["agent=dqn", "environment.actions=discrete"], ["panda_push", "ur5_insert_demos"], ("bit_flip is left out",)),
    ],
)
def test_what_an_agent_cannot_use_is_left_out_and_named(overrides, left, said, tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text("specs: [panda_push, ur5_insert_demos, bit_flip]\n")
    found = training.fitted(load_suite(path, overrides))
    assert [spec.name for spec in found.specs] == left
    for words in said:
        assert words in "\n".join(found.notes)


def test_a_suite_of_which_an_agent_can_use_nothing_is_refused_with_the_first_reason(tmp_path):
    (tmp_path / "mine.yaml").write_text("specs: [panda_reach, panda_pick]\n")
    with pytest.raises(KarolosError, match=r"takes \d continuous numbers"):
        training.fitted(load_suite(tmp_path / "mine.yaml", ["agent=dqn", "buffer.hindsight.imitate=true"]))


@pytest.mark.parametrize(
    ("load", "path", "said"),
    [
        (load_spec, "mine.yaml", r"^mine\.yaml:1:1: specs: .* a suite, not a spec; `karolos suite mine\.yaml` trains"),
        (load_suite, "fast.yaml", r"^fast\.yaml:1:1: .* a spec, not a suite; `karolos run fast\.yaml` trains it$"),
    ],
)
def test_a_suite_given_as_a_spec_or_a_spec_as_a_suite_is_one_line_with_the_command(folder, load, path, said):
    with pytest.raises(SpecError, match=said):
        load(path)


def test_verdict_counts_specs_without_a_test_and_refuses_probabilities_of_few_seeds():
    def entry(name: str, seeds: int, others: int) -> Entry:
        own, other = contender("own", [[200]] * seeds), contender("other", [[100]] * others)
        spec = spec_from_dict({**LINE, "name": name, "seeds": list(range(5))})
        return Entry(spec, compare([other, own]), reaching(own.runs, "end", 0.95), None)

    entries = (entry("five", 5, 5), entry("lost", 4, 5))  # each run has all successes; one has lost a seed
    report = SuiteReport("mine", "own", "other", entries, ("slow",), (), ())
    assert verdict(report).partition("included. ")[2] == (
        "Success at the end: 1.000 to 1.000, mean 1.000. 1 of 3 specs reached .95 in a test with every seed. "
        "Without a test: slow. A run is better than one of other with probability 1.00, mean over specs with 5 seeds "
        "of each (1); .5: no difference. Too few seeds to tell from other (5 of each are needed): lost."
    )


def test_a_spec_whose_runs_have_no_test_is_named(folder):
    found = load_suite("mine.yaml")
    plan = SuitePlan(found)
    plan.found = [SuiteJob(spec, Home(folder, "", "resume")) for spec in found.specs]
    report = suite_report(plan)
    assert report.untested == ("fast", "slow")
    assert report.warnings == ("no test yet (fast, slow)",)
    assert "Without a test: fast, slow." in verdict(report)


def test_specs_share_a_budget_by_their_steps_and_get_what_others_leave(tmp_path, monkeypatch):
    now = 0.0
    monkeypatch.setattr(training, "monotonic", lambda: now)
    line = {**LINE, "seeds": [0]}
    jobs = [
        SuiteJob(spec_from_dict({**line, "name": name}, [f"training.steps={steps}"]), Home(tmp_path, "", "resume"))
        for name, steps in (("short", 100), ("long", 300), ("last", 100))
    ]
    late, enough = training.too_short(jobs, 49.0, 1)
    assert late == ["short", "last"]
    assert enough == "at 330 steps per second, --budget 1m is enough"
    assert training.too_short(jobs, 60.0, 1)[0] == []
    budget = training.Budget(100.0, 1, jobs)
    short, long, last = jobs
    for job in jobs:
        job.budget = budget
        budget.wait(job, None)
    event = RunStarted("run", 0, 100, "folder")
    assert short.heard(event) is None
    now = 4.0  # of 20
    short.ended()
    assert long.heard(event) is None
    now = 4.0 + 96.0 * 300 / 400
    assert long.heard(event) is None
    now += 0.1
    assert long.heard(event) == "cut after 72 s, its share of the budget"
    long.ended()
    assert last.heard(event) is None
    now = 100.1
    assert last.heard(event) is not None
    assert [job.spec.name for job in jobs if job.cut] == ["long", "last"]


def test_a_budget_that_no_first_test_fits_into_is_refused_with_one_that_is_enough(folder):
    code, out, err = call(app, "mine.yaml", "--budget", "5s")
    assert (code, out) == (2, "")
    said = "--budget: the share of the budget ends before the first test of fast, slow; at 330 steps per second"
    assert said in err
    assert not list(Path("runs").glob("*/run.json"))
