"""A gantry: three axes that carry a tool, written on the protocol `Robot` alone. It is no arm and has no gripper."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

import numpy as np
from pydantic import BaseModel

from karolos.core import Field, FloatArray, Layout
from karolos.core.parameters import RandomizedParameter
from karolos.core.seeding import Generator
from karolos.errors import UsageError
from karolos.simulation.geometry import Box, Orientations, Vector
from karolos.simulation.interface import Ability, Body, Gripper, JointLimits, TaskNeeds, World
from karolos.simulation.kinematics import Configuration, Pose
from karolos.simulation.shapes import Cuboid

SIZE = (0.04, 0.04, 0.04)


class Gantry:
    """Its tool goes where an action sends it, within one control step."""

    class Settings(BaseModel):
        """It has none."""

    workspace = Box((0.3, -0.2, 0.05), (0.6, 0.2, 0.35))
    limits = JointLimits((0.3, -0.2, 0.05), (0.6, 0.2, 0.35), (0.5,) * 3, (100.0,) * 3)
    gripper: Gripper | None = None
    home: Vector = (0.45, 0.0, 0.2)
    base = (0.0, 0.0, 0.0)
    home_yaw = 0.0
    home_joints: tuple[float, ...] = home
    reset_noise = 0.01
    tool_step = 0.02
    tool_speed = 0.5
    gripper_delay = 0.0
    stops, stopped = 0, False
    measures = ()
    joint_step = (0.02,) * 3
    turns_joints = False
    engine_needs: ClassVar[dict[str, Ability]] = {}
    dexterous: Box | None = None
    orientations = Orientations((1.0, 0.0, 0.0, 0.0), 0.0, 0.0)
    opening = 0.0
    observation = Layout((Field("tool_position", 3, "m"), Field("tool_velocity", 3, "m/s")))
    action = Layout((Field("tool_position_change", 3),))
    parameters: Mapping[str, RandomizedParameter] = {
        "play": RandomizedParameter("m", 0.0, 0.0, 0.001, "how far the tool stays behind along x")
    }

    def __init__(self, settings: BaseModel) -> None:
        self.settings = settings
        self.tool_position = self.home
        self.tool_velocity: Vector = (0.0, 0.0, 0.0)
        self.play = 0.0

    def prepare(self, needs: TaskNeeds) -> None:
        if needs.gripper:
            raise UsageError("this robot has no gripper", where="Gantry")
        self.period = needs.period

    def build(self, world: World) -> None:
        self.tool = world.body([Cuboid(SIZE)], 0.0, (0.3, 0.3, 0.4, 1.0))

    def apply(self, name: str, value: float) -> None:
        self.play = value

    def reset(self, generator: Generator) -> None:
        noise = generator.uniform(-self.reset_noise, self.reset_noise, 3)
        self.place_tool(tuple(np.add(self.home, noise).tolist()), 0.0)

    def place_tool(self, position: Vector, opening: float) -> None:
        self.tool_position, self.tool_velocity = position, (0.0, 0.0, 0.0)
        self.tool.place(position)

    def act(self, action: Sequence[float]) -> None:
        change = self.tool_step * np.clip(action, -1, 1)
        change[0] -= np.sign(change[0]) * min(self.play, abs(change[0]))
        goal = np.clip(np.add(self.tool_position, change), self.workspace.low, self.workspace.high)
        self.tool_velocity = tuple((np.subtract(goal, self.tool_position) / self.period).tolist())
        self.tool.place(tuple(goal.tolist()))

    def read(self) -> None:
        self.tool_position = self.tool.pose()[0]

    def measure(self) -> dict[str, float]:
        return {}

    def observe(self) -> list[float]:
        return [*self.tool_position, *self.tool_velocity]

    @property
    def joint_positions(self) -> Sequence[float]:
        return self.tool_position

    @property
    def joint_velocities(self) -> Sequence[float]:
        return self.tool_velocity

    def forward(self, joints: Sequence[float]) -> Configuration:
        x, y, z = joints
        return Configuration(Pose((x, y, z), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)), np.zeros(0))

    def touches_others(self, *allowed: Body) -> bool:
        return False

    def pads_touching(self, body: Body) -> int:
        return 0

    def towards(self, position: Vector, opening: float) -> FloatArray:
        change = np.subtract(position, self.tool_position) / self.tool_step
        return np.clip(change, -1, 1).astype(np.float32)

    def turning(self, changes: Sequence[float], opening: float) -> FloatArray:
        raise UsageError("a gantry turns no joints")
