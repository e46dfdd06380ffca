"""Loads of an arm's motors: torques of gravity and inertia, and the accelerations that the motors can reach."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..core import Array
from ..simulation import urdf
from ..simulation.interface import GRAVITY
from .model import ACCELERATION_TIME

SHARE = 0.95
"""Fraction of a motor's largest torque for gravity and accelerations. The rest is for Coriolis forces."""
LEAST = 0.25
"""Fraction of the usual acceleration that each joint keeps, even with too little torque."""
ROUNDS, SMALLER = 200, 0.97
"""Number and factor of the reductions of accelerations that together need too much torque."""


@dataclass(frozen=True)
class _Weight:
    """A link, or a finger, by the joint that moves it, counted from the base. In the frame of that joint's link."""

    joint: int
    mass: float
    centre: Array
    tensor: Array


class MotorLoads:
    """Torques on the joints of an arm with its hand.

    Args:
        description: the simulated arm; its turning joints are those of the arm.
    """

    def __init__(self, description: urdf.Description) -> None:
        self.joints = [joint for joint in description.joints if joint.revolute]
        links = {link.get("name", ""): urdf.inertia_of(link) for link in description.robot.findall("link")}
        self._pieces = [_Weight(place, *links[joint.child]) for place, joint in enumerate(self.joints)]
        for slide in (joint for joint in description.joints if not joint.revolute):
            mass, centre, tensor = links[slide.child]
            turn = np.array(slide.rotation)
            place = np.array(slide.origin) + turn @ centre
            self._pieces.append(_Weight(len(self.joints) - 1, mass, place, turn @ tensor @ turn.T))

    def at(self, pose: Sequence[float]) -> tuple[Array, Array]:
        """Torques (n,) in N m that hold the arm at a pose (n,), and its inertia (n, n) in kg m2."""
        place, turn = np.zeros(3), np.eye(3)
        frames, axes = list[tuple[Array, Array]](), list[Array]()
        for joint, position in zip(self.joints, pose, strict=True):
            place, turn = place + turn @ joint.origin, turn @ joint.rotation
            axes.append(turn @ joint.axis)
            turn = turn @ urdf.about(joint.axis, position)
            frames.append((place, turn))
        size = len(self.joints)
        held, inertia = np.zeros(size), np.zeros((size, size))
        for piece in self._pieces:
            origin, rotation = frames[piece.joint]
            centre, tensor = origin + rotation @ piece.centre, rotation @ piece.tensor @ rotation.T
            moves, turns = np.zeros((3, size)), np.zeros((3, size))
            for one in range(piece.joint + 1):
                moves[:, one], turns[:, one] = np.cross(axes[one], centre - frames[one][0]), axes[one]
            held -= GRAVITY * piece.mass * moves[2]
            inertia += piece.mass * moves.T @ moves + turns.T @ tensor @ turns
        return held, inertia

    def shares(self, poses: Iterable[Sequence[float]]) -> Array:
        """The largest fraction (n,) of each motor's torque that gravity needs at these poses."""
        efforts = np.array([joint.effort for joint in self.joints])
        most: Array = np.max([np.abs(self.at(pose)[0]) / efforts for pose in poses], axis=0)
        return most

    def accelerations(self, poses: Iterable[Sequence[float]]) -> tuple[float, ...] | None:
        """Accelerations (n,) in rad/s2 that the motors can give to all joints at once; None: the usual ones.

        If a motor lacks torque, the other joints drive its joint beyond its speed.
        """
        usual = np.array([joint.velocity for joint in self.joints]) / ACCELERATION_TIME
        efforts, found = SHARE * np.array([joint.effort for joint in self.joints]), usual.copy()
        loads = [(np.abs(held), np.abs(inertia)) for held, inertia in map(self.at, poses)]
        for _ in range(ROUNDS):
            needed = [(held + inertia @ found - efforts, inertia) for held, inertia in loads]
            lacking, joint, inertia = max(
                ((float(one.max()), int(one.argmax()), of) for one, of in needed), key=lambda one: one[0]
            )
            if lacking <= 0:
                break
            parts = inertia[joint] * found
            found = np.maximum(found * (1 - (1 - SMALLER) * parts / parts.max()), LEAST * usual)
        return None if np.array_equal(found, usual) else tuple(float(f"{one:.3g}") for one in found)
