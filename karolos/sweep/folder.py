"""The folder of a sweep. Its runs are in the runs folder like all others.

runs/sweeps/<name>/
    sweep.yaml      the resolved spec with its sweep
    sweep.json      id and what is searched; read by `karolos.records.sweep_records`, as are trials.jsonl and final.json
    journal.log     every trial, as Optuna's journal, to resume the sweep
    trials.jsonl    the same, one line per trial, for readers without Optuna
    best.yaml       the best trial as a spec
    final.json      the best trials on new seeds
    figures/        of the search
    lock            held by the process of the sweep
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from ..errors import RunError, UsageError
from ..files import append_lines, locked, write_json, write_whole, writing
from ..records.run_records import timestamp
from ..records.sweep_records import (
    BEST,
    DESCRIPTION,
    FINAL,
    LOCK,
    TRIALS,
    SweepFinal,
    SweepRecord,
    read_sweep,
    read_sweep_description,
)
from ..specification import Spec, Sweep, load_spec, to_yaml
from .events import SweepListener
from .objectives import directions
from .study import Study

_SWEEP_LOCK_SECONDS = 0.5
"""Readers hold the lock for an instant to test whether the sweep is running."""
_FREE_SETTINGS = ("trials", "final")
"""Settings of a sweep that may change between two calls, because they do not change existing trials."""


class SweepFolder:
    """A sweep's folder.

    Args:
        path: the folder.
        spec: with its sweep.
        asked: number of trials that the sweep should have.

    Raises:
        RunError: another process runs this sweep.
        UsageError: a sweep of this name has other settings.
        MachineError: from every method that writes.
    """

    def __init__(self, path: Path, spec: Spec, asked: int) -> None:
        self.path, self.figures = path, path / "figures"
        self.spec, self.asked = spec, asked

    @contextmanager
    def claimed(self, listener: SweepListener) -> Iterator[None]:
        """Hold the sweep's lock. Its spec and description are written; `study` holds its trials.

        `listener` is told of warnings.
        """
        refusal = RunError("another process runs this sweep", where=str(self.path), hint="wait for it")
        with locked(self.path / LOCK, refusal, _SWEEP_LOCK_SECONDS):
            self.directions = directions(self.spec)
            sweep, journal = self._claim(), self.path / "journal.log"
            append_lines(journal, ())  # removes an incomplete last line of a killed process
            self.study = Study(journal, sweep, self.spec.name, self.spec.training.steps, self.directions)
            self.listener = listener
            yield

    def write(self) -> SweepRecord:
        """Write the trials, and return the sweep."""
        trials = (json.dumps(one.row(), separators=(",", ":"), allow_nan=False) for one in self.study.trials())
        write_whole(self.path / TRIALS, "".join(f"{line}\n" for line in trials))
        return read_sweep(self.path)[0]

    def write_best(self, spec: Spec, comment: Iterable[str]) -> Path:
        """Write the spec below a comment on its origin."""
        path = self.path / BEST
        write_whole(path, "".join(f"# {line}\n" for line in comment) + to_yaml(spec.dump()))
        return path

    def write_final(self, final: SweepFinal | None) -> None:
        """Write the result of the final phase; None removes that of an earlier call."""
        path = self.path / FINAL
        if final is None:
            with writing(path):
                path.unlink(missing_ok=True)
        else:
            write_json(path, final.row())

    def _claim(self) -> Sweep:
        """Write the spec, and the description with the id and time of the first call.

        Raises UsageError if the folder belongs to a sweep with other settings.
        """
        path = self.path / "sweep.yaml"
        if path.exists() and _fingerprint(load_spec(path)) != _fingerprint(self.spec):
            raise UsageError(
                f"a sweep {self.spec.name!r} with other settings exists",
                where=str(path),
                hint="give this one another name (name=...), or remove that folder",
            )
        write_whole(path, to_yaml(self.spec.dump()))
        sweep = self.spec.sweep
        assert sweep is not None  # only such a spec has a folder
        now = datetime.now(UTC)
        identity, created = f"{self.spec.name}-{now:%Y%m%d-%H%M%S}", timestamp(now)
        if (self.path / DESCRIPTION).exists():
            known = read_sweep_description(self.path)
            identity, created = known.sweep, known.created
        record = SweepRecord(
            sweep=identity,
            name=self.spec.name,
            experiment=self.spec.hash(),
            objectives=sweep.objectives,
            directions=self.directions,
            parameters=tuple(sweep.space),
            seeds=sweep.seeds,
            asked=self.asked,
            wants_final=sweep.final is not None,
            created=created,
            folder=str(self.path),
        )
        write_json(self.path / DESCRIPTION, record.description())
        return sweep


def _fingerprint(spec: Spec) -> str:
    """A hash of the settings that two calls of the same sweep have in common."""
    assert spec.sweep is not None  # only such a spec has a folder
    search = {key: value for key, value in spec.sweep.model_dump(mode="json").items() if key not in _FREE_SETTINGS}
    return hashlib.sha256(json.dumps([spec.hash(), search], sort_keys=True).encode()).hexdigest()
