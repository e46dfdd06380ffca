"""Throw: the arm throws a cube at a target on the floor that it cannot reach."""

from __future__ import annotations

from math import atan2, cos, degrees, hypot, radians, sin
from typing import Annotated, Literal

import numpy as np
from pydantic import Field as Setting

from ..core import Array, BoolArray, Expert, Field, FloatArray, Generator, Layout, Measure
from ..core.parameters import Drawn, Probability
from ..errors import UsageError
from ..simulation.geometry import Vector, axes
from ..simulation.interface import GRAVITY, Box, Camera, RobotView, Stroke, World
from .cube import FIELDS, CubeSettings, CubeTask, check_gripper, check_pads
from .point_goal import GOAL_COLOUR, PointGoal, sample_position
from .throw_planner import FLIGHT_STEPS, RUN_UP, Flight, ThrowPlanner, flight_time

FLOOR_CONTACT = 0.002
"""Height in m above the floor below which a corner of the cube counts as touching it."""
TRAIL_COLOUR = (0.86, 0.3, 0.06, 1.0)
BOUNCE_HEIGHT = 0.08
"""Largest height in m of a corner of the cube above the floor, a control step after a landing."""


class Landing(PointGoal):
    """Success if a thrown object lands nearer than `threshold` to the target, in m. Landing ends the episode.

    `achieved` (..., 3) is the object's position on the floor (2) in m and a status: 0 in the hand or in the air, 1
    landed after a release, -1 a failure for every target, such as an object put on the floor. `desired` (..., 2) is
    the target in m.

    Sparse reward: 1 for a success, else 0; a cost per step would make dropping the object at once profitable. Dense
    reward: 1 - tanh(2 d) for landing after a release, d in m from the target; else 0. A failure for every target
    costs `failure_cost`. A miss also gives 0, so only this cost keeps a policy off the floor.
    """

    place = slice(2)

    def __init__(self, threshold: float, *, dense: bool, failure_cost: float) -> None:
        super().__init__(threshold, dense=dense, span=1.0)
        self.failure_cost = failure_cost
        self.reward_range = (-failure_cost, 1.0)

    def distance(self, achieved: Array, desired: Array) -> FloatArray:
        return np.where(achieved[..., 2] > 0.5, super().distance(achieved, desired), np.inf).astype(np.float32)

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        near = 1 - np.tanh(2 * self.distance(achieved, desired)) if self.dense else self.success(achieved, desired)
        return (near - self.failure_cost * (achieved[..., 2] < -0.5)).astype(np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return self.distance(achieved, desired) < self.threshold

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:  # noqa: ARG002 (wherever the target is)
        return np.abs(achieved[..., 2]) > 0.5


class Throw(CubeTask):
    """What to do: throw the cube, which starts in the gripper, so that it comes down on the target.

    What is randomised: the tool's start, within `start_range` of the home position along each axis, and the target: on
    the floor in front of the robot within `sector` degrees to both sides, beyond the arm's reach by at least
    `threshold`, and from there at most the fraction `share` of the way to the furthest throw.

    Observation: object_position (3, m), object_rotation (6, two columns of its matrix), object_velocity (3, m/s),
    object_angular_velocity (3, rad/s), object_from_tool (3, m), landing_if_released (2, m) and time_of_flight (1, s):
    place and time at which the centre of the cube would land if it left the hand now, in free fall without spin.
    Action: the robot's joint changes and the gripper.
    Goals: achieved, the cube's position on the floor (2, m), after the landing that of its first contact, and a status
    (0 in hand or air, 1 landed after a release, -1 on the floor without one, or the arm touched something else, or its
    protective stop acted); desired, the target (2, m).
    Reward: at landing; sparse 1 within the threshold, else 0; dense in [0, 1]; minus `failure_cost` if the status is
    -1, see `Landing`.
    What counts as success: the cube's first contact with the floor after its release lies within `threshold` of the
    target. Flying over the target or carrying the cube there does not count. Until then the arm touches neither the
    floor nor itself, and its protective stop does not act.
    Termination: when the cube touches the floor, thrown or put down, or the arm does; truncated after `max_steps`.
    In training with probability `end_at_release` already when the cube leaves the hand, with the computed landing of a
    free flight. If the hand touches the cube again, the true landing
    differs by up to a decimetre.

    Reach and furthest throw follow from the speed limits of joints and tool, see `ThrowPlanner`. Horizontal distances
    from the robot's axis: panda .95 and 1.13 m, ur5 1.06 and 1.21 m, iiwa 1.08 and 1.73 m. Such throws turn the
    gripper, so they need `control: joint`, the default for this task. With the tool pointing down, within the
    workspace, no throw lands beyond .81 (panda), .86 (ur5) and .79 m (iiwa), which the arm can reach.
    """

    class Settings(CubeSettings):
        reward: Literal["sparse", "dense"] = Setting("sparse", description="at landing: 1 or 0, or by the distance")
        failure_cost: float = Setting(
            0.0, ge=0, le=1, description="cost of putting the cube down, and of an arm that touches something or stops"
        )
        threshold: float = Setting(0.1, gt=0, le=0.5, description="distance at which the target is hit, m")
        share: float = Setting(0.9, gt=0, le=1, description="share of the possible distances in which targets lie")
        sector: float = Setting(45.0, gt=0, le=60, description="largest angle of targets to both sides, degrees")
        max_steps: int = Setting(75, ge=1, le=100_000, description="control steps per episode")
        start_range: Annotated[float, Drawn("m", 0.0, 0.5)] = Setting(
            0.05, ge=0, le=0.5, description="largest distance of the tool from home at the start, along each axis, m"
        )
        end_at_release: Probability = Setting(
            0.0, description="probability that an episode ends at the release and its landing is computed"
        )

    settings: Throw.Settings
    drawn: Throw.Settings
    observation = Layout(
        (*FIELDS, Field("landing_if_released", 2, "m", kind="point"), Field("time_of_flight", 1, "s", kind="scalar"))
    )
    uses_gripper = True
    control = "joint"
    achieved_goal = Layout((Field("landing_point", 2, "m", kind="point"), Field("landed", 1, kind="scalar")))
    desired_goal = Layout((Field("target", 2, "m", kind="point"),))
    distance_measure = Measure("miss", "m", "smaller", "distance of the landing from the target; undefined without one")

    def __init__(self, settings: Throw.Settings) -> None:
        super().__init__(settings)
        self.goal_rule = Landing(
            settings.threshold, dense=settings.reward == "dense", failure_cost=settings.failure_cost
        )
        self._gravity = GRAVITY

    def fit(self, robot: RobotView) -> None:
        settings, self._robot = self.settings, robot
        check_pads(robot, type(self).__name__, "throws")
        self.gripper = check_gripper(robot, type(self).__name__, settings.object_size)
        self.planner = planner = ThrowPlanner(robot, settings.object_size / 2)
        self.nearest = planner.reach + settings.threshold
        self.furthest = self.nearest + settings.share * (planner.furthest - self.nearest)
        if self.nearest >= self.furthest:
            raise UsageError(
                f"no target is left between {self.nearest:.2f} m, the arm's reach and the threshold, and "
                f"{planner.furthest:.2f} m, the furthest throw",
                setting="task.threshold",
                hint="a smaller threshold, or a larger robot.tool_speed or robot.joint_step, leaves more",
            )
        angle, far = radians(settings.sector), self.furthest
        self.camera = Camera(target=(0.5 * far, 0.0, 0.25 * far), distance=2.5 * far, yaw=22.0, pitch=-22.0)
        targets = Box((self.nearest * cos(angle), -far * sin(angle), 0.0), (far, far * sin(angle), 0.0))
        self._targets = targets.moved((*planner.axis, 0.0))

    def _starts(self) -> Box:
        """Box of start positions of the tool."""
        home, workspace, most = self._robot.home, self._robot.workspace, self.drawn.start_range
        ranges = [
            (max(at - most, low), min(at + most, high))
            for at, low, high in zip(home, workspace.low, workspace.high, strict=True)
        ]
        return Box(*zip(*ranges, strict=True))

    def build(self, world: World) -> None:
        super().build(world)
        world.release_in_motion()
        self._robot.touches_others()  # starts the record of forces
        self._lead = world.lead
        self._marker = world.marker(self.settings.threshold, GOAL_COLOUR)

    def apply(self, world: World, name: str, value: float) -> None:
        super().apply(world, name, value)
        if name == "gravity":
            self._gravity = value

    def reset(self, generator: Generator) -> None:
        x, y, z = sample_position(generator, self._starts(), "the cube").tolist()
        self.cube.put_in_gripper(self._robot, self.gripper, (x, y, z))
        self._flight: Flight | None = None
        self._landing: tuple[float, float] | None = None
        self._status = 0.0
        self._trail: list[Vector] = []
        """Positions of the cube since its release, one per control step."""
        target = sample_position(generator, self._targets, "the target", self._is_target)
        self.goal = target[:2].copy()
        self._marker.place((float(target[0]), float(target[1]), 0.0))
        self._ends_at_release = generator.uniform() < self.drawn.end_at_release

    def _is_target(self, position: FloatArray) -> bool:
        x, y = (at - axis for at, axis in zip(position.tolist(), self.planner.axis, strict=False))
        return self.nearest <= hypot(x, y) <= self.furthest and degrees(abs(atan2(y, x))) <= self.settings.sector

    def read(self) -> None:
        """Read the cube's state, and whether and where it landed since the last step."""
        super().read()
        cube = self.cube
        if self._status:
            return
        if self._robot.stopped or self._robot.touches_others(cube.body):
            self._status = -1.0
            return
        lowest = cube.lowest
        if self._flight is not None and lowest < BOUNCE_HEIGHT:
            self._landing = self._flight.landing(self._robot.period)
        held = self._robot.pads_touching(cube.body) > 0
        if self._landing is not None:
            self._status = 1.0
        elif lowest < FLOOR_CONTACT:
            self._landing = cube.position[:2]
            self._status = -1.0 if held else 1.0
        self._flight = None
        if not held:
            x, y, z = cube.velocity
            velocity, turning = (x, y, self._rise(z)), cube.angular_velocity
            self._flight = Flight(cube.position, velocity, axes(cube.orientation), turning, cube.half, self._gravity)
        self._trail = [] if held else [*self._trail, cube.position]
        if self._ends_at_release and self._flight is not None and not self._status:
            seconds = float(flight_time(cube.position[2], self._flight.velocity[2], self._gravity))
            self._landing = self._flight.landing(seconds, steps=FLIGHT_STEPS)
            self._status = float(self._landing is not None)

    def observe(self) -> list[float]:
        values = super().observe()
        (x, y, z), (vx, vy, vz) = values[:3], values[9:12]
        seconds = float(flight_time(z - self.cube.half, self._rise(vz), self._gravity))
        return [*values, x + vx * seconds, y + vy * seconds, seconds]

    def _rise(self, speed: float) -> float:
        """The upward speed in m/s at which ideal free fall equals the simulated fall of a cube that rises at `speed`.

        PyBullet changes speeds before positions (semi-implicit Euler): after k physics steps of dt a body is at
        z + k dt v + k (k + 1) g dt^2 / 2. Without this a throw lands 5 mm nearer than computed.
        """
        return speed + self._gravity * self._lead

    def achieved(self) -> FloatArray:
        x, y = self._landing or self.cube.position[:2]
        return np.array((x, y, self._status), np.float32)

    def strokes(self) -> list[Stroke]:
        """The flight, and a cross where the cube landed."""
        if self._landing is None:
            return [Stroke(self._trail, TRAIL_COLOUR)]
        (x, y), arm = self._landing, 0.6 * self.settings.threshold
        cross = [((x - arm, y - side * arm, 0.001), (x + arm, y + side * arm, 0.001)) for side in (1, -1)]
        flight = [*self._trail[:-1], (x, y, self.cube.half)]
        return [Stroke(flight, TRAIL_COLOUR), *(Stroke(line, TRAIL_COLOUR, width=1.5) for line in cross)]

    def expert(self) -> Expert:
        return ThrowExpert(self._robot, self)


RAMP_SECONDS = 0.32
"""Time in s in which the throw accelerates to its speed. The heaviest arm has the torque for it."""
DECELERATION = 3.0
"""Deceleration in rad/s2 with which joints come to rest at the start of the throw."""
SETTLED_LIMITS = 0.05, 0.3
"""Largest error in rad and speed in rad/s at which the arm counts as at rest at the start of the throw."""
APPROACH_PATIENCE = 40
"""Number of control steps after which the throw starts from the current position."""
POSITION_GAIN = 0.1
"""Fraction of its position error that a joint corrects in a control step."""
VELOCITY_GAIN = 0.15
"""Fraction of a joint's velocity error that its next steps add. Velocities follow actions a step or two later: larger
values of this and of `SPEED_GAIN` make the throw unstable."""
SPEED_GAIN = 0.6
"""Fraction of the missing distance by which the throw gets faster in a control step."""
LARGEST_SPEED_UP = 1.5
"""Largest factor by which the throw gets faster or slower."""
LOOK_AHEAD = 0.25
"""Time ahead in s in which the furthest landing is searched."""
LARGEST_CORRECTION = 0.8
"""Largest correction of a joint's change, as a fraction of its change at full speed."""
OPENING_DELAY = 0.01
"""Time in s from the beginning of the opening until the pads release."""


class ThrowExpert(Expert):
    """Moves to the start of the throw, then turns each joint at constant speed; opens where the landing is nearest."""

    def __init__(self, robot: RobotView, task: Throw) -> None:
        self._robot = robot
        self._task = task
        self._delay = OPENING_DELAY + robot.gripper_delay
        """Time in s from the command to open until the pads release."""
        self.reset()

    def reset(self) -> None:
        x, y = self._task.goal.tolist()
        plan = self._task.planner.plan(x, y)
        self._velocities = np.array(plan.velocities)
        self._start = np.array(plan.release) - self._velocities * RUN_UP
        self._distance = self._task.planner.distance_along(x, y)
        self._steps = 0
        self._throwing = -1
        """Control steps since the throw began; -1 on the way to its start."""
        self._released = 0
        """The step of the throw in which the gripper began to open; 0 before."""
        self._correction = np.zeros_like(self._start)
        self._speed_up = 1.0
        self._elapsed = 0.0
        """Time in s along the plan."""

    def act(self) -> FloatArray:
        robot, period = self._robot, self._robot.period
        positions, velocities = robot.joint_positions, robot.joint_velocities
        self._steps += 1
        to_start = self._start - positions
        near, slow = SETTLED_LIMITS
        moving = np.abs(to_start).max() > near or np.abs(velocities).max() > slow
        if self._throwing < 0 and moving and self._steps < APPROACH_PATIENCE:
            # straight to the start, each joint in proportion, slow enough to stop there: v^2 = 2 a s
            distance = max(float(np.abs(to_start).max()), 1e-9)
            braking = (2 * DECELERATION * distance) ** 0.5 * period
            steps = np.array(robot.joint_step) / np.maximum(np.abs(to_start), 1e-9)
            return robot.turning((to_start * min(1.0, braking / distance, float(steps.min()))).tolist(), 0.0)
        self._throwing += 1
        accelerated = self._throwing * period > RAMP_SECONDS
        if not self._released and accelerated and self._release_now(positions, velocities):
            self._released = self._throwing
        late = self._throwing - self._released - int(self._delay / period)
        if self._released and late > 0:  # a moving hand would hit the cube that leaves it, or the floor
            return robot.turning([0.0] * len(positions), 1.0)
        if accelerated:
            speed_up = self._speed_up * (1 + SPEED_GAIN * self._shortfall(positions, velocities))
            self._speed_up = min(max(speed_up, 1 / LARGEST_SPEED_UP), LARGEST_SPEED_UP)
        # a joint that is slower than planned gets a larger change, within its step
        planned = self._velocities * self._speed_up * min(1.0, self._throwing * period / RAMP_SECONDS)
        largest = LARGEST_CORRECTION * np.abs(self._velocities) * period
        correction = self._correction + VELOCITY_GAIN * (planned - velocities) * period
        self._correction = np.clip(correction, -largest, largest)
        error = to_start + self._velocities * self._elapsed
        # the speed in the middle of the next step
        elapsed = self._speed_up * min(1.0, (self._throwing + 0.5) * period / RAMP_SECONDS) * period
        self._elapsed += elapsed
        changes = self._velocities * elapsed + self._correction + POSITION_GAIN * error
        return robot.turning(changes.tolist(), float(self._released > 0))

    def _landings(self, positions: Array, velocities: Array, times: Array) -> Array:
        """Landing distances (t,) for releases after `times` (t,) in s at the current joint velocities."""
        ahead = positions + np.multiply.outer(times, velocities)
        return self._task.planner.landing_of(ahead, np.broadcast_to(velocities, ahead.shape))

    def _shortfall(self, positions: Array, velocities: Array) -> float:
        """Missing distance to the target, as a fraction of it, if the throw continues at these velocities."""
        landings = self._landings(positions, velocities, np.linspace(0.0, LOOK_AHEAD, 13))
        return 1 - float(landings.max()) / self._distance

    def _release_now(self, positions: Array, velocities: Array) -> bool:
        """Whether opening now brings the cube nearer to the target than opening a control step later."""
        times = self._delay + np.array((0.0, self._robot.period))
        now, later = np.abs(self._landings(positions, velocities, times) - self._distance)
        return bool(now <= later)
