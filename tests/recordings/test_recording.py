"""Recordings out: episodes, their order, interruptions, and what comes back from each format."""

import json
import shutil
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from imageio_ffmpeg import read_frames
from karolos_cli.main import app
from support.commands import call
from support.datasets import facts, lerobot, record

from karolos.errors import RunError
from karolos.recordings.minari_file import write_minari
from karolos.recordings.reading import read_recordings

COMMAND = ["dataset", "panda_reach", "orchestrator.processes=0", "task.max_steps=20"]
COMMAND += ["--expert", "--episodes", "3", "--noise", "0.2", "--out"]


def test_each_format_gives_back_every_bit(tmp_path):
    folder = record(tmp_path / "own", 3)
    about = folder.about()
    assert about is not None
    write_minari(tmp_path, about, folder.recordings(), "karolos/reach/expert-v0")
    places = tmp_path / "own", lerobot(tmp_path / "second"), tmp_path / "karolos/reach/expert-v0"
    own, *others = [read_recordings(place, facts(), {}, 100).episodes for place in places]
    assert len(own) == 3
    for episodes in others:
        for one, other in zip(own, episodes, strict=True):
            for name, column, same in zip(one._fields, one, other, strict=True):
                assert (column.dtype, column.tobytes()) == (same.dtype, same.tobytes()), name


def test_episodes_depend_on_their_number_alone(tmp_path):
    one, other = record(tmp_path / "one", 4, environments=1), record(tmp_path / "other", 4, environments=3)
    for first, second in zip(one.recordings(), other.recordings(), strict=True):
        np.testing.assert_array_equal(first.action, second.action)
        np.testing.assert_array_equal(first.observation, second.observation)


def test_an_interrupted_recording_goes_on_as_if_it_had_not_been(tmp_path):
    def stop(kept: int) -> None:
        if kept == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(tmp_path / "broken", 4, on_episode=stop)
    broken, whole = record(tmp_path / "broken", 4), record(tmp_path / "whole", 4)
    assert [one.seed for one in broken.played()] == [one.seed for one in whole.played()]
    for first, second in zip(broken.recordings(), whole.recordings(), strict=True):
        np.testing.assert_array_equal(first.observation, second.observation)


def test_failures_are_left_out_and_counted_and_a_policy_that_never_succeeds_comes_to_an_end(tmp_path):
    played = record(tmp_path / "some", 3, only_success=True, noise=0.0, random=0.7).played()
    assert sum(one.kept for one in played) == 3
    assert all(one.success == one.kept for one in played)
    assert len(played) > 3
    with pytest.raises(RunError, match="of 100 episodes succeed, and 1 are wanted"):
        record(tmp_path / "none", 1, only_success=True, noise=0.0, random=1.0)


def test_a_lerobot_folder_says_what_lerobot_reads(tmp_path):
    path = lerobot(tmp_path)
    info = json.loads((path / "meta/info.json").read_text())
    table = pq.read_table(path / "data/chunk-000/file-000.parquet")
    episodes = pq.read_table(path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    stats = json.loads((path / "meta/stats.json").read_text())
    assert info["total_frames"] == table.num_rows == sum(row["length"] for row in episodes)
    assert set(info["features"]) == set(table.column_names) == set(stats)
    assert table["index"].to_pylist() == list(range(table.num_rows))
    assert [row["dataset_from_index"] for row in episodes] == [0, 12, 24]
    actions = np.array(table["action"].to_pylist())
    assert stats["action"]["mean"] == pytest.approx(actions.mean(0), abs=1e-6)
    assert stats["action"]["std"] == pytest.approx(actions.std(0), abs=1e-6)
    assert json.loads(pq.read_schema(path / "meta/tasks.parquet").metadata[b"pandas"])["index_columns"] == ["task"]


def test_the_command_writes_a_card_and_refuses_another_dataset_in_its_folder(tmp_path):
    out = tmp_path / "set"
    _, printed, said = call(app, *COMMAND, str(out), "--json")
    row: dict[str, Any] = json.loads(printed)
    assert (row["kept"], row["played"]) == (3, 3)
    card = (out / "README.md").read_text()
    assert card.startswith("---\n")
    assert "| robot | panda |" in card
    assert not (out / ".recording").exists()
    code, _, said = call(app, *COMMAND, str(out))
    assert (code, "the folder is not empty" in said) == (2, True)
    assert call(app, *COMMAND, str(out / "README.md"))[2].endswith(
        "a file is in the way of a folder; name another folder\n"
    )
    assert "set.npz: names a file, and a dataset is a folder" in call(app, *COMMAND, str(tmp_path / "set.npz"))[2]
    begun = tmp_path / "begun"
    call(app, *COMMAND, str(begun), "--format", "karolos")
    shutil.copytree(begun, tmp_path / "other" / ".recording")
    _, _, said = call(app, *COMMAND, str(tmp_path / "other"), "--seed", "1")
    assert "beginning of another dataset: seed differ" in said


def test_films_have_a_picture_for_each_action(tmp_path):
    filmed = [*COMMAND, str(tmp_path), "--episodes", "2", "--camera", "front", "--camera", "wrist", "--size", "32"]
    filmed += ["task.max_steps=4", "orchestrator.environments=1"]
    assert call(app, *filmed)[0] == 0
    info = json.loads((tmp_path / "meta/info.json").read_text())
    rows = pq.read_table(tmp_path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    for name in ("observation.images.front", "observation.images.wrist"):
        assert info["features"][name]["shape"] == [32, 32, 3]
        for row in rows:
            place = {kind: row[f"videos/{name}/{kind}"] for kind in ("chunk_index", "file_index")}
            pictures = read_frames(tmp_path / info["video_path"].format(video_key=name, **place))
            assert next(pictures)["fps"] == info["fps"]
            assert sum(1 for _ in pictures) == row["length"]
    code, _, said = call(app, *COMMAND, str(tmp_path / "other"), "--camera", "side")
    assert (code, "there is no camera 'side'; there are front and wrist" in said) == (2, True)
