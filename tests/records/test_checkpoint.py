"""Checkpoints: replaced whole or not at all, damage that is found, states that come back bit for bit, shared arrays."""

import errno
import hashlib
import json
import os
import pickle
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from support.states import same

from karolos import system
from karolos.errors import MachineError, RunError, UsageError
from karolos.records import checkpoint
from karolos.records.checkpoint import _SOUND, FORMAT, SIZE, CheckpointError, decode, encode, load, save, seal

PARTS = {"agent": {"weight": torch.arange(1000.0)}, "buffer": {"slot": np.arange(50)}}
META = {"experiment": "abc", "steps": 7}


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    return save(tmp_path, "best", PARTS, META)


def test_new_checkpoint_takes_the_place_of_the_old_one(tmp_path):
    save(tmp_path, "best", PARTS, {"steps": 1})
    save(tmp_path, "best", {"agent": {}}, {"steps": 2})
    assert load(tmp_path, "best") == ({"agent": {}}, {"steps": 2})
    assert [path.name for path in tmp_path.iterdir()] == ["best"]
    assert checkpoint.names(tmp_path) == ("best",)


def test_a_part_comes_with_the_digest_of_the_checkpoint_that_it_was_read_from(whole, tmp_path):
    parts, meta = load(tmp_path, "best")
    for part in PARTS:
        state, about, sha256 = checkpoint.load_part(tmp_path, "best", part)
        assert same(state, parts[part])
        assert (about, sha256) == (meta, checkpoint.digest(tmp_path, "best", part))
    with pytest.raises(checkpoint.CheckpointError, match="it lacks other"):
        checkpoint.load_part(tmp_path, "best", "other")


def test_loading_never_leaves_the_folder(tmp_path):
    save(tmp_path, "best", PARTS, {})
    (tmp_path / "inner").mkdir()
    with pytest.raises(UsageError, match="leads out"):
        load(tmp_path / "inner", "../best")


FULL = "the disk is full; free some space; the old content is intact"


@pytest.mark.parametrize("calls", range(8))
def test_disk_that_fails_at_any_moment_keeps_a_whole_checkpoint(whole, calls, monkeypatch):
    left = calls
    fsync = os.fsync

    def fail_later(descriptor: int) -> None:
        nonlocal left
        if left == 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        left -= 1
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", fail_later)
    new = {"agent": {"x": 1}, "buffer": {"y": 2}}
    told = FULL
    try:
        save(whole.parent, "best", new, {})
    except MachineError as error:
        told = str(error)
    assert FULL in told
    monkeypatch.undo()
    found = load(whole.parent, "best")[0]
    assert same(found, PARTS) or same(found, new)
    save(whole.parent, "best", new, {})
    assert same(load(whole.parent, "best")[0], new)
    assert [path.name for path in whole.parent.iterdir()] == ["best"]


def killed_at(folder: Path, place: int) -> int:
    """Save in a fork of this process that is killed before it renames folder `place`, or at its end; how it ended."""
    if child := os.fork():
        return os.waitpid(child, 0)[1]
    rename, left = system.replace, [place]

    def count_down(source: Path, target: Path) -> None:
        if source.is_dir():  # not the manifest
            if not left[0]:
                os.kill(os.getpid(), signal.SIGKILL)
            left[0] -= 1
        rename(source, target)

    try:
        system.replace = count_down
        save(folder, "best", {"agent": {"x": 1}}, {"steps": 8})
        os.kill(os.getpid(), signal.SIGKILL)
    finally:
        os._exit(1)  # an error of it is not one of this test alone


@pytest.mark.parametrize(("place", "steps"), [(0, 7), (1, 7), (2, 8)])
def test_process_killed_between_renames_leaves_a_checkpoint(whole, place, steps):
    assert killed_at(whole.parent, place) == signal.SIGKILL
    assert load(whole.parent, "best")[1]["steps"] == steps
    assert checkpoint.names(whole.parent) == ("best",)
    assert checkpoint.read_meta(whole.parent, "best")["steps"] == steps
    save(whole.parent, "best", PARTS, {"steps": 9})
    assert load(whole.parent, "best")[1]["steps"] == 9
    assert [path.name for path in whole.parent.iterdir()] == ["best"]


@pytest.mark.parametrize("name", ["read_manifest", "unpack_state", "read_state"])
def test_reader_of_a_run_that_goes_on_gets_the_old_or_the_new(whole, name, monkeypatch):
    function = getattr(checkpoint, name)
    new = {"agent": {"weight": torch.ones(3)}}

    def replaced_before(*arguments: Any) -> Any:
        monkeypatch.setattr(checkpoint, name, function)
        save(whole.parent, "best", new, {"steps": 8})
        return function(*arguments)

    monkeypatch.setattr(checkpoint, name, replaced_before)
    parts, meta = load(whole.parent, "best")
    assert meta == {"steps": 8}
    assert same(parts, new)


