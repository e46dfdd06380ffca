"""Throw: the arm throws a cube at a target on the floor that it cannot reach."""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, radians, sin
from typing import Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Field, FloatArray, Layout
from ..core.seeding import Generator
from ..errors import UsageError
from ..simulation.camera import Camera
from ..simulation.interface import Box, Expert, RobotView
from ..simulation.world import GRAVITY, World
from .cube import CubeSettings, CubeTask
from .fitting import fitting_gripper
from .flight import Flight
from .goals import Landing
from .placement import GOAL_COLOUR, place
from .swing import Swing
from .throw_expert import ThrowExpert

START = 0.05
"""m along each axis around the home position within which the tool starts."""
ON_FLOOR = 0.002
"""m above the floor below which a corner of the cube is taken to touch it."""
BOUNCE = 0.08
"""m above the floor that no corner of the cube is a control step after it has landed."""


class Throw(CubeTask):
    """What to do: throw the cube, which starts in the gripper, so that it comes down on the target.

    What is randomised: the tool's start, within 5 cm of the home position along each axis, and the target: on the
    floor ahead of the robot within `sector` degrees to either side, beyond the arm's reach by at least `threshold` and
    nearer than `share` of the furthest throw. Nothing has landed at the start.

    What counts as success: the cube's first contact with the floor after its release lies within `threshold` of the
    target. Flying over it or carrying the cube there is none. Landing ends the episode, so does putting the cube down.

    Reach and furthest throw follow from the speed limits of the joints, see `swing.Swing`. Horizontal distances from
    the robot's axis: panda .95 and 2.14 m, ur5 1.06 and 2.39 m, iiwa 1.08 and 1.73 m. Such throws turn the gripper, so
    that `control: joint` is needed, which is what robots here take unless told otherwise: pointing down, within the
    workspace, no throw lands beyond .81 (panda), .86 (ur5) and .79 m (iiwa), within the arm's reach.

    Observation: `cube.FIELDS`, position, rotation (6), velocities of the cube and its place seen from the tool.
    Goals: achieved, the cube's place along the floor, once it has landed the point of its landing, and a status (0 in
    hand or air, 1 landed after a release, -1 on the floor without one); desired, the target's place in m.
    Reward: at landing; sparse 1 within the threshold, else 0; dense in [0, 1], see `goals.Landing`.
    """

    class Settings(CubeSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="at landing: 1 or 0, or by the distance")
        threshold: float = Setting(0.1, gt=0, le=0.5, description="distance at which the target is hit, m")
        share: float = Setting(0.8, gt=0, le=1, description="largest distance of a target / furthest throw")
        sector: float = Setting(30.0, gt=0, le=60, description="of targets, to either side of straight ahead, degrees")
        max_steps: int = Setting(75, ge=1, le=100_000, description="control steps per episode")

    settings: Throw.Settings
    uses_gripper = True
    points_down = False
    camera = Camera(target=(0.75, 0.0, 0.42), distance=3.4, yaw=22.0, pitch=-22.0)
    achieved_goal = Layout((Field("landing_point", 2, "m"), Field("landed", 1)))
    desired_goal = Layout((Field("target", 2, "m"),))

    def __init__(self, settings: Throw.Settings) -> None:
        self.settings = settings
        self.goal = np.zeros(2, np.float32)
        self.goal_rule = Landing(settings.threshold, dense=settings.reward == "dense")
        self._gravity = GRAVITY

    @property
    def max_steps(self) -> int:
        return self.settings.max_steps

    def fit(self, robot: RobotView) -> None:
        settings, self._robot = self.settings, robot
        self.gripper = fitting_gripper(robot, type(self).__name__, settings.object_size)
        self.swing = swing = Swing(robot, settings.object_size / 2)
        self.nearest, self.furthest = swing.reach + settings.threshold, settings.share * swing.furthest
        if self.nearest >= self.furthest:
            raise UsageError(
                f"no target is left between {self.nearest:.2f} m, the arm's reach and the threshold, and "
                f"{self.furthest:.2f} m, {settings.share:g} of the furthest throw",
                where="task.share",
                hint="a larger share or robot.joint_step leaves more, a smaller task.threshold too",
            )
        x, y, z = robot.home
        low, high = robot.workspace.low, robot.workspace.high
        around = [(max(at - START, a), min(at + START, b)) for at, a, b in zip((x, y, z), low, high, strict=True)]
        self._starts = Box(*zip(*around, strict=True))
        angle, far = radians(settings.sector), self.furthest
        self._targets = Box((self.nearest * cos(angle), -far * sin(angle), 0.0), (far, far * sin(angle), 0.0))

    def build(self, world: World) -> None:
        super().build(world)
        world.show_floor((0.0, -0.9), (self.furthest + 0.3, 0.9))
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    def apply(self, world: World, name: str, value: float) -> None:
        if name == "gravity":
            self._gravity = value
        super().apply(world, name, value)

    def reset(self, generator: Generator) -> None:
        start = place(generator, self._starts, lambda _: True, "the cube").tolist()
        self.cube.put_in_gripper(self._robot, (start[0], start[1], start[2]))
        self._flight: Flight | None = None
        self._landing: tuple[float, float] | None = None
        self._status = 0.0
        target = place(generator, self._targets, self._throwable, "the target")
        self.goal = target[:2].copy()
        self._marker.place((float(target[0]), float(target[1]), 0.0))

    def _throwable(self, target: FloatArray) -> bool:
        x, y, _ = target.tolist()
        return self.nearest <= hypot(x, y) <= self.furthest and degrees(abs(atan2(y, x))) <= self.settings.sector

    def read(self) -> None:
        """Take the cube's state, and whether and where it came down since the last step."""
        super().read()
        cube = self.cube
        if self._status:
            return
        lowest = cube.lowest
        if self._flight is not None and lowest < BOUNCE:
            self._landing = self._flight.landing(self._robot.period)
        held = self._robot.pads_touching(cube.body) > 0
        if self._landing is not None:
            self._status = 1.0
        elif lowest < ON_FLOOR:
            self._landing = cube.position[:2]
            self._status = -1.0 if held else 1.0
        self._flight = None if held else self._flying()

    def _flying(self) -> Flight:
        cube = self.cube
        a, b, c, d, e, f = cube.columns
        axes = (a, b, c), (d, e, f), (b * f - c * e, c * d - a * f, a * e - b * d)
        return Flight(cube.position, cube.velocity, axes, cube.angular_velocity, cube.half, self._gravity)

    def achieved(self) -> FloatArray:
        x, y = self._landing or self.cube.position[:2]
        return np.array((x, y, self._status), np.float32)

    def expert(self) -> Expert:
        return ThrowExpert(self._robot, self)
