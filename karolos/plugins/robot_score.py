"""Score of a robot: its success with policies that never saw it, and the causes of failures."""

from __future__ import annotations

import multiprocessing
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from ..core import FloatArray, SeedTree, Step
from ..environments.build import used
from ..environments.robot_task import RobotTask
from ..errors import KarolosError, UsageError, alternatives
from ..evaluation.changed_spec import load_player
from ..evaluation.playing import Moment, play, play_one
from ..evaluation.policies import Policy
from ..evaluation.testing import test_seeds
from ..files import write_whole, writing
from ..records import RunFolder
from ..records.shipped import FOLDER, shipped_names
from ..report.page import Section, document
from ..report.tables import Columns, Table
from ..report.video import write_film
from ..robots.arm import Arm
from ..statistics.aggregates import mean, paired_interval
from ..statistics.intervals import wilson
from ..system import cores

CAUSES = {
    "overloaded": "a force or a torque beyond the limits of a protective stop or of the task",
    "touched": "a link that is no pad touches an object, the floor or another link",
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
    """The name of the shipped run."""
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
    """Why the robot does not fit the task."""
    seconds: float = 0.0
    film: str | None = None
    """Film of the first failure, or of the first episode if none fails."""


class Watch:
    """Observes an arm during one episode, to find the cause of a failure."""

    def __init__(self, environment: RobotTask, policy: Policy) -> None:
        self._environment, self._act = environment, policy.act
        self.policy = Policy(self._remembered, policy.begin)
        self._clear()

    def _clear(self) -> None:
        self._touched = self._gripped = self._grips = self._limit = False
        self._ways: deque[tuple[float, float]] = deque(maxlen=STUCK_STEPS)
        self._action = 0.0

    def _remembered(self, state: Step) -> FloatArray:
        action = self._act(state)
        self._action = float(np.abs(action[:3]).max())
        return action

    def see(self, moment: Moment) -> None:
        """Record the state after a control step."""
        if moment.step == 0:
            self._clear()
            self._place = self._arm.tool_position
            return
        arm = self._arm
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
        overloaded = arm.stops > 0 or getattr(self._environment.task, "overloaded", False)
        signs = (overloaded, self._touched, self._limit, self._gripped and not self._grips, stuck, True)
        return next(cause for cause, shows in zip(CAUSES, signs, strict=True) if shows)

    @property
    def _arm(self) -> Any:
        return self._environment.robot


def policies_of(robot: str) -> list[str]:
    """Names of the shipped policies that were trained on this robot. Raises UsageError if there are none."""
    found = [name for name in shipped_names() if name.startswith(f"{robot}_")]
    if not found:
        known = sorted({name.partition("_")[0] for name in shipped_names()})
        raise UsageError(f"no policy of the robot {robot!r} ships", hint=alternatives(robot, known))
    return found


def refused(policy: str, episodes: int, error: KarolosError) -> PolicyScore:
    """The score of a policy on a robot that does not fit its task, or that cannot be used at all."""
    return PolicyScore(policy, policy.partition("_")[2], episodes, None, refused=" ".join(str(error).splitlines()))


def score_policy(
    name: str, overrides: Sequence[str], episodes: int, film: Path | None = None, size: tuple[int, int] = (320, 240)
) -> PolicyScore:
    """Play the final test's first episodes of a shipped policy on another robot.

    Args:
        name: of the shipped run.
        overrides: name the robot, as for `changed_spec`.
        episodes: to play.
        film: file to write, with the first failure, or the first episode if none fails.
        size: of the film in pixels.
    """
    started = perf_counter()
    folder = RunFolder.open(FOLDER / name)
    task = name.partition("_")[2]
    try:
        player = load_player(folder, "last", overrides)
    except KarolosError as error:  # the robot does not fit the task
        return refused(name, episodes, error)
    environment, seed = player.environment, player.spec.testing.final_seed
    causes: Counter[str] = Counter()
    ends, shown = 0, 0
    with used(environment):
        assert isinstance(environment, RobotTask)
        if not isinstance(environment.robot, Arm):
            raise UsageError("it is no arm", setting="robot", hint="`karolos test` tests any robot")
        watch = Watch(environment, player.policy)
        for moment in play(environment, watch.policy, episodes=episodes, seed=seed):
            watch.see(moment)
            if moment.over and moment.success:
                ends += 1
            elif moment.over:
                shown = shown if causes else moment.episode
                causes[watch.cause] += 1
        if film is not None:
            moments = play_one(environment, player.policy, shown, test_seeds(seed, episodes)[shown])
            write_film(film, moments, environment, size)
    low, high = wilson(ends, episodes)
    seconds, ordered = perf_counter() - started, {cause: causes[cause] for cause in CAUSES if causes[cause]}
    where = film.name if film else None
    return PolicyScore(name, task, episodes, ends / episodes, low, high, ordered, None, seconds, where)


def score_robot(
    policies: Sequence[str], overrides: Sequence[str], episodes: int, films: Path | None = None
) -> Iterator[PolicyScore]:
    """The scores of a robot with shipped policies, in their order, each in a process of its own.

    Args:
        policies: names of shipped runs.
        overrides: name the robot, as for `changed_spec`.
        episodes: of each.
        films: folder for a film of each; None: no films.
    """
    context = multiprocessing.get_context("spawn")  # a fork would share threads of torch
    with ProcessPoolExecutor(min(cores(), len(policies)), mp_context=context) as pool:
        tasks = [
            pool.submit(score_policy, name, overrides, episodes, films and films / f"{name}.mp4") for name in policies
        ]
        for task in tasks:
            yield task.result()


def scores_table(scores: Sequence[PolicyScore]) -> Table:
    """A row for each policy."""
    columns: Columns[PolicyScore] = {
        "task": lambda one: one.task,
        "success": lambda one: "-" if one.success is None else f"{one.success:.2f} [{one.low:.2f}, {one.high:.2f}]",
        "episodes": lambda one: "" if one.success is None else str(one.episodes),
        "failures": lambda one: one.refused or ", ".join(f"{cause} {count}" for cause, count in one.causes.items()),
        "seconds": lambda one: f"{one.seconds:.0f}",
    }
    return Table.of(scores, columns)


def arms_table(scores: Sequence[tuple[str, Sequence[PolicyScore]]]) -> Table:
    """A row for each task. The arm is the unit: mean over arms with bootstrap interval, minimum, and arms left out.

    Args:
        scores: name and scores of each arm.
    """
    rows = []
    for task in dict.fromkeys(one.task for _, of in scores for one in of):
        found = [(arm, one) for arm, of in scores for one in of if one.task == task]
        values = sorted((one.success, arm) for arm, one in found if one.success is not None)
        over = [value for value, _ in values]
        interval = paired_interval([over], mean, SeedTree(0).generator()) if over else None
        within = f" [{interval[0]:.2f}, {interval[1]:.2f}]" if interval else ""
        rows.append(
            {
                "task": task,
                "arms": str(len(over)),
                "mean": f"{float(np.mean(over)):.3f}{within}" if over else "-",
                "least": "{:.2f} {}".format(*values[0]) if values else "-",
                "refused": "; ".join(f"{arm}: {one.refused}" for arm, one in found if one.refused),
            }
        )
    columns: Columns[dict[str, str]] = {key: itemgetter(key) for key in ("task", "arms", "mean", "least", "refused")}
    return Table.of(rows, columns, "Over arms")


def write_score_page(path: Path, robot: str, assumed: Sequence[str], scores: Sequence[PolicyScore]) -> None:
    """Write the page of a robot's scores. Names of tasks link to films in the same folder. Raises MachineError."""
    done = [one for one in scores if one.success is not None]
    good = f"{sum((one.low or 0) > 0.9 for one in done)} of {len(done)} tasks surely above 90 %, nothing trained"
    table, notes = scores_table(scores), [f"{cause}: {what}" for cause, what in CAUSES.items()]
    notes.append("in brackets the 95 % Wilson interval; a failure counts under the first cause that applies")
    sections = [
        Section(text=good),
        Section(
            "Policies that never saw this robot", table=table, links=[one.film or "" for one in scores], notes=notes
        ),
        *([Section("What is assumed of the file", notes=assumed)] if assumed else []),
    ]
    with writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, document(f"Score: {robot}", "success of shipped policies, zero-shot", sections))
