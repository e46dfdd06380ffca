"""The promises of every driver, for the tests of its author:

    from karolos_deploy.contracts import check

    def test_it_keeps_what_every_driver_promises(bundle):
        check("my_driver", bundle, {"host": "127.0.0.1"}, lose=lambda driver: driver.client.unplug())

The robot moves by a few degrees or 2 cm. It must stand at the start pose of the bundle, as for an episode.
"""

from __future__ import annotations

import copy
import traceback
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from .bundle import Bundle, BundleError
from .drivers import Driver, find
from .executor import Executor
from .faults import Fault
from .kinematics import chain_of
from .readings import Reading, SetPoint

RATE = 125.0
"""Set points per second in which drivers are checked."""
JOINT_ERROR, TOOL_ERROR = 0.02, 0.01
"""Largest difference, in rad and in m, of a robot at rest from the last set point."""
STANDSTILL = 0.005
"""Largest difference in rad between joint readings of a robot at rest."""
LATE = 0.5
"""Largest age of readings in s. A busy computer does not break a promise."""
BRAKING = 1.0
"""Time in s in which a robot must come to rest after `stop`."""


@dataclass
class Case:
    """A checked driver. `read` and `sent` record its readings and set points since `connected`."""

    name: str
    bundle: Bundle
    settings: Mapping[str, str]
    lose: Callable[[Any], object]
    read: list[Reading] = field(default_factory=list)
    sent: list[SetPoint] = field(default_factory=list)

    def made(self, bundle: Bundle | None = None, **settings: str) -> Driver:
        """A new driver."""
        return find(self.name)(bundle or self.bundle, {**self.settings, **settings})

    @contextmanager
    def connected(self, act: Callable[[int], float]) -> Iterator[tuple[Driver, Executor]]:
        """A connected driver, and an executor. Its policy moves the first column by `act(number of actions)`."""
        bundle, actions = copy.copy(self.bundle), 0

        def policy(_observation: Any, _goal: Any) -> Any:
            nonlocal actions
            actions += 1
            action = np.zeros(sum(one["size"] for one in bundle.contract["action"]))
            action[0] = act(actions - 1)
            return action

        bundle.policy = policy
        driver = self.made(bundle)
        read, send = driver.read, driver.send
        self.read, self.sent = [], []

        def recorded() -> Reading | None:
            found = read()
            self.read += [found] if found is not None else []
            return found

        def told(point: SetPoint) -> None:
            self.sent.append(point)
            send(point)

        driver.read, driver.send = recorded, told  # type: ignore[method-assign]
        try:
            executor = Executor(bundle, driver, rate=RATE)
            executor.late = LATE
            executor.check()
            yield driver, executor
        finally:
            driver.close()

    def watched(self, driver: Driver, seconds: float) -> Reading:
        """The last reading after these seconds, in which nothing is sent."""
        until = driver.now() + seconds
        while driver.now() < until:
            driver.wait(driver.now() + 1 / RATE)
            driver.read()
        return self.read[-1]


def demand(kept: object, problem: str) -> None:
    """Raise AssertionError with the problem unless the promise is kept."""
    if not kept:
        raise AssertionError(problem)


def unknown_settings_are_refused(case: Case) -> None:
    """A driver refuses settings that it does not know."""
    try:
        case.made(no_such_setting="1")
    except BundleError:
        return
    raise AssertionError("it takes the setting no_such_setting: call super().__init__ and read self.values")


def another_robot_is_refused(case: Case) -> None:
    """The executor, or the driver by its forward kinematics, refuses a robot for which the policy was not trained."""
    other = copy.copy(case.bundle)
    other.contract = copy.deepcopy(case.bundle.contract)
    other.contract["robot"]["name"] = "another"
    other.contract["kinematics"]["links"][0][2] += 0.1
    other.chain = chain_of(other.contract)
    driver = case.made(other)
    try:
        Executor(other, driver, rate=RATE).check()
    except Fault as fault:
        demand(fault.kind == "wrong robot", f"another robot gives {fault}; it is a Fault 'wrong robot'")
        return
    finally:
        driver.close()
    raise AssertionError("it takes a bundle of another robot: `connect` tells the name that the controller knows")


def readings_are_whole_and_new(case: Case) -> None:
    """Without `move` readings are complete, have new times and come at the policy's rate; the robot stands still."""
    with case.connected(lambda _: 1.0) as (driver, executor):
        steps = round(executor.bundle.contract["control"]["rate"] / 2)
        executor.run(0, move=False, steps=steps)  # a reading with a fault ends it
        stamps = list(dict.fromkeys(reading.time for reading in case.read))
        demand(np.all(np.diff(stamps) > 0), "the stamps of readings go back")
        demand(len(stamps) >= steps, f"{len(stamps)} new readings in half a second; the policy acts {steps} times")
        moved = np.ptp([reading.positions for reading in case.read], axis=0).max()
        demand(not case.sent and moved < STANDSTILL, f"it moves by {moved:.3f} rad without --move")
        times = []
        for _ in range(50):
            driver.wait(driver.now() + 1 / RATE)
            begin = perf_counter()
            driver.read()
            times.append(perf_counter() - begin)
        demand(np.median(times) < 1 / RATE, f"`read` takes {1000 * np.median(times):.1f} ms: it must not wait")


