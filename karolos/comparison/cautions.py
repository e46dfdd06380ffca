"""Warnings about a comparison: unintended differences between the experiments."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial

from ..records.run_records import RunRecord
from ..simulation.engines import ENGINES
from .contenders import Contender


def cautions(contenders: Sequence[Contender]) -> tuple[str, ...]:
    """One line per warning, the most important first."""
    found = [problem for contender in contenders for problem in contender.problems]
    found += _different(contenders, "they do different tasks", _task)
    found += _different(contenders, "different physics engines (environment.engine)", _engine)
    found += _unfinished(contenders)
    found += _different(contenders, "they ended at different steps", lambda run: f"{run.tests[-1].steps:,}")
    found += _without_return(contenders)
    counts = [len(contender.runs) for contender in contenders]
    if len(set(counts)) > 1:
        found.append(f"unequal numbers of seeds: {_each(contenders, counts)}")
    found += _different(contenders, "tests of different numbers of episodes", lambda run: run.episodes)
    found += _different(
        contenders, "figures of different tests", lambda run: "final test" if run.summary.final else "last test"
    )
    for key, what in (
        ("seed", "tests on different episodes (testing.seed)"),
        ("interval", "tests at different intervals, which steps to a ratio depend on (testing.interval)"),
    ):
        found += _different(contenders, what, partial(_testing, key))
    for name in sorted({name for contender in contenders for run in contender.runs for name in run.versions}):
        found += _different(contenders, f"different versions of {name}", partial(_version, name))
    found += _different(contenders, "made from different code (git commit, + with changes)", lambda run: run.commit)
    return tuple(found)


def _unfinished(contenders: Sequence[Contender]) -> list[str]:
    found = []
    for contender in contenders:
        open_ = [run.summary for run in contender.runs if not run.finished]
        if open_:
            named = ", ".join(f"{run.run} {run.state} at {run.steps:,} steps" for run in open_)
            found.append(f"{contender.label}: {len(open_)} of {len(contender.runs)} runs are not finished: {named}")
    return found


def _without_return(contenders: Sequence[Contender]) -> list[str]:
    found = []
    for contender in contenders:
        named = [run.summary.run for run in contender.runs if math.isnan(run.reported("return"))]
        if named:
            found.append(f"{contender.label}: no finite return, so no mean is known: {', '.join(named)}")
    return found


def _different(contenders: Sequence[Contender], what: str, of: Callable[[RunRecord], object]) -> list[str]:
    """One line if the values of the runs differ; unknown values (None) do not count."""
    values = [
        sorted({str(value) for value in map(of, contender.runs) if value is not None}) for contender in contenders
    ]
    if len({value for listed in values for value in listed}) < 2:
        return []
    return [f"{what}: {_each(contenders, [' and '.join(listed) or 'not known' for listed in values])}"]


def _each(contenders: Sequence[Contender], values: Sequence[object]) -> str:
    return "; ".join(f"{contender.label} {value}" for contender, value in zip(contenders, values, strict=True))


def _testing(key: str, run: RunRecord) -> object:
    return (run.spec.get("testing") or {}).get(key)


def _version(package: str, run: RunRecord) -> str | None:
    """The version of a package; None if it is that of an engine that the run did not use."""
    engine = _engine(run)
    others = [one.package for one in ENGINES.values() if engine is not None and one.name != engine]
    return None if package in others else run.versions.get(package)


def _engine(run: RunRecord) -> str | None:
    """The physics engine; None of an environment without one."""
    environment: Mapping[str, str] = run.spec.get("environment") or {}
    return environment.get("engine")


def _task(run: RunRecord) -> str | None:
    """Name of the task, or of the environment and its id if there is no task."""
    name = run.summary.task or run.summary.environment
    environment = run.spec.get("environment")
    if run.summary.task or not isinstance(environment, Mapping) or "id" not in environment:
        return name
    return f"{name} {environment['id']}"
