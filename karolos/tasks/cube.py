"""The cube that tasks move: its settings, its body, what a task sees of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from pydantic import Field as Setting

from ..core import Field
from ..core import Settings as BaseSettings
from ..randomization.parameter import Parameter
from ..simulation.body import UPRIGHT, Quaternion, Vector
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


class CubeSettings(BaseSettings):
    """Of every task with a cube."""

    object_size: float = Setting(0.04, ge=0.01, le=0.2, description="edge of the cube, m")
    object_mass: float = Setting(0.1, gt=0, le=5, description="of the cube, kg")
    object_friction: float = Setting(1.0, ge=0, le=5, description="lateral friction coefficient of the cube")


def parameters(settings: CubeSettings) -> Mapping[str, Parameter]:
    """What domain randomization may change of a cube."""
    return {
        "object_mass": Parameter("kg", settings.object_mass, 0.001, 5.0, "of the cube; its inertia goes with it"),
        "object_friction": Parameter("1", settings.object_friction, 0.0, 5.0, "lateral friction coefficient"),
    }


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
