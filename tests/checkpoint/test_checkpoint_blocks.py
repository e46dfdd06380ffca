"""Large arrays lie in blocks that checkpoints share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from karolos import checkpoint
from karolos.checkpoint import CheckpointError
from karolos.checkpoint.array_files import SIZE


def large(seed: int, blocks: float = 3.5) -> np.ndarray:
    """Float32 numbers that take so many blocks."""
    return np.random.default_rng(seed).random(int(blocks * SIZE / 4), np.float32)


def blocks(folder: Path) -> set[str]:
    return {path.name for path in (folder / ".blocks").iterdir()}


@pytest.mark.parametrize("shape", [(-1,), (2, -1), (-1, 7)])
def test_large_array_comes_back_bit_for_bit(tmp_path: Path, shape: tuple[int, ...]) -> None:
    array = large(0)[: 7 * 100_000].reshape(shape)
    array.flat[3] = np.nan
    checkpoint.save(tmp_path, "last", {"buffer": {"table": array}}, {})
    found = checkpoint.load(tmp_path, "last")[0]["buffer"]["table"]
    assert found.dtype == array.dtype
    assert found.shape == array.shape
    assert found.tobytes() == array.tobytes()


def test_second_checkpoint_writes_only_the_blocks_that_changed(tmp_path: Path) -> None:
    array = large(1)
    checkpoint.save(tmp_path, "last", {"buffer": {"table": array}}, {})
    before = {name: (tmp_path / ".blocks" / name).stat().st_ino for name in blocks(tmp_path)}
    array[0] += 1
    checkpoint.save(tmp_path, "last", {"buffer": {"table": array}}, {})
    after = {name: (tmp_path / ".blocks" / name).stat().st_ino for name in blocks(tmp_path)}
    assert len(after) == len(before) == 4
    assert len(set(before.items()) & set(after.items())) == 3


def test_blocks_go_when_no_checkpoint_uses_them(tmp_path: Path) -> None:
    checkpoint.save(tmp_path, "best", {"buffer": {"table": large(2)}}, {})
    kept = blocks(tmp_path)
    checkpoint.save(tmp_path, "last", {"buffer": {"table": large(3)}}, {})
    assert kept < blocks(tmp_path)
    (tmp_path / ".last.new").mkdir()  # what a killed process left
    (tmp_path / ".blocks" / ".half.1").write_bytes(b"0")
    checkpoint.save(tmp_path, "last", {"agent": {"steps": 1}}, {})
    assert blocks(tmp_path) == kept
    assert np.array_equal(checkpoint.load(tmp_path, "best")[0]["buffer"]["table"], large(2))


@pytest.mark.parametrize("damage", ["changed", "truncated", "missing"])
def test_damaged_block_is_refused_by_name(tmp_path: Path, damage: str) -> None:
    checkpoint.save(tmp_path, "last", {"agent": {"steps": 1}, "buffer": {"table": large(4)}}, {})
    block = tmp_path / ".blocks" / sorted(blocks(tmp_path))[1]
    data = bytearray(block.read_bytes())
    if damage == "missing":
        block.unlink()
    elif damage == "truncated":
        block.write_bytes(data[:-1])
    else:
        data[100] ^= 1
        block.write_bytes(data)
    with pytest.raises(CheckpointError, match=f"block {block.name[:12]}"):
        checkpoint.load(tmp_path, "last")
    assert checkpoint.load(tmp_path, "last", only=("agent",))[0] == {"agent": {"steps": 1}}


def test_block_that_was_truncated_is_written_again(tmp_path: Path) -> None:
    checkpoint.save(tmp_path, "last", {"buffer": {"table": large(5)}}, {})
    block = tmp_path / ".blocks" / sorted(blocks(tmp_path))[0]
    block.write_bytes(b"")
    checkpoint.save(tmp_path, "last", {"buffer": {"table": large(5)}}, {})
    assert np.array_equal(checkpoint.load(tmp_path, "last")[0]["buffer"]["table"], large(5))
