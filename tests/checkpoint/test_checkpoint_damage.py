from __future__ import annotations

import hashlib
import json
import os
import pickle
from pathlib import Path
from typing import Any

import pytest
import torch
from support.checkpoint_samples import META, PARTS

from karolos.checkpoint import CheckpointError, load, save
from karolos.checkpoint.manifest import FORMAT, seal
from karolos.errors import RunError


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    return save(tmp_path, "best", PARTS, META)


def test_every_flipped_byte_of_the_manifest_is_found(whole: Path) -> None:
    path = whole / "manifest.json"
    data = path.read_bytes()
    meaning = json.loads(data)
    for place in range(len(data)):
        changed = bytearray(data)
        changed[place] ^= 0x04
        path.write_bytes(changed)
        try:
            found = load(whole.parent, "best")
        except RunError:
            continue
        assert json.loads(changed) == meaning, f"byte {place}"  # white space only
        assert found[1] == META


@pytest.mark.parametrize("part", ["agent.pt", "buffer.pt"])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.999])
def test_flipped_byte_is_found(whole: Path, part: str, share: float) -> None:
    data = bytearray((whole / part).read_bytes())
    data[int(share * len(data))] ^= 1
    (whole / part).write_bytes(data)
    with pytest.raises(CheckpointError, match=rf"{part}: the checkpoint is damaged: its content was changed; use"):
        load(whole.parent, "best")


@pytest.mark.parametrize("name", ["agent.pt", "manifest.json"])
@pytest.mark.parametrize("size", [0, 1, 100])
def test_truncated_file_is_found(whole: Path, name: str, size: int) -> None:
    data = (whole / name).read_bytes()
    (whole / name).write_bytes(data[:size])
    with pytest.raises(CheckpointError, match="damaged"):
        load(whole.parent, "best")


@pytest.mark.parametrize("name", ["agent.pt", "buffer.pt", "manifest.json"])
def test_missing_file_is_found(whole: Path, name: str) -> None:
    (whole / name).unlink()
    with pytest.raises(CheckpointError, match=f"damaged: .*{'manifest' if 'json' in name else 'No such file'}"):
        load(whole.parent, "best")


def test_missing_checkpoint_names_those_that_are_there(whole: Path) -> None:
    with pytest.raises(CheckpointError, match="there is no checkpoint 'last'; there are best"):
        load(whole.parent, "last")
    with pytest.raises(CheckpointError, match="there are no checkpoints"):
        load(whole / "nowhere", "last")


def rewrite(path: Path, **changes: Any) -> None:
    """A manifest that is sound in itself, as somebody who knows the format would forge it."""
    manifest = json.loads((path / "manifest.json").read_text()) | changes
    manifest["files"] = {
        part: {
            "bytes": (path / f"{part}.pt").stat().st_size,
            "sha256": hashlib.sha256((path / f"{part}.pt").read_bytes()).hexdigest(),
        }
        for part in manifest["files"]
    }
    manifest["sha256"] = seal(manifest)
    (path / "manifest.json").write_text(json.dumps(manifest))


def test_newer_format_is_named(whole: Path) -> None:
    rewrite(whole, format=FORMAT + 1)
    with pytest.raises(CheckpointError, match="format 2, this karolos knows 1; update karolos"):
        load(whole.parent, "best")


class Trap:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.mark),)


@pytest.mark.parametrize("by", ["pickle", "torch"])
def test_malicious_pickle_is_refused_and_not_run(whole: Path, by: str, tmp_path: Path) -> None:
    mark = tmp_path / "sprung"
    if by == "pickle":
        (whole / "agent.pt").write_bytes(pickle.dumps({"x": Trap(mark)}, protocol=2))
    else:
        torch.save({"x": Trap(mark)}, whole / "agent.pt")
    rewrite(whole)
    with pytest.raises(CheckpointError, match=r"does not hold a plain state and was not loaded; it may run foreign"):
        load(whole.parent, "best")
    assert not mark.exists()


@pytest.mark.parametrize(
    "state",
    [
        [1],
        {"x": {"__karolos__": "array"}},
        {"x": {"__karolos__": "array", "dtype": "O", "shape": (1,), "data": torch.zeros(8, dtype=torch.uint8)}},
        {"x": {"__karolos__": "array", "dtype": "f4", "shape": (9,), "data": torch.zeros(8, dtype=torch.uint8)}},
        {"x": {"__karolos__": "integer", "text": "zz"}},
    ],
)
def test_forged_state_is_refused(whole: Path, state: Any) -> None:
    torch.save(state, whole / "agent.pt")
    rewrite(whole)
    with pytest.raises(CheckpointError):
        load(whole.parent, "best")


def test_forged_part_name_leads_nowhere(whole: Path) -> None:
    manifest = json.loads((whole / "manifest.json").read_text())
    manifest["files"] = {"../../agent": manifest["files"]["agent"]}
    manifest["sha256"] = seal(manifest)
    (whole / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(CheckpointError, match="changed"):
        load(whole.parent, "best")
