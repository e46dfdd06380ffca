"""Transfer results: tests of a run's policy under changed settings, one line each in transfers.jsonl of its folder.

Any process may append at any time, also while the run goes on; the file has its own lock.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from ..files import append_lines, locked, read_lines
from . import RunFolder
from .decode import from_json
from .results import TestCounts, TestResult, decode_test, encode_test

FILE = "transfers.jsonl"


@dataclass(frozen=True)
class TransferResult:
    """The result of a test of a saved policy under changed settings."""

    time: str
    """End of the test (ISO 8601, UTC)."""
    checkpoint: str
    sha256: str
    """Of the agent's state in the checkpoint; it identifies the policy if the checkpoint is overwritten later."""
    overrides: tuple[str, ...]
    """Changes to the run's spec, as `path=value`."""
    randomized: bool
    """Whether domain randomization was on."""
    seed: int
    """Root of the test episodes' seeds."""
    wall_seconds: float
    """Duration of the test."""
    result: TestResult
    """Episode by episode; `steps` and `seconds` are those of training before the checkpoint."""
    versions: Mapping[str, str]
    own: TestCounts
    """The same policy on the same episodes under the unchanged spec."""

    def row(self) -> dict[str, Any]:
        """The fields as JSON values, in the order that scripts rely on; intervals are Wilson's at 95 %."""
        return {
            "time": self.time,
            "checkpoint": self.checkpoint,
            "steps": self.result.steps,
            "overrides": list(self.overrides),
            "randomized": self.randomized,
            "seed": self.seed,
            **TestCounts.of(self.result).row(),
            "own": self.own.row(),
            "wall_seconds": self.wall_seconds,
        }


def add(folder: RunFolder, transfer: TransferResult) -> None:
    """Append a result; it is on the disk when this returns.

    Raises:
        MachineError: the folder cannot be written, or another process keeps the file locked.
    """
    with locked(folder.path / "transfers.lock"):
        append_lines(folder.path / FILE, [_encode(transfer)])


def read(folder: RunFolder) -> tuple[tuple[TransferResult, ...], tuple[str, ...]]:
    """The results in the order of the file, and one line per problem."""
    rows, problems = read_lines(folder.path / FILE)
    decoded = [_decode(row) for row in rows]
    invalid = decoded.count(None)
    if invalid:
        problems += (f"{FILE}: {invalid} lines are not results of a test; left out",)
    return tuple(transfer for transfer in decoded if transfer is not None), problems


def _encode(transfer: TransferResult) -> dict[str, Any]:
    row = {name: value for name, value in vars(transfer).items() if name != "result"}
    test = {"episodes": transfer.result.episodes, "test": encode_test(transfer.result)}
    return row | test | {"own": asdict(transfer.own), "versions": dict(transfer.versions)}


def _decode(row: Mapping[str, Any]) -> TransferResult | None:
    """The result in a JSON object, or None if it is not one."""
    test = row.get("test")
    valid = isinstance(test, dict) and decode_test(test) is not None
    return from_json(TransferResult, {**row, "result": test}) if valid else None
