"""LeRobotDataset v3, written and read only with pyarrow: https://huggingface.co/docs/lerobot/lerobot-dataset-v3.

The format has no frame for the last state of an episode: it stands in columns `final/...` of meta/episodes. The key
`karolos` of meta/info.json holds the meaning of the numbers, and the exact rate if it is not a whole number.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import system
from ..errors import UsageError
from ..system.files import below, read_object, write_json, writing
from .recording import STATES, Columns, Dataset, Recording, column_names, refuse, require, rows_of

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
FILE_BYTES, FILES_PER_CHUNK = 100 << 20, 1000
NAMES = {
    "observation": "observation.state",
    "desired_goal": "observation.environment_state",
    "achieved_goal": "achieved_goal",
    "action": "action",
    "reward": "next.reward",
    "terminated": "next.terminated",
}
"""Name of the goal that LeRobot's policies expect."""
FLAGS = ("next.done", "next.truncated", "next.terminated", "next.success")
COUNTED = ("timestamp", "frame_index", "episode_index", "index", "task_index")
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}
MOST_FRAMES = 100_000_000
"""Largest number in a dataset that is read; a larger number means a damaged file."""


def features(about: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The features of info.json."""
    found: dict[str, dict[str, Any]] = {}
    for part in (*STATES, "action"):
        names = column_names(about[part])
        if names:
            found[NAMES[part]] = {"dtype": "float32", "shape": [len(names)], "names": names}
    for camera, seen in about.get("cameras", {}).items():
        width, height = seen["width"], seen["height"]
        shape = [height, width, 3]
        video = {"video.fps": whole_rate(about["rate"]), "video.codec": "h264", "video.pix_fmt": "yuv420p"}
        video |= {"video.height": height, "video.width": width, "video.channels": 3, "has_audio": False}
        named = ["height", "width", "channels"]
        found[f"observation.images.{camera}"] = {"dtype": "video", "shape": shape, "names": named, "info": video}
    scalar = {"shape": [1], "names": None}
    found["next.reward"] = {"dtype": "float32", **scalar}
    found |= {name: {"dtype": "bool", **scalar} for name in FLAGS}
    found |= {name: {"dtype": "float32" if name == "timestamp" else "int64", **scalar} for name in COUNTED}
    return found


def whole_rate(rate: float) -> int:
    """Frames per second, rounded: LeRobot needs a whole number."""
    return max(1, round(rate))


def write_lerobot(
    path: Path,
    about: Mapping[str, Any],
    recordings: Iterable[Recording],
    task: str,
    films: Path | None = None,
) -> None:
    """Write a dataset. Files of an interrupted call are replaced.

    Args:
        about: meaning of the numbers, see `recording.describe`; `cameras` has the size of each film's pictures.
        recordings: in order; one is in memory at a time.
        films: folder with SEED-CAMERA.mp4 of each episode, which are copied into the dataset.

    Raises MachineError if pyarrow is missing, or the folder cannot be written.
    """
    require("pyarrow", "lerobot", "a LeRobotDataset")
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    with writing(path):
        for name in ("data", "meta", "videos"):
            system.remove_tree(path / name, ignore_errors=True)
        fps = whole_rate(about["rate"])
        known = features(about)
        episodes: list[dict[str, Any]] = []
        frames = file = 0
        writer: Any = None
        for place, recording in enumerate(recordings):
            columns = _frames(recording, place, frames, fps)
            table = pa.table({name: _arrow(columns[name]) for name in known if name in columns})
            data = path / DATA.format(chunk_index=file // FILES_PER_CHUNK, file_index=file % FILES_PER_CHUNK)
            if writer is None:
                data.parent.mkdir(parents=True, exist_ok=True)
                writer = pq.ParquetWriter(data, table.schema, compression="snappy")
            writer.write_table(table)
            statistics = {name: _statistics(column) for name, column in columns.items()}
            row = {
                "episode_index": place,
                "tasks": [task],
                "length": recording.steps,
                "data/chunk_index": file // FILES_PER_CHUNK,
                "data/file_index": file % FILES_PER_CHUNK,
                "dataset_from_index": frames,
                "dataset_to_index": frames + recording.steps,
                "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
                **{f"stats/{name}/{kind}": value for name, one in statistics.items() for kind, value in one.items()},
                **{
                    f"final/{NAMES[part]}": getattr(recording, part)[-1].tolist()
                    for part in STATES
                    if NAMES[part] in known
                },
                "final/seed": recording.seed,
            }
            for camera in about.get("cameras", {}):
                video = {"chunk_index": place // FILES_PER_CHUNK, "file_index": place % FILES_PER_CHUNK}
                target = path / VIDEO.format(video_key=f"observation.images.{camera}", **video)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile((films or path) / f"{recording.seed}-{camera}.mp4", target)
                at = {**video, "from_timestamp": 0.0, "to_timestamp": recording.steps / fps}
                row |= {f"videos/observation.images.{camera}/{key}": value for key, value in at.items()}
            episodes.append(row)
            frames += recording.steps
            if data.stat().st_size > FILE_BYTES:
                writer.close()
                writer, file = None, file + 1
        if writer is not None:
            writer.close()
        meta = path / "meta"
        listed = meta / "episodes/chunk-000/file-000.parquet"
        listed.parent.mkdir(parents=True)
        pq.write_table(pa.Table.from_pylist(episodes), listed)
        pq.write_table(_tasks(task), meta / "tasks.parquet")
        write_json(meta / "stats.json", _together(episodes))
        info = {
            "codebase_version": VERSION,
            "robot_type": about.get("robot"),
            "total_episodes": len(episodes),
            "total_frames": frames,
            "total_tasks": 1,
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": FILE_BYTES >> 20,
            "video_files_size_in_mb": 200,
            "fps": fps,
            "splits": {"train": f"0:{len(episodes)}"},
            "data_path": DATA,
            "video_path": VIDEO if about.get("cameras") else None,
            "features": known,
            "karolos": dict(about),
        }
        write_json(meta / "info.json", info)  # the last file: without it there is no dataset


def _frames(recording: Recording, episode: int, before: int, fps: int) -> Columns:
    """The frames of an episode by LeRobot's names: (n, k), or (n,) for single numbers."""
    steps = recording.steps
    count = np.arange(steps, dtype=np.int64)
    parts = {NAMES[part]: getattr(recording, part)[:steps] for part in (*STATES, "action")}
    return {
        **{name: part[:, 0] if part.shape[1] == 1 else part for name, part in parts.items() if part.shape[1]},
        "next.reward": recording.reward,
        "next.done": recording.terminated | recording.truncated,
        "next.truncated": recording.truncated,
        "next.terminated": recording.terminated,
        "next.success": recording.success[1:],
        "timestamp": (count / fps).astype(np.float32),
        "frame_index": count,
        "episode_index": np.full(steps, episode, np.int64),
        "index": before + count,
        "task_index": np.zeros(steps, np.int64),
    }


def _arrow(column: NDArray[Any]) -> Any:
    import pyarrow as pa  # noqa: PLC0415

    if column.ndim == 1:
        return pa.array(column)
    return pa.FixedSizeListArray.from_arrays(pa.array(column.reshape(-1)), column.shape[1])


def _statistics(column: NDArray[Any]) -> dict[str, list[Any]]:
    values = column.reshape(len(column), -1).astype(np.float64)
    found = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
    found |= {name: np.quantile(values, share, 0) for name, share in QUANTILES.items()}
    return {"count": [len(values)], **{name: value.tolist() for name, value in found.items()}}


def _together(episodes: list[dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """stats.json: the statistics of all frames. Quantiles are means over the episodes, as in LeRobot."""
    found = {}
    for name in sorted({key.split("/")[1] for row in episodes for key in row if key.startswith("stats/")}):
        of = {kind: np.array([row[f"stats/{name}/{kind}"] for row in episodes]) for kind in ("count", *_KINDS)}
        share = of["count"] / of["count"].sum()
        mean = (share * of["mean"]).sum(0)
        variance = (share * (of["std"] ** 2 + (of["mean"] - mean) ** 2)).sum(0)
        every = {"min": of["min"].min(0), "max": of["max"].max(0), "mean": mean, "std": np.sqrt(variance)}
        every |= {kind: (share * of[kind]).sum(0) for kind in QUANTILES}
        found[name] = {kind: value.tolist() for kind, value in every.items()} | {"count": [int(of["count"].sum())]}
    return found


_KINDS = ("min", "max", "mean", "std", *QUANTILES)


def _tasks(task: str) -> Any:
    """tasks.parquet as pandas reads it: the task is the index."""
    import pyarrow as pa  # noqa: PLC0415

    column = {"name": "task_index", "field_name": "task_index", "pandas_type": "int64", "numpy_type": "int64"}
    index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}
    known = {"index_columns": ["task"], "column_indexes": [], "columns": [column, index], "pandas_version": "2.3.0"}
    known["columns"] = [{**one, "metadata": None} for one in (column, index)]
    table = pa.table({"task_index": pa.array([0], pa.int64()), "task": [task]})
    return table.replace_schema_metadata({"pandas": json.dumps(known)})


def read_lerobot(path: Path) -> Dataset:
    """A dataset of any origin.

    Raises:
        UsageError: it is damaged or of another version; names the file, the episode and the column.
        MachineError: pyarrow is missing.
    """
    require("pyarrow", "lerobot", "a LeRobotDataset")
    info = read_object(path / "meta/info.json")
    if info is None:
        refuse(path / "meta/info.json", "holds no JSON object")
    if info.get("codebase_version") != VERSION:
        hint = "lerobot converts older ones: python -m lerobot.scripts.convert_dataset_v21_to_v30"
        refuse(path, f"it is a LeRobotDataset {info.get('codebase_version')!r}, and {VERSION} can be read", hint)
    known, rate = info.get("features"), info.get("fps")
    if not isinstance(known, dict) or not isinstance(rate, int | float) or not rate > 0:
        refuse(path / "meta/info.json", "has no features, or no fps above 0")
    about = info.get("karolos")
    about = about if isinstance(about, dict) else None
    files = sorted((path / "meta/episodes").glob("*/*.parquet"))
    if not files:
        refuse(path / "meta/episodes", "holds no file")
    rows = [row for file in files for row in _table(file).to_pylist()]
    try:
        lengths = tuple(int(row["length"]) for row in rows)
    except (KeyError, TypeError, ValueError):
        refuse(files[0], "an episode has no length")
    if lengths and (min(lengths) < 1 or sum(lengths) > MOST_FRAMES):
        refuse(files[0], f"episodes of {min(lengths)} to {max(lengths)} steps are impossible", "it is damaged")
    cache: dict[Path, Any] = {}

    def read(place: int) -> Columns:
        row = rows[place]
        try:
            file = below(
                path,
                str(info["data_path"]).format(chunk_index=row["data/chunk_index"], file_index=row["data/file_index"]),
            )
        except (KeyError, ValueError, IndexError, AttributeError):
            refuse(path / "meta/info.json", f"data_path {info.get('data_path')!r} names no file")
        except UsageError as error:
            refuse(path / "meta/info.json", f"data_path: {error.what}")
        if file not in cache:
            cache.clear()
            cache[file] = _table(file)
        return _episode(cache[file], file, row, known, rate)

    true = about.get("rate", rate) if about else rate
    return Dataset(path, lengths, float(true), NAMES, read, about)


def _table(file: Path) -> Any:
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    try:
        return pq.ParquetFile(file).read()
    except (OSError, pa.ArrowException) as error:
        first = next(iter(str(error).splitlines()), "")
        refuse(file, f"cannot be read: {first}", "copy it again")


def _episode(table: Any, file: Path, row: Mapping[str, Any], known: Mapping[str, Any], rate: float) -> Columns:
    """The columns of one episode. Raises UsageError for a missing column, or one that contradicts the features."""
    import pyarrow as pa  # noqa: PLC0415
    import pyarrow.compute as pc  # noqa: PLC0415

    episode, length = row.get("episode_index"), row["length"]
    if "episode_index" not in table.column_names:
        refuse(file, "has no column episode_index")
    mine = table.filter(pc.equal(table["episode_index"], episode))
    if mine.num_rows != length:
        refuse(
            file, f"episode {episode} has {mine.num_rows} rows here and {length} in meta/episodes", "its index is wrong"
        )
    found: Columns = {}
    for name, feature in known.items():
        if feature.get("dtype") in ("video", "image", "string"):
            continue
        if name not in mine.column_names:
            refuse(file, f"episode {episode} has no column {name!r}, which meta/info.json promises")
        try:
            column = mine[name].combine_chunks()
            nested = pa.types.is_fixed_size_list(column.type) or pa.types.is_list(column.type)
            values = rows_of((column.flatten() if nested else column).to_numpy(zero_copy_only=False))
            found[name] = values.reshape(length, -1)
        except (pa.ArrowException, TypeError, ValueError) as error:
            refuse(file, f"episode {episode}, column {name!r}: {error}")
        size = int(np.prod(feature.get("shape") or [1]))
        if found[name].shape[1] != size:
            what = f"has {found[name].shape[1]} numbers a row, and meta/info.json says {size}"
            refuse(file, f"episode {episode}, column {name!r} {what}")
        last = row.get(f"final/{name}")
        if last is not None and len(last) == size:
            found[name] = np.concatenate((found[name], np.array([last], found[name].dtype)))
    count = np.arange(length)
    if "frame_index" in found and not np.array_equal(found["frame_index"][:, 0], count):
        refuse(file, f"episode {episode}, column 'frame_index' does not count from 0 to {length - 1}")
    if "timestamp" in found and not np.allclose(found["timestamp"][:, 0], count / rate, rtol=0, atol=0.5 / rate):
        refuse(file, f"episode {episode}, column 'timestamp' does not fit {rate:g} frames a second")
    return found
