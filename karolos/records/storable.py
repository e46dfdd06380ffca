"""Whether every database can store what the folder of a run or a sweep holds. Its files may be damaged or edited."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from .run_records import RunRecord
from .sweep_records import SweepRecord

_BITS = {"attempt": 31, "episodes": 31, "any": 31, "end": 31, "reset": 31, "number": 31, "asked": 31}
"""Bits of integers that are stored in less than 64."""
_LENGTHS = {
    **dict.fromkeys(("experiment", "environment", "robot", "task", "agent"), 128),
    **dict.fromkeys(("name", "seed"), 64),
    **dict.fromkeys(("created", "updated"), 32),
    "state": 16,
}
"""Most characters of texts that are not stored in full length."""
_DEEPEST = 50
"""Levels of nested objects and lists in a spec."""


def run_fault(record: RunRecord) -> str | None:
    """The first value of a run that cannot be stored, in one line; None if all can."""
    summary = asdict(record.summary)
    seed = summary.pop("seed")
    if seed < 0 or seed.bit_length() > 200:  # up to 64 digits
        return "seed is not a number from 0 to 2^200"
    fault = _row_fault(summary)
    for test in record.tests:
        fault = fault or _row_fault(vars(test), f"test after {test.steps} steps: ")
    return fault or _fault(record.spec, "spec") or _fault(record.versions, "versions")


def sweep_fault(record: SweepRecord) -> str | None:
    """The first value of a sweep that cannot be stored, in one line; None if all can."""
    fault = _row_fault({name: value for name, value in vars(record).items() if name not in {"trials", "final"}})
    for trial in record.trials:
        fault = fault or _row_fault(vars(trial), f"trial {trial.number}: ")
    return fault or (_row_fault(vars(record.final), "final: ") if record.final else None)


def _row_fault(row: Mapping[str, Any], where: str = "") -> str | None:
    for name, value in row.items():
        if isinstance(value, str) and len(value) > _LENGTHS.get(name, len(value)):
            return f"{where}{name} is longer than {_LENGTHS[name]} characters"
        if isinstance(value, int) and not -(1 << (bits := _BITS.get(name, 63))) <= value < 1 << bits:
            return f"{where}{name} is an integer of more than {bits + 1} bits"
        if fault := _fault(value, f"{where}{name}"):
            return fault
    return None


def _fault(value: Any, where: str, depth: int = 0) -> str | None:  # noqa: PLR0911  (one return per kind of fault)
    """Why a JSON value cannot be stored; integers of any size can, because they are stored as text."""
    if isinstance(value, str):
        if "\0" in value:
            return f"{where} contains the character NUL"
        return None if value.isascii() or not _has_surrogate(value) else f"{where} contains a lone surrogate"
    if isinstance(value, float):
        return None if math.isfinite(value) else f"{where} is {value}, not a finite number"
    if depth > _DEEPEST:
        return f"{where.partition('.')[0]} is nested more than {_DEEPEST} levels deep"
    if isinstance(value, Mapping):
        for key, one in value.items():
            if fault := _fault(key, f"a key of {where}") or _fault(one, f"{where}.{key}", depth + 1):
                return fault
    elif isinstance(value, list | tuple):
        for one in value:
            if fault := _fault(one, where, depth + 1):
                return fault
    return None


def _has_surrogate(text: str) -> bool:
    return any("\ud800" <= character <= "\udfff" for character in text)
