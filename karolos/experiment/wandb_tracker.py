"""Runs in Weights & Biases: offline in the runs folder, unless WANDB_MODE=online; `wandb sync` sends them later."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import wandb
from typing_extensions import override

from .tracking import Tracked, Tracker


class WandbTracker(Tracker):
    """A run of W&B with the id of the run. Code, command line, console and facts of the machine are not sent."""

    def __init__(self, run: Tracked) -> None:
        quiet = {"console": "off", "disable_git": True, "save_code": False, "silent": True, "x_disable_stats": True}
        self.known = set()  # offline this is unknown; if two points have the same steps W&B shows the later one
        mode: Any = os.environ.get("WANDB_MODE", "offline")
        self._run = wandb.init(
            project=run.project,
            id=run.id,
            name=run.id,
            group=run.group,
            config=run.settings,
            dir=os.environ.get("WANDB_DIR") or str(run.runs),
            mode=mode,
            resume="allow",
            reinit="create_new",
            settings=wandb.Settings(**quiet, x_disable_meta=True, x_disable_machine_info=True),
        )
        self._run.define_metric("*", step_metric="steps")

    @override
    def add(self, points: Mapping[str, float], steps: int) -> None:
        self._run.log({"steps": steps, **points})

    @override
    def add_files(self, files: list[Path]) -> None:
        artifact = wandb.Artifact(f"{self._run.id}-records", type="run")
        for file in files:
            artifact.add_file(str(file))
        self._run.log_artifact(artifact)

    @override
    def end(self, state: str) -> None:
        self._run.finish(exit_code=0 if state == "finished" else 1)
