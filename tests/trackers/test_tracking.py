"""Trackers: what their own libraries read back, a second time, a tracker that fails, and what they must not see."""

import struct
import time
from collections.abc import Iterator
from typing import Any

import pytest
from karolos_cli.main import app
from support.commands import call
from support.listeners import Heard
from support.toy_runs import run_of, toy

from karolos.experiment import tracking
from karolos.specification import spec_from_dict
from karolos.store.database import sqlite_url

TOY = toy(training={"steps": 60}, testing={"interval": 20})


def test_a_tracker_is_no_part_of_what_a_run_is():
    assert spec_from_dict({**TOY, "tracking": "mlflow"}).hash() == spec_from_dict(TOY).hash()


def test_mlflow_holds_every_test_setting_and_file_and_a_second_time_changes_nothing(tmp_path):
    tracking_of = pytest.importorskip("mlflow.tracking")
    runs = tmp_path / "a%20b?"
    folder = run_of(toy(TOY, tracking="mlflow"), runs)
    client = tracking_of.MlflowClient(sqlite_url(runs / "mlflow.db"))
    for _ in range(2):
        [run] = client.search_runs([client.get_experiment_by_name("karolos").experiment_id])
        assert (run.info.run_name, run.info.status) == (folder.id, "FINISHED")
        points = client.get_metric_history(run.info.run_id, "test/return")
        assert [(one.step, one.value) for one in points] == [(one.steps, one.mean_return) for one in folder.tests()]
        assert run.data.params["agent.hidden"] == "[8]"
        assert run.data.params["training.steps"] == "60"
        assert {one.path for one in client.list_artifacts(run.info.run_id)} == {*tracking.FILES} - {"spec.yaml"}
        code, printed, _ = call(app, "runs", "push", folder.id, "--to", "mlflow", "--runs", str(runs))
        assert (code, printed.strip()) == (0, folder.id)


def test_trackio_holds_every_test(tmp_path, monkeypatch):
    storage = pytest.importorskip("trackio.sqlite_storage")
    monkeypatch.setattr(storage, "TRACKIO_DIR", tmp_path / "trackio")
    folder = run_of(TOY, tmp_path / "runs")
    for _ in range(2):
        tracking.push("trackio", folder)
        rows = storage.SQLiteStorage.get_logs("karolos", folder.id)
        points = [(row["step"], row["test/return"]) for row in rows if "test/return" in row]
        assert points == [(one.steps, one.mean_return) for one in folder.tests()]


def wandb_records(data: bytes) -> Iterator[bytes]:
    """The records of an offline run: LevelDB's log format in blocks of 32 KiB, after a header of 7 bytes."""
    place, record = 7, b""
    while place + 7 <= len(data):
        if (left := 32768 - place % 32768) < 7:
            place += left
            continue
        size, kind = struct.unpack_from("<HB", data, place + 4)
        record += data[place + 7 : place + 7 + size]
        place += 7 + size
        if kind in (1, 4):  # whole, or its last part
            yield record
            record = b""


def test_wandb_keeps_an_offline_run_of_every_test(tmp_path, monkeypatch):
    pytest.importorskip("wandb")
    from wandb.proto.wandb_internal_pb2 import Record

    monkeypatch.setenv("WANDB_MODE", "offline")
    folder = run_of(toy(TOY, tracking="wandb"), tmp_path)
    [file] = (tmp_path / "wandb").glob("offline-run-*/*.wandb")
    assert folder.id in file.name
    records, deadline = list[Any](), time.monotonic() + 20
    while not (records and records[-1].HasField("exit")) and time.monotonic() < deadline:  # its service writes late
        records = [Record.FromString(one) for one in wandb_records(file.read_bytes())]
    rows = [{one.key or one.nested_key[0]: one.value_json for one in record.history.item} for record in records]
    assert [int(row["steps"]) for row in rows if "test/return" in row] == [one.steps for one in folder.tests()]
    [run] = [one.run for one in records if one.WhichOneof("record_type") == "run"][:1]
    assert (run.run_id, run.run_group) == (folder.id, "toy")
    assert "agent.hidden" in {one.key for one in run.config.update}


def test_a_tracker_that_fails_is_a_warning_and_loses_no_run(tmp_path, monkeypatch):
    def fail(*_: Any) -> None:
        raise ConnectionError("no route to the tracker")

    heard = Heard()
    monkeypatch.setattr(tracking, "open_tracker", fail)
    monkeypatch.setenv(tracking.VARIABLE, "mlflow")
    assert run_of(TOY, tmp_path, listener=heard).state().state == "finished"
    [warning] = heard.warnings
    assert warning.startswith("the tracker failed: ConnectionError: no route to the tracker (the run goes on; `karolos")
    assert warning.endswith(f" --runs {tmp_path}` sends it later)")
    monkeypatch.undo()
    code, _, said = call(app, "runs", "push", "@last", "--runs", str(tmp_path))
    assert (code, "its spec names no tracker; name one with --to" in said) == (2, True)
    code, _, said = call(app, "runs", "push", "@last", "--to", "mlfow", "--runs", str(tmp_path))
    assert (code, "choose mlflow, wandb, trackio" in said) == (2, True)


def test_secrets_and_code_do_not_reach_a_tracker(tmp_path):
    folder = run_of(TOY, tmp_path)
    told = tracking.Tracked.of(folder)
    assert (told.group, told.settings["agent.name"]) == ("toy", "sac")
    assert "code.diff" not in tracking.FILES
    assert tracking.Tracked("r", "toy-t007", "p", tmp_path, {}).group == "toy"


def test_a_run_is_pushed_to_the_tracker_of_its_spec(tmp_path, monkeypatch):
    pushed = []
    folder = run_of(toy(TOY, tracking="wandb"), tmp_path)
    monkeypatch.setattr(tracking, "push", lambda name, one: pushed.append((name, one.id)))
    assert call(app, "runs", "push", "@last", "--runs", str(tmp_path))[0] == 0
    assert pushed == [("wandb", folder.id)]
