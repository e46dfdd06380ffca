"""The motors of an arm and its gripper: limited in torque and speed, aimed at positions, read in one call."""

from __future__ import annotations

from collections.abc import Sequence

from ..simulation.body import Body
from ..simulation.interface import JointLimits
from ..simulation.world import World
from .model import Fingers

DAMPING = 0.5
"""Share of its speed that a motor gives up per substep. At 1 a motor has no inertia: an arm would change its speed at
500 rad/s2, which no arm does, which overruns joints and shakes a cube out of any friction grip."""
GAIN = DAMPING**2 / 4
"""Share of the way to its target that a motor asks for per substep; critically damped: 71 % of a small step is done in
ten substeps."""
FINGER_GAIN = 0.1
BELOW_CAP = 0.97
"""Share of the body's cap on joint speed that motors ask for. The cap is applied after contacts are solved, and where
it binds a gripped object slips: creep of a cube in a 1 s shake 8 mm at 1, .4 mm at .97 (Panda)."""
HOLD = 0.01
"""How far, in rad, a motor's target may stay from where the joint is: aimed anew at where gravity has pulled it, an arm
would sink; without a bound, an arm that is held back would store up its way."""
PAD_SPIN = 0.002
"""Spinning friction of the pads in m: a point contact stands for a pad, which resists turning about its normal."""


class Drives:
    """Positions in rad and m, torques in N m, forces in N.

    Args:
        links: of the arm's joints, from base to wrist, as the body counts them.
    """

    def __init__(self, world: World, body: Body, links: Sequence[int], limits: JointLimits) -> None:
        self._body = body
        self._substeps = world.substeps
        self._limits = limits
        self._size = len(links)
        self._joints = list(links)
        self._bounds = tuple(zip(limits.lower, limits.upper, strict=True))
        self._targets: list[float] = []
        self._fingers: Fingers | None = None
        self.pads: list[int] = []
        # A motor that is short of torque can be overrun (a wrist when the shoulder turns round), so the body is capped
        # as well. PyBullet has one cap for all joints, so the slowest one's limit binds them all.
        cap = min(limits.velocity)
        body.limit_joint_speed(cap)
        for link, speed in zip(links, limits.velocity, strict=True):
            body.prepare_motor(link, min(speed, BELOW_CAP * cap))
        for link in (-1, *self._joints):
            body.set_air_drag(0.0, link)
        self._masses = [(link, *body.inertia(link)) for link in self._joints]
        self._forces: list[float] = []
        self._gains: list[float] = []
        self._dampings: list[float] = []
        self.set_friction(0.0)
        self.set_gain(1.0)

    def add_fingers(self, fingers: Fingers, links: Sequence[int]) -> None:
        """Drive the gripper too."""
        self._fingers = fingers
        self.pads = list(links)
        self._joints += links
        for link in links:
            self._body.prepare_motor(link, fingers.facts.speed)
            self._body.set_air_drag(0.0, link)
            self._body.set_spinning_friction(PAD_SPIN, link)
            self._body.stick(link)
        self._body.couple(*links)
        self._masses += [(link, *self._body.inertia(link)) for link in links]
        self.set_pad_friction(fingers.facts.pad_friction)
        self.set_friction(0.0)
        self.set_gain(1.0)

    def set_friction(self, torque: float) -> None:
        """Dry friction of the arm's joints, as torque that the motors lack; at most half of what they have."""
        forces = [effort - min(torque, effort / 2) for effort in self._limits.effort]
        if self._fingers is not None:
            forces += [self._fingers.facts.force] * 2
        self._forces = [force / self._substeps for force in forces]  # see Body.drive

    def set_gain(self, factor: float) -> None:
        self._gains = [GAIN * factor] * self._size + [FINGER_GAIN] * len(self.pads)
        self._dampings = [DAMPING * factor**0.5] * self._size + [1.0] * len(self.pads)  # critical whatever the factor

    def set_pad_friction(self, friction: float) -> None:
        for link in self.pads:
            self._body.set_friction(friction, link)

    def set_damping(self, damping: float) -> None:
        for link in self._joints[: self._size]:
            self._body.set_joint_damping(damping, link)

    def set_mass(self, factor: float) -> None:
        for link, mass, (x, y, z) in self._masses:
            self._body.set_inertia(mass * factor, (x * factor, y * factor, z * factor), link)

    def write(self, positions: list[float], opening: float) -> None:
        """Put joints and fingers there at rest, and aim the motors at just that."""
        self._targets = positions
        if self._fingers is not None:
            finger = self._fingers.position(opening)
            positions = [*positions, finger, finger]
        self._body.write_joints(self._joints, positions)
        self._body.drive(self._joints, positions, self._forces, self._gains, self._dampings)

    def turn(self, positions: Sequence[float], change: Sequence[float], opening: float | None) -> None:
        """Aim the arm's motors at `positions` plus `change`, within the limits, and the fingers at `opening`."""
        targets = []
        for value, turn, old, (low, high) in zip(positions, change, self._targets, self._bounds, strict=True):
            held = value - HOLD if old < value - HOLD else value + HOLD if old > value + HOLD else old
            target = held + turn
            targets.append(low if target < low else high if target > high else target)
        self._targets = targets[:]
        if self._fingers is not None and opening is not None:
            finger = self._fingers.position(opening)
            targets += (finger, finger)
        self._body.drive(self._joints, targets, self._forces, self._gains, self._dampings)

    def read(self) -> tuple[list[float], list[float], float]:
        """Positions and velocities of the arm's joints, and the opening of the gripper (0 without one)."""
        states = self._body.joints(self._joints)
        positions = [state[0] for state in states]
        velocities = [state[1] for state in states]
        if self._fingers is None:
            return positions, velocities, 0.0
        opening = self._fingers.opening((positions[-1] + positions[-2]) / 2)
        return positions[: self._size], velocities[: self._size], opening
