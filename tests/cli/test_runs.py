"""`karolos runs`: lists, one run, filters, CSV, labels, trash, archives."""

import csv
import io
import shutil
import sys
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from karolos_cli.runs import app
from support import run_commands, run_samples
from support.run_samples import stored
from typer.testing import CliRunner

from karolos.errors import MachineError, RunError, UsageError
from karolos.records import RunFolder, checkpoint
from karolos.store import Store

SPEC = {"name": "reach", "environment": {"name": "toy"}, "robot": None, "agent": {"name": "sac"}, "seeds": [0, 1]}


call, rows = partial(run_commands.call, app), partial(run_commands.rows, app)


def add_run(runs: Path, seed: int, state: str = "finished", spec: dict[str, Any] | None = None) -> str:
    """A run with a test, which measures a force, and a checkpoint."""
    force = {"unit": "N", "better": "smaller", "values": (None, *[10.0 * seed + 4] * 19)}
    about = {"spec": spec or SPEC, "experiment": "abc", "text": "environment: toy\n"}
    error = "it broke" if state == "failed" else None
    run = run_samples.add_run(runs, seed, state=state, error=error, measures={"peak_force": force}, **about)
    checkpoint.save(runs / run / "checkpoints", "best", {"agent": {}}, {"steps": 1000})
    return run


def test_list_gives_a_row_per_run_newest_first(runs):
    first, second = add_run(runs, 0), add_run(runs, 1, "failed")
    found = rows("list", "--runs", runs)
    assert [row["run"] for row in found] == [second, first]
    keys = "run experiment seed state steps seconds success_any success_end steps_to_95 seconds_to_95"
    assert list(found[0])[:10] == keys.split()
    assert found[1].items() >= {"seed": 0, "state": "finished", "success_any": 0.95, "steps_to_95": 1000}.items()
    table = call("list", "--runs", runs)
    assert first in table.stdout
    assert "0.95 [0.76, 0.99]" in table.stdout
    assert all(line == line.rstrip() for line in table.stdout.splitlines())


def test_list_sorts_and_groups(runs):
    first, second = add_run(runs, 0), add_run(runs, 1, "failed")
    for sort, expected in (("seed", [first, second]), ("-seed", [second, first]), ("state", [second, first])):
        assert [row["run"] for row in rows("list", "--sort", sort, "--runs", runs)] == expected
    assert [row["agent.name"] for row in rows("list", "--columns", "agent.name", "--sort", "seed", "--runs", runs)]
    [group] = rows("list", "--group", "--sort", "-success_end", "--runs", runs)
    assert (group["name"], group["runs"], group["states"]) == ("reach", 2, "1 failed, 1 finished")
    assert (group["success_end"], group["best_end"]) == (0.95, None)
    with pytest.raises(UsageError, match="no run has a column 'sed'"):
        call("list", "--sort", "sed", "--runs", runs)
    with pytest.raises(UsageError, match="there is no column 'seed' with --group"):
        call("list", "--group", "--sort", "seed", "--runs", runs)


def test_a_group_has_one_run_per_seed_and_counts_those_that_never_reach_95(runs):
    add_run(runs, 0)
    for seed, successes in ((0, ()), (2, (19,)), *((seed, (0,)) for seed in (3, 4, 5))):
        run_samples.add_run(runs, seed, successes, spec=SPEC, experiment="abc")
    [group] = rows("list", "--group", "--runs", runs)
    assert (group["runs"], group["steps"]) == (6, 800)  # the newer run of seed 0, which has no test
    assert (group["steps_to_95"], group["reached_95"]) == (None, "1 of 4")
    assert "reach: 1 of 6 runs repeat a seed" in call("list", "--group", "--runs", runs).stderr
    [group] = rows("list", "seed in (2, 3)", "--group", "--runs", runs)
    assert (group["steps_to_95"], group["reached_95"]) == (None, "1 of 2")
    [group] = rows("list", "seed=2", "--group", "--runs", runs)
    assert (group["steps_to_95"], group["reached_95"]) == (1000, "1 of 1")


@pytest.mark.parametrize(
    ("options", "ignored"),
    [
        (("--watch", "--json"), "--watch takes no --json"),
        (("--watch", "--trash"), "--watch takes no --trash"),
        (("--trash", "--json", "--columns", "run"), "--trash takes no --columns"),
        (("--group", "--columns", "run"), "--group cannot be combined with --columns"),
    ],
)
def test_options_of_a_list_that_would_be_ignored_are_refused(runs, options, ignored):
    with pytest.raises(UsageError, match=ignored):
        call("list", *options, "--runs", runs)


