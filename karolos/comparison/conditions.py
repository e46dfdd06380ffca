"""Results that only run folders hold: tests under changed settings, and final tests episode by episode."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from ..core.seeding import SeedTree
from ..errors import KarolosError
from ..records import RunFolder
from ..records.evaluation import Evaluation
from ..records.run_records import RunRecord, flatten
from . import aggregates
from .contenders import Contender
from .scores import Estimate, estimate

_Tests = dict[float, Evaluation]
"""Value of a setting -> test under it."""
_Group = tuple[str, int | None, int]
"""Checkpoint, seed and number of episodes of tests that belong together."""


@dataclass(frozen=True)
class Condition:
    """Success over one setting, of the same runs at each of its values."""

    success: Mapping[float, Estimate]
    """Value -> success at the end of the episode, ascending."""
    notes: tuple[str, ...]
    """Tests that are left out, one sentence each."""


def final_values(run: RunRecord) -> dict[str, tuple[float, ...]]:
    """Each measure in the episodes of the final test in which it is defined; empty if no folder holds it."""
    if run.summary.final:
        with suppress(KarolosError):
            if final := RunFolder.open(run.summary.folder).final():
                measures = final["last"].measures.items()
                return {name: tuple(x for x in one.get("values", ()) if x is not None) for name, one in measures}
    return {}


def conditions(contender: Contender, tree: SeedTree) -> dict[str, Condition]:
    """For each setting that tests changed to other numbers: success at each number.

    A test counts if it changed only this setting, defines success, and used the checkpoint's latest policy. Tests
    belong together if checkpoint, seed and number of episodes are the same. The group with the most runs is shown, at
    values at which all of these runs were tested. The run's own value is included, with the success in the same
    episodes. A parameter of the world, such as task.gravity, has no value in the spec. If a value was tested twice, the
    later test counts.
    """
    tested: dict[str, dict[_Group, dict[int, _Tests]]] = {}
    for place, run in enumerate(contender.runs):
        tests: Sequence[Evaluation] = ()
        with suppress(KarolosError):  # the folder is gone or damaged, and the index does not hold these tests
            tests = RunFolder.open(run.summary.folder).transfers().rows
        policies = {test.checkpoint: test.sha256 for test in tests}
        for test in tests:
            setting, _, text = test.overrides[0].partition("=") if len(test.overrides) == 1 else ("", "", "")
            value, own = _number(text), _number(dict(flatten(run.spec)).get(setting))
            if value is None or test.own is None or not (test.has_success and test.own.has_success):
                continue
            if test.randomized or test.sha256 != policies[test.checkpoint]:
                continue
            groups = tested.setdefault(setting, {})
            of_run = groups.setdefault((str(test.checkpoint), test.seed, test.episodes), {})
            of_run.setdefault(place, {}).update({value: test} if own is None else {own: test.own, value: test})
    return {
        setting: _condition(contender, setting, groups, tree.child(setting))
        for setting, groups in sorted(tested.items())
    }


def _condition(
    contender: Contender, setting: str, groups: Mapping[_Group, dict[int, _Tests]], tree: SeedTree
) -> Condition:
    """The group of tests with the most runs, reduced to the runs and values with the most tests.

    `groups` maps group -> place of a run -> its tests that changed the setting.
    """
    (checkpoint, seed, episodes), group = max(groups.items(), key=_size)
    candidates = [
        (sorted(values), [place for place, tests in group.items() if values.keys() <= tests.keys()])
        for values in group.values()
    ]
    shown, places = max(candidates, key=lambda one: (len(one[0]) * len(one[1]), len(one[1])))
    success = {}
    for value in shown:
        ends = [group[place][value].success_end or 0.0 for place in places]
        found = estimate([ends], aggregates.mean, tree.child(f"{value:g}"), episodes)
        if found is not None:
            success[value] = found
    notes = []
    if len(groups) > 1:
        notes.append(f"Only tests of {checkpoint} on {episodes} episodes of seed {seed} are shown.")
    if len(places) < len(contender.runs):
        notes.append(f"{len(places)} of {len(contender.runs)} runs were tested at each of these values.")
    if left_out := sorted({value for tests in group.values() for value in tests}.difference(shown)):
        notes.append(f"Not every run was tested at {', '.join(f'{value:g}' for value in left_out)}.")
    if _number(dict(flatten(contender.spec)).get(setting)) is None:
        notes.append("Success at the nominal value, which the spec does not name, is left out.")
    return Condition(success, tuple(notes))


def _size(group: tuple[_Group, dict[int, _Tests]]) -> tuple[int, int, int]:
    """Runs, tests, and episodes of a test."""
    (_, _, episodes), tests = group
    return len(tests), sum(map(len, tests.values())), episodes


def _number(value: Any) -> float | None:
    """A finite number; None for anything else."""
    try:
        number = float(value) if not isinstance(value, bool) else math.nan
    except (TypeError, ValueError):
        return None
    return number if math.isfinite(number) else None
