"""The motors of an arm and its gripper in MuJoCo."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ..interface.engine import FINGER_GAIN, TIMESTEP, Fingers, JointLimits
from .body import Body
from .simulation import Simulation

MOTOR_IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""`solimp` of a motor: it reaches its target speed unless its torque does not allow it."""


class Motors:
    """Implements `interface.Motors`. A motor is a constraint on the speed of its joint, limited in torque.

    MuJoCo has this constraint as dry friction, with the target speed 0: `substep` writes the acceleration that the
    constraint asks for. An actuator with a large gain would chatter at its largest force, and is solved apart from the
    contacts.

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
        self._speeds = np.zeros((simulation.substeps, len(self._joints)))
        """Target speed of each joint in each physics step."""
        self._goal = 0.0
        """Joint position in m that the fingers aim at."""
        self._goals: dict[int, float] = {}
        """What they aim at from a physics step of the control step on."""
        self._damping = self._friction = 0.0
        self._mass = 1.0
        self._rates = np.full(len(self._joints), 1 / TIMESTEP)
        """Fraction of a difference in speed that a motor removes per physics step, per s."""
        if fingers is not None:
            self.set_pad_friction(fingers.gripper.pad_friction)

    def find(self, model: Any) -> None:
        """Look up the joints' places in a model that was just compiled."""
        self._positions = np.array([self._body.positions[joint + 1] for joint in self._joints])
        self._dofs = np.array([self._body.dofs[joint + 1] for joint in self._joints])
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
        model.dof_armature[dofs] = TIMESTEP * damping

    def set_joint_friction(self, fraction: float) -> None:
        self._friction = fraction
        self._simulation.reparametrise()

    def set_joint_damping(self, damping: float) -> None:
        self._damping = damping
        self._simulation.reparametrise()

    def set_gain(self, factor: float) -> None:
        self._rates[: self._size] = factor / TIMESTEP

    def set_mass(self, factor: float) -> None:
        self._mass = factor
        self._simulation.reparametrise()

    def set_pad_friction(self, friction: float) -> None:
        for link in self.pads:
            self._body.set_friction(friction, link)

    def write(self, positions: Sequence[float], opening: float) -> None:
        data = self._simulation.writable()
        self._speeds[:] = 0.0
        if self._fingers is not None:
            self._goal, self._goals = self._fingers.position(opening), {}
            positions = [*positions, self._goal, self._goal]
        data.qpos[self._positions] = positions
        data.qvel[self._dofs] = 0.0

    def drive(self, begin: Sequence[float], end: Sequence[float], openings: Mapping[int, float]) -> None:
        first = np.array(begin)
        self._speeds[:, : self._size] = first + self._fractions * (np.array(end) - first)
        if self._fingers is not None:
            self._goals = {step: self._fingers.position(opening) for step, opening in openings.items()}

    def substep(self, step: int, data: Any, rows: Any) -> None:
        """Set the target speeds of physics step number `step` of the control step: those at its end.

        Args:
            step: 0 to `substeps` - 1.
            data: MuJoCo's, between `mj_step1` and `mj_step2`.
            rows: row of each degree of freedom's motor among the constraints.
        """
        speeds = self._speeds[step]
        if self._fingers is not None:
            self._goal = self._goals.get(step, self._goal)
            most, gain = self._fingers.gripper.speed, FINGER_GAIN / TIMESTEP
            for place in (-2, -1):  # plain floats take half the time of numpy arrays here
                wanted = gain * (self._goal - float(data.qpos[self._positions[place]]))
                speeds[place] = min(max(wanted, -most), most)
        dofs = self._dofs
        data.efc_aref[rows[dofs]] = self._rates * (speeds - data.qvel[dofs])

    def read(self) -> tuple[Sequence[float], Sequence[float], float]:
        data, size = self._simulation.ready(), self._size
        positions = data.qpos[self._positions].tolist()
        velocities = data.qvel[self._dofs].tolist()
        opening = 0.0
        if self._fingers is not None:
            opening = self._fingers.opening((positions[-2] + positions[-1]) / 2)
            positions, velocities = positions[:size], velocities[:size]
        return positions, velocities, opening
