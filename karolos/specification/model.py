"""The models of a validated spec."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, PrivateAttr, StringConstraints, model_validator
from pydantic import Field as Setting

from ..core import Settings
from ..errors import KarolosError, UsageError, described
from ..registry import blaming
from ..system.files import fingerprint, is_portable
from .parts import OfKind, Part, Recipe
from .sweep import Seed, Seeds, Sweep, Transfer
from .tree import PARTS

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9._-]{0,63}$"
"""Names are used as folder names: at most 64 letters, digits, dots, underscores and hyphens."""


def _portable(name: str) -> str:
    """The name. Raises ValueError if Windows does not allow a file of this name."""
    if not is_portable(name):
        raise ValueError("cannot name a file on Windows: give another name")
    return name


Name = Annotated[str, StringConstraints(pattern=NAME_PATTERN), AfterValidator(_portable)]
"""The name of an experiment or a suite."""
PARAMETER_PATTERN = r"^(robot|task)\.[A-Za-z_][A-Za-z0-9_]*$"
"""Parameters for randomization, e.g. task.gravity."""

TOGETHER = ("robot.", "task.", "environment.", "agent.", "buffer.")
"""Prefixes of settings that must fit together."""
MAX_THREADS = 1024


class TrainingSettings(Settings):
    """Amounts of collecting and learning, and where the agent runs."""

    steps: int = Setting(
        default=100_000,
        ge=0,
        le=10**12,
        description="environment steps of training, over all environments; 0: learn only from demonstrations",
    )
    batch_size: int = Setting(default=256, ge=1, le=10**7, description="transitions per gradient update")
    replay_ratio: float = Setting(
        default=64.0,
        ge=0,
        le=10**6,
        description="sampled transitions per environment step: gradient updates x batch size",
    )
    warmup_episodes: int = Setting(
        default=20, ge=0, le=10**9, description="episodes of random actions before learning begins"
    )
    device: Literal["auto", "cpu", "cuda"] = Setting(
        default="cpu",
        description="where the agent learns; auto: the GPU if there is one. Does not count as a change",
    )
    threads: int | None = Setting(
        default=None,
        ge=1,
        le=MAX_THREADS,
        description="CPU threads of the learner; null: karolos decides. Does not count as a change",
    )
    diverging: float = Setting(
        default=0.5,
        ge=0,
        le=1,
        description="largest share of training episodes that diverge between two tests; more fails the run. Does not "
        "count as a change",
    )
    mode: Literal["lockstep", "async"] = Setting(
        default="lockstep",
        description="lockstep: each round waits for all environments, and a repeated run is the same bit for bit; "
        "async: goes on with the environments that are ready, and a run depends on timing",
    )
    minimum_batch: int | None = Setting(
        default=None,
        ge=1,
        le=10**6,
        description="async: number of environments that must be ready before training goes on; null: 1",
    )

    @model_validator(mode="after")
    def _batch_goes_with_async(self) -> Self:
        if self.minimum_batch is not None and self.mode != "async":
            raise ValueError(f"minimum_batch requires mode: async, not {self.mode}")
        return self

    @property
    def at_least(self) -> int | None:
        """Number of environments that a round of training waits for; None: all."""
        return (self.minimum_batch or 1) if self.mode == "async" else None

    def identity(self) -> dict[str, Any]:
        """The settings that change results. The default mode, lockstep, is not included."""
        fixed = self.model_dump(mode="json", exclude={"device", "threads", "diverging", "mode", "minimum_batch"})
        return fixed | ({"mode": self.mode, "minimum_batch": self.at_least} if self.mode == "async" else {})


class DemonstrationSettings(Settings):
    """Episodes of the task's scripted expert, or of a recording. They do not count as training steps."""

    file: str | None = Setting(
        default=None,
        min_length=1,
        description="folder of a recording that replaces the expert: a LeRobotDataset v3, a Minari dataset, or one of "
        "`karolos dataset`; noise and random do not apply to it",
    )
    columns: dict[str, str] = Setting(
        default={},
        description="names in the recording, with units, for fields of the observation, observation, achieved_goal, "
        "desired_goal or action, e.g. object_position: observation.state[0:3] mm",
    )
    episodes: int = Setting(
        default=100, ge=1, le=10**6, description="number of episodes; with file: the first ones, or all if it has fewer"
    )
    noise: float = Setting(
        default=0.1, ge=0, le=10, description="standard deviation of the Gaussian noise on the expert's actions"
    )
    random: float = Setting(default=0.05, ge=0, le=1, description="probability that an action is uniformly random")
    share: float | None = Setting(
        default=None,
        gt=0,
        lt=1,
        description="share of demonstrations in each batch; null: sampled like other transitions",
    )
    updates: int = Setting(
        default=0,
        ge=0,
        le=10**9,
        description="gradient updates on the demonstrations before the first environment step",
    )

    @model_validator(mode="after")
    def _columns_are_of_a_file(self) -> Self:
        if self.columns and self.file is None:
            raise ValueError("columns needs a file")
        return self

    def identity(self) -> dict[str, Any]:
        """The settings that change results: a recording replaces noise and random."""
        unused = {"file", "columns"} if self.file is None else {"noise", "random"}
        return self.model_dump(mode="json", exclude=unused)