def test_list_filters_and_limits(runs):
    first = add_run(runs, 0)
    failed, lost = add_run(runs, 1, "failed"), add_run(runs, 2, "running")
    assert [row["run"] for row in rows("list", "--runs", runs, "--state", "failed")] == [failed]
    assert [row["run"] for row in rows("list", "--runs", runs, "--state", "lost")] == [lost]
    assert [row["run"] for row in rows("list", "--runs", runs, "--limit", 1)] == [lost]
    with pytest.raises(UsageError, match="there is no state 'done'"):
        call("list", "--runs", runs, "--state", "done")
    assert [row["run"] for row in rows("list", "measures.peak_force < 24", "--runs", runs)] == [failed, first]
    columns = ("--columns", "seed,measures.peak_force", "--sort", "-measures.peak_force")
    assert [row["measures.peak_force"] for row in rows("list", *columns, "--runs", runs)] == [24, 14, 4]
    with pytest.raises(UsageError, match=r"no run has 'measures\.peak'; did you mean measures\.peak_force"):
        call("list", "measures.peak < 24", "--runs", runs)
    for chosen, told in (("--state=stopped", "no runs are stopped\n"), ("task=push", "no runs match the filter\n")):
        nothing = call("list", "--runs", runs, chosen)
        assert (nothing.stdout, nothing.stderr) == ("", told)


def test_environment_names_folder_and_database(runs, monkeypatch):
    run = add_run(runs, 0)
    monkeypatch.setenv("KAROLOS_RUNS", str(runs))
    assert [row["run"] for row in rows("list")] == [run]
    monkeypatch.setenv("KAROLOS_RUNS", str(runs.parent))
    monkeypatch.setenv("KAROLOS_DATABASE", Store.default_url(runs))
    assert [row["run"] for row in rows("list")] == [run]


@pytest.mark.usefixtures("runs")
def test_place_without_runs_lists_nothing_and_makes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("KAROLOS_RUNS")
    nothing = call("list")
    assert nothing.stdout == ""
    assert "no runs in runs yet; `karolos run SPEC` makes one" in nothing.stderr
    assert rows("list") == []
    with pytest.raises(UsageError, match="means no run: there are no runs in runs yet"):
        call("show", "@last")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(UsageError, match="there is no folder elsewhere; name the runs folder"):
        call("list", "--runs", "elsewhere")


def test_missing_index_is_rebuilt_from_the_folders(runs):
    add_run(runs, 0)
    before = call("list", "--runs", runs, "--json").stdout
    (runs / "karolos.sqlite").unlink()
    again = call("list", "--runs", runs, "--json")
    assert "rebuilt from 1 run folders" in again.stderr
    assert again.stdout == before


def test_show_tells_all_about_a_run(runs):
    run = add_run(runs, 0, "failed")
    (found,) = rows("show", "@last", "--runs", runs)
    assert found["run"] == run
    assert found["spec"] == SPEC
    interval = [pytest.approx(0.7639, abs=1e-4), pytest.approx(0.9911, abs=1e-4)]
    both = {
        f"success_{way}{key}": value for way in ("any", "end") for key, value in (("", 0.95), ("_interval", interval))
    }
    counts = {"steps": 1000, "seconds": 10.0, "episodes": 20, "mean_return": -1.5, "solved_at_reset": 0}
    measures = {"peak_force": {"unit": "N", "better": "smaller", "mean": 4.0}}
    assert found["tests"] == [counts | both | {"measures": measures}]
    assert found["checkpoints"] == [{"name": "best", "steps": 1000}]
    assert found["versions"]["python"] == sys.version.split()[0]
    assert found["problems"] == []
    short, text = (call("show", run[:9], *options, "--runs", runs).stdout for options in ((), ("--all",)))
    for part in (run, "failed: it broke", "0.95 [0.76, 0.99]", "best (1,000 steps)", "agent.name", str(runs), "numpy"):
        assert part in text
    assert all(part in short for part in (run, "failed: it broke", "0.95 [0.76, 0.99]", str(runs)))
    assert not [part for part in ("best (1,000 steps)", "numpy") if part in short]


def test_show_names_what_is_damaged(runs):
    run = add_run(runs, 0)
    with (runs / run / "tests.jsonl").open("a") as file:
        file.write('{"steps":')
    (runs / run / "checkpoints" / "best" / "manifest.json").write_text("{}")
    shown = call("show", run, "--runs", runs)
    assert "warning: tests.jsonl:2: the last line is torn" in shown.stderr
    assert "the checkpoint is damaged" in shown.stderr
    (runs / run / "run.json").unlink()
    with pytest.raises(RunError, match="not a run folder"):
        call("show", run, "--runs", runs)


