"""The executor: reads the robot, acts at the policy's rate, sends set points at the robot's rate, stops at faults."""

from __future__ import annotations

import gc
import json
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import IO, Any

import numpy as np

from .bundle import Bundle, BundleError
from .drivers import Driver
from .faults import Fault, Watch
from .kinematics import Array
from .motion import Motion
from .readings import Observer, Reading, SetPoint

PATIENCE = 5.0
"""Time in s in which the first reading must come."""


@dataclass
class Outcome:
    """The outcome of an episode."""

    steps: int = 0
    """Number of actions of the policy."""
    success: bool | None = None
    """Whether it succeeded; None: the driver does not know."""
    cycles: list[float] = field(default_factory=list)
    """Computing time of each cycle in s."""
    actions: list[Array] = field(default_factory=list)

    @property
    def slowest(self) -> float:
        """Computing time in s that 99 % of the cycles do not exceed."""
        return float(np.quantile(self.cycles, 0.99)) if self.cycles else 0.0


class Executor:
    """Runs a bundle on a robot.

    Args:
        driver: connected or not; `connect` is called by `check`.
        rate: set points per second.
        log: file for every cycle; None: no log.
    """

    def __init__(self, bundle: Bundle, driver: Driver, *, rate: float, log: Path | None = None) -> None:
        self.bundle, self.driver, self.rate = bundle, driver, rate
        contract = bundle.contract
        if not contract["control"]["rate"] <= rate <= 1000:
            raise BundleError(f"a rate of {rate:g} Hz is not possible; it is {contract['control']['rate']:g} to 1000")
        driver.rate = rate
        self.late: float = contract["limits"]["late"]
        self._log = Log(log, bundle, rate) if log is not None else None

    def check(self) -> None:
        """Connect, and raise Fault if the policy was not trained for this robot."""
        Watch(self.bundle.contract, self.late).identity(self.driver.connect())

    def run(
        self, episode: int = 0, goal: list[float] | None = None, *, move: bool = True, steps: int | None = None
    ) -> Outcome:
        """Run one episode, and stop the robot at its end.

        Args:
            episode: number of the episode, for drivers that reset something.
            goal: desired goal (g,); None: the driver's goal, or that of the logged episode.
            move: whether to send set points; otherwise the policy acts, and nothing is sent.
            steps: number of actions of the policy; None: as in an episode of training.

        Raises:
            Fault: the robot was stopped; no set point was sent after the fault.
        """
        outcome = Outcome()
        collecting = gc.isenabled()
        self.driver.late = self.late
        try:
            told = self.driver.begin(episode, move=move)
            wanted = self._goal(told if goal is None else goal)
            gc.disable()  # a garbage collection takes longer than a cycle
            self._run(outcome, wanted, move, steps or self.bundle.contract["episode"]["steps"])
        finally:
            self.driver.stop()
            if collecting:
                gc.enable()
        outcome.success = self.driver.outcome()  # cameras may answer late: the robot stands still by then
        return outcome

    def _goal(self, given: list[float] | None) -> Array:
        size = sum(one["size"] for one in self.bundle.contract["desired_goal"])
        if given is None:
            return np.asarray(self.bundle.episode()["desired_goal"][0])
        try:  # it may come from cameras
            goal = np.array(given, float)
        except (TypeError, ValueError, OverflowError):
            goal = np.zeros(0)
        if goal.shape != (size,) or not np.isfinite(goal).all():
            numbers = " ".join(f"{one:g}" for one in goal) if goal.ndim == 1 and goal.size else repr(given)
            raise BundleError(f"the goal is {numbers}; it needs {size} finite numbers, see the page of the bundle")
        return goal.astype(np.float32)

    def _first(self, watch: Watch) -> Reading:
        """The first reading."""
        begin = self.driver.now()
        while self.driver.now() - begin < PATIENCE:
            reading = self.driver.read()
            if reading is not None and watch.look(reading, self.driver.now()):
                return reading
            self.driver.wait(self.driver.now() + 1 / self.rate)
        raise Fault("late reading", f"no reading came from the robot for {PATIENCE:g} s")

    def _run(self, outcome: Outcome, goal: Array, move: bool, steps: int) -> None:
        bundle, driver = self.bundle, self.driver
        contract, chain, cycle = bundle.contract, bundle.chain, 1 / self.rate
        watch, observer = Watch(contract, self.late), Observer(contract)
        motion = Motion(contract, chain, driver.acceleration_share)
        latest = self._first(watch)
        watch.start(latest)
        at = chain.at(latest.positions)
        motion.reset(latest.positions, at)
        observer.feel(latest)
        begin = driver.now()
        while True:
            began, now = perf_counter(), driver.now()
            planned = begin + len(outcome.cycles) * cycle
            if now - planned > self.late:
                raise Fault("late cycle", f"this computer is {1000 * (now - planned):.0f} ms behind")
            reading = driver.read() if outcome.cycles else latest
            if watch.look(reading, now):
                assert reading is not None
                latest, at = reading, chain.at(reading.positions)
                observer.feel(reading)
                watch.tool(at, observer.wrench)
            if now >= begin + outcome.steps / contract["control"]["rate"] - cycle / 2:
                if outcome.steps == steps:
                    return
                observation = observer(latest, at, motion.set_point_from(at))
                action = np.asarray(bundle.policy(observation, goal), float)
                outcome.actions.append(action)
                outcome.steps += 1
                if move:
                    motion.plan(action, latest.positions, at, now)
            point = motion.at(now, cycle) if move else None
            if point is not None:
                driver.send(point)
            if self._log is not None:
                self._log.add(now, latest, goal, outcome.steps, point)
            outcome.cycles.append(perf_counter() - began)
            driver.wait(planned + cycle)