def the_clock_goes_on(case: Case) -> None:
    """`wait` returns when `now` is the requested time."""
    with case.connected(lambda _: 0.0) as (driver, _):
        driver.begin(0, move=False)
        for _ in range(10):
            until = driver.now() + 0.01
            driver.wait(until)
            demand(until - 1e-6 <= driver.now() < until + 0.5, "`wait` does not return at the time that is asked for")
        driver.stop()


def set_points_are_followed(case: Case) -> None:
    """The robot comes to rest at the last set point."""
    with case.connected(lambda step: 0.2 * (step < 5)) as (driver, executor):
        executor.run(0, steps=5 + round(executor.bundle.contract["control"]["rate"]))
        there, point, chain = case.read[-1].positions, case.sent[-1], executor.bundle.chain
        moved = np.abs(there - case.read[0].positions).max()
        demand(moved > STANDSTILL, "it does not move where set points do")
        if point.positions is not None:
            away = float(np.abs(there - point.positions).max())
            demand(away < JOINT_ERROR, f"a joint is {away:.3f} rad away from the last set point")
        elif point.place is not None:
            away = float(np.linalg.norm(chain.at(there).position - point.place))
            demand(away < TOOL_ERROR, f"the tool is {away:.4f} m away from the last set point")
        driver.stop()


def nothing_moves_after_stop(case: Case) -> None:
    """After `stop` the robot comes to rest. Until `begin` a set point is ignored or a Fault."""
    with case.connected(lambda _: -0.3) as (driver, executor):
        executor.run(0, steps=5)  # it ends with `stop`, while the robot moves
        at_rest = case.watched(driver, BRAKING).positions
        point = copy.copy(case.sent[-1])
        for _ in range(25):
            try:
                if point.positions is not None:
                    point = SetPoint(point.positions + 0.002, point.velocities, opening=point.opening)
                elif point.place is not None:
                    point = SetPoint(None, None, point.place + 0.001, point.rotation, point.velocity, point.opening)
                driver.send(point)
            except Fault:
                break
            driver.wait(driver.now() + 1 / RATE)
        moved = np.abs(case.watched(driver, BRAKING / 2).positions - at_rest).max()
        demand(moved < STANDSTILL, f"it moves by {moved:.3f} rad after `stop`")
        driver.stop()


def a_lost_connection_is_a_fault(case: Case) -> None:
    """A lost connection is a Fault within two seconds. After it `stop` and `close` do not raise."""
    lost = []

    def act(step: int) -> float:
        if step == 5:
            lost.append(perf_counter())
            case.lose(driver)
        return 0.1

    with case.connected(act) as (driver, executor):
        try:
            executor.run(0, steps=5 + round(2 * executor.bundle.contract["control"]["rate"]))
        except Fault as fault:
            demand(lost, f"before the connection was lost: {fault}")
            demand(perf_counter() - lost[0] < 2, "a lost connection is a Fault only after more than two seconds")
        else:
            raise AssertionError("a lost connection is not noticed")
        count = len(case.sent)
        driver.stop()
        demand(len(case.sent) == count, "`stop` sends a set point")


def stop_and_close_never_raise(case: Case) -> None:
    """`stop` and `close` do not raise, even before `connect` or in a second call."""
    driver = case.made()
    for _ in range(2):
        driver.stop()
        driver.close()


PROMISES = (
    stop_and_close_never_raise,
    unknown_settings_are_refused,
    another_robot_is_refused,
    the_clock_goes_on,
    readings_are_whole_and_new,
    set_points_are_followed,
    nothing_moves_after_stop,
    a_lost_connection_is_a_fault,
)
"""All promises. Each raises AssertionError with one line."""


def check(name: str, bundle: Path, settings: Mapping[str, str], *, lose: Callable[[Any], object]) -> None:
    """Check every promise of an installed driver.

    Args:
        bundle: folder of a bundle for its robot. One of the task reach needs no cameras.
        lose: function that cuts a driver's connection, like a pulled cable.

    Raises:
        AssertionError: promises are broken; one line for each.
    """
    case, broken = Case(name, Bundle(bundle), settings, lose), []
    for promise in PROMISES:
        try:
            promise(case)
        except (AssertionError, Fault, BundleError) as error:
            broken.append(f"{promise.__name__}: {error}")
        except Exception as error:  # a driver may raise anything; the traceback shows the place
            traceback.print_exception(error)
            broken.append(f"{promise.__name__}: {type(error).__name__}: {error}")
    demand(not broken, "\n".join(broken))
