"""Selectors: what a person types to mean a run, or the runs of an experiment."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import UsageError
from ..records.run_records import RunSummary

if TYPE_CHECKING:
    from .store import Store

SHORTEST_HASH = 6
"""Digits of a hash that are taken for the beginning of one."""
_LISTED = 5
_LAST = re.compile(r"@last(?:-(\d{1,9}))?")
_HASH = re.compile(rf"[0-9a-f]{{{SHORTEST_HASH},}}")


def select(store: Store, selector: str, *, unfinished_ids: bool = False) -> tuple[RunSummary, ...]:
    """The runs that a selector means, the newest first. What comes first counts:

    1. @last, the newest run; @last-2, the second before it
    2. a run's id, or the path of its folder
    3. the name of an experiment: all its runs
    4. how an experiment's hash begins (6 digits or more): all its runs
    5. how a run's id begins

    Args:
        store: the index.
        selector: what was typed.
        unfinished_ids: give all the runs whose ids begin so, for `only` to complain about.

    Raises:
        UsageError: it means no run, or is the beginning of several ids or hashes.
    """
    last = _LAST.fullmatch(selector)
    if last:
        back = int(last[1] or 0)
        newest = store.runs(limit=back + 1)
        if not newest:
            raise UsageError("there are no runs yet", hint="`karolos run SPEC` makes one")
        if len(newest) <= back:
            raise UsageError(f"{selector!r} means no run", hint=f"there are {len(newest)}, from @last on")
        return newest[-1:]
    identity = Path(selector).name
    if not identity:
        raise _none(selector)
    exact = store.runs(ids=[identity])
    if exact:
        return exact
    named = store.runs(name=selector)
    if named:
        return named
    if _HASH.fullmatch(selector):
        hashed = store.runs(experiment=selector)
        experiments = sorted({run.experiment for run in hashed})
        if len(experiments) > 1:
            shown = ", ".join(f"{experiment[:12]}" for experiment in experiments[:_LISTED])
            raise UsageError(f"{selector!r} begins several experiments", hint=f"add digits: {shown}")
        if hashed:
            return hashed
    begun = store.runs(prefix=identity, limit=_LISTED + 1)
    if not begun:
        raise _none(selector)
    return begun if unfinished_ids else (only(selector, begun),)


def only(selector: str, found: Sequence[RunSummary]) -> RunSummary:
    """The one run that was found. Raises UsageError where there are several."""
    if len(found) == 1:
        return found[0]
    listed = ", ".join(run.run for run in found[:_LISTED]) + (" ..." if len(found) > _LISTED else "")
    raise UsageError(f"{selector!r} means several runs", hint=f"one of {listed}; or @last")


def _none(selector: str) -> UsageError:
    return UsageError(f"{selector!r} means no run", hint="`karolos runs list` shows them; @last is the newest")
