"""A sweep over a point on a line, which is learned within a second with a suitable learning rate."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from karolos.records.sweep_records import DESCRIPTION, FINAL, FOLDER, TRIALS, SweepFinal, SweepRecord, Trial


def sweep_spec(space: dict[str, Any], **sweep: Any) -> dict[str, Any]:
    return {
        "name": "line",
        "environment": {"name": "toy", "dimensions": 1, "threshold": 0.2, "speed": 0.3, "max_steps": 10},
        "agent": {"name": "sac", "hidden": [32], "learning_rate": 1e-6, "discount": 0.9},
        "buffer": {"capacity": 2000, "hindsight": {"strategy": "future"}},
        "orchestrator": {"processes": 0, "environments": 4},
        "training": {"steps": 200, "batch_size": 32, "replay_ratio": 32, "warmup_episodes": 4},
        "testing": {"interval": 50, "episodes": 10},
        "sweep": {"space": space, "seeds": [0], **sweep},
    }


LEARNING_RATE = {"agent.learning_rate": {"float": [1e-6, 1e-1], "log": True}}


def write_sweep(
    runs: Path, name: str, trials: list[Trial], final: SweepFinal | None = None, **known: Any
) -> SweepRecord:
    """A sweep's folder as `karolos sweep` leaves it; returns what it says."""
    folder = runs / FOLDER / name
    folder.mkdir(parents=True, exist_ok=True)
    values = {
        "sweep": f"{name}-20260101-000000",
        "experiment": "abc",
        "objectives": ("success_end", "steps_to_95"),
        "directions": ("maximize", "minimize"),
        "parameters": ("agent.learning_rate",),
        "seeds": (0, 2**70),
        "asked": 3,
        "wants_final": final is not None,
        "created": "2026-01-01T00:00:00.000000Z",
    }
    record = SweepRecord(name=name, folder=str(folder.resolve()), **(values | known))
    (folder / DESCRIPTION).write_text(json.dumps(record.description()))
    (folder / TRIALS).write_text("".join(json.dumps(trial.row()) + "\n" for trial in trials))
    if final is not None:
        (folder / FINAL).write_text(json.dumps(final.row()))
    return replace(record, trials=tuple(trials), final=final)


def some_trial(number: int, state: Any = "complete", value: float = 0.5) -> Trial:
    return Trial(
        number,
        f"x-t{number:03}",
        state,
        {"agent.learning_rate": 10.0**-number},
        (value, 1000.0) if state == "complete" else None,
        (f"x-t{number:03}-s0-20260101-000000",) if state != "running" else (),
        "a loss that is nan" if state == "failed" else None,
    )