TRACKERS = ("mlflow", "wandb", "trackio")
"""Names of trackers. Each has a module NAME_tracker in karolos.experiment."""
FINAL_SEED_OFFSET = 1_000_000
"""Distance of the final test's root of seeds from `testing.seed`."""


class TestingSettings(Settings):
    """Tests of the agent without exploration."""

    interval: int = Setting(
        default=5_000, ge=1, le=10**12, description="environment steps of training between two tests"
    )
    episodes: int = Setting(default=100, ge=1, le=10**6, description="episodes per test")
    seed: Seed = Setting(default=0, description="root of the test episodes' seeds; the same episodes for every run")
    final_episodes: int | None = Setting(
        default=None,
        ge=0,
        le=10**6,
        description="episodes of the final tests of `last` and `best`, all of them held out; null: as many as in a "
        "test; 0: no final test",
    )

    @property
    def final_count(self) -> int:
        """Number of episodes of the final test."""
        return self.episodes if self.final_episodes is None else self.final_episodes

    @property
    def held_out_count(self) -> int:
        """Episodes of a held-out test: as many as in the final test, or as in other tests if there is no final one."""
        return self.final_count or self.episodes

    @property
    def final_seed(self) -> int:
        """Root of the seeds of the final test, whose episodes are held out."""
        return self.seed + FINAL_SEED_OFFSET

    def identity(self) -> dict[str, Any]:
        """The settings that results depend on."""
        return self.model_dump(mode="json") | {"final_episodes": self.final_count}


class Continued(Settings):
    """The experiment and the step from which a run continues."""

    experiment: Annotated[str, StringConstraints(pattern="^[0-9a-f]{64}$")] = Setting(description="its hash")
    at: int = Setting(ge=0, description="environment steps of its runs")


_WRITTEN = re.compile(
    r"(?:^|_)(?:logs?|outputs?|out|saves?|videos?|films?|monitor|cache|te?mp|results?)"
    r"(?:_?(?:dir|folder|path|file|to|root)\w*)?(?:_|$)"
)
"""Names of settings for files that an environment writes. Their content does not belong to an experiment."""


RECORDING = "demonstrations.file"
"""Name of a setting that always names a folder."""


def _by_content(value: Any, found: dict[str, str], path: str = "") -> Any:
    """JSON with hashes of content in place of names of files and folders; `found` gets these by key path."""
    if isinstance(value, dict):
        return {key: _by_content(entry, found, f"{path}.{key}".lstrip(".")) for key, entry in value.items()}
    if isinstance(value, list):
        return [_by_content(entry, found, f"{path}[{place}]") for place, entry in enumerate(value)]
    named = isinstance(value, str) and (path == RECORDING or re.search(r"[/\\]|\.\w{1,8}$", value))
    if named and not _WRITTEN.search(path.rpartition(".")[2].partition("[")[0]):
        digest = fingerprint(Path(value))
        if digest is not None:
            found[path] = digest
            return f"sha256:{digest}"
    return value


