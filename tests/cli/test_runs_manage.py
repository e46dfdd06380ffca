"""`karolos runs`: filters, CSV, labels, trash, archives."""

from __future__ import annotations

import csv
import io
import shutil
from functools import partial
from pathlib import Path

import pytest
from karolos_cli.runs import app
from support import run_commands
from support.run_samples import add_run, stored
from typer.testing import CliRunner

from karolos.errors import MachineError, RunError, UsageError
from karolos.records import RunFolder
from karolos.store import Store

call, rows = partial(run_commands.call, app), partial(run_commands.rows, app)


def ids(*arguments: object) -> list[str]:
    return [row["run"] for row in rows("list", *arguments)]


def test_list_takes_a_filter(runs: Path) -> None:
    first, second = add_run(runs, 0), add_run(runs, 1, rate=1e-4)
    assert ids("task=reach and agent.learning_rate<1e-3 and state=finished") == [second]
    assert ids("task=reach", "--limit", 1) == [second]
    assert ids("seed in (0, 5)") == [first]
    nothing = call("list", "task=push")
    assert (nothing.stdout, nothing.stderr) == ("", "no runs match the filter\n")
    with pytest.raises(UsageError, match=r"filter, column 1: no run has 'agent\.learning_rat'; did you mean"):
        call("list", "agent.learning_rat=1")
    with pytest.raises(UsageError, match=r"filter, column 6: something is missing after '='"):
        call("list", "task=")


def test_only_what_runs_can_be_stopped(runs: Path) -> None:
    with pytest.raises(UsageError, match="is finished: there is nothing to stop"):
        call("stop", add_run(runs, 0))


def test_csv_has_all_columns_and_no_formulas(runs: Path) -> None:
    first = add_run(runs, 0)
    call("tag", "--", first, "=1+1", "-x")
    call("note", first, '=HYPERLINK("http://x"), "quoted"\nsecond line \x1b[2J')
    (row,) = csv.DictReader(io.StringIO(call("list", "--csv").stdout))
    assert list(row)[:4] == ["run", "experiment", "seed", "state"]
    assert row["run"] == first
    assert row["tags"] == "'-x; =1+1"
    assert row["note"] == '\'=HYPERLINK("http://x"), "quoted"\nsecond line \N{REPLACEMENT CHARACTER}[2J'
    assert row["success_any"] == "0.95"


def test_tags_and_notes_are_found_shown_and_taken_away(runs: Path) -> None:
    first, second = add_run(runs, 0), add_run(runs, 1)
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


def test_removed_runs_come_back_with_all_they_had(runs: Path) -> None:
    first, second = add_run(runs, 0), add_run(runs, 1)
    call("tag", first, "good")
    before = rows("list")
    assert first in call("rm", first).stdout
    assert ids() == [second]
    assert [row["run"] for row in rows("list", "--trash")] == [first]
    assert call("list", "--trash").stdout == f"{first}\n"
    call("restore", first[:8])
    assert rows("list") == before
    assert call("list", "--trash").stdout == ""


def test_filter_chooses_what_is_removed(runs: Path) -> None:
    first, second = add_run(runs, 0), add_run(runs, 1, rate=1e-4)
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


def test_path_of_a_run_folder_elsewhere_changes_no_run_of_the_index(runs: Path, tmp_path: Path) -> None:
    add_run(runs, 0)
    other = shutil.copytree(tmp_path / "other" / add_run(tmp_path / "other", 0), tmp_path / "other" / "reach-s0")
    before = rows("list")
    for command in (("rm", other), ("tag", other, "good"), ("note", other, "text")):
        with pytest.raises(UsageError, match=r"reach-s0 is not in the index; name its runs folder with --runs"):
            call(*command)
    assert rows("list") == before


def test_run_that_goes_on_is_not_removed(runs: Path) -> None:
    first = add_run(runs, 0)
    with RunFolder.open(runs / first) as folder:
        folder.lock()
        with pytest.raises(RunError, match="another process is running it"):
            call("rm", first)
    assert ids() == [first]


def test_exported_runs_come_in_elsewhere(runs: Path, tmp_path: Path) -> None:
    first, second = add_run(runs, 0), add_run(runs, 1)
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


def test_spec_file_means_the_runs_of_its_experiment(runs: Path, tmp_path: Path) -> None:
    from karolos.specification import load_spec

    path = tmp_path / "toy.yaml"
    path.write_text("environment: toy\nagent: sac\n")
    add_run(runs, 0)
    with pytest.raises(UsageError, match=r"there are no runs of .*toy\.yaml; `karolos run"):
        call("show", path)
    spec = load_spec(path)
    run = add_run(runs, 0, (), name="toy", spec=spec.dump(), experiment=spec.hash(), state="created")
    assert rows("show", path)[0]["run"] == run
    assert [row["run"] for row in rows("tag", path, "mine")] == [run]
