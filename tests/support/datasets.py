"""Recordings for tests: of the expert of reaching, and a LeRobotDataset that karolos did not write."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from karolos.core.seeding import SeedTree
from karolos.environments.build import Facts, opened
from karolos.orchestrator.local import Local
from karolos.recordings.lerobot import write_lerobot
from karolos.recordings.playing import Recorder, build_recorded, expert_act
from karolos.recordings.recording import RecordingFolder, describe
from karolos.specification import spec_from_dict
from karolos.specification.parts import Recipe

REACH: dict[str, Any] = {
    "robot": {"name": "panda", "control": "cartesian"},
    "task": {"name": "reach", "reward": "sparse", "max_steps": 12},
    "agent": {"name": "sac", "hidden": [8]},
    "buffer": {"name": "uniform", "capacity": 1000, "hindsight": {}},
    "orchestrator": {"processes": 0, "environments": 2},
    "training": {"steps": 24, "batch_size": 8, "replay_ratio": 1, "warmup_episodes": 0},
    "testing": {"interval": 24, "episodes": 1},
}
RECIPE = spec_from_dict(REACH).recipe(randomize=False)


COLUMNS = {
    "tool_position": "arm[0:3] mm",
    "tool_velocity": "arm[3:6] mm/s",
    "desired_goal": "goal SI",
}
"""Of what `foreign` writes."""


def facts(recipe: Recipe = RECIPE) -> Facts:
    with opened(recipe) as environment:
        return Facts.of(environment)


def record(path: Path, episodes: int = 3, environments: int = 2, **how: Any) -> RecordingFolder:
    """Record the expert in our own format."""
    folder = RecordingFolder(path)
    folder.begin(describe(RECIPE, {"title": "reach", "task": "Reach.", "robot": "panda", "policy": "expert"}))
    settings = Local.Settings(processes=0, environments=environments)
    with Local(settings, partial(build_recorded, RECIPE, expert=True)) as orchestrator:
        act, hidden = expert_act(orchestrator.signature), orchestrator.signature.action.size
        Recorder(orchestrator, act, SeedTree(0), folder, episodes, hidden=hidden, **{"noise": 0.1, **how}).run()
    return folder


def lerobot(path: Path, episodes: int = 3) -> Path:
    """Record the expert as a LeRobotDataset."""
    folder = record(path / "own", episodes)
    about = folder.about()
    assert about is not None
    write_lerobot(path / "lerobot", about, folder.recordings(), "Reach.")
    return path / "lerobot"


def foreign(path: Path, own: RecordingFolder, **changed: Any) -> Path:
    """What somebody else's script would write of the same episodes: millimetres, names of its own, no last state."""
    frames: dict[str, list[Any]] = {
        name: [] for name in ("arm", "goal", "joints", "action", "frame_index", "episode_index")
    }
    lengths = []
    for place, one in enumerate(own.recordings()):
        count = one.steps
        frames["arm"] += (one.observation[:count] * 1000).tolist()
        frames["goal"] += one.desired_goal[:count].tolist()
        frames["joints"] += [[90.0] * 7] * count
        frames["action"] += one.action.tolist()
        frames["frame_index"] += range(count)
        frames["episode_index"] += [place] * count
        lengths.append(count)
    sizes = {name: np.array(values[:1]).reshape(-1).size for name, values in frames.items()}
    info = {"codebase_version": "v3.0", "fps": 24, "total_episodes": len(lengths)}
    info["data_path"] = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    info["features"] = {name: {"dtype": "float32", "shape": [size]} for name, size in sizes.items()}
    (path / "meta/episodes/chunk-000").mkdir(parents=True)
    (path / "data/chunk-000").mkdir(parents=True)
    (path / "meta/info.json").write_text(json.dumps({**info, **changed}))
    pq.write_table(pa.table(frames), path / "data/chunk-000/file-000.parquet")
    rows = [
        {"episode_index": k, "length": n, "data/chunk_index": 0, "data/file_index": 0} for k, n in enumerate(lengths)
    ]
    pq.write_table(pa.Table.from_pylist(rows), path / "meta/episodes/chunk-000/file-000.parquet")
    return path