class Log:
    """A log of every cycle: one line of JSON with the names of the columns, then rows of float64."""

    def __init__(self, path: Path, bundle: Bundle, rate: float) -> None:
        contract = bundle.contract
        self._measured = {one["name"]: one["size"] for one in contract["observation"] if one["formula"] == "measured"}
        joints, goal = len(contract["joints"]), sum(one["size"] for one in contract["desired_goal"])
        self._size = 13 if contract["control"]["mode"] == "impedance" else 2 * joints + 1
        sizes = {"now": 1, "time": 1, "step": 1, "goal": goal, "positions": joints, "velocities": joints, "wrench": 6}
        sizes |= {"opening": 1, **{f"measured_{name}": size for name, size in self._measured.items()}}
        sizes |= {"set_point": self._size}
        self._path = path
        head = {"format": 1, "run": contract["run"]["id"], "rate": rate, "columns": sizes}
        try:
            self._file: IO[bytes] = path.open("wb", buffering=0)
            self._file.write(json.dumps(head).encode() + b"\n")
        except OSError as error:
            raise BundleError(f"the log {path} cannot be written: {error.strerror}") from None

    def add(self, now: float, reading: Reading, goal: Array, step: int, point: SetPoint | None) -> None:
        """Write one cycle; `step` counts the actions so far."""
        seen = [value for name in self._measured for value in np.ravel(reading.measured[name])]
        sent = [np.nan] * self._size if point is None else point.row()
        row = [now, reading.time, step, *goal, *reading.positions, *reading.velocities, *reading.wrench]
        try:
            self._file.write(np.array([*row, reading.opening, *seen, *sent]).tobytes())
        except OSError as error:
            raise Fault("no log", f"{self._path} cannot be written: {error.strerror}") from None


def read_log(path: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """The first line of a log, and its columns by name; a torn last row is left out. Raises BundleError."""
    try:
        first, _, rest = path.read_bytes().partition(b"\n")
        head: dict[str, Any] = json.loads(first)
        width = sum(head["columns"].values())
    except OSError as error:
        raise BundleError(f"the log {path} cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError):
        raise BundleError(f"{path} is not a log; `--log FILE` writes one") from None
    rows = np.frombuffer(rest[: len(rest) // (8 * width) * 8 * width]).reshape(-1, width)
    ends = np.cumsum([0, *head["columns"].values()])
    return head, {name: rows[:, low:high] for name, low, high in zip(head["columns"], ends, ends[1:], strict=False)}


class Replay(Driver):
    """A driver that reads a log in place of a robot, and compares its set points with the logged ones."""

    def __init__(self, bundle: Bundle, path: Path) -> None:
        super().__init__(bundle, {})
        self.head, self.columns = read_log(path)
        if self.head["run"] != bundle.contract["run"]["id"]:
            raise BundleError(f"{path} is of {self.head['run']}, the bundle of {bundle.contract['run']['id']}")
        if not len(self.columns["step"]):
            raise BundleError(f"{path} has no cycle: the robot was stopped before the first one")
        starts = np.flatnonzero(np.diff(self.columns["step"][:, 0], prepend=np.inf) < 0)
        self.episodes = list(zip(starts.tolist(), [*starts[1:].tolist(), len(self.columns["step"])], strict=True))
        self.error = 0.0
        """Largest difference of set points so far."""

    def connect(self) -> dict[str, Any]:
        return {}

    def begin(self, episode: int, *, move: bool) -> list[float] | None:  # noqa: ARG002
        self._row, self._end = self.episodes[episode]
        goal: list[float] = self.columns["goal"][self._row].tolist()
        return goal

    def now(self) -> float:
        return float(self.columns["now"][min(self._row, self._end - 1), 0])

    def wait(self, until: float) -> None:  # noqa: ARG002  (the log says when)
        self._row += 1
        if self._row >= self._end:
            raise EOFError

    def read(self) -> Reading | None:
        return Reading.logged(self.columns, self._row)

    def send(self, point: SetPoint) -> None:
        sent = self.columns["set_point"][self._row]
        if np.isfinite(sent).any():  # otherwise nothing was moved
            self.error = max(self.error, float(np.nanmax(np.abs(np.array(point.row()) - sent))))


def replay(bundle: Bundle, path: Path) -> tuple[int, float]:
    """Replay a log. Returns the cycles, and the largest difference of a set point from the log, in rad or m."""
    driver = Replay(bundle, path)
    for episode in range(len(driver.episodes)):
        with suppress(EOFError):  # the log ends before the episode
            Executor(bundle, driver, rate=driver.head["rate"]).run(episode)
    return len(driver.columns["step"]), driver.error