class Spec(Settings):
    """An experiment: the environment, the agent and the training. Frozen; specs with the same `dump` are equal.

    Made by `load_spec(path, overrides)` or `spec_from_dict(dictionary)`.
    """

    name: Name = Setting(description="begins the names of run folders. Default: the file's name")
    seeds: Seeds = Setting(
        (0,), description="one run per seed, the root of its random numbers; a number n: seeds 0 to n - 1"
    )
    robot: Annotated[Part, OfKind("robots")] | None = Setting(None, description="the arm; requires a task")
    task: Annotated[Part, OfKind("tasks")] | None = Setting(None, description="what the robot has to do")
    environment: Annotated[Part, OfKind("environments")] = Setting(
        description="the environment of the agent. Default: robot_task, for a robot and a task"
    )
    agent: Annotated[Part, OfKind("agents")] = Setting(description="the learning algorithm")
    buffer: Annotated[Part, OfKind("buffers")] = Setting(description="the buffer of transitions. Default: uniform")
    orchestrator: Annotated[Part, OfKind("orchestrators")] = Setting(
        description="how environments are spread over processes and machines. Default: local"
    )
    launcher: Annotated[Part, OfKind("launchers")] | None = Setting(
        None, description="where runs are executed: local, ray or slurm; null: local. Does not count as a change"
    )
    randomization: dict[
        Annotated[str, StringConstraints(pattern=PARAMETER_PATTERN)], Annotated[Part, OfKind("distributions")]
    ] = Setting(
        {},
        description="distributions of robot.* and task.* parameters, sampled at each training reset; a number: fixed",
    )
    demonstrations: DemonstrationSettings | None = Setting(
        None, description="episodes of the task's expert or of a recording, known before training; null: none"
    )
    training: TrainingSettings = Setting(TrainingSettings(), description="amounts of collecting and learning")
    testing: TestingSettings = Setting(TestingSettings(), description="interval, episodes and seeds of tests")
    tracking: Literal["mlflow", "wandb", "trackio"] | None = Setting(
        None, description="tracker that receives each test; null: that of KAROLOS_TRACKING. Does not count as a change"
    )
    continued_from: Continued | None = Setting(
        None, description="experiment that these runs continue; only `karolos resume RUN training.steps=...` writes it"
    )

    sweep: Sweep | None = Setting(None, description="search for good settings by `karolos sweep`")
    transfer: Transfer | None = Setting(None, description="matrix of transfers by `karolos transfer`")

    _origins: dict[str, str] = PrivateAttr(default_factory=dict)
    _text: str | None = PrivateAttr(default=None)

    @property
    def origins(self) -> dict[str, str]:
        """The origin of each value of `dump`: key path -> "file:line:column", "override ...", "dict", "default"."""
        return dict(self._origins)

    @property
    def text(self) -> str | None:
        """The file as its author wrote it; None for a spec without a file."""
        return self._text

    def dump(self) -> dict[str, Any]:
        """The spec with all defaults, as JSON-able data that loads as an equal spec."""
        return {key: value for key, value in self.model_dump(mode="json").items() if value is not None}

    def changed(self) -> dict[str, Any]:
        """The plugins and the settings that differ from their defaults; JSON-able."""
        return self.model_dump(mode="json", exclude_defaults=True)

    def given(self) -> dict[str, Any]:
        """The plugins and the given settings, even if they equal the defaults; JSON-able."""
        given = self.model_dump(mode="json", exclude_unset=True)
        return {key: value for key, value in given.items() if value is not None}

    def alone(self) -> Spec:
        """This spec without sweep, transfer and launcher, which do not belong to a run."""
        return self.model_copy(update={"sweep": None, "transfer": None, "launcher": None})

    def having(self, key: str, **settings: Any) -> Spec:
        """This spec with other settings of a part (`agent`) or a block (`testing`), which are not validated."""
        block = getattr(self, key)
        if isinstance(block, Part):
            changed: Any = replace(block, settings=block.settings.model_copy(update=settings))
        else:
            changed = block.model_copy(update=settings)
        return self.model_copy(update={key: changed})

    def files(self) -> dict[str, str]:
        """The files that settings name: key path -> SHA-256 (hex) of file and files named there (`fingerprint`)."""
        found: dict[str, str] = {}
        _by_content(self._identity(), found)
        return found

    def hash(self) -> str:
        """SHA-256 (hex) of the settings that change results. Specs with the same hash are one experiment.

        A file is identified by its content, not by its name. Excludes name, seeds, sweep, transfer, launcher, tracking,
        device, threads and settings that a plugin's `Settings.identity()` omits.
        """
        text = json.dumps(_by_content(self._identity(), {}), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()

    def _identity(self) -> dict[str, Any]:
        parts: dict[str, Part | None] = {key: getattr(self, key) for key in PARTS}
        identity = {
            **self.dump(),
            **{key: part.identity() for key, part in parts.items() if part is not None},
            "randomization": {key: part.identity() for key, part in self.randomization.items()},
            **({} if self.demonstrations is None else {"demonstrations": self.demonstrations.identity()}),
            "training": self.training.identity(),
            "testing": self.testing.identity(),
        }
        for key in ("name", "seeds", "sweep", "transfer", "launcher", "tracking"):
            identity.pop(key, None)
        return identity

    def recipe(self, *, randomize: bool) -> Recipe:
        """The recipe of one environment, with or without randomization."""
        drawn = tuple(sorted(self.randomization.items())) if randomize else ()
        return Recipe(self.environment, self.robot, self.task, drawn)

    @contextmanager
    def located(self) -> Iterator[None]:
        """Add to an error the place of its setting or plugin: file:line:column, or the override."""
        try:
            yield
        except KarolosError as error:
            parts = ((key, getattr(self, key)) for key in PARTS)
            named = next((key for key, part in parts if part and (part.kind, part.name) == error.plugin), None)
            if named is not None and error.setting is None:
                error.setting, error.what = f"{named}.name", ": ".join(filter(None, (error.where, error.what)))
                error.where = None
            error.where = self._origin(error.setting) or error.where
            raise

    @contextmanager
    def making(self, key: str) -> Iterator[None]:
        """Turn an error of the constructor of the part's plugin into a UsageError that names it, or a PluginError."""
        try:
            with blaming():
                yield
        except KarolosError:
            raise
        except (Exception, SystemExit) as error:  # a plugin may raise anything
            what = f"{key} {getattr(self, key).name!r} cannot be made: {described(error)}"
            raise UsageError(what, setting=f"{key}.name") from error

    def _origin(self, path: str | None) -> str | None:
        """Place at which the setting `path`, or the first one below it, or its part was set. None for default parts."""
        if path is None:
            return None
        part = path.partition(".")[0]  # the part holds a setting that was not set
        near = [key for one in (path, part) for key in self._origins if key == one or key.startswith(f"{one}.")]
        place = next((self._origins[key] for key in near if self._origins[key] != "default"), None)
        if place is None or place.startswith("override "):
            return place
        changed = {origin for key, origin in self._origins.items() if key.startswith(TOGETHER)}  # may be contradicted
        overrides = sorted(origin for origin in changed if origin.startswith("override "))
        changes = " and ".join(overrides)
        if place == "dict" and changes:  # a test of a run, whose spec is in no file
            return changes
        return f"{place} with {changes}" if changes else place

    def __eq__(self, other: object) -> bool:
        return self.dump() == other.dump() if isinstance(other, Spec) else NotImplemented

    def __hash__(self) -> int:
        return hash((self.name, self.seeds, self.hash()))
