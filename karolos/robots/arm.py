"""A serial arm: a robot file gives an `ArmModel` and the defaults of its settings; this file implements the robot.

The effect of an action is an object of its own, see `control`.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import atan2, dist, floor, inf, sqrt
from operator import mul, truediv
from typing import Any, ClassVar

import numpy as np

from ..core import Array, Field, FloatArray, Layout, Measure
from ..core.parameters import RandomizedParameter, drawn_settings
from ..core.seeding import Generator
from ..errors import PluginError, UsageError
from ..simulation import urdf
from ..simulation.geometry import Orientations, Quaternion, Vector, quaternion_of
from ..simulation.interface import OPENS, Ability, Body, Cup, Gripper, JointLimits, TaskNeeds, World
from ..simulation.kinematics import Chain, Configuration, Pose, downward
from ..simulation.parts import Mechanism
from .control import CONTROLS, POSTURE_GAIN, ROTATION, Control, Way
from .loads import MotorLoads
from .model import ACCELERATION_TIME, ArmModel, arm_joints, check_model
from .mounting import mounted
from .protective_stop import Guard, ProtectiveStop
from .settings import ArmSettings

INNER_FACE_COSINE = 0.9
"""Smallest cosine between the normal of a contact and the axis along which the pads face each other."""
PLACE_TOLERANCE = 5e-4
"""Largest error of `place_tool`, in m for the position and in rad for the orientation."""
LARGEST_DAMPING = 5.0
"""Upper bound of the parameter joint_damping in N m s/rad."""
DAMPED_SHARE = 0.4
"""Largest fraction of a motor's torque that joint_damping takes at the top speed of its joint. A motor that lacks half
its torque (joint_friction) still reaches that speed. Above it PyBullet, which damps explicitly, is unstable at light
wrists."""
HELD, RANGE_STEP = 0.97, 0.05
"""Largest fraction of a motor's torque with which it surely holds the arm. Upper bounds that follow from it are
multiples of the second number."""
SPRING_FRICTION = RandomizedParameter(
    "1", 0.0, 0.0, 0.02, "dry friction of every joint: fraction of its largest torque"
)
"""Replaces joint_friction if a spring moves the tool: the spring cannot overcome more."""
ARM_PARAMETERS: Mapping[str, RandomizedParameter] = {
    "joint_friction": RandomizedParameter(
        "1", 0.0, 0.0, 0.5, "dry friction: fraction of its largest torque that every motor lacks"
    ),
    "link_mass": RandomizedParameter("1", 1.0, 0.5, 2.0, "factor on the masses and inertias of all links"),
    "motor_gain": RandomizedParameter(
        "1", 1.0, 0.8, 1.0, "fraction of its speed error that a motor removes in 1/240 s"
    ),
    "observation_noise": RandomizedParameter(
        "1", 0.0, 0.0, 0.2, "standard deviation of the noise on observed values of arm and object, in SI units"
    ),
    "calibration_error": RandomizedParameter(
        "m", 0.0, 0.0, 0.02, "largest error of positions from cameras along each axis; constant in an episode"
    ),
    "latency": RandomizedParameter("s", 0.0, 0.0, 0.1, "age of the observation"),
    "jitter": RandomizedParameter("s", 0.0, 0.0, 0.05, "largest random increase of that age"),
    "action_delay": RandomizedParameter("control steps", 0.0, 0.0, 2.0, "delay of the actions; rounded"),
}

WRENCH = Field("wrench", 6, "N, N m", kind="wrench")
WRENCH_NOISE = RandomizedParameter(
    "N", 0.0, 0.0, 2.0, "standard deviation of the noise on the observed wrench; on its torque a tenth of that, in N m"
)
TORQUE_ARM = 0.1
"""Ratio of the noise on the wrench's torque to that on its force, in m."""
ARM_MEASURES = (
    Measure("path_length", "m", "smaller", "length of the path of the tool centre point"),
    Measure("peak_force", "N", "smaller", "largest force of a body or another link on a link of the arm or gripper"),
    Measure("peak_wrist_force", "N", "smaller", "largest force of the wrench at the wrist, low-passed"),
    Measure("peak_joint_speed", "1", "smaller", "largest speed of a joint, as a share of its limit"),
    Measure("peak_joint_acceleration", "1", "smaller", "largest acceleration of a joint, as a share of its limit"),
    Measure("peak_joint_torque", "1", "smaller", "largest torque of a motor, as a share of its limit"),
)
"""Measures of every arm. `Arm.measure` computes them."""
PAD_FORCE = Measure("peak_pad_force", "N", "smaller", "largest force of a body on a pad of the gripper")
STOPS = Measure("protective_stops", "1", "smaller", "protective stops, those that are only counted included")