def test_every_flipped_byte_of_the_manifest_is_found(whole):
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


def damage(path: Path, how: str, place: int = 100) -> None:
    """Damage a file: `changed` at a place, `truncated` there, or `missing`."""
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    if how == "missing":
        path.unlink()
    else:
        path.write_bytes(data if how == "changed" else data[:place])


@pytest.mark.parametrize("how", ["changed", "truncated", "missing"])
@pytest.mark.parametrize("file", ["agent.pt", "buffer.pt", "manifest.json"])
@pytest.mark.parametrize("place", [0, 100, -2])
def test_damaged_file_is_found_and_named(whole, file, how, place):
    damage(whole / file, how, place)
    why = {"changed": "its content was changed", "truncated": "it has .* bytes of", "missing": "it cannot be read"}[how]
    told = "its manifest.json" if file == "manifest.json" else f"{file}: the checkpoint is damaged: {why}"
    with pytest.raises(CheckpointError, match=rf"{told}.*; use another checkpoint"):
        load(whole.parent, "best")


def test_missing_checkpoint_names_those_that_are_there(whole):
    with pytest.raises(CheckpointError, match="there is no checkpoint 'last'; there are best"):
        load(whole.parent, "last")
    with pytest.raises(CheckpointError, match="there are no checkpoints"):
        load(whole / "nowhere", "last")


def rewrite(path: Path, **changes: Any) -> None:
    """A manifest that is sound in itself, as somebody who knows the format would forge it."""
    manifest = json.loads((path / "manifest.json").read_text()) | changes
    for part in manifest["files"].keys() & PARTS.keys():
        data = (path / f"{part}.pt").read_bytes()
        manifest["files"][part] = {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
    manifest["sha256"] = seal(manifest)
    (path / "manifest.json").write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"format": FORMAT + 1}, "format 2, this karolos knows 1; update karolos"),
        ({"files": {"../../agent": {}}}, "changed"),
    ],
)
def test_manifest_of_a_newer_format_or_with_a_part_that_leads_elsewhere_is_refused(whole, change, told):
    rewrite(whole, **change)
    with pytest.raises(CheckpointError, match=told):
        load(whole.parent, "best")


class Trap:
    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> Any:
        return os.mkdir, (str(self.mark),)


@pytest.mark.parametrize("by", ["pickle", "torch"])
def test_malicious_pickle_is_refused_and_not_run(whole, by, tmp_path):
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
def test_forged_state_is_refused(whole, state):
    torch.save(state, whole / "agent.pt")
    rewrite(whole)
    with pytest.raises(CheckpointError):
        load(whole.parent, "best")


def test_state_of_an_agent_comes_back_bit_for_bit(tmp_path):
    network = torch.nn.Sequential(torch.nn.Linear(3, 4), torch.nn.BatchNorm1d(4))
    optimiser = torch.optim.Adam(network.parameters())
    network(torch.rand(5, 3)).sum().backward()
    optimiser.step()
    generators = {kind.__name__: kind(3).state for kind in (np.random.PCG64, np.random.MT19937, np.random.Philox)}
    state = {
        "network": dict(network.state_dict()),
        "optimiser": optimiser.state_dict(),
        "generators": generators,
        "torch": torch.Generator().manual_seed(3).get_state(),
        "bf16": torch.ones(3, dtype=torch.bfloat16),
        "numbers": (1, -(2**127), 2**63, -(2**63), 0.1, -0.0, float("inf"), True, None, "text", np.float32(0.1)),
    }
    save(tmp_path, "last", {"agent": state}, META)
    parts, meta = load(tmp_path, "last")
    assert same(parts["agent"], state)
    assert meta == META
    network.load_state_dict(parts["agent"]["network"])
    optimiser.load_state_dict(parts["agent"]["optimiser"])


simple_arrays = arrays.arrays(
    st.one_of(arrays.scalar_dtypes(), arrays.unicode_string_dtypes(), arrays.byte_string_dtypes()),
    arrays.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)
leaves = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5), simple_arrays)
states = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.lists(inner, max_size=3).map(tuple),
        st.dictionaries(st.one_of(st.text(max_size=5), st.integers(-9, 9)), inner, max_size=3),
    ),
    max_leaves=8,
)


@given(states)
def test_any_state_survives_encoding(state):
    assert same(decode(encode(state)), state)


def test_array_in_any_memory_order_comes_back(tmp_path):
    base = np.arange(12, dtype=">i4").reshape(3, 4)
    frozen = base.copy()
    frozen.flags.writeable = False
    state = {"t": base.T, "fortran": np.asfortranarray(base), "strided": base[::2, ::-1], "frozen": frozen}
    save(tmp_path, "last", {"buffer": state}, {})
    found = load(tmp_path, "last")[0]["buffer"]
    assert all(np.array_equal(found[key], state[key]) and found[key].dtype == ">i4" for key in state)


