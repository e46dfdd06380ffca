"""The motors of an arm and its gripper in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import exp
from typing import Any

import numpy as np

from ...core import Array
from ..geometry import Quaternion, Vector
from ..interface import FINGER_RATE, PHYSICS_RATE, Body, Cup, Fingers, Frame, JointLimits, Loads, Spring
from ..kinematics import Numbers
from .simulation import MujocoBody, Simulation

MOTOR_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""`solimp` of a motor: it reaches its target speed if its torque allows it."""
HEAVIEST_TOOL = 15.0
"""Largest effective mass in kg of a tool on a spring, in any direction at home; a UR10's value. Controllers of heavier
arms reduce the effective mass by the force measured at the wrist, because contacts would not be gentle otherwise."""
LEAST_FORCE = 1e-9
"""Friction in N or N m of a joint without friction."""


class MujocoMotors:
    """Implements `interface.Motors`. A motor is a constraint on the speed of its joint, limited in torque.

    MuJoCo has this constraint as dry friction, with the target speed 0. The kernel writes the acceleration that the
    constraint asks for. An actuator with a large gain would chatter at its largest force, and would be solved
    separately from the contacts.

    Attributes:
        targets: speed of each joint of the arm in rad/s, then position of each finger in m, per physics step (n, m).
        gains: 0 for joints of the arm; rate in 1/s at which a finger closes its distance.
        most: largest speed of a finger in m/s.
        rates: fraction of a difference from its speed that a motor removes per s.
        places: position and velocity of each joint in MuJoCo's data (m, 2).

    Args:
        joints: of the arm, from base to wrist, as the body counts them.
        pads: joints of the two fingers; empty without a gripper.
        tool: frame of the tool in the last link; None for an arm without.
        cup: at the tool, replaces fingers.
    """

    def __init__(
        self,
        simulation: Simulation,
        body: MujocoBody,
        limits: JointLimits,
        joints: Sequence[int],
        fingers: Fingers | None,
        pads: Sequence[int],
        *,
        tool: Frame | None,
        cup: Cup | None = None,
    ) -> None:
        self.pads = pads
        self._simulation = simulation
        self._body = body
        self.limits = limits
        self._tool, self._cup = tool, cup
        self._spring: Spring | None = None
        self._aim = np.zeros(13)
        self._share = 1.0
        if tool is not None:
            simulation.arms.append(self)
        self._size = len(joints)
        self._joints = [*joints, *pads]
        self._fingers = fingers
        self._damping = self._friction = 0.0
        self._mass = 1.0
        size = len(self._joints)
        self.targets = np.zeros((simulation.substeps, size))
        self.rates = np.full(size, 1 / simulation.timestep)
        self.gains, self.most = np.zeros(size), np.full(size, np.inf)
        if fingers is not None:
            self.gains[-2:], self.most[-2:] = FINGER_RATE, fingers.gripper.speed
            self.set_pad_friction(fingers.gripper.pad_friction)
        if cup is not None:
            self.set_pad_friction(cup.pad_friction)

    def find(self, model: Any) -> None:
        """Look up the joints' places in a model that was just compiled."""
        self._positions = np.array([self._body.positions[joint + 1] for joint in self._joints])
        self._dofs = np.array([self._body.dofs[joint + 1] for joint in self._joints])
        self.places = np.stack([self._positions, self._dofs], 1)
        self._moving = [self._body.ids[joint + 1] for joint in self._joints]
        self._own_damping = model.dof_damping[self._dofs].copy()
        if self._tool is not None:
            self._find_tool(model, self._tool)

    def _find_tool(self, model: Any, tool: Frame) -> None:
        """Fill in this arm's row of the kernel's table of tools."""
        size, dofs = self._size, self._dofs
        self._place = row = self._simulation.arms.index(self)
        self._row = own = self._simulation.tools[row]
        own["body"] = carrier = self._moving[size - 1]
        own["size"] = size
        (x, y, z), (i, j, k, w) = tool
        own["frame"] = x, y, z, w, i, j, k
        own["joints"][:size] = [model.body_jntadr[body] for body in self._moving[:size]]
        own["dofs"][:size], own["positions"][:size] = dofs[:size], self._positions[:size]
        for one, dof in enumerate(dofs[:size]):
            first, count = model.M_rowadr[dof], model.M_rownnz[dof]
            places = {int(column): place for place, column in enumerate(model.M_colind[first : first + count], first)}
            own["entries"][one, : one + 1] = [places[int(other)] for other in dofs[: one + 1]]
        hand = {carrier}
        for body in range(carrier + 1, model.nbody):
            hand |= {body} if int(model.body_parentid[body]) in hand else set()
        self._simulation.hands[np.isin(model.geom_bodyid, [*hand])] = row
        own["speeds"][:size] = self.limits.velocity
        own["efforts"][:size], own["aim"], own["share"] = self.limits.effort, self._aim, self._share
        own["held"] = -1
        if self._cup is not None:
            lip = [
                geom
                for geom in self._body.geoms[self._joints[size - 1] + 1]
                if np.linalg.norm(model.geom_pos[geom] - tool[0]) < self._cup.radius
            ]
            self._simulation.lips[lip] = range(len(lip))
            own["cup"], own["lip"] = self._cup.max_force, (1 << len(lip)) - 1
        if self._spring is not None:
            own["home"][:size] = self._spring.home
            root = self._simulation.root_of_mass(row, self._spring.home)
            own["felt"] = felt = min(1.0, HEAVIEST_TOOL / float(np.linalg.eigvalsh((root @ root)[:3, :3])[-1]))
            self._root = np.sqrt(felt) * root
            self._write_spring(self._spring)
            self._simulation.sprung.update({int(dof): (row, joint) for joint, dof in enumerate(dofs[:size])})

    def write_parameters(self, model: Any) -> None:
        """Write masses, largest torques and damping into the model."""
        model.body_mass[self._moving] *= self._mass
        model.body_inertia[self._moving] *= self._mass
        force = [self._fingers.gripper.force] * 2 if self._fingers else []
        dofs = self._dofs
        share = 1 - self._friction if self._spring is None else self._friction  # a spring moves against the friction
        model.dof_frictionloss[dofs] = [*(share * effort for effort in self.limits.effort), *force]
        model.dof_solimp[dofs] = MOTOR_IMPEDANCE
        damping = self._own_damping.copy()
        damping[: self._size] += self._damping
        model.dof_damping[dofs] = damping
        # implicit damping: (M + h D) a = f - D v, in the same metric as the constraints
        model.dof_armature[dofs] = self._simulation.timestep * damping

    def set_joint_friction(self, fraction: float) -> None:
        self._friction = fraction
        self._simulation.reparametrise()

    def set_joint_damping(self, damping: float) -> None:
        self._damping = damping
        self._simulation.reparametrise()

    def set_gain(self, factor: float) -> None:
        timestep = self._simulation.timestep
        self.rates[: self._size] = (1 - (1 - factor) ** (PHYSICS_RATE * timestep)) / timestep

    def set_mass(self, factor: float) -> None:
        self._mass = factor
        self._simulation.reparametrise()

    def set_pad_friction(self, friction: float) -> None:
        for link in self.pads if self._cup is None else [self._joints[-1]]:
            self._body.set_friction(friction, link)

    def attach(self, spring: Spring) -> None:
        if self._spring is None:
            self._simulation.restructure()
        else:
            self._simulation.ready()
            self._write_spring(spring)
        self._spring = spring

    def _write_spring(self, spring: Spring) -> None:
        """D = z (M^(1/2) K^(1/2) + K^(1/2) M^(1/2)): Albu-Schaeffer et al. 2003, Cartesian Impedance Control.

        For a light hand, D is raised until the largest torque turns it no faster than the slowest joint.
        """
        self._row["spring"] = spring.stiffness, spring.turn_stiffness, spring.error, spring.turn_error
        half = self._root * np.sqrt([spring.stiffness] * 3 + [spring.turn_stiffness] * 3)
        damping = spring.damping_ratio * (half + half.T)
        least = spring.turn_stiffness * spring.turn_error / min(self.limits.velocity)
        damping[range(3, 6), range(3, 6)] = np.maximum(np.diagonal(damping)[3:], least)
        self._row["damping"] = damping

    def aim(self, position: Vector, orientation: Quaternion, velocity: Vector, spin: Vector) -> None:
        x, y, z, w = orientation
        self._aim[:] = (*position, w, x, y, z, *velocity, *spin)
        self._simulation.ready()
        self._row["aim"] = self._aim

    def set_wrench_filter(self, seconds: float) -> None:
        self._share = 1 - exp(-self._simulation.timestep / seconds) if seconds else 1.0
        self._simulation.restructure()

    def wrench(self) -> Sequence[float]:
        self._simulation.ready()
        felt: list[float] = self._row["wrench"].tolist()
        return felt

    def write(self, positions: Numbers, opening: float) -> None:
        data = self._simulation.writable()
        if self._tool is not None:
            self._row["wrench"] = self._row["peak"] = 0.0
            self._row["held"], data.xfrc_applied[:] = -1, 0.0
            self._simulation.suction[self._place] = self._cup is not None and opening < 0.5
        self.targets[:] = 0.0
        if self._fingers is not None:
            self.targets[:, -2:] = goal = self._fingers.position(opening)
            positions = [*positions, goal, goal]
        data.qpos[self._positions] = positions
        data.qvel[self._dofs] = 0.0
        self._simulation.largest[:] = self._simulation.loads[:] = 0.0

    def drive(self, ramp: Array, openings: Mapping[int, float]) -> None:
        targets = self.targets
        self._simulation.kernel.spread(ramp, targets)
        if self._fingers is not None:
            if 0 not in openings:
                targets[:, -2:] = targets[-1, -1]
            for step, opening in openings.items():
                targets[step:, -2:] = self._fingers.position(opening)
        elif self._cup is not None:
            self._simulation.ready()
            suction = self._simulation.suction[self._place]
            suction[:] = suction[-1]
            for step, opening in openings.items():
                suction[step:] = opening < 0.5

    def read(self) -> tuple[Array, Array, float]:
        data, size = self._simulation.ready(), self._size
        positions, velocities = data.qpos.take(self._positions), data.qvel.take(self._dofs)  # faster than indexing
        opening = 0.0
        if self._fingers is not None:
            opening = self._fingers.opening(float(positions[-2] + positions[-1]) / 2)
            positions, velocities = positions[:size], velocities[:size]
        elif self._cup is not None:
            sucks = self._simulation.suction[self._place, -1]
            opening = 1.0 if not sucks else 0.5 if self.holds() else 0.0
        return positions, velocities, opening

    def holds(self, body: Body | None = None) -> bool:
        self._simulation.ready()
        if self._cup is None or self._row["held"] < 0:
            return False
        bodies = (one for one in self._simulation.parts if isinstance(one, MujocoBody))
        return body is None or any(one.index == body.index and self._row["held"] in one.ids for one in bodies)

    def loads(self) -> Loads:
        wrench = 0.0 if self._tool is None else float(self._row["peak"])
        speed, acceleration, torque = self._simulation.loads[:, self._dofs[: self._size]].tolist()
        return Loads(speed, acceleration, torque, wrench)