def test_show_without_a_folder_tells_what_the_index_knows(runs):
    run = add_run(runs, 0)
    shutil.rmtree(runs / run)
    (found,) = rows("show", run, "--runs", runs)
    assert found["spec"] == {key: value for key, value in SPEC.items() if key != "seeds"}
    assert len(found["tests"]) == 1
    assert found["problems"] == [f"the run folder is missing: {runs / run}"]


def test_show_knows_the_runs_that_ship_unless_one_of_ones_own_has_the_name(runs):
    (shipped,) = rows("show", "panda_pick", "--runs", runs.parent)
    assert (shipped["name"], shipped["state"]) == ("panda_pick", "finished")
    run = run_samples.add_run(runs, 0, name="panda_pick")
    assert rows("show", "panda_pick", "--runs", runs)[0]["run"] == run
    with pytest.raises(UsageError, match="did you mean 'panda_pick'"):
        call("show", "panda_pikc", "--runs", runs)


def test_text_from_a_spec_cannot_steer_the_terminal(runs):
    run = add_run(runs, 0, spec={**SPEC, "agent": {"name": "\x1b[2J[bold]x", "\x1b[31m": 1}})
    for shown in (call("show", run, "--runs", runs), call("list", "--runs", runs)):
        assert "\x1b[2J" not in shown.output
        assert "\x1b[31m" not in shown.output
    assert "[2J[bold]x" in call("show", run, "--runs", runs).stdout


def test_watch_shows_what_runs_where_until_nothing_runs(runs, monkeypatch):
    folder = RunFolder.create(runs, "reach", 7)
    folder.describe({}, experiment="e")
    folder.set_state("running", steps=100)
    folder.launch.write_text('{"host": "node-3"}')
    folder.progress.write_text('{"RunAdvanced": {"steps": 1234}}')

    def end(seconds: float) -> None:
        folder.set_state("finished")
        folder.release()

    monkeypatch.setattr("karolos_cli.runs.time.sleep", end)
    shown = call("list", "--runs", runs, "--watch")
    assert shown.stdout.splitlines()[1].split() == [folder.id, "running", "node-3", "1,234"]
    assert "nothing runs" in shown.stderr


def ids(*arguments: object) -> list[str]:
    return [row["run"] for row in rows("list", *arguments)]


def test_only_what_runs_can_be_stopped(runs):
    with pytest.raises(UsageError, match="is finished: there is nothing to stop"):
        call("stop", run_samples.add_run(runs, 0))


def test_csv_has_all_columns_and_no_formulas(runs):
    first = run_samples.add_run(runs, 0)
    call("tag", "--", first, "=1+1", "-x")
    call("note", first, '=HYPERLINK("http://x"), "quoted"\nsecond line \x1b[2J')
    (row,) = csv.DictReader(io.StringIO(call("list", "--csv").stdout))
    assert list(row)[:4] == ["run", "experiment", "seed", "state"]
    assert row["run"] == first
    assert row["tags"] == "'-x; =1+1"
    assert row["note"] == '\'=HYPERLINK("http://x"), "quoted"\nsecond line \N{REPLACEMENT CHARACTER}[2J'
    assert row["success_any"] == "0.95"


def test_tags_and_notes_are_found_shown_and_taken_away(runs):
    first, second = run_samples.add_run(runs, 0), run_samples.add_run(runs, 1)
    call("tag", first, "good", "<script>alert(1)</script>")
    call("note", first, "fell \x1b[2Jover")
    assert ids("tags=good") == ids("note~over") == [first]
    assert "<script>alert(1)</script>, good" in call("list").stdout
    shown = call("show", first).stdout
    assert "good" in shown
    assert "<script>alert(1)</script>" in shown
    assert "\x1b[2J" not in shown
    assert rows("tag", "reach", "all")[0]["tags"] == ["all"]  # the experiment's name: both runs
    assert sorted(ids("tags=all")) == sorted([first, second])
    assert call("tag", "reach", "good", "--remove").stderr == "1 run changed\n"
    assert call("tag", "reach", "good", "--remove").stderr == "nothing changed: no run has such a tag\n"
    assert call("tag", "reach", "all").stderr == "nothing changed: all have these tags already\n"
    call("note", first, "--remove")
    assert call("note", first, "--remove").stderr == "nothing changed: no run has a note\n"
    assert ids("tags=good") == ids("note!=null") == []
    assert RunFolder.open(runs / first).labels().tags == ("<script>alert(1)</script>", "all")
    for wrong in (["note", first], ["note", first, "text", "--remove"], ["note", first, ""]):
        with pytest.raises(UsageError, match="a note needs a text"):
            call(*wrong)
    with pytest.raises(UsageError, match="is not a tag"):
        call("tag", first, "two\nlines")


