"""Large arrays are stored in array files that checkpoints share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from karolos.records import checkpoint
from karolos.records.array_files import _SOUND, SIZE
from karolos.records.checkpoint import CheckpointError


def large(seed: int, files: float = 3.5) -> np.ndarray:
    """Float32 numbers for this many files."""
    return np.random.default_rng(seed).random(int(files * SIZE / 4), np.float32)


def files(folder: Path) -> set[str]:
    return {path.name for path in (folder / ".arrays").iterdir()}


@pytest.mark.parametrize("shape", [(-1,), (2, -1), (-1, 7)])
def test_large_array_comes_back_bit_for_bit(tmp_path: Path, shape: tuple[int, ...]) -> None:
    array = large(0)[: 7 * 100_000].reshape(shape)
    array.flat[3] = np.nan
    checkpoint.save(tmp_path, "last", {"buffer": {"table": array}}, {})
    found = checkpoint.load(tmp_path, "last")[0]["buffer"]["table"]
    assert found.dtype == array.dtype
    assert found.shape == array.shape
    assert found.tobytes() == array.tobytes()


def test_second_checkpoint_writes_only_the_array_files_that_changed(tmp_path: Path) -> None:
    array = large(1)
    checkpoint.save(tmp_path, "last", {"buffer": {"table": array}}, {})
    before = {name: (tmp_path / ".arrays" / name).stat().st_ino for name in files(tmp_path)}
    array[0] += 1
    checkpoint.save(tmp_path, "last", {"buffer": {"table": array}}, {})
    after = {name: (tmp_path / ".arrays" / name).stat().st_ino for name in files(tmp_path)}
    assert len(after) == len(before) == 4
    assert len(set(before.items()) & set(after.items())) == 3


def test_array_files_go_when_no_checkpoint_uses_them(tmp_path: Path) -> None:
    checkpoint.save(tmp_path, "best", {"buffer": {"table": large(2)}}, {})
    kept = files(tmp_path)
    checkpoint.save(tmp_path, "last", {"buffer": {"table": large(3)}}, {})
    assert kept < files(tmp_path)
    (tmp_path / ".last.new").mkdir()  # what a killed process left
    (tmp_path / ".arrays" / ".half.1").write_bytes(b"0")
    checkpoint.save(tmp_path, "last", {"agent": {"steps": 1}}, {})
    assert files(tmp_path) == kept
    assert np.array_equal(checkpoint.load(tmp_path, "best")[0]["buffer"]["table"], large(2))


@pytest.mark.parametrize("damage", ["changed", "truncated", "missing"])
def test_damaged_array_file_is_refused_by_name(tmp_path: Path, damage: str) -> None:
    checkpoint.save(tmp_path, "last", {"agent": {"steps": 1}, "buffer": {"table": large(4)}}, {})
    path = tmp_path / ".arrays" / sorted(files(tmp_path))[1]
    data = bytearray(path.read_bytes())
    if damage == "missing":
        path.unlink()
    elif damage == "truncated":
        path.write_bytes(data[:-1])
    else:
        data[100] ^= 1
        path.write_bytes(data)
    with pytest.raises(CheckpointError, match=f"array file {path.name[:12]}"):
        checkpoint.load(tmp_path, "last")
    assert checkpoint.load(tmp_path, "last", only=("agent",))[0] == {"agent": {"steps": 1}}


def test_what_a_save_that_failed_wrote_is_removed(tmp_path: Path) -> None:
    checkpoint.save(tmp_path, "best", {"buffer": {"table": large(2)}}, {})
    kept = files(tmp_path)
    with pytest.raises(TypeError):
        checkpoint.save(tmp_path, "last", {"buffer": {"table": large(3)}, "agent": {"odd": object()}}, {})
    assert files(tmp_path) == kept


@pytest.mark.parametrize("damage", ["changed", "truncated"])
def test_array_file_that_was_damaged_is_written_again(tmp_path: Path, damage: str) -> None:
    checkpoint.save(tmp_path, "last", {"buffer": {"table": large(5)}}, {})
    path = tmp_path / ".arrays" / sorted(files(tmp_path))[0]
    data = bytearray(path.read_bytes())
    data[100] ^= 1
    path.write_bytes(data if damage == "changed" else b"")
    _SOUND.clear()  # as in a process that has not written it
    checkpoint.save(tmp_path, "last", {"buffer": {"table": large(5)}}, {})
    assert np.array_equal(checkpoint.load(tmp_path, "last")[0]["buffer"]["table"], large(5))
