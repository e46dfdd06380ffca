"""Runs for comparisons, without folders or a database."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from karolos.comparison import Comparison, Contender, compare
from karolos.records.evaluation import Evaluation
from karolos.records.run_records import RunRecord
from support import run_samples

SPEC: dict[str, Any] = {
    "name": "reach",
    "seeds": [0, 1],
    "task": {"name": "reach"},
    "environment": {"name": "robot_task"},
    "agent": {"name": "sac", "learning_rate": 1e-3, "hidden": [256, 256]},
    "testing": {"interval": 1000, "episodes": 100, "seed": 0},
}


def run(
    seed: int,
    successes: Sequence[int],
    *,
    name: str = "reach",
    interval: int = 1000,
    rate: float = 100.0,
    episodes: int = 100,
    spec: Mapping[str, Any] = SPEC,
    versions: Mapping[str, str] | None = None,
    commit: str | None = None,
    has_success: bool = True,
    **values: Any,
) -> RunRecord:
    """A run with a test every `interval` steps: so many episodes succeed at some step, half of them at the end.

    This number minus 200 is the return.
    """
    tests = tuple(
        Evaluation(
            place * interval,
            place * interval / rate,
            episodes,
            *((k, k // 2, 0) if has_success else (None, None, None)),
            k - 200.0,
        )
        for place, k in enumerate(successes, 1)
    )
    steps = len(tests) * interval
    usual = {"run": f"{name}-s{seed}", "experiment": f"hash of {name}", "seed": seed, "name": name, "steps": steps}
    usual |= {"seconds": steps / rate, "updates": steps / rate * 50, "episodes": episodes, "task": "reach"}
    usual |= {"environment": "robot_task", "agent": "sac", "folder": f"/nowhere/{name}-s{seed}"}
    return RunRecord(run_samples.summary(**usual | values), spec, tests, versions or {}, commit)


def contender(label: str, curves: Sequence[Sequence[int]], **options: Any) -> Contender:
    """One run for each curve, with seeds 0, 1 ..."""
    return Contender(label, tuple(run(seed, curve, name=label, **options) for seed, curve in enumerate(curves)))


CURVES = [[0, 50, 90], [0, 40, 100], [10, 60, 95], [0, 0, 0], [0, 20, 85]]
EVIL = "<script>alert(1)</script>\"'><img src=x onerror=alert(2)>"


def comparison() -> Comparison:
    return compare([contender("one", CURVES), contender("two", CURVES[:2])], "any")


def evil() -> Comparison:
    """Everything that a person or a plugin can put a text into."""
    spec = SPEC | {"agent": {"name": EVIL, EVIL: EVIL}}
    found = contender(EVIL, CURVES, spec=spec, commit=EVIL, versions={EVIL: EVIL}, state=EVIL, error=EVIL)
    runs = tuple(replace(run, summary=replace(run.summary, tags=(EVIL,), note=EVIL)) for run in found.runs)
    return compare([contender("one", CURVES, versions={EVIL: "1"}), Contender(EVIL, runs, (EVIL,))], "any")
