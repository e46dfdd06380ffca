"""Drivers connect the executor with a robot. Each is a class behind an entry point of `karolos_deploy.drivers`."""

from __future__ import annotations

import time
from collections.abc import Mapping
from importlib.metadata import entry_points
from math import isfinite, nan
from typing import Any, ClassVar

from ..bundle import Bundle, BundleError
from ..readings import Reading, SetPoint

GROUP = "karolos_deploy.drivers"


TCP_TOLERANCE = 0.01
"""Largest distance in m between the tool centre points of controller and bundle."""


class Driver:
    """The contract of a driver.

    The executor calls `connect`, then `begin` for each episode, then in each cycle `read`, `send` and `wait`. After a
    fault or at the end it calls `stop` and `close`. A driver raises `Fault` if the robot or the connection fails, and
    sends nothing after `stop`. `karolos_deploy.contracts` checks all this.

    Args:
        bundle: the bundle to run.
        settings: texts by name, from `--set NAME=VALUE`. A driver refuses unknown names.
    """

    settings: ClassVar[Mapping[str, str]] = {}
    """Names of settings and their defaults."""
    modes: ClassVar[tuple[str, ...]] = ("joint", "cartesian", "pose", "impedance")
    """Control modes that the driver can follow."""
    acceleration_share: ClassVar[float] = 1.0
    """Fraction of the joints' accelerations that set points use. The rest is for following them."""
    rate: float
    """Set points per second; the executor sets it."""
    late: float = float("inf")
    """Largest age in s of the data of gripper and cameras; the executor sets it."""

    def __init__(self, bundle: Bundle, settings: Mapping[str, str]) -> None:
        self.bundle = bundle
        if unknown := sorted(set(settings) - set(self.settings)):
            known = ", ".join(f"{name}={value}" for name, value in self.settings.items())
            raise BundleError(f"the driver has no setting {', '.join(unknown)}; it has {known}")
        self.values = {**self.settings, **settings}
        for name, usual in self.settings.items():
            if usual in ("yes", "no") and self.values[name] not in ("yes", "no"):
                raise BundleError(f"the setting {name} is {self.values[name]!r}; it is yes or no")
        if self.values.get("host") == "":
            raise BundleError("the address of the controller is missing: --set host=...")
        if (mode := bundle.contract["control"]["mode"]) not in self.modes:
            raise BundleError(f"this driver cannot follow {mode} control; it follows {', '.join(self.modes)}")

    def number(self, name: str) -> float:
        """A setting as a number."""
        try:
            found = float(self.values[name])
        except ValueError:
            found = nan
        if not isfinite(found):
            raise BundleError(f"the setting {name} is {self.values[name]!r}; give a number")
        return found

    def now(self) -> float:
        """The time of the executor's clock in s."""
        return time.perf_counter()

    def wait(self, until: float) -> None:
        """Return at this time."""
        while (left := until - self.now()) > 0:
            time.sleep(left)

    def connect(self) -> dict[str, Any]:
        """Connect. Returns known facts of the robot: `name`, `gripper`, `joints` (their number), `payload` in kg."""
        raise NotImplementedError

    def begin(self, episode: int, *, move: bool) -> list[float] | None:
        """Prepare for an episode, with set points if `move`. Returns its goal, if the driver knows one."""
        raise NotImplementedError

    def read(self) -> Reading | None:
        """The newest reading; None if there is no new one since the last call. Does not wait."""
        raise NotImplementedError

    def send(self, point: SetPoint) -> None:
        """Let the robot follow a set point from now on."""
        raise NotImplementedError

    def stop(self) -> None:
        """Bring the robot to a controlled stop. Must not raise."""

    def outcome(self) -> bool | None:
        """Whether the episode ended in success, asked after `stop`; None: the driver does not know."""
        return None

    def close(self) -> None:
        """End the connection. Must not raise."""


def find(name: str) -> type[Driver]:
    """The class of a driver. Raises BundleError for an unknown name."""
    installed = {one.name: one for one in entry_points(group=GROUP)}
    if name not in installed:
        raise BundleError(f"no driver is called {name!r}; installed are {', '.join(sorted(installed))}")
    found: type[Driver] = installed[name].load()
    return found
