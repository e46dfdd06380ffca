import json
import os
import sys
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.run_samples import SPEC, new_run, result

from karolos.core.environment import STAGE
from karolos.errors import MachineError, RunError
from karolos.records import RunFolder, run_folder, scan
from karolos.records.run_records import timestamp
from karolos.system.files import read_values


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    return new_run(tmp_path)


def test_collision_adds_a_number(tmp_path, monkeypatch):
    class Clock(datetime):
        @classmethod
        def now(cls, tz: Any = None) -> datetime:
            return datetime(2026, 1, 2, 3, 4, 5, tzinfo=UTC)

    monkeypatch.setattr("karolos.records.run_folder.datetime", Clock)
    ids = [RunFolder.create(tmp_path, "reach", 0).id for _ in range(3)]
    assert ids == ["reach-s0-20260102-030405", "reach-s0-20260102-030405-2", "reach-s0-20260102-030405-3"]


def test_runs_folder_that_is_a_file_is_told(tmp_path):
    (tmp_path / "runs").write_text("")
    for attempt in (RunFolder.check_writable, lambda runs: RunFolder.create(runs, "x", 0)):
        with pytest.raises(MachineError, match=r"runs: a file is in the way of a folder; name another"):
            attempt(tmp_path / "runs")


def test_check_writable_makes_the_folder_and_leaves_it_empty(tmp_path):
    RunFolder.check_writable(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []


def test_folder_says_what_the_run_was_made_from(tmp_path):
    run = new_run(tmp_path, text="robot: panda  # mine\n")
    assert (run.path / "spec.yaml").read_text() == "robot: panda  # mine\n"
    opened = RunFolder.open(run.path)
    assert opened.spec() == SPEC
    about = opened.description()
    assert {"id": run.id, "experiment": "abc", "name": "reach", "seed": 3}.items() <= about.items()
    assert about["versions"]["python"] == sys.version.split()[0]
    text = (run.path / "run.json").read_text()
    assert os.uname().nodename not in text.replace(about["machine"], "")
    assert "remote" not in text


def test_folder_is_no_run_before_it_is_described(tmp_path):
    run = RunFolder.create(tmp_path, "x", 0)
    assert list(scan(tmp_path)) == []
    with pytest.raises(RunError, match="not a run folder"):
        RunFolder.open(run.path)


def test_state_is_kept_and_steps_stay_when_not_given(run):
    assert run.state().state == "created"
    run.set_state("running")
    run.set_state("running", steps=50, seconds=1.5)
    run.set_state("failed", error="it broke")
    state = RunFolder.open(run.path).state()
    assert (state.state, state.steps, state.seconds, state.error) == ("failed", 50, 1.5, "it broke")
    assert state.updated > run.description()["created"]


@pytest.mark.parametrize(
    ("stored", "processes", "seen"),
    [
        ("created", 1, "created"),
        ("created", 2, "lost"),  # its second process died before it resumed
        ("running", 1, "lost"),
        ("finished", 1, "finished"),
        ("stopped", 1, "stopped"),
    ],
)
def test_run_that_nobody_runs_is_lost_unless_it_ended_or_waits_for_its_start(run, stored, processes, seen):
    for _ in range(1, processes):
        run.next_attempt()
    run.set_state(stored)
    assert RunFolder.open(run.path).state().state == stored
    run.release()
    assert RunFolder.open(run.path).state().state == seen
    assert json.loads((run.path / "state.json").read_text())["state"] == stored  # a reader writes nothing


def test_run_that_ends_between_two_looks_is_not_lost(run, monkeypatch):
    run.set_state("running")
    reader = RunFolder.open(run.path)

    def ends_now() -> bool:
        run.set_state("finished")
        run.release()
        return False

    monkeypatch.setattr(reader, "is_locked", ends_now)
    assert reader.state().state == "finished"


def test_second_process_on_a_run_is_refused(run):
    other = RunFolder.open(run.path)
    with pytest.raises(RunError, match="another process is running it"):
        other.lock()
    with run:
        assert other.is_locked()
    other.lock()
    assert other.next_attempt() == 2
    assert other.state().attempt == 2
    other.release()


def test_repeated_test_replaces_the_first(run):
    for each in (result(100, 3), result(200, 4), result(100, 5)):
        run.add_test(each)
    assert run.tests() == (result(100, 5), result(200, 4))


def test_torn_test_is_told_and_the_rest_is_read(run):
    run.add_test(result(100, 3))
    with (run.path / "tests.jsonl").open("a") as file:
        file.write('{"steps":1}\n{"steps":200,"any":[1,')
    assert run.tests() == (result(100, 3),)
    problems = run.record().problems
    assert problems == ("tests.jsonl:2: not a test; left out", "tests.jsonl:3: the last line is torn; left out")
    assert run.record().tests == (result(100, 3).counts,)
    run.add_test(result(300, 4))
    assert run.tests() == (result(100, 3), result(300, 4))


def test_the_process_that_runs_it_reads_its_tests_once(tmp_path, monkeypatch):
    read: list[str] = []
    monkeypatch.setattr(
        run_folder, "read_values", lambda path, *more: read.append(path.name) or read_values(path, *more)
    )
    with new_run(tmp_path) as run:
        for steps in (100, 200, 300):
            run.add_test(result(steps, 3))
            assert [test.steps for test in run.record().tests][-1] == steps
        assert read == ["tests.jsonl"]
        run.cut_tests(200)
        assert run.tests() == (result(100, 3), result(200, 3))
    with RunFolder.open(run.path) as other:
        other.lock()
        other.add_test(result(300, 4))
    assert run.tests() == (result(100, 3), result(200, 3), result(300, 4))


def test_sound_folder_has_no_problems_and_missing_files_are_named(run):
    run.event("started", processes=2)
    assert run.record().problems == ()
    assert [(event["event"], event["processes"]) for event in run.events()] == [("started", 2)]
    (run.path / "resolved.json").unlink()
    (run.path / "state.json").write_text("{")
    run.release()
    record = RunFolder.open(run.path).record()
    assert record.problems == ("resolved.json: missing, damaged or changed", "state.json: missing or damaged")
    assert record.summary.state == "lost"


def test_summary_counts_success_of_the_last_test_and_the_first_at_95(run):
    before = run.summary()
    assert (before.success_any, before.success_end, before.steps_to_95, before.episodes) == (None, None, None, None)
    for each in (result(100, 19, end=18), result(200, 19), result(300, 20), result(400, 10)):
        run.add_test(each)
    run.set_state("finished", steps=410, seconds=4.5)
    row = run.summary().row()
    first = "run experiment seed state steps seconds success_any success_end steps_to_95 seconds_to_95"
    assert list(row)[:10] == first.split()
    assert list(row.values())[1:10] == ["abc", 3, "finished", 410, 4.5, 0.5, 0.5, 200, 2.0]
    assert (row["environment"], row["robot"], row["agent"], row["episodes"]) == ("toy", None, "sac", 20)
    assert (row["steps_to_95_any"], row["seconds_to_95_any"]) == (100, 1.0)
    json.dumps(row, allow_nan=False)


VALID = '{"format":FORMAT,"id":"ID","name":"x","seed":0,"created":"","experiment":""}'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        *((text, r"run\.json is damaged") for text in ("", "[]", '{"id": "x"}', "\x00")),
        (VALID.replace("FORMAT", "1").replace("ID", "../x"), r"run\.json is damaged"),
        (VALID.replace("FORMAT", "2").replace("ID", "x"), "newer karolos made this run folder; update"),
    ],
)
def test_description_that_cannot_be_read_is_told_and_does_not_hide_the_others(tmp_path, text, told):
    good, bad = new_run(tmp_path), new_run(tmp_path)
    (bad.path / "run.json").write_text(text)
    with pytest.raises(RunError, match=told):
        RunFolder.open(bad.path)
    assert [getattr(each, "id", type(each)) for each in scan(tmp_path)] == [good.id, RunError]


