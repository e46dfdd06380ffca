"""Score of a robot: its success with policies that never saw it, and the causes of failures."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from json import dumps
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..core import FloatArray, Moment, Step
from ..environments.build import used
from ..environments.robot_task import RobotTask
from ..errors import KarolosError, PluginError, UsageError, alternatives
from ..evaluation.changed_spec import changed_spec
from ..evaluation.playing import evaluate, play_one
from ..evaluation.policies import Policy, environment_of, load_agent
from ..evaluation.testing import playing_processes, test_seeds
from ..evaluation.zero_shot import changed_test, final_of, keep
from ..records import RunFolder, scan
from ..records.run_records import part_name
from ..records.shipped import FOLDER, is_shipped, shipped_names
from ..registry import load
from ..report.page import Section, document
from ..report.tables import Columns, Table, count, success
from ..report.video import write_film
from ..robots.arm import Arm
from ..robots.from_file import FromFile, proposal_of
from ..system import cores
from ..system.files import INSTALLED, file_of, write_whole, writing
from .matrix_report import targets_table

CAUSES = {
    "overloaded": "a force or a torque beyond the limits of a protective stop or of the task",
    "touched": "a link other than a pad touches an object, the floor or another link",
    "joint limit": "a joint is at an end of its range",
    "dropped": "an object was between the pads, and is not any more",
    "unreachable": "actions do not move the tool any more",
    "out of time": "none of these",
}
"""Causes of a failure; the first one that applies counts."""
AT_LIMIT, STUCK_STEPS, STUCK, WANTED = 0.01, 5, 0.1, 0.5
"""Distance from the end of a joint's range, rad. Number of control steps; in each the tool moves by less than this
share of a `tool_step`, while the action is larger than the last number."""


@dataclass(frozen=True)
class PolicyScore:
    """The episodes of one policy on a robot."""

    policy: str
    task: str
    episodes: int
    success: float | None
    """Fraction of the episodes whose goal held at the last step; None: the robot does not fit the task."""
    low: float | None = None
    """Lower end of the 95 % Wilson interval."""
    high: float | None = None
    causes: dict[str, int] = field(default_factory=dict)
    """Failed episodes by cause, see `CAUSES`."""
    refused: str | None = None
    """Why the robot does not fit the task. Refusals are not kept."""
    seconds: float = 0.0
    film: str | None = None
    """Film of the first failure, or of the first episode if none fails."""


class Watch:
    """Observes an arm during one episode, to find the cause of a failure."""

    def __init__(self, environment: RobotTask, policy: Policy) -> None:
        self._task, self._action = environment.task, 0.0
        self._arm: Any = environment.robot

        def act(state: Step) -> FloatArray:
            action = policy.act(state)
            self._action = float(np.abs(action[:3]).max())
            return action

        self.policy = Policy(act, policy.begin)

    def see(self, moment: Moment) -> None:
        """Record the state after a control step."""
        arm = self._arm
        if moment.step == 0:
            self._touched = self._gripped = self._grips = self._limit = False
            self._ways: deque[tuple[float, float]] = deque(maxlen=STUCK_STEPS)
            self._place = arm.tool_position
            return
        pads = set(arm.motors.pads)
        pressed = arm.world.forces(arm.body)
        hand = pads or {len(arm.limits.lower) - 1}  # a gripper that the task does not use is a part of the last link
        self._touched |= any(link not in hand for link, _ in pressed)
        self._grips = (
            len({link for link, other in pressed if link in pads and other > arm.body.index}) == len(pads) == 2
        )
        self._gripped |= self._grips
        ends = zip(arm.joint_positions, arm.limits.lower, arm.limits.upper, strict=True)
        self._limit = any(min(at - low, high - at) < AT_LIMIT for at, low, high in ends)
        way = float(np.linalg.norm(np.subtract(arm.tool_position, self._place)))
        self._ways.append((way, self._action))
        self._place = arm.tool_position

    @property
    def cause(self) -> str:
        """The cause of failure of the finished episode."""
        arm = self._arm
        stuck = all(way < STUCK * arm.tool_step and action > WANTED for way, action in self._ways)
        overloaded = arm.stops > 0 or getattr(self._task, "overloaded", False)
        signs = (overloaded, self._touched, self._limit, self._gripped and not self._grips, stuck, True)
        return next(cause for cause, shows in zip(CAUSES, signs, strict=True) if shows)


def policies_of(robot: str) -> list[Path]:
    """Folders of the shipped policies that were trained on this robot. Raises UsageError if there are none."""
    found = [FOLDER / name for name in shipped_names() if name.startswith(f"{robot}_")]
    if not found:
        known = sorted({name.partition("_")[0] for name in shipped_names()})
        raise UsageError(f"there is no shipped policy of the robot {robot!r}", hint=alternatives(robot, known))
    return found


def refused(run: Path, episodes: int, error: KarolosError) -> PolicyScore:
    """The score of a policy on a robot that does not fit its task, or that cannot be used at all."""
    task = part_name(RunFolder.open(run).spec(), "task") or ""
    # The overrides that name the robot are no news, the setting that does not fit is.
    what = str(error)
    if error.setting is not None:
        what = f"{error.setting}: {'; '.join(filter(None, (error.what, error.hint)))}"
    return PolicyScore(run.name, task, episodes, None, refused=" ".join(what.splitlines()))


def score_policy(
    run: Path,
    overrides: Sequence[str],
    episodes: int,
    film: Path | None = None,
    runs: Path | None = None,
    size: tuple[int, int] = (320, 240),
) -> PolicyScore:
    """Play the final test's first episodes of a policy on another robot, and keep the result like any test of it.

    Args:
        run: folder of its run.
        overrides: name the robot, as for `changed_spec`.
        film: file to write, with the first failure, or the first episode if none fails.
        runs: folder of the run folders, where tests of shipped policies are kept; None: they are not kept.
        size: of the film in pixels.
    """
    started, folder = perf_counter(), RunFolder.open(run)
    saved = load_agent(folder, "last" if is_shipped(folder) else "best")
    try:
        spec = changed_spec(saved.spec, overrides, trained=saved.signature)
        environment = environment_of(spec, randomize=True)
    except KarolosError as error:  # the robot does not fit the task
        return refused(run, episodes, error)
    causes: Counter[str] = Counter()
    failures: list[int] = []
    with used(environment):
        assert isinstance(environment, RobotTask)
        if not isinstance(environment.robot, Arm):
            raise UsageError("this robot is not an arm", setting="robot", hint="`karolos test` tests any robot")
        watch, seed = Watch(environment, saved.policy()), spec.testing.final_seed

        def see(moment: Moment) -> None:
            watch.see(moment)
            if moment.over and not moment.success:
                failures.append(moment.episode)
                causes[watch.cause] += 1

        result = evaluate(environment, watch.policy, episodes=episodes, seed=seed, heard=see)
        if film is not None:
            shown = (failures or [0])[0]
            moments = play_one(environment, saved.policy(), shown, test_seeds(seed, episodes)[shown])
            write_film(film, moments, environment, size)
    seconds, ordered = perf_counter() - started, {cause: causes[cause] for cause in CAUSES if causes[cause]}
    own = final_of(folder, saved, seed, episodes)
    test = replace(changed_test(saved, result, overrides, seed, seconds, own), causes=ordered)
    keep(folder, test, runs)
    ends = test.successes_end or 0
    task, where = spec.task.name if spec.task else "", film.name if film else None
    low, high = test.interval(ends)
    return PolicyScore(run.name, task, episodes, ends / episodes, low, high, ordered, None, seconds, where)


def score_robot(
    policies: Sequence[Path],
    overrides: Sequence[str],
    episodes: int,
    films: Path | None = None,
    runs: Path | None = None,
) -> Iterator[PolicyScore]:
    """The scores of a robot with some policies, in their order, each in a process of its own.

    `policies` are the folders of their runs, `films` is a folder for a film of each. The rest as for `score_policy`.
    """
    with playing_processes(min(cores(), len(policies))) as pool:
        tasks = [
            pool.submit(score_policy, run, overrides, episodes, films and films / f"{run.name}.mp4", runs)
            for run in policies
        ]
        for task in tasks:
            yield task.result()


def file_overrides(
    file: str, gripper: str | None, mass: float | None, tool: str | None = None
) -> tuple[list[str], list[str], str]:
    """The overrides that name the robot of a URDF, the assumptions about the file, and the robot's name.

    A file that cannot be used as it is gets repaired in a copy.

    Args:
        file: its path, or installed:PACKAGE/PATH.
        gripper: at its flange; None: its own hand.
        mass: of the arm in kg, used if the file needs repair.
        tool: link at the end of the arm, in a file of two arms; None: the file says it.
    """
    if gripper is not None:
        load("grippers", gripper)
    path = file_of(file)
    settings: dict[str, Any] = {"file": str(path if str(path).startswith(INSTALLED) else path.absolute())}
    settings |= {"tool": tool} if tool is not None else {}
    try:
        found = proposal_of(FromFile.Settings.model_validate(settings | {"gripper": gripper}))
    except PluginError:
        settings |= {"repair": True} | ({"mass": mass} if mass is not None else {})
        found = proposal_of(FromFile.Settings.model_validate(settings | {"gripper": gripper}))
    given = [f"robot.{key}={dumps(value)}" for key, value in settings.items()]
    return ["robot.name=urdf", *given], [*found.notes], path.stem


def kept_scores(runs: Path) -> list[dict[str, Any]]:
    """Tests of policies on other robots, from run folders and, for shipped policies, from `runs`/shipped.

    Each is a row of JSON values: policy, robot, gripper, then as `Evaluation.changed_row`.
    """
    folders = [one for one in scan(runs) if isinstance(one, RunFolder)]
    rows = []
    for folder in (*folders, *(RunFolder(path) for path in sorted((runs / "shipped").glob("*")))):
        for test in folder.transfers().rows:
            given = {key: value.strip('"') for key, _, value in (one.partition("=") for one in test.overrides)}
            robot = Path(given["robot.file"]).stem if "robot.file" in given else given.get("robot.name")
            if robot is not None:
                about = {"policy": folder.path.name, "robot": robot, "gripper": given.get("robot.gripper", "null")}
                rows.append(about | test.changed_row())
    return sorted(rows, key=lambda row: str(row["time"]))


def kept_table(rows: Sequence[dict[str, Any]]) -> Table:
    """The results of `kept_scores`, a row for each test."""
    columns: Columns[dict[str, Any]] = {
        "robot": lambda one: one["robot"],
        "gripper": lambda one: "own" if one["gripper"] == "null" else one["gripper"],
        "policy": lambda one: one["policy"],
        "success": lambda one: success(one["success_end"], one["episodes"]),
        "episodes": lambda one: count(one["episodes"]),
        "failures": lambda one: _failures(one["causes"]),
        "when": lambda one: str(one["time"])[:16].replace("T", " "),
    }
    return Table.of(rows, columns)


def _failures(causes: Mapping[str, int]) -> str:
    return ", ".join(f"{cause} {number}" for cause, number in causes.items())


def scores_table(scores: Sequence[PolicyScore]) -> Table:
    columns: Columns[PolicyScore] = {
        "task": lambda one: one.task,
        "success": lambda one: "-" if one.success is None else f"{one.success:.2f} [{one.low:.2f}, {one.high:.2f}]",
        "episodes": lambda one: "" if one.success is None else str(one.episodes),
        "failures": lambda one: one.refused or _failures(one.causes),
        "seconds": lambda one: f"{one.seconds:.0f}",
    }
    return Table.of(scores, columns)


def arms_table(scores: Sequence[tuple[str, Sequence[PolicyScore]]]) -> Table:
    """A row for each task, over the arms, of which name and scores are given."""
    return targets_table([(one.task, arm, one.success, one.refused) for arm, of in scores for one in of], "task")


def write_score_page(path: Path, robot: str, assumed: Sequence[str], scores: Sequence[PolicyScore]) -> None:
    """Write the page of a robot's scores. Names of tasks link to films in the same folder. Raises MachineError."""
    done = [one for one in scores if one.success is not None]
    good = f"{sum((one.low or 0) > 0.9 for one in done)} of {len(done)} tasks: interval above 90 %, no training"
    table, notes = scores_table(scores), [f"{cause}: {what}" for cause, what in CAUSES.items()]
    notes.append("in brackets the 95 % Wilson interval; a failure counts under the first cause that applies")
    sections = [
        Section(text=good),
        Section(
            "Policies that never saw this robot", table=table, links=[one.film or "" for one in scores], notes=notes
        ),
        *([Section("Assumptions about the file", notes=assumed)] if assumed else []),
    ]
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, document(f"Score: {robot}", "success of shipped policies, zero-shot", sections))