class Arm:
    """Implements `karolos.simulation.interface.Robot` for a serial arm; a subclass sets `model` and may set `Settings`.

    Observation: tool_position (3, m), tool_velocity (3, m/s); with `yaw` tool_heading (2, cosine and sine of the yaw);
    with pose and impedance control also tool_rotation (6, the first two columns of its matrix) and
    tool_angular_velocity (3, rad/s), with impedance control set_point (6, the way from the tool to it, m and rad);
    with a gripper that actions move gripper_opening (1, 0 closed to 1 open; of a cup 1 without suction, .5 while it
    holds something, else 0); with joint control joint_positions (n, rad) and joint_velocities (n, rad/s). With
    `joint_slots` (s) instead, for each of s joints, 0 where there is none: joint_effects (6 s, how far an action of 1
    moves the tool in m and turns it in rad), joint_rooms (2 s, to the lower and the upper limit, at most MOST_ROOM),
    joint_speeds (s) and joint_accelerations (s, at most 1), all three in joint steps and control steps.
    Action, each number in [-1, 1]: tool_position_change (3, in units of `tool_step`), with `yaw` yaw_change (1, in
    units of `yaw_step`), with pose and impedance control tool_turn (3, rotation vector in units of `turn_step`); with
    joint control instead joint_changes (n or s, in joint steps); with a gripper gripper_opening (1, -1 closed
    to 1 open; a cup sucks below 0). With `timed_release` a gripper that holds something and is told to open lets go
    within the control step. The less the action exceeds the current opening, the later it lets go.
    """

    Settings: ClassVar[type[ArmSettings]] = ArmSettings
    model: ArmModel
    """Model of the arm. In the class: without a gripper if the arm has a flange. In an instance: with its gripper."""

    def __init__(self, settings: ArmSettings) -> None:
        self.settings = settings
        self.model = model = mounted(self.bare_model(settings), settings.gripper)
        self._joints = arm_joints(model)
        self.limits = JointLimits(
            *(
                tuple(getattr(joint, key) for joint in self._joints)
                for key in ("lower", "upper", "velocity", "effort", "name")
            )
        )
        published = model.accelerations if settings.acceleration == "sheet" else None
        self.accelerations = published or tuple(speed / ACCELERATION_TIME for speed in self.limits.velocity)
        self.tool_speed = settings.tool_speed or model.tool_speed or inf
        middle_x, middle_y, _ = model.workspace.centre
        offset: Vector = (-middle_x, -middle_y, 0.0) if settings.base == "centred" else (0.0, 0.0, 0.0)
        self.base: Vector = *offset[:2], 0.0 - model.floor
        tool = np.array(model.tool), urdf.rotation_matrix(*model.tool_rpy)
        self.chain = Chain(self._joints, tool, self.base)
        self.workspace = model.workspace.moved(offset)
        self.dexterous = model.dexterous.moved(offset) if model.dexterous is not None else None
        self.configuration = self.chain.forward(model.home)
        pose = self.configuration.tool
        self.home = pose.position
        self.home_yaw = atan2(pose.x[1], pose.x[0])
        check_model(model, self._joints, tuple(np.subtract(pose.position, offset).tolist()))
        self.reset_noise = settings.reset_noise
        self.gripper_delay = settings.gripper_delay
        self._told: list[tuple[int, float]] = []
        """Pending commands of the gripper: opening, and number of physics steps until it is done."""
        self._pressing: dict[tuple[int, int], float] | None = None
        nominal = {**ARM_PARAMETERS, "wrench_noise": WRENCH_NOISE, **drawn_settings(settings)}
        self._values = {name: parameter.nominal for name, parameter in nominal.items()}
        self.gripper: Gripper | Cup | None = model.fingers.gripper if model.fingers else model.cup
        self.home_joints = model.home
        self._rest = np.array(model.home)
        self.prepare(TaskNeeds(gripper=False, period=1 / 24))

    @classmethod
    def bare_model(cls, settings: ArmSettings) -> ArmModel:  # noqa: ARG003  (of an arm that comes from a file)
        """The model, without a gripper if the arm has a flange."""
        return cls.model

    def forward(self, joints: Sequence[float]) -> Configuration:
        return self.chain.forward(joints)

    def prepare(self, needs: TaskNeeds) -> None:
        if needs.gripper and self.gripper is None:
            what, hint = "this robot has no gripper", "choose a task that needs no gripper"
            if self.model.flange is not None:
                raise UsageError(
                    what, setting="robot.gripper", hint=f"mount one (robot.gripper=robotiq_2f85), or {hint}"
                )
            raise UsageError(what, where=type(self).__name__, hint=hint)
        if self.settings.finger_opening and needs.gripper:
            what = "the task moves the gripper, so it cannot be held open"
            raise UsageError(what, setting="robot.finger_opening", hint="set it to 0")
        self._grip = self.gripper if needs.gripper else None
        self._commanded = needs.gripper is True
        """Whether actions move the gripper."""
        self._held_open = self.settings.finger_opening or needs.fingers
        self.period = period = needs.period
        limits = self.settings.protective_stop
        if limits == "task":
            limits = ProtectiveStop.model_validate({}) if needs.protective_stop else None
        self._guard = Guard(limits, self.limits.effort, period) if limits is not None else None
        self.tool_step = self.settings.tool_step
        self.mode = mode = self.settings.control or needs.control
        steps = [min(self.settings.joint_step, speed * period) for speed in self.limits.velocity]
        if self.settings.joint_slots is not None:  # actions do alike whatever the size of an arm
            if mode != "joint":
                what, hint = f"control is {mode}, whose actions do not move joints", "set robot.control: joint"
                raise UsageError(what, setting="robot.joint_slots", hint=hint)
            levers = np.linalg.norm(self.chain.jacobian(self.chain.forward(self.model.home))[:3], axis=0)
            steps = np.minimum(steps, self.settings.tool_step / np.maximum(levers, 1e-6)).tolist()
        self.joint_step = tuple(steps)
        self.engine_needs: dict[str, Ability] = {}
        if mode == "impedance":
            self.engine_needs["robot.control"] = "impedance"
        if isinstance(self._grip, Cup):
            self.engine_needs["robot.gripper"] = "suction"
        self._control: Control = CONTROLS[mode](self)
        self._observed = list(dict.fromkeys(self.settings.observe))
        if ROTATION in self._control.observed and "rotation" in self._observed:
            self._observed.remove("rotation")  # it is there already
        self.turns_joints = self._control.turns_joints
        turns = (self.model.tilt, self.model.turn) if self._control.turns_tool else (0.0, 0.0)
        self.orientations = Orientations(downward(self.home, self.home_yaw).orientation, *turns)

    @cached_property
    def _weight(self) -> float:
        """Largest fraction of a motor's torque that gravity takes at home, but at least .1."""
        return max(0.1, float(MotorLoads(self.model.description).shares([self.model.home]).max()))

    @property
    def parameters(self) -> Mapping[str, RandomizedParameter]:
        limits = zip(self.limits.effort, self.limits.velocity, strict=True)
        most = min(LARGEST_DAMPING, DAMPED_SHARE * min(effort / speed for effort, speed in limits))
        damping = RandomizedParameter("N m s/rad", 0.0, 0.0, most, "viscous friction that is added to every joint")
        parameters = {"joint_damping": damping, **ARM_PARAMETERS}
        weight = self._weight  # with more friction or mass the arm would sink
        for name, most in (("joint_friction", max(1 - weight, RANGE_STEP)), ("link_mass", max(HELD / weight, 1.0))):
            usual = parameters[name]
            high = min(usual.high, round(floor(most / RANGE_STEP) * RANGE_STEP, 2))
            parameters[name] = replace(usual, high=high)
        drawn = drawn_settings(self.settings)
        delay = drawn.pop("gripper_delay")
        if self.mode == "impedance":
            del parameters["motor_gain"]  # nothing follows speeds
            if self.settings.stiffness_range is not None:
                del drawn["stiffness"]  # actions choose it
            parameters = {**parameters, "joint_friction": SPRING_FRICTION, **drawn}
        if "wrench" in self._observed:
            parameters["wrench_noise"] = WRENCH_NOISE
        if self._grip is None:
            return parameters
        nominal = self._grip.pad_friction
        friction = RandomizedParameter("1", nominal, 0.0, 5.0, "lateral friction coefficient of the gripper's pads")
        return {**parameters, "pad_friction": friction, "gripper_delay": delay}

    @cached_property
    def observation(self) -> Layout:
        gripper = (Field("gripper_opening", 1, kind="scalar"),) if self._commanded else ()
        torques = Field("joint_torques", self.chain.size, "N m")
        offered = {"rotation": ROTATION, "wrench": WRENCH, "torques": torques}
        fields = (*self._control.observed, *gripper, *self._control.observed_joints)
        return Layout((*fields, *(offered[name] for name in self._observed)))

    @cached_property
    def action(self) -> Layout:
        gripper = (Field("gripper_opening", 1, kind="scalar"),) if self._commanded else ()  # -1 closed, 1 open
        return Layout((*self._control.action, *gripper))

    def facts(self) -> dict[str, Any]:
        """Facts that a controller needs to run a policy: JSON-able, SI units, in the world's frame."""
        settings, limits, scales = self.settings, self.limits, self._control.scales
        names = [limits.name(joint) for joint in range(self.chain.size)]
        columns = (names, limits.lower, limits.upper, limits.velocity, self.accelerations, limits.effort)
        keys = ("name", "lower", "upper", "velocity", "acceleration", "effort", "home")
        rows = zip(*columns, self.home_joints, strict=True)
        joints = [dict(zip(keys, row, strict=True)) for row in rows]
        action = [
            {"name": field.name, "size": field.size}
            | (dict(zip(("unit", "scale"), scales[field.name], strict=True)) if field.name in scales else {})
            for field in self.action.fields
        ]
        facts: dict[str, Any] = {"rate": 1 / self.period, "control": self.mode, "action": action, "joints": joints}
        facts["moved"] = "joints" if self.turns_joints else "set point" if self.mode == "impedance" else "tool"
        facts |= {"base": self.base, "workspace": [self.workspace.low, self.workspace.high]}
        facts |= {"tool_speed": self.tool_speed} if self.tool_speed < inf else {}
        if self.mode in ("pose", "impedance"):
            facts["frame"] = settings.frame
        if self.mode == "impedance":
            spring = "stiffness turn_stiffness damping_ratio error_limit turn_error_limit stiffness_range"
            facts["spring"] = {key: getattr(settings, key) for key in spring.split()}
        if self._commanded:
            width = self._grip.width if isinstance(self._grip, Gripper) else None
            facts["gripper"] = {"closed": -1, "open": 1, "width": width}
        return facts

    @property
    def measures(self) -> tuple[Measure, ...]:
        pads = (PAD_FORCE,) if isinstance(self._grip, Gripper) else ()
        stops = (STOPS,) if self._guard is not None else ()
        return (*ARM_MEASURES, *pads, *stops)

    def measure(self) -> dict[str, float]:
        forces, loads = self.world.largest_forces(self.body), self.motors.loads()
        pads = [force for (link, _), force in forces.items() if link in self.motors.pads]
        return {
            "path_length": self._path,
            "peak_force": max(forces.values(), default=0.0),
            "peak_joint_speed": max(map(truediv, loads.speed, self.limits.velocity)),
            "peak_joint_acceleration": max(map(truediv, loads.acceleration, self.accelerations)),
            "peak_joint_torque": max(map(truediv, loads.torque, self.limits.effort)),
            "peak_wrist_force": loads.wrench,
            "peak_pad_force": max(pads, default=0.0),
            "protective_stops": self.stops,
        }

    def build(self, world: World) -> None:
        robot, carriers = self.model.description.robot, self.model.description.carriers
        fingers = self.model.fingers
        if fingers is not None and self._grip is None:
            robot = urdf.weld(robot, dict.fromkeys(fingers.joints, fingers.position(self._held_open)))
        self.world = world
        self.body = world.load(Mechanism(robot), position=self.base)
        links = {**self.body.links(), self._joints[0].parent: -1}
        named = [(carriers[first], carriers[second]) for first, second in self.model.self_collisions]
        # a welded finger has no link
        pairs = [(links[first], links[second]) for first, second in named if first in links and second in links]
        self.body.collide_only(pairs)
        arm = [joint.child for joint in self._joints]
        tool = self.model.tool, quaternion_of(urdf.rotation_matrix(*self.model.tool_rpy))
        fingers, cup = (self.model.fingers, self.model.cup) if self._grip is not None else (None, None)
        self.motors = motors = world.motors(self.body, arm, self.limits, fingers, tool, cup)
        motors.set_wrench_filter(self.settings.wrench_filter)
        if "wrench" in self._observed:
            motors.wrench()  # PyBullet measures it from the first question on
        self._control.build()
        self._arm_links = [self.body.links()[name] for name in arm]
        if self._guard is not None:
            world.forces(self.body)  # the world records them from the first question on
        self._apply: dict[str, Callable[[float], None]] = {
            "joint_damping": motors.set_joint_damping,
            "joint_friction": self._set_joint_friction,
            "link_mass": motors.set_mass,
            "motor_gain": motors.set_gain,
            "pad_friction": motors.set_pad_friction,
        }

    def apply(self, name: str, value: float) -> None:
        if name in self._apply:
            self._apply[name](value)
        else:  # of observations, action_delay, gripper_delay, of the spring
            self._values[name] = value

    def _set_joint_friction(self, fraction: float) -> None:
        self.motors.set_joint_friction(fraction)
        if self._guard is not None and self.mode != "impedance":  # springs move what friction holds
            self._guard.available = 1 - fraction

    def value(self, name: str) -> float:
        """Value of a parameter in the running episode."""
        return self._values[name]

    def reset(self, generator: Generator) -> None:
        home, noise = self.model.home, self.reset_noise
        self._generator = generator
        self._place(np.add(home, generator.uniform(-noise, noise, len(home))), 1.0, 1.0)

    def _place(self, positions: Array, opening: float, command: float) -> None:
        """Place the joints there at rest, within their limits, and the gripper at `opening` with this command."""
        positions = self._clipped(positions)
        self.motors.write(positions, opening)
        self.opening_command = command
        self._opens = False
        # until the first delayed action takes effect the arm rests and the gripper keeps its command
        rest = [0.0] * self.action.size
        if self._commanded:
            rest[-1] = 2 * command - 1
        self._delayed = deque(rest for _ in range(round(self._values["action_delay"])))
        self._told.clear()
        self._seen_off: Sequence[float] = ()
        if self._guard is not None:
            self._guard.reset()
        self._read()
        self._control.reset()
        self._path = 0.0

    def _clipped(self, positions: Array) -> Array:
        """Joint positions (n,) within their limits."""
        return np.clip(positions, self.limits.lower, self.limits.upper)

    def place_tool(
        self, position: Vector, opening: float, *, orientation: Quaternion | None = None, closing: bool = False
    ) -> None:
        joints = np.array(self.model.home)
        target = self._target(position, orientation)
        for _ in range(100):
            configuration = self.chain.forward(joints)
            tool = configuration.tool
            turned = 0.0 if orientation is None else dist(tool.x, target.x)  # a yaw that is home's is near anyway
            if max(dist(tool.position, position), dist(tool.z, target.z), turned) < PLACE_TOLERANCE:
                break
            joints = self._clipped(joints + self.chain.step(configuration, target, self.posture(joints)))
        reached = self.chain.forward(joints).tool.position
        if np.linalg.norm(np.subtract(reached, position)) > 0.005:
            raise PluginError(
                f"the tool cannot reach {tuple(round(value, 3) for value in position)} m",
                where=type(self).__name__,
                hint=f"its workspace is {self.workspace.low} to {self.workspace.high}",
            )
        self._place(joints, opening, 0.0 if closing else opening)

    def _target(self, position: Vector, orientation: Quaternion | None) -> Pose:
        """A pose of the tool, by default pointing down as at home."""
        return downward(position, self.home_yaw) if orientation is None else Pose.at(position, orientation)

    @property
    def steps_down(self) -> float:
        return self.model.steps_down

    def posture(self, joints: Array) -> Array:
        """Changes of the joints (n,) in rad that inverse kinematics prefers: back towards the home pose."""
        return POSTURE_GAIN * (self._rest - joints)

    def act(self, action: Sequence[float]) -> None:
        values = [-1.0 if value < -1.0 else 1.0 if value > 1.0 else value for value in action]
        if self._delayed:
            self._delayed.append(values)
            values = self._delayed.popleft()
        closed = None if self._grip is None else 0.0
        opening = 0.5 + 0.5 * values[-1] if self._commanded else closed
        self.opening_command = opening or 0.0
        self._control.act(values, {} if opening is None else self._openings(opening))

    def _openings(self, opening: float) -> dict[int, float]:
        """The gripper's openings in this control step, by physics step, if this opening is commanded now."""
        opening, wait = self._timed(opening) if self.settings.timed_release else (opening, 0.0)
        substeps = self.world.substeps
        delay = round(self._values["gripper_delay"] * substeps / self.world.period)
        self._told.append((int(wait * substeps) + delay, opening))
        now = {step: value for step, value in self._told if step < substeps}
        self._told = [(step - substeps, value) for step, value in self._told if step >= substeps]
        return now

    def _timed(self, opening: float) -> tuple[float, float]:
        """The gripper's command in this control step, and the fraction of the step after which it is given.

        A release late in one step is nearly the same as one at the beginning of the next step. The effect on the object
        is therefore continuous in the actions. A release only at the beginning of steps would jump.
        """
        opened, self._opens = self._opens, opening > self.opening + OPENS
        if opened or not self._opens:
            return opening, 0.0
        return 1.0, (1 - opening) / (1 - self.opening)

    def read(self) -> None:
        before = self.tool_position
        self._read()
        self._path += dist(before, self.tool_position)
        if self._guard is not None:
            self._guard.watch(self._forces(), self.joint_torques)

    @property
    def joint_torques(self) -> Sequence[float]:
        return [torque for _, _, _, torque in self.body.joints(self._arm_links)]

    @property
    def tool(self) -> Pose:
        return self.configuration.tool

    @property
    def closing(self) -> Vector:
        tool = self.configuration.tool
        return (tool.x, tool.y)[self._pad_sides[0]]

    @property
    def stops(self) -> int:
        return self._guard.stops if self._guard is not None else 0

    @property
    def stopped(self) -> bool:
        return self._guard is not None and self._guard.stopped

    def _forces(self) -> dict[tuple[int, int], float]:
        """Forces on the arm after this control step, as `World.forces` returns them."""
        if self._pressing is None:
            self._pressing = self.world.forces(self.body)
        return self._pressing

    def largest_force(self, *allowed: Body) -> float:
        indices = {body.index for body in allowed}
        return max((force for (_, other), force in self._forces().items() if other not in indices), default=0.0)

    def touches_others(self, *allowed: Body) -> bool:
        return self.largest_force(*allowed) > 0

    def _read(self) -> None:
        self._pressing = None
        self.joint_positions, self.joint_velocities, self.opening = self.motors.read()
        motion = self.chain.motion(self.joint_positions, self.joint_velocities)
        self.configuration, self.tool_velocity, self.tool_spin = motion
        self.tool_position = self.configuration.tool.position

    def observe(self) -> list[float]:
        values = self._control.observe()
        if self._commanded:
            values.append(self.opening)
        values += self._control.observe_joints()
        values = self.with_noise(values)
        self.observed_tool_position = values[0], values[1], values[2]
        for name in self._observed:
            values += self._observe(name)
        return values

    def _observe(self, name: str) -> list[float]:
        """The observation that the setting `observe` adds under this name, with noise."""
        if name == "rotation":
            return self.with_noise([*self.tool.x, *self.tool.y])
        if name == "torques":
            return self.with_noise(self.joint_torques)
        deviation = self._values["wrench_noise"]
        if not deviation:
            return list(self.wrench)
        noise = self._generator.normal(0.0, [deviation] * 3 + [TORQUE_ARM * deviation] * 3).tolist()
        return [value + error for value, error in zip(self.wrench, noise, strict=True)]

    @property
    def seen_off(self) -> Sequence[float]:
        """Error of positions from cameras in this episode, in m: (3,)."""
        if not self._seen_off:  # sampled after the reset, which is the same with and without it
            most = self._values["calibration_error"]
            self._seen_off = self._generator.uniform(-most, most, 3).tolist() if most else (0.0, 0.0, 0.0)
        return self._seen_off

    def with_noise(self, values: Sequence[float]) -> list[float]:
        deviation = self._values["observation_noise"]
        if not deviation:
            return list(values)
        noise = self._generator.normal(0.0, deviation, len(values)).tolist()
        return [value + error for value, error in zip(values, noise, strict=True)]

    @property
    def wrench(self) -> Sequence[float]:
        return self.motors.wrench()

    def contact_force(self, body: Body) -> float:
        return sum(force for (_, other), force in self._forces().items() if other == body.index)

    def pads_touching(self, body: Body) -> int:
        if isinstance(self._grip, Cup):
            return 2 * self.motors.holds(body)
        return sum(bool(self.world.contacts(self.body, body, link)) for link in self.motors.pads)

    def pads_gripping(self, body: Body) -> int:
        if isinstance(self._grip, Cup):
            return 2 * self.motors.holds(body)
        axes = (self.configuration.tool.x, self.configuration.tool.y)
        axis, sides = self._pad_sides
        count = 0
        for link, side in zip(self.motors.pads, sides, strict=True):
            # the normal points from the body to the pad: outwards where the inner face touches
            normals = (contact.normal for contact in self.world.contacts(self.body, body, link))
            count += any(side * sum(map(mul, normal, axes[axis])) > INNER_FACE_COSINE for normal in normals)
        return count

    @cached_property
    def _pad_sides(self) -> tuple[int, tuple[float, ...]]:
        """Axis of the tool along which the pads face each other, 0 for x or 1 for y, and the side of each pad."""
        tool = self.configuration.tool
        offsets = [
            np.subtract(self.body.link(link).centre, tool.position) @ np.transpose([tool.x, tool.y])
            for link in self.motors.pads
        ]
        axis = int(np.abs(offsets[0] - offsets[1]).argmax())
        sides = np.sign(np.array(offsets)[:, axis] - np.mean(offsets, 0)[axis])
        return axis, tuple(sides.tolist())

    def towards(self, position: Vector, opening: float, orientation: Quaternion | None = None) -> FloatArray:
        target = self._target(position, orientation)
        way = self.chain.step(self.configuration, target, self.posture(self.joint_positions))
        # so fast that .8 of a joint's acceleration stops it at the end of its way
        needed = (sqrt(abs(ahead) / (1.6 * most)) for ahead, most in zip(way, self.accelerations, strict=True))
        # and less if actions act late: the policy would repeat a step of the whole way until it sees the effect
        slower = max(1.0 + len(self._delayed), max(needed) / self.period)
        return self._action(self._control.towards(Way(target, way, slower)), opening)

    def turning(self, changes: Sequence[float], opening: float) -> FloatArray:
        if not self.turns_joints:
            raise UsageError(
                "the control mode does not move joints directly",
                setting="robot.control",
                hint="set robot.control: joint",
            )
        shares = [change / step for change, step in zip(changes, self.joint_step, strict=True)]
        return self._action([*shares, *[0.0] * (self._control.action[0].size - len(shares))], opening)

    def _action(self, values: list[float], opening: float) -> FloatArray:
        if self._commanded:
            values.append(2 * opening - 1)
        return np.clip(np.array(values, np.float32), -1, 1)
