"""A transfer between two speeds of a point on a line, whose runs take a fraction of a second."""

from pathlib import Path
from typing import Any

import pytest

from karolos.launchers.experiment import Outcome
from karolos.plans.matrix import Matrix
from karolos.specification import Spec, spec_from_dict
from support.fake_launcher import FakeLauncher

LINE: dict[str, Any] = {
    "name": "line",
    "seeds": [0, 1],
    "environment": {"name": "toy", "dimensions": 1, "threshold": 0.2, "max_steps": 10},
    "agent": {"name": "sac", "hidden": [16], "learning_rate": 1e-3, "discount": 0.9},
    "buffer": {"capacity": 2000, "hindsight": {"strategy": "future"}},
    "orchestrator": {"processes": 0, "environments": 4},
    "training": {"steps": 160, "batch_size": 32, "replay_ratio": 16, "warmup_episodes": 4},
    "testing": {"interval": 40, "episodes": 10},
    "transfer": {
        "variants": {"fast": {"environment.speed": 0.3}, "slow": {"environment.speed": 0.15}},
        "fine_tune": {"training.steps": 80, "training.warmup_episodes": 0, "testing.interval": 20},
        "threshold": 0.3,
    },
}


def line(*overrides: str) -> Spec:
    return spec_from_dict(LINE, overrides)


def run_matrix(
    runs: Path, *overrides: str, resume: bool = False, launcher: FakeLauncher | None = None
) -> tuple[Matrix, Outcome, list[str]]:
    """The matrix executed in this process; also the names of the runs, and of tests in brackets, that were started."""
    launcher, matrix = launcher or FakeLauncher(), Matrix(line(*overrides))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("karolos.plans.plan.make_launcher", lambda *_: launcher)
        outcome = matrix.run(runs, existing="resume" if resume else "ignore")
    names = [(folder.name.rpartition("-s")[0], folder.parent.name == "tests") for folder in launcher.started]
    return matrix, outcome, [f"({name})" if is_test else name for name, is_test in names]
