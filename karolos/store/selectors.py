"""Selectors: the text a person types to name one run, or the runs of an experiment."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import sqlalchemy

from ..errors import NoSuchRunError, UsageError
from ..records import RunFolder
from ..records.run_records import RunSummary
from ..records.sweep_records import BEST, best_name
from ..registry import closest
from .database import Database
from .runs import find_runs
from .sweeps import Sweeps
from .tables import RUNS

SHORTEST_HASH = 6
"""Fewest digits that are taken for the beginning of a hash."""
_LISTED = 5
_LAST = re.compile(r"@last(?:-(\d{1,9}))?")
_HASH = re.compile(rf"[0-9a-f]{{{SHORTEST_HASH},}}")


def select(
    database: Database, selector: str, *, all_prefixed: bool = False, or_trial: bool = False
) -> tuple[RunSummary, ...]:
    """The runs that a selector means, the newest first. The first rule that finds runs counts:

    1. @last, the newest run; @last-2, the second before it
    2. a run's id; or the path of its folder, which means no other run
    3. the name of an experiment: all its runs
    4. the beginning of an experiment's hash (6 digits or more): all its runs
    5. the beginning of a run's id

    A spec file means all runs of its experiment.

    Args:
        database: the index.
        selector: the text.
        all_prefixed: return every run that rule 5 finds, for `only` to refuse.
        or_trial: the name of a sweep's best spec, if no run has it, means the trial that the final phase chose.

    Raises:
        NoSuchRunError: it means no run, or a run folder that the index does not have.
        RunError: it is a run folder that is damaged.
        UsageError: it is the beginning of several ids or hashes.
    """
    last = _LAST.fullmatch(selector)
    if last:
        back = int(last[1] or 0)
        newest = find_runs(database, limit=back + 1)
        if not newest:
            raise UsageError("there are no runs yet", hint="`karolos run SPEC` makes one")
        if len(newest) <= back:
            raise NoSuchRunError(f"{selector!r} means no run", hint=f"there are {len(newest)}, from @last on")
        return newest[-1:]
    if is_spec(selector):
        from ..specification import load_spec  # noqa: PLC0415  (yaml)

        found = find_runs(database, experiment=load_spec(Path(selector), ()).hash())
        if not found:
            raise UsageError(f"there are no runs of {selector}", hint=f"`karolos run {selector}` makes them")
        return found
    identity = Path(selector).name
    if is_run_folder(selector) or os.path.dirname(selector):
        if found := _at(database, Path(selector)):
            return found
    elif identity:
        named = find_runs(database, ids=[identity]) or find_runs(database, name=selector)
        if found := named or _of_best(database, selector, or_trial):
            return found
        if _HASH.fullmatch(selector) and (found := find_runs(database, experiment=selector)):
            experiments = sorted({run.experiment for run in found})
            if len(experiments) > 1:
                shown = ", ".join(experiment[:12] for experiment in experiments[:_LISTED])
                raise UsageError(f"{selector!r} begins several experiments", hint=f"add digits: {shown}")
            return found
        if found := find_runs(database, prefix=identity, limit=_LISTED + 1):
            return found if all_prefixed else (only(selector, found),)
    like = closest(identity, ["@last", *experiment_names(database)])
    hint = "`karolos runs list` shows them; @last is the newest"
    raise NoSuchRunError(f"{selector!r} means no run", hint=f"did you mean {like!r}? {hint}" if like else hint)


def experiment_names(database: Database) -> list[str]:
    """The names of the runs' experiments, each once."""
    return [row.name for row in database.fetch(sqlalchemy.select(RUNS.c.name).distinct())]


def _of_best(database: Database, selector: str, or_trial: bool) -> tuple[RunSummary, ...]:
    """The runs of the trial that a sweep chose, by its best spec's name; none if it is no such name, or as `select`."""
    named = Sweeps(database).all(name=selector.removesuffix(best_name("")))
    sweep = next((one for one in named if best_name(one.name) == selector), None)
    if sweep is None:
        return ()
    if or_trial and sweep.final and sweep.best and (found := find_runs(database, name=sweep.best.name)):
        return found
    spec = os.path.join(sweep.folder, BEST)
    if os.path.isfile(spec):
        raise NoSuchRunError(f"{selector!r} means no run", hint=f"`karolos run {spec}` makes them")
    return ()


def _at(database: Database, path: Path) -> tuple[RunSummary, ...]:
    """The run that the index has at a path; none if there is no run folder. Raises as `select`."""
    there = is_run_folder(path)
    identity = RunFolder.open(path).id if there else path.name
    place = os.path.realpath(path)
    found = tuple(run for run in find_runs(database, ids=[identity]) if os.path.realpath(run.folder) == place)
    if there and not found:
        hint = "name its runs folder with --runs; `karolos db reindex` enters its runs"
        raise NoSuchRunError(f"the run folder {path} is not in the index", hint=hint)
    return found


def is_run_folder(selector: str | Path) -> bool:
    """Whether a selector is the path of a run folder."""
    return os.path.isfile(Path(selector) / "run.json")  # Path.is_file raises for a name that is too long


def is_spec(selector: str) -> bool:
    """Whether a selector is a spec file, or karolos:NAME."""
    return selector.startswith("karolos:") or (selector.endswith((".yaml", ".yml")) and os.path.isfile(selector))


def only(selector: str, found: Sequence[RunSummary]) -> RunSummary:
    """The one run that was found. Raises UsageError if there are several."""
    if len(found) == 1:
        return found[0]
    listed = ", ".join(run.run for run in found[:_LISTED]) + (" ..." if len(found) > _LISTED else "")
    raise UsageError(f"{selector!r} means several runs", hint=f"one of {listed}; or @last")