class Passive:
    """The joints of a mechanism. Each has dry friction, which is a motor with the target speed 0; see `Motors`.

    Args:
        frictions: in N or N m, by the joint as the body counts it.
    """

    def __init__(self, simulation: Simulation, body: MujocoBody, frictions: Mapping[int, float]) -> None:
        self._simulation, self._body = simulation, body
        self._order = {joint: place for place, joint in enumerate(frictions)}
        self._forces = list(frictions.values())
        size = len(frictions)
        self._dampings = np.full(size, np.nan)  # as the file says
        self.targets = np.zeros((simulation.substeps, size))
        self.gains, self.most = np.zeros(size), np.full(size, np.inf)
        self.rates = np.full(size, 1 / simulation.timestep)

    def find(self, model: Any) -> None:
        """Look up the joints' places in a model that was just compiled."""
        self._dofs = np.array([self._body.dofs[joint + 1] for joint in self._order])
        self.places = np.stack([[self._body.positions[joint + 1] for joint in self._order], self._dofs], 1)
        self._own_damping = model.dof_damping[self._dofs].copy()

    def write_parameters(self, model: Any) -> None:
        """Write friction and damping into the model; the kernel needs a constraint for each joint."""
        dofs = self._dofs
        model.dof_frictionloss[dofs] = np.maximum(self._forces, LEAST_FORCE)
        model.dof_solimp[dofs] = MOTOR_IMPEDANCE
        damping = np.where(np.isnan(self._dampings), self._own_damping, self._dampings)
        model.dof_damping[dofs] = damping
        model.dof_armature[dofs] = self._simulation.timestep * damping  # implicit, as in `Motors`

    def drive(self, joint: int, speed: float, force: float) -> None:
        """Drive a joint at a speed (per s) with at most this force (N or N m)."""
        self.targets[:, self._order[joint]] = speed
        self._forces[self._order[joint]] = force
        self._simulation.reparametrise()

    def set_damping(self, joint: int, damping: float) -> None:
        """Set the viscous friction of a joint in N s/m or N m s/rad."""
        self._dampings[self._order[joint]] = damping
        self._simulation.reparametrise()
