"""A spec whose run ends within a second, and a disk that is full."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from karolos.errors import MachineError
from karolos.launchers.experiment import Experiment
from karolos.launchers.runs import Home
from karolos.records import RunFolder, checkpoint
from karolos.specification import spec_from_dict

TOY: dict[str, Any] = {
    "name": "toy",
    "environment": "toy",
    "agent": {"name": "sac", "hidden": [8]},
    "buffer": {"name": "uniform", "capacity": 1000},
    "orchestrator": {"processes": 0, "environments": 2},
    "training": {"steps": 80, "batch_size": 8, "replay_ratio": 4, "warmup_episodes": 2},
    "testing": {"interval": 40, "episodes": 2},
}


def toy(base: dict[str, Any] = TOY, /, **changes: Any) -> dict[str, Any]:
    """The spec with other settings, which a part keeps beside its own."""
    both = {key: value for key, value in changes.items() if isinstance(value, dict) and isinstance(base.get(key), dict)}
    return base | changes | {key: base[key] | value for key, value in both.items()}


REACH = toy(
    name="reach",
    robot={"name": "panda", "control": "cartesian"},
    task={"name": "reach", "max_steps": 5},
    environment="robot_task",
    training={"steps": 20, "warmup_episodes": 1},
    testing={"interval": 20},
)


def run_of(spec: dict[str, Any], runs: Path, **options: Any) -> RunFolder:
    """Run a spec of one seed."""
    (summary,) = Experiment(spec).run(runs, check=False, **options).runs
    return RunFolder.open(summary.folder)


def created(spec: dict[str, Any], runs: Path, seed: int = 0) -> RunFolder:
    """The folder of a run that waits for its process."""
    folder = Home(runs, "").create(spec_from_dict(spec), seed)
    folder.release()
    return folder


def fill_disk(patch: pytest.MonkeyPatch, fits: Callable[[str], object]) -> None:
    """Checkpoints of a name that does not fit cannot be written."""
    save = checkpoint.save

    def full(folder: Path, name: str, *content: Any) -> Path:
        if not fits(name):
            raise MachineError("no space left on the disk")
        return save(folder, name, *content)

    patch.setattr(checkpoint, "save", full)
