"""The cube that tasks move: its settings, its body, what a task sees of it, and what tasks with one share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, pi, sin

from pydantic import Field as Setting

from ..core import Field, Layout
from ..core import Settings as BaseSettings
from ..errors import PluginError
from ..randomization.parameter import Parameter
from ..simulation.body import UPRIGHT, Quaternion, Vector
from ..simulation.interface import RobotView, Task
from ..simulation.world import World

COLOUR = (0.93, 0.45, 0.13, 1.0)
FAR = 10.0
"""m from the origin; further away, or below the floor, an object has left all sense."""
FIELDS = (
    Field("object_position", 3, "m"),
    Field("object_rotation", 6, "1"),
    Field("object_velocity", 3, "m/s"),
    Field("object_angular_velocity", 3, "rad/s"),
    Field("object_from_tool", 3, "m"),
)
"""What a task with an object observes. The rotation is the first two columns of its matrix: unlike quaternions and
angles they change continuously (Zhou et al. 2019, On the Continuity of Rotation Representations)."""


def aligned(robot: RobotView) -> Quaternion:
    """The upright rotation, at most 45 degrees, in which a cube's sides face the pads of the gripper at home.

    Not every robot can turn its gripper, and a cube that is gripped by its edges stays askew and weakly held.
    """
    quarter = pi / 2
    angle = robot.home_yaw - quarter * round(robot.home_yaw / quarter)
    return 0.0, 0.0, sin(angle / 2), cos(angle / 2)


class CubeSettings(BaseSettings):
    """Of every task with a cube."""

    object_size: float = Setting(0.04, ge=0.01, le=0.2, description="edge of the cube, m")
    object_mass: float = Setting(0.1, gt=0, le=5, description="of the cube, kg")
    object_friction: float = Setting(1.0, ge=0, le=5, description="lateral friction coefficient of the cube")


class Cube:
    """A cube of a world: build once, `place` at a reset, `read` after a step."""

    def __init__(self, settings: CubeSettings, world: World) -> None:
        edge, mass = settings.object_size, settings.object_mass
        self.half = edge / 2
        self.body = world.box((edge, edge, edge), mass, COLOUR)
        self.body.set_air_drag(0.0)
        self.body.set_friction(settings.object_friction)
        self._world = world
        self.set_mass(mass)

    def set_mass(self, mass: float) -> None:
        """In kg; the inertia is that of a solid cube: m a^2 / 6 about every axis."""
        inertia = mass * (2 * self.half) ** 2 / 6
        self.body.set_inertia(mass, (inertia, inertia, inertia))

    def place(self, position: Sequence[float], orientation: Quaternion = UPRIGHT) -> None:
        """Put it there at rest, and read."""
        x, y, z = position
        self.body.place((x, y, z), orientation)
        self.read()

    def put_in_gripper(self, robot: RobotView, position: Vector) -> None:
        """At a reset: the cube at rest there, the tool around it with the pads at its sides.

        Raises PluginError where the tool cannot be there, or for a robot without a gripper.
        """
        if robot.gripper is None:
            raise PluginError("this robot has no gripper", where=type(robot).__name__, hint="a cube cannot be held")
        # a grip of the episode before must not warm up this one's: the same episode would not be the same again
        self.body.place((0.0, 0.0, FAR))
        self._world.find_contacts()
        robot.place_tool(position, 2 * self.half / robot.gripper.width)
        self.place(position, aligned(robot))

    def read(self) -> None:
        """Take the state from the world: position (m), rotation (quaternion), velocities (m/s, rad/s)."""
        self.position, self.orientation = self.body.pose()
        self.velocity, self.angular_velocity = self.body.velocity()

    @property
    def columns(self) -> tuple[float, ...]:
        """The first two columns of the rotation matrix: 6 numbers."""
        x, y, z, w = self.orientation
        return (
            1 - 2 * (y * y + z * z),
            2 * (x * y + w * z),
            2 * (x * z - w * y),
            2 * (x * y - w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z + w * x),
        )

    @property
    def lowest(self) -> float:
        """Height of the lowest corner above the floor in m."""
        x, y, z, w = self.orientation
        upright = abs(2 * (x * z - w * y)) + abs(2 * (y * z + w * x)) + abs(1 - 2 * (x * x + y * y))
        return self.position[2] - self.half * upright

    def observe(self, tool: Vector) -> list[float]:
        """Numbers of `FIELDS`; `tool` is the tool position in m."""
        away = [mine - its for mine, its in zip(self.position, tool, strict=True)]
        return [*self.position, *self.columns, *self.velocity, *self.angular_velocity, *away]

    @property
    def lost(self) -> bool:
        """Whether it is below the floor or further than 10 m away."""
        x, y, z = self.position
        return not (z > -self.half and x * x + y * y + z * z < FAR * FAR)  # so that NaN is lost as well


class CubeTask(Task):
    """What tasks that move one cube share; a task sets `_robot` in `fit`."""

    observation = Layout(FIELDS)
    settings: CubeSettings
    _robot: RobotView

    def build(self, world: World) -> None:
        self.cube = Cube(self.settings, world)

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        mass, friction = self.settings.object_mass, self.settings.object_friction
        return {
            **super().parameters,
            "object_mass": Parameter("kg", mass, 0.001, 5.0, "of the cube; its inertia goes with it"),
            "object_friction": Parameter("1", friction, 0.0, 5.0, "lateral friction coefficient"),
        }

    def apply(self, world: World, name: str, value: float) -> None:
        if name == "object_mass":
            self.cube.set_mass(value)
        elif name == "object_friction":
            self.cube.body.set_friction(value)
        else:
            super().apply(world, name, value)

    def read(self) -> None:
        self.cube.read()

    def observe(self) -> list[float]:
        return self.cube.observe(self._robot.tool_position)

    def lost(self) -> bool:
        return self.cube.lost