def test_removed_runs_come_back_with_all_they_had(runs):
    first, second = run_samples.add_run(runs, 0), run_samples.add_run(runs, 1)
    call("tag", first, "good")
    before = rows("list")
    assert first in call("rm", first).stdout
    assert ids() == [second]
    assert [row["run"] for row in rows("list", "--trash")] == [first]
    assert call("list", "--trash").stdout == f"{first}\n"
    call("restore", first[:8])
    assert rows("list") == before
    assert call("list", "--trash").stdout == ""


def test_filter_chooses_what_is_removed(runs):
    first, second = run_samples.add_run(runs, 0), run_samples.add_run(runs, 1, rate=1e-4)
    with pytest.raises(UsageError, match="which runs"):
        call("rm")
    with pytest.raises(UsageError, match="no runs match the filter"):
        call("rm", first, "--where", "seed=1")
    with pytest.raises(UsageError, match="'reach-' means several runs"):
        call("rm", "reach-")
    with RunFolder.open(runs / first) as running:
        running.lock()
        result = CliRunner().invoke(app, ["rm", second, first], env={"KAROLOS_RUNS": str(runs)})
        assert isinstance(result.exception, RunError)
        assert result.stdout.startswith(f"{second} -> "), "what was moved before is told"
    call("restore", second)
    call("rm", "--where", "agent.learning_rate<1e-3")
    assert ids() == [first]
    call("rm", "reach")
    assert ids() == []
    assert len(rows("list", "--trash")) == 2
    with pytest.raises(UsageError, match="--purge empties the trash and takes no RUN"):
        call("rm", second, "--purge")
    assert "2 runs removed for good" in call("rm", "--purge").stderr
    assert rows("list", "--trash") == []


def test_path_of_a_run_folder_elsewhere_changes_no_run_of_the_index(runs, tmp_path):
    run_samples.add_run(runs, 0)
    other = shutil.copytree(
        tmp_path / "other" / run_samples.add_run(tmp_path / "other", 0), tmp_path / "other" / "reach-s0"
    )
    before = rows("list")
    for command in (("rm", other), ("tag", other, "good"), ("note", other, "text")):
        with pytest.raises(UsageError, match=r"reach-s0 is not in the index; name its runs folder with --runs"):
            call(*command)
    assert rows("list") == before


def test_exported_runs_come_in_elsewhere(runs, tmp_path):
    first, second = run_samples.add_run(runs, 0), run_samples.add_run(runs, 1)
    call("tag", first, "good")
    call("export", tmp_path / "x.tar.gz", "reach")
    other = tmp_path / "other"
    assert set(call("import", tmp_path / "x.tar.gz", "--runs", other).stdout.split()) == {first, second}
    came = rows("list", "--runs", other)
    assert [{**row, "folder": ""} for row in came] == [{**row, "folder": ""} for row in rows("list")]
    with Store(Store.default_url(other)) as store:
        assert len(stored(store, first).tests) == 1
    with pytest.raises(UsageError, match=r"exists already; `karolos runs rm`"):
        call("import", tmp_path / "x.tar.gz", "--runs", other)
    assert rows("list", "--runs", other) == came
    with pytest.raises(MachineError, match=r"^[^\n]*x\.tar\.gz[^\n]*$"):
        call("import", tmp_path / "x.tar.gz", "--runs", tmp_path / "x.tar.gz")


def test_spec_file_means_the_runs_of_its_experiment(runs, tmp_path):
    from karolos.specification import load_spec

    path = tmp_path / "toy.yaml"
    path.write_text("environment: toy\nagent: sac\n")
    run_samples.add_run(runs, 0)
    with pytest.raises(UsageError, match=r"there are no runs of .*toy\.yaml; `karolos run"):
        call("show", path)
    spec = load_spec(path)
    run = run_samples.add_run(runs, 0, (), name="toy", spec=spec.dump(), experiment=spec.hash(), state="created")
    assert rows("show", path)[0]["run"] == run
    assert [row["run"] for row in rows("tag", path, "mine")] == [run]
