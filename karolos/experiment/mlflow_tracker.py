"""Runs in MLflow: in the server of MLFLOW_TRACKING_URI, or in mlflow.db in the runs folder."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from pathlib import Path

from mlflow.entities import Metric, Param, RunTag
from mlflow.tracking import MlflowClient
from typing_extensions import override

from ..store.database import sqlite_url
from .tracking import Tracked, Tracker

PARAMS = 100
"""Largest number of values in one batch."""
STATES = {"finished": "FINISHED", "failed": "FAILED"}


class MlflowTracker(Tracker):
    """A run of MLflow, found again by its tag `karolos.run`."""

    def __init__(self, run: Tracked) -> None:
        address = os.environ.get("MLFLOW_TRACKING_URI") or sqlite_url(run.runs / "mlflow.db")
        self._client = MlflowClient(address)
        found = self._client.get_experiment_by_name(run.project)
        where = (run.runs / "mlflow").as_uri() if address.startswith("sqlite:") else None
        experiment = found.experiment_id if found else self._client.create_experiment(run.project, where)
        same = self._client.search_runs([experiment], f"tags.`karolos.run` = '{run.id}'")
        self.known = set()
        if same:
            self._id = same[0].info.run_id
            self.known = {point.step for point in self._client.get_metric_history(self._id, "test/return")}
            self._client.update_run(self._id, status="RUNNING")
            return
        tags = {"karolos.run": run.id, "karolos.group": run.group, "karolos.experiment": run.settings["experiment"]}
        self._id = self._client.create_run(experiment, tags=tags, run_name=run.id).info.run_id
        params = [Param(name, str(value)[:6000]) for name, value in run.settings.items()]
        for first in range(0, len(params), PARAMS):
            self._client.log_batch(self._id, params=params[first : first + PARAMS])
        self._client.log_batch(self._id, tags=[RunTag("mlflow.source.name", "karolos")])

    @override
    def add(self, points: Mapping[str, float], steps: int) -> None:
        now = int(time.time() * 1000)
        self._client.log_batch(self._id, [Metric(name, value, now, steps) for name, value in points.items()])

    @override
    def add_files(self, files: list[Path]) -> None:
        for file in files:
            self._client.log_artifact(self._id, str(file))

    @override
    def end(self, state: str) -> None:
        self._client.set_terminated(self._id, STATES.get(state, "KILLED"))