@given(st.datetimes(datetime(2000, 1, 1), datetime(2100, 1, 1)), st.timedeltas(), st.integers(-12, 12))
def test_timestamps_sort_like_times(first, later, hours):
    ours = first.replace(tzinfo=timezone(timedelta(hours=hours)))
    theirs = ours.astimezone(UTC) + abs(later) % timedelta(days=9000)
    assert (timestamp(ours) < timestamp(theirs)) == (ours < theirs)
    assert (timestamp(ours) == timestamp(theirs)) == (ours == theirs)


def test_success_of_training_episodes_is_told_by_the_stage_that_they_began_in(run):
    assert run.stages(STAGE) == {}
    begun = [(1.0, 0.0, True), (0.0, 1.0, False), (0.0, 0.0, True), (1.0, 0.0, False)] * 3
    names = "task.start_grasped", "task.start_near"
    rows = [{"end": end, "parameters": dict(zip(names, drawn, strict=True)) | {"x": 3.0}} for *drawn, end in begun]
    run.add_episodes(rows)
    assert run.stages(STAGE, 4) == {"grasped": (2, 1), "near": (1, 0), "start": (1, 1)}
    run.add_episodes([{"end": True, "parameters": {"task.start_near": 0.6}}])
    assert run.stages(STAGE) == {}, "version 0.2 recorded the probability"
