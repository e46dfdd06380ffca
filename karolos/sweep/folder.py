"""The sweep's own folder; its runs lie beside all others in the runs folder.

runs/sweeps/<name>/
    sweep.yaml      the resolved spec with its sweep
    sweep.json      id and what is searched; read by `karolos.records.sweep_records`, as are trials.jsonl and final.json
    journal.log     every trial, as Optuna's journal: what a sweep goes on from
    trials.jsonl    the same, one line per trial, for whoever reads it without Optuna
    best.yaml       the best trial as a spec that runs
    final.json      the best trials on fresh seeds
    figures/        of the search
    lock            held by the process that carries it out; workers/ those of its processes
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType

from ..errors import RunError, UsageError
from ..files import FileLock, append_lines, write_json, write_whole, writing
from ..records.run_records import timestamp
from ..records.sweep_records import (
    DESCRIPTION,
    FINAL,
    LOCK,
    TRIALS,
    SweepFinal,
    SweepRecord,
    Trial,
    read_sweep_description,
)
from ..spec import Spec, load_spec, to_yaml
from .objectives import directions

ORPHAN_SECONDS = 60.0
"""How long the processes of a sweep that was killed are waited for: they notice, write a checkpoint and end."""
_POLL_SECONDS = 0.05
_LOCK_SECONDS = 0.5
"""A reader that looks whether a sweep goes on holds the lock for an instant."""
_FREE = ("trials", "final")
"""What of a sweep may change between two calls: it adds trials, and changes none."""


class SweepFolder:
    """One sweep's folder, locked for as long as it is used in a `with`.

    Args:
        path: the folder.
        spec: with its sweep.
        asked: how many trials it is to have.

    Raises:
        RunError: another process carries this sweep out.
        UsageError: a sweep of this name searches something else.
        MachineError: from every method that writes.
    """

    def __init__(self, path: Path, spec: Spec, asked: int) -> None:
        self.path = path
        self.journal = path / "journal.log"
        self.workers = path / "workers"
        self.figures = path / "figures"
        self._spec = spec
        self._asked = asked
        self._lock = FileLock(path / LOCK)

    def __enter__(self) -> SweepFolder:
        with writing(self.path):
            self.workers.mkdir(parents=True, exist_ok=True)
        if not self._lock.acquire(_LOCK_SECONDS):
            raise RunError("another process carries this sweep out", where=str(self.path), hint="wait for it")
        try:
            self._claim()
            self._await_orphans()
            append_lines(self.journal, ())  # cuts off what a killed process may have left half-written
        except BaseException:
            self._lock.release()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()

    def write_trials(self, trials: Iterable[Trial]) -> None:
        lines = [json.dumps(trial.row(), separators=(",", ":"), allow_nan=False) for trial in trials]
        write_whole(self.path / TRIALS, "".join(f"{line}\n" for line in lines))

    def write_best(self, spec: Spec, comment: Iterable[str]) -> Path:
        """The spec under the words that say where it comes from."""
        path = self.path / "best.yaml"
        write_whole(path, "".join(f"# {line}\n" for line in comment) + to_yaml(spec.dump()))
        return path

    def write_final(self, final: SweepFinal | None) -> None:
        """What the best trials came to on fresh seeds; None takes away what an earlier call found."""
        path = self.path / FINAL
        if final is None:
            with writing(path):
                path.unlink(missing_ok=True)
        else:
            write_json(path, final.row())

    def _claim(self) -> None:
        """Write the spec down, or see that what was written down searches the same."""
        path = self.path / "sweep.yaml"
        if path.exists() and _fingerprint(load_spec(path)) != _fingerprint(self._spec):
            raise UsageError(
                f"a sweep {self._spec.name!r} with other settings is there already",
                where=str(path),
                hint="give this one another name (name=...), or remove that folder",
            )
        write_whole(path, to_yaml(self._spec.dump()))
        write_json(self.path / DESCRIPTION, self._described().description())

    def _described(self) -> SweepRecord:
        """What sweep.json is to say; id and time are those of the first call."""
        sweep = self._spec.sweep
        assert sweep is not None  # only such a spec has a folder
        now = datetime.now(UTC)
        identity, created = f"{self._spec.name}-{now:%Y%m%d-%H%M%S}", timestamp(now)
        if (self.path / DESCRIPTION).exists():
            known = read_sweep_description(self.path)
            identity, created = known.sweep, known.created
        return SweepRecord(
            sweep=identity,
            name=self._spec.name,
            experiment=self._spec.hash(),
            objectives=sweep.objectives,
            directions=directions(sweep.objectives),
            parameters=tuple(sweep.space),
            seeds=sweep.seeds,
            asked=self._asked,
            wants_final=sweep.final is not None,
            created=created,
            folder=str(self.path),
        )

    def _await_orphans(self) -> None:
        deadline = time.monotonic() + ORPHAN_SECONDS
        while any(FileLock(path).is_locked() for path in self.workers.iterdir()):
            if time.monotonic() > deadline:
                raise RunError(
                    "a process of this sweep, whose parent was killed, is still running",
                    where=str(self.workers),
                    hint="end it, and start the sweep again",
                )
            time.sleep(_POLL_SECONDS)


def _fingerprint(spec: Spec) -> str:
    """What two calls must have in common to be the same sweep."""
    assert spec.sweep is not None  # only such a spec has a folder
    search = {key: value for key, value in spec.sweep.dump().items() if key not in _FREE}
    return hashlib.sha256(json.dumps([spec.hash(), search], sort_keys=True).encode()).hexdigest()
