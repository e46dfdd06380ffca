"""The motors of an arm and its gripper: limited in torque and speed, aimed at positions, read in one call."""

from __future__ import annotations

from collections.abc import Sequence
from operator import gt

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
"""Share of a joint's largest speed that its motor asks for. Speeds are capped after contacts are solved, and where a
cap binds a gripped object slips: creep of a cube in a 1 s shake 8 mm at 1, .4 mm at .97 (Panda)."""
SPEED_UP = 1 / 24
"""Seconds in which a motor's speed changes by its largest speed, at least: 52 rad/s2 for a Panda's shoulder (its data
sheet: 7.5 to 20). Without a bound a cube creeps .9 mm in a 1 s shake instead of .3; at 1/12 experts overshoot."""
BRAKE = 1 / 12
"""Seconds before the end of a joint, at its speed, from which on a motor slows down: a hard stop flings others."""
HOLD = 0.01
"""How far, in rad, a motor's target may stay from where the joint is: aimed anew at where gravity has pulled it, an arm
would sink; without a bound, an arm that is held back would store up its way."""


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
        self._period = period = world.period
        self._bounds = tuple(
            (low, high, speed * period / SPEED_UP, 1 / (speed * period**2))
            for low, high, speed in zip(limits.lower, limits.upper, limits.velocity, strict=True)
        )
        self._targets: list[float] = []
        self._fingers: Fingers | None = None
        self.pads: list[int] = []
        # A motor that is short of torque can be overrun, when the arm hits the floor, itself or the end of a joint.
        # PyBullet caps all joints of a body at one speed, the fastest one's; `read` brakes the others.
        body.limit_joint_speed(max(limits.velocity))
        for link, speed in zip(links, limits.velocity, strict=True):
            body.prepare_motor(link, BELOW_CAP * speed)
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
        self._joints.append(links[0])  # one motor with the force of both: the gear moves the other finger
        for link in links:
            self._body.prepare_motor(link, fingers.facts.speed)
            self._body.set_air_drag(0.0, link)
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
            forces.append(2 * self._fingers.facts.force)
        self._forces = [force / self._substeps for force in forces]  # see Body.drive

    def set_gain(self, factor: float) -> None:
        grippers = len(self._joints) - self._size
        self._gains = [GAIN * factor] * self._size + [FINGER_GAIN] * grippers
        self._dampings = [DAMPING * factor**0.5] * self._size + [1.0] * grippers  # critical whatever the factor

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
            positions = [*positions, finger]
            self._body.write_joints(self.pads[1:], [finger])
        self._body.write_joints(self._joints, positions)
        self._body.drive(self._joints, positions, self._forces, self._gains, self._dampings)

    def turn(
        self, positions: Sequence[float], velocities: Sequence[float], change: Sequence[float], opening: float | None
    ) -> None:
        """Aim the arm's motors at `positions` plus `change`, within the limits, and the fingers at `opening`.

        Motors pass their targets at speeds that grow with the square of the change: an arm that goes far does not slow
        down at every control step, one that is nearly there stops. All by the same share, so that the tool goes on in
        the direction it was told: each by its own, it leaves the way by 2 cm a step. From its speed now a motor gets
        there evenly, by no more than `SPEED_UP` allows, and it slows down before the end of the joint.
        """
        targets, speeds = [], []
        pace = min(
            1 / self._period, max(abs(turn) * bounds[3] for turn, bounds in zip(change, self._bounds, strict=False))
        )
        for value, speed, turn, old, (low, high, gain, _) in zip(
            positions, velocities, change, self._targets, self._bounds, strict=True
        ):
            held = value - HOLD if old < value - HOLD else value + HOLD if old > value + HOLD else old
            wish = pace * turn
            most, least = speed + gain, speed - gain
            if value + BRAKE * most > high:
                most = (high - value) / BRAKE
            if value + BRAKE * least < low:
                least = (low - value) / BRAKE
            if least <= wish <= most:
                target = held + turn
            else:
                wish = most if wish > most else least
                target = held + (speed + wish) / 2 * self._period
            targets.append(low if target < low else high if target > high else target)
            speeds.append(wish)
        self._targets = targets[:]
        if self._fingers is not None and opening is not None:
            targets.append(self._fingers.position(opening))
            speeds.append(0.0)
        self._body.drive(self._joints, targets, self._forces, self._gains, self._dampings, speeds)

    def read(self) -> tuple[tuple[float, ...], tuple[float, ...], float]:
        """Positions and velocities of the arm's joints, and the opening of the gripper (0 without one).

        A joint that was driven beyond its largest speed is braked to it.
        """
        positions, velocities, _, _ = zip(*self._body.joints(self._joints), strict=True)
        opening = 0.0
        if self._fingers is not None:
            opening = self._fingers.opening(positions[-1])
            positions, velocities = positions[:-1], velocities[:-1]
        if any(map(gt, map(abs, velocities), self._limits.velocity)):
            velocities = tuple(
                min(max(speed, -most), most) for speed, most in zip(velocities, self._limits.velocity, strict=True)
            )
            self._body.write_joints(self._joints[: self._size], positions, velocities)
        return positions, velocities, opening
