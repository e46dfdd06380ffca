"""Carrying: how episodes with a gripped cube begin, and how experts grip a cube and bring it to a place."""

from __future__ import annotations

from math import hypot

from ..core import FloatArray, Generator
from ..simulation.geometry import Vector
from ..simulation.interface import Cup, Gripper, RobotView
from .cube import BRAKING_SHARE, Cube, CubeTask, aligned, braking, drift

HOVER_HEIGHT = 0.08
"""m above the cube at which the gripper arrives."""
ALIGNED_DISTANCE = 0.018
"""m off the cube's axis at which the gripper may go down; open, it has 1.5 cm to each side of a 4 cm cube."""
STILL_DRIFT = 0.015
"""Largest horizontal drift of the tool, in m per control step, when it goes down or closes."""
GRIP_HEIGHT = 0.006
"""m above the centre of the cube at which it is gripped, so that the pads do not rub on the floor: there the fingers
stick, and an arm that drags them along lags behind."""
CARRYING_CLEARANCE = 0.03
"""m above the floor at which the cube moves to a goal on the floor: a dragged cube twists out of the pads."""
SET_DOWN_GAP = 0.003
"""m above the floor at which the cube is held over a goal on the floor: an arm that aims at the floor presses on it."""
OVER = 0.01
"""m beside a goal on another cube, and m that the tool moves aside in a control step, at which it goes down there."""
SLOW_SHARE = 0.5
"""Of the largest speed, with which it goes down near what stands there: arms swing aside when they stop."""
CUP_GAP = 0.001
"""m above the cube at which a cup begins to suck, and pulls the cube up: an arm that aims at the cube presses on it."""
NEAR, NEAR_CUP = 0.006, 0.0007
"""m above the height of the grip at which the gripper closes, or a cup sucks."""
CLOSING_STEPS = 3
"""Control steps for which both pads must touch before the cube is lifted: until then they push it to the middle."""
GRASP_PATIENCE = 30
"""Control steps after which a gripper that has closed on nothing opens again."""


class CarryTask(CubeTask):
    """The part that tasks share in which cubes are gripped; a task sets `gripper` in `fit`."""

    uses_gripper = True
    gripper: Gripper | Cup

    def _begin(self, cube: Cube, place: Vector, stage: str | None, generator: Generator) -> None:
        """Put a cube there in m: in the gripper (`grasped`), the open gripper around or above it (`near`), or alone."""
        if stage == "grasped":
            cube.put_in_gripper(self._robot, self.gripper, place)
        elif stage == "near":
            x, y, z = place
            above = x, y, z + cube.rise(self.gripper) + generator.uniform(GRIP_HEIGHT, HOVER_HEIGHT)
            cube.place_with_tool(self._robot, place, above, 1.0)
        else:
            cube.place(place, aligned(self._robot))


class Carrier:
    """Goes over a cube, down, closes, lifts, moves it to its goal and holds it there. Restarts when it loses it."""

    def __init__(self, robot: RobotView, gripper: Gripper | Cup) -> None:
        self._robot = robot
        self._gripper = gripper
        self._closing = 0
        """Control steps since the gripper began to close; 0 while it is open."""
        self._held = 0
        """Control steps for which the cube has been between the pads."""

    def begin(self, cube: Cube) -> None:
        """Take up a cube, which may be in the hand already."""
        self._cube, self._size = cube, 2 * cube.half
        self._rise = cube.rise(self._gripper)
        self._grip_height, self._near = (self._rise + CUP_GAP, NEAR_CUP) if self._rise else (GRIP_HEIGHT, NEAR)
        self.open = 1.0
        """Opening of the gripper that is wide enough for the cube on its diagonal."""
        if isinstance(self._gripper, Gripper):
            self.open = min(1.0, (1.5 * self._size + 0.01) / self._gripper.width)
        self._held = CLOSING_STEPS if self._enclosed() else 0
        self._closing = self._held

    def _enclosed(self) -> bool:
        """Whether the cube is between the pads (on its diagonal 1.42 times as wide as along its edges), or held."""
        robot, size = self._robot, self._size
        if isinstance(self._gripper, Cup):
            return robot.pads_touching(self._cube.body) > 0
        near = sum((a - b) ** 2 for a, b in zip(robot.tool_position, self._cube.position, strict=True)) < size**2
        return near and 0.8 * size < robot.opening * self._gripper.width < 1.45 * size

    def _holding(self) -> bool:
        """Whether the cube is between the pads, and both touched it before it was lifted."""
        return self._enclosed() and (self._held >= CLOSING_STEPS or self._robot.pads_touching(self._cube.body) == 2)

    def act(self, goal: Vector, floor: float = 0.0) -> FloatArray:
        """The next action. `floor`: height in m of what stands on the floor, above which it stays on its ways."""
        robot, (x, y, z), (tx, ty, tz) = self._robot, self._cube.position, self._robot.tool_position
        grip: Vector = (x, y, max(z + self._grip_height, robot.workspace.low[2]))
        if self._closing:
            self._closing += 1
            lifted = self._held > CLOSING_STEPS
            self._held = self._held + 1 if self._holding() else 0
            if self._held > CLOSING_STEPS:
                return robot.towards(self._transport(goal, floor), 0.0)
            if not lifted and self._closing < GRASP_PATIENCE:
                return robot.towards((tx, ty, tz) if self._held else grip, 0.0)
            self._closing = 0
        over = max(floor - self._size, 0.0) + self._rise  # over one cube it comes anyway
        error, above = hypot(tx - x, ty - y), z + over + HOVER_HEIGHT
        high = tz > z + over + HOVER_HEIGHT / 2
        if error > ALIGNED_DISTANCE or (high and drift(robot) > STILL_DRIFT):
            target: Vector = (x, y, above) if high else (tx, ty, above)
            return robot.towards(braking(robot, target), self.open)
        if tz > grip[2] + self._near or drift(robot) > STILL_DRIFT:
            if floor:
                grip = x, y, max(grip[2], tz - SLOW_SHARE / BRAKING_SHARE * robot.tool_step)
            return robot.towards(braking(robot, grip), self.open)
        self._closing = 1
        return robot.towards(grip, 0.0)

    def _transport(self, goal: Vector, floor: float) -> Vector:
        """Position of the tool at which the cube, as it lies in the gripper, is at the goal."""
        robot, tool, cube = self._robot, self._robot.tool_position, self._cube
        x, y, z = (t + g - c for t, g, c in zip(tool, goal, cube.position, strict=True))
        lowest, aside = cube.lowest - floor, hypot(x - tool[0], y - tool[1])
        if aside > CARRYING_CLEARANCE or (floor and max(aside, drift(robot)) > OVER):
            if lowest < CARRYING_CLEARANCE / 3:
                return tool[0], tool[1], tool[2] + CARRYING_CLEARANCE
            z = max(z, tool[2] + CARRYING_CLEARANCE - lowest)
        if floor:
            x, y, _ = braking(robot, (x, y, z))
            z = max(z, tool[2] - SLOW_SHARE * robot.tool_step)
        z = max(z, robot.workspace.low[2], tool[2] + SET_DOWN_GAP - lowest)
        if self._rise and z < tool[2]:  # the cube is pressed between the arm and what it comes down on
            _, _, z = braking(robot, (x, y, z))
        return x, y, z