def test_view_does_not_drag_its_storage_along(tmp_path):
    large = torch.zeros(1_000_000)
    path = save(tmp_path, "last", {"agent": {"view": large[3:7]}}, {})
    assert (path / "agent.pt").stat().st_size < 10_000
    assert torch.equal(load(tmp_path, "last")[0]["agent"]["view"], large[3:7])


@pytest.mark.parametrize(
    ("state", "where"),
    [
        ({"a": {"b": [1, {2}]}}, r"agent\.a\.b\[1\]: a checkpoint cannot hold a set"),
        ({"f": print}, r"agent\.f: a checkpoint cannot hold a builtin"),
        ({"x": np.array([None])}, r"agent\.x: a checkpoint cannot hold an array of object"),
        ({"x": np.zeros(2, [("a", "f4")])}, r"agent\.x: a checkpoint cannot hold an array"),
        ({"__karolos__": 1}, "agent: keys"),
        ({(1, 2): 1}, "agent: keys"),
    ],
)
def test_what_cannot_be_kept_is_refused_by_its_path(tmp_path, state, where):
    with pytest.raises(TypeError, match=where):
        save(tmp_path, "last", {"agent": state}, {})
    assert list(tmp_path.iterdir()) == []


def large(seed: int, files: float = 3.5) -> np.ndarray:
    """Float32 numbers for this many files."""
    return np.random.default_rng(seed).random(int(files * SIZE / 4), np.float32)


def files(folder: Path) -> set[str]:
    return {path.name for path in (folder / ".arrays").iterdir()}


@pytest.mark.parametrize("shape", [(-1,), (2, -1), (-1, 7)])
def test_large_array_comes_back_bit_for_bit(tmp_path, shape):
    array = large(0)[: 7 * 100_000].reshape(shape)
    array.flat[3] = np.nan
    save(tmp_path, "last", {"buffer": {"table": array}}, {})
    found = load(tmp_path, "last")[0]["buffer"]["table"]
    assert found.dtype == array.dtype
    assert found.shape == array.shape
    assert found.tobytes() == array.tobytes()


def test_second_checkpoint_writes_only_the_array_files_that_changed(tmp_path):
    array = large(1)
    save(tmp_path, "last", {"buffer": {"table": array}}, {})
    before = {name: (tmp_path / ".arrays" / name).stat().st_ino for name in files(tmp_path)}
    array[0] += 1
    save(tmp_path, "last", {"buffer": {"table": array}}, {})
    after = {name: (tmp_path / ".arrays" / name).stat().st_ino for name in files(tmp_path)}
    assert len(after) == len(before) == 4
    assert len(set(before.items()) & set(after.items())) == 3


def test_array_files_go_when_no_checkpoint_uses_them(tmp_path):
    save(tmp_path, "best", {"buffer": {"table": large(2)}}, {})
    kept = files(tmp_path)
    save(tmp_path, "last", {"buffer": {"table": large(3)}}, {})
    assert kept < files(tmp_path)
    (tmp_path / ".last.new").mkdir()  # what a killed process left
    (tmp_path / ".arrays" / ".half.1").write_bytes(b"0")
    save(tmp_path, "last", {"agent": {"steps": 1}}, {})
    assert files(tmp_path) == kept
    assert np.array_equal(load(tmp_path, "best")[0]["buffer"]["table"], large(2))


@pytest.mark.parametrize("how", ["changed", "truncated", "missing"])
def test_damaged_array_file_is_refused_by_name_and_written_again(tmp_path, how):
    parts = {"agent": {"steps": 1}, "buffer": {"table": large(4)}}
    save(tmp_path, "last", parts, {})
    path = tmp_path / ".arrays" / sorted(files(tmp_path))[1]
    damage(path, how)
    with pytest.raises(CheckpointError, match=f"array file {path.name[:12]}"):
        load(tmp_path, "last")
    assert load(tmp_path, "last", only=("agent",))[0] == {"agent": {"steps": 1}}
    _SOUND.clear()  # as in a process that has not written it
    save(tmp_path, "last", parts, {})
    assert same(load(tmp_path, "last")[0], parts)


def test_what_a_save_that_failed_wrote_is_removed(tmp_path):
    save(tmp_path, "best", {"buffer": {"table": large(2)}}, {})
    kept = files(tmp_path)
    with pytest.raises(TypeError):
        save(tmp_path, "last", {"buffer": {"table": large(3)}, "agent": {"odd": object()}}, {})
    assert files(tmp_path) == kept
