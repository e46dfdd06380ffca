"""A task: the gripper holds somebody's plug and seats it in somebody's jig."""

from __future__ import annotations

from math import cos, hypot, pi, sin, tanh
from pathlib import Path

import numpy as np
from pydantic import Field as Setting

from karolos.core import Expert, Field, FloatArray, Layout
from karolos.core import Settings as BaseSettings
from karolos.core.seeding import Generator
from karolos.simulation.geometry import UPRIGHT, inverse, multiply, rotated, rotation_vector
from karolos.simulation.interface import Camera, RobotView, Task, World
from karolos.simulation.shapes import Mesh, volume_of
from karolos.tasks.cube import aligned, check_pads
from karolos.tasks.pose_goal import PoseGoal, pose_array, pose_fields

PARTS = Path(__file__).parent / "parts"
PLUG = (Mesh(PARTS / "plug.stl", scale=0.001),)  # the file is in millimetres
WIDTH, GRIP, PLASTIC = 0.016, 0.05, 1200.0
"""Of the plug between the pads and of the tool above its tip, in m; kg/m3."""
FLOOR, TOP = 0.005, 0.03
"""Heights of the bottom of the hole and of its mouth in m."""


class SeatPlug(Task):
    """What to do: seat the plug that the gripper holds in the jig. It fits in one orientation only.

    What is randomised: the jig, within 5 cm along each axis and turned by up to 30 degrees; the plug's tip, 1 to 3 cm
    above the jig and up to 2 cm beside the hole.
    What counts as success: the tip is within `threshold` of the bottom of the hole, the plug turned as the hole is.

    Observation, along the world's axes: the plug's tip from the bottom of the hole (3, m), its rotation from that in
    which it fits (6), its velocities (3, m/s and 3, rad/s), and its errors at fine scales (11, tanh).
    Goals: the first two of these. Reward: sparse, -1 until the goal is reached, then 0. Termination: never.
    """

    class Settings(BaseSettings):
        threshold: float = Setting(0.001, gt=0, le=0.02, description="of the tip from the bottom of the hole, m")
        max_steps: int = Setting(50, ge=1, le=1000, description="control steps per episode")

    settings: Settings
    uses_gripper = "closed"
    control = "impedance"
    camera = Camera(target=(0.45, 0.0, 0.06), distance=0.55)
    achieved_goal = Layout(pose_fields("plug"))
    desired_goal = Layout(pose_fields("seat"))
    observation = achieved_goal + Layout(
        (Field("plug_velocity", 3, "m/s"), Field("plug_spin", 3, "rad/s"), Field("near_errors", 11))
    )

    def fit(self, robot: RobotView) -> None:
        self.robot, self.opening = robot, WIDTH / check_pads(robot, "SeatPlug", "holds a plug").width
        self.held_mass = PLASTIC * volume_of(PLUG)
        self.goal_rule = PoseGoal(self.settings.threshold, 0.1, dense=False, span=1.0)
        self.goal = pose_array((0.0, 0.0, 0.0), UPRIGHT)

    def build(self, world: World) -> None:
        self.plug = world.body(PLUG, self.held_mass, (0.93, 0.45, 0.13, 1.0))
        self.jig = world.load(PARTS / "jig.urdf")
        self.jig.set_friction(0.3)  # greased: the plug slides off the rim

    def reset(self, generator: Generator) -> None:
        x, y, _ = self.robot.workspace.centre
        x, y = x + generator.uniform(-0.05, 0.05), y + generator.uniform(-0.05, 0.05)
        turn, upright = generator.uniform(-pi / 6, pi / 6), aligned(self.robot)
        self.seat, self.fitting = (x, y, FLOOR), multiply((0.0, 0.0, sin(turn / 2), cos(turn / 2)), upright)
        self.jig.place((x, y, 0.0), self.fitting)
        dx, dy, dz = generator.uniform((-0.02, -0.02, 0.01), (0.02, 0.02, 0.03)).tolist()
        tip = x + dx, y + dy, TOP + dz
        self.robot.place_tool((*tip[:2], tip[2] + GRIP), self.opening, closing=True)
        self.plug.place(tip, upright)

    def achieved(self) -> FloatArray:
        tip, rotation = self.plug.pose()
        return pose_array(np.subtract(tip, self.seat).tolist(), multiply(rotation, inverse(self.fitting)))

    def observe(self) -> list[float]:
        velocity, spin = self.plug.velocity()
        seen = self.robot.with_noise([*self.achieved().tolist(), *velocity, *spin])
        x, y, z = seen[:3]
        near = [tanh(error / scale) for scale in (0.004, 0.001) for error in (x, y, z, z + FLOOR - TOP)]
        turn = seen[8], -seen[5], seen[4]  # rad: what small turns are in the columns of a rotation matrix
        near += [tanh(axis / 0.05) for axis in turn]
        return [*seen, *near]

    def expert(self) -> Expert:
        return SeatPlugExpert(self)


class SeatPlugExpert(Expert):
    """Over the hole, turned as it is, then down."""

    def __init__(self, task: SeatPlug) -> None:
        self.task, self.height = task, 0.0

    def act(self) -> FloatArray:
        task, robot = self.task, self.task.robot
        (tip, rotation), tool = task.plug.pose(), robot.tool
        x, y, z = np.subtract(tip, task.seat).tolist()
        turn = multiply(task.fitting, inverse(rotation))
        over = hypot(x, y) < 0.0012 and hypot(*rotation_vector(turn)) < 0.02
        if z > TOP - FLOOR + 0.002 and not over:
            self.height = max(z, TOP - FLOOR + 0.005)
        else:
            self.height = max(min(self.height, z) - 0.003, z - 0.0125, -0.004)  # presses with 10 N at the most
        (sx, sy, sz), arm = task.seat, rotated(turn, np.subtract(tool.position, tip).tolist())
        place = sx + arm[0], sy + arm[1], sz + self.height + arm[2]
        return robot.towards(place, 0.0, multiply(turn, tool.orientation))
