"""Minari datasets, written and read by the package minari: https://minari.farama.org."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .. import system
from ..system.files import writing
from .recording import NAMES, STATES, Columns, Dataset, Recording, column_names, refuse, require, rows_of

FOLDER = "MINARI_DATASETS_PATH"
"""Environment variable with the folder of minari's datasets."""


def write_minari(path: Path, about: Mapping[str, Any], recordings: Iterable[Recording], name: str) -> None:
    """Write the dataset `name` ("karolos/panda_pick/expert-v0") below a folder. All episodes are in memory.

    Raises MachineError if minari is missing, or the folder cannot be written.
    """
    require("minari", "minari", "a Minari dataset")
    import minari  # noqa: PLC0415
    from gymnasium.spaces import Box, Dict, Discrete, Space  # noqa: PLC0415
    from minari.data_collector.episode_buffer import EpisodeBuffer  # noqa: PLC0415

    def box(part: str) -> Space[Any]:
        return Box(-np.inf, np.inf, (len(column_names(about[part])),), np.float32)

    discrete = isinstance(about["action"], dict)
    action: Space[Any] = Box(-1, 1, box("action").shape or (), np.float32)
    if discrete:
        action = Discrete(len(about["action"]["labels"]))
    goals = bool(about["desired_goal"])
    observation = Dict({part: box(part) for part in STATES}) if goals else box("observation")
    buffers = []
    for place, one in enumerate(recordings):
        states = {part: getattr(one, part) for part in STATES}
        buffers.append(
            EpisodeBuffer(
                id=place,
                seed=one.seed,
                options=None,
                observations=states if goals else one.observation,
                actions=one.action[:, 0].astype(np.int64) if discrete else one.action,
                rewards=one.reward,
                terminations=one.terminated,
                truncations=one.truncated,
                infos={"success": one.success[:, None]},
            )
        )
    before = os.environ.get(FOLDER)
    with writing(path), warnings.catch_warnings():
        path.mkdir(parents=True, exist_ok=True)
        system.remove_tree(path / name, ignore_errors=True)  # of an interrupted call
        try:
            os.environ[FOLDER] = str(path.resolve())
            warnings.simplefilter("ignore")  # of links and addresses that a local dataset does not have
            dataset = minari.create_dataset_from_buffers(
                name,
                buffers,
                observation_space=observation,
                action_space=action,
                algorithm_name=str(about.get("policy")),
                author="karolos",
                data_format="arrow",
                description=str(about.get("title", "")),
            )
            dataset.storage.update_metadata({"karolos": dict(about)})
        finally:
            os.environ.pop(FOLDER)
            if before is not None:
                os.environ[FOLDER] = before


def read_minari(path: Path) -> Dataset:
    """The dataset in a folder, which holds `data/`.

    Raises:
        UsageError: it is damaged.
        MachineError: minari is missing.
    """
    require("minari", "minari", "a Minari dataset")
    from minari.dataset.minari_dataset import MinariDataset  # noqa: PLC0415

    try:
        dataset = MinariDataset(path / "data")
        about: Any = dataset.storage.metadata.get("karolos")
        lengths = tuple(
            int(one["total_steps"]) for one in dataset.storage.get_episode_metadata(dataset.episode_indices)
        )
    except Exception as error:  # minari raises what its formats raise
        refuse(path, f"minari cannot open it: {type(error).__name__}: {next(iter(str(error).splitlines()), '')}")

    def read(place: int) -> Columns:
        index = int(dataset.episode_indices[place])
        try:
            [episode] = dataset.storage.get_episodes([index])
        except Exception as error:
            refuse(path, f"episode {index} cannot be read: {type(error).__name__}: {error}")
        found = {"action": episode["actions"], "reward": episode["rewards"], "terminated": episode["terminations"]}
        observations = episode["observations"]
        found |= observations if isinstance(observations, dict) else {"observation": observations}
        columns: Columns = {}
        for name, values in found.items():
            try:
                columns[name] = rows_of(values)
            except (TypeError, ValueError) as error:
                refuse(path, f"episode {index}, column {name!r}: {error}")
        return columns

    about = about if isinstance(about, dict) else None
    return Dataset(path, lengths, float(about["rate"]) if about else 0.0, NAMES, read, about)
