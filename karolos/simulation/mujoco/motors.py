"""The motors of an arm and its gripper in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..interface.engine import FINGER_RATE, PHYSICS_RATE, Fingers, JointLimits, Loads
from .body import Body
from .simulation import Simulation

MOTOR_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""`solimp` of a motor: it reaches its target speed unless its torque does not allow it."""


class Motors:
    """Implements `interface.Motors`. A motor is a constraint on the speed of its joint, limited in torque.

    MuJoCo has this constraint as dry friction, with the target speed 0: the kernel writes the acceleration that the
    constraint asks for. An actuator with a large gain would chatter at its largest force, and is solved apart from the
    contacts.

    Attributes:
        targets: speed of each joint of the arm in rad/s, then position of each finger in m, per physics step (n, m).
        gains: 0 for joints of the arm; speed in 1/s by which a finger closes its distance.
        most: largest speed of a finger in m/s.
        rates: fraction of a difference from its speed that a motor removes per s.
        places: position and velocity of each joint in MuJoCo's data (m, 2).

    Args:
        joints: of the arm, from base to wrist, as the body counts them.
        pads: joints of the two fingers; empty without a gripper.
    """

    def __init__(
        self,
        simulation: Simulation,
        body: Body,
        limits: JointLimits,
        joints: Sequence[int],
        fingers: Fingers | None,
        pads: Sequence[int],
    ) -> None:
        self.pads = pads
        self._simulation = simulation
        self._body = body
        self._limits = limits
        self._size = len(joints)
        self._joints = [*joints, *pads]
        self._fingers = fingers
        self._fractions = np.arange(1, simulation.substeps + 1)[:, None] / simulation.substeps
        self._damping = self._friction = 0.0
        self._mass = 1.0
        size = len(self._joints)
        self.targets = np.zeros((simulation.substeps, size))
        self.rates = np.full(size, 1 / simulation.timestep)
        self.gains, self.most = np.zeros(size), np.full(size, np.inf)
        if fingers is not None:
            self.gains[-2:], self.most[-2:] = FINGER_RATE, fingers.gripper.speed
            self.set_pad_friction(fingers.gripper.pad_friction)

    def find(self, model: Any) -> None:
        """Look up the joints' places in a model that was just compiled."""
        self._positions = np.array([self._body.positions[joint + 1] for joint in self._joints])
        self._dofs = np.array([self._body.dofs[joint + 1] for joint in self._joints])
        self.places = np.stack([self._positions, self._dofs], 1)
        self._moving = [self._body.ids[joint + 1] for joint in self._joints]
        self._own_damping = model.dof_damping[self._dofs].copy()

    def write_parameters(self, model: Any) -> None:
        """Write masses, largest torques and damping into the model."""
        model.body_mass[self._moving] *= self._mass
        model.body_inertia[self._moving] *= self._mass
        force = [self._fingers.gripper.force] * 2 if self._fingers else []
        dofs = self._dofs
        model.dof_frictionloss[dofs] = [*((1 - self._friction) * effort for effort in self._limits.effort), *force]
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
        for link in self.pads:
            self._body.set_friction(friction, link)

    def write(self, positions: Sequence[float], opening: float) -> None:
        data = self._simulation.writable()
        self.targets[:] = 0.0
        if self._fingers is not None:
            self.targets[:, -2:] = goal = self._fingers.position(opening)
            positions = [*positions, goal, goal]
        data.qpos[self._positions] = positions
        data.qvel[self._dofs] = 0.0
        self._simulation.largest[:] = self._simulation.loads[:] = 0.0

    def drive(self, begin: Sequence[float], end: Sequence[float], openings: Mapping[int, float]) -> None:
        first, targets = np.array(begin), self.targets
        targets[:, : self._size] = first + self._fractions * (np.array(end) - first)
        if self._fingers is not None:
            targets[:, -2:] = targets[-1, -1]
            for step, opening in openings.items():
                targets[step:, -2:] = self._fingers.position(opening)

    def read(self) -> tuple[Sequence[float], Sequence[float], float]:
        data, size = self._simulation.ready(), self._size
        positions = data.qpos[self._positions].tolist()
        velocities = data.qvel[self._dofs].tolist()
        opening = 0.0
        if self._fingers is not None:
            opening = self._fingers.opening((positions[-2] + positions[-1]) / 2)
            positions, velocities = positions[:size], velocities[:size]
        return positions, velocities, opening

    def loads(self) -> Loads:
        return Loads(*self._simulation.loads[:, self._dofs[: self._size]].tolist())
