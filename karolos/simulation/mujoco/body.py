"""One body of a MuJoCo world: its pose, its joints, its material."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from ..geometry import UPRIGHT, Quaternion, Vector
from ..interface import OBJECT_MATERIAL, LinkState, Material
from .simulation import Simulation

LINK_FRICTION = 0.5
"""Lateral friction coefficient of a link for which none was set."""


class MujocoBody:
    """Implements `interface.Body`.

    The base of a free body has a free joint. Every other base is a mocap body, which only `place` moves.

    Args:
        simulation: of the body's world.
        index: of the body in its world.
        names: of the model's bodies: the base, then the links.
        shapes: names of the geoms that collide, of the base and of each link.
        free: whether the base moves.
    """

    def __init__(
        self, simulation: Simulation, index: int, names: Sequence[str], shapes: Sequence[Sequence[str]], *, free: bool
    ) -> None:
        self.index = index
        self.shapes = shapes
        self.free = free
        self.frictions = [LINK_FRICTION] * len(names)
        self.materials = [OBJECT_MATERIAL if free else Material()] * len(names)
        self.inertias: dict[int, tuple[float, Vector]] = {}
        self.pairs: set[tuple[int, int]] = set()
        """Links that collide with each other."""
        self.passive_joints: dict[str, int] = {}
        """Joints of a mechanism by name; `passive` moves them."""
        self.passive: Any = None
        self._simulation = simulation
        self._names = names

    def find(self, model: Any) -> None:
        """Look up the body's places in a model that was just compiled."""
        self.ids = [model.body(name).id for name in self._names]
        self.geoms = [[model.geom(shape).id for shape in shapes] for shapes in self.shapes]
        """Numbers of `shapes` in the model."""
        self._mocap = int(model.body_mocapid[self.ids[0]])
        joints = [int(model.body_jntadr[body]) for body in self.ids]
        self.positions = [int(model.jnt_qposadr[joint]) if joint >= 0 else -1 for joint in joints]
        self.dofs = [int(model.jnt_dofadr[joint]) if joint >= 0 else -1 for joint in joints]

    def write_parameters(self, model: Any) -> None:
        """Write masses and inertias that were set into the model."""
        for link, (mass, diagonal) in self.inertias.items():
            model.body_mass[self.ids[link + 1]] = mass
            model.body_inertia[self.ids[link + 1]] = diagonal

    def links(self) -> dict[str, int]:
        return {name.partition("/")[2]: index for index, name in enumerate(self._names[1:])}

    def collide_only(self, pairs: Collection[tuple[int, int]]) -> None:
        self.pairs = set(pairs)
        self._simulation.restructure()

    def place(self, position: Vector, orientation: Quaternion = UPRIGHT) -> None:
        data = self._simulation.writable()
        x, y, z, w = orientation
        if self.free:
            first, dof = self.positions[0], self.dofs[0]
            data.qpos[first : first + 7] = (*position, w, x, y, z)
            data.qvel[dof : dof + 6] = 0.0
        else:
            data.mocap_pos[self._mocap] = position
            data.mocap_quat[self._mocap] = w, x, y, z

    def pose(self) -> tuple[Vector, Quaternion]:
        data = self._simulation.ready()
        if self.free:
            first = self.positions[0]
            px, py, pz, w, x, y, z = data.qpos[first : first + 7].tolist()
        else:
            px, py, pz = data.mocap_pos[self._mocap].tolist()
            w, x, y, z = data.mocap_quat[self._mocap].tolist()
        return (px, py, pz), (x, y, z, w)

    def velocity(self) -> tuple[Vector, Vector]:
        if not self.free:
            return (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
        _, (x, y, z, w) = self.pose()
        dof = self.dofs[0]
        vx, vy, vz, a, b, c = self._simulation.ready().qvel[dof : dof + 6].tolist()
        # a free joint's angular velocity is in the body's frame: v + 2 w (u x v) + 2 u x (u x v) with u = (x, y, z)
        i, j, k = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
        return (vx, vy, vz), (a + w * i + y * k - z * j, b + w * j + z * i - x * k, c + w * k + x * j - y * i)

    def set_velocity(self, velocity: Vector) -> None:
        data, dof = self._simulation.writable(), self.dofs[0]
        data.qvel[dof : dof + 6] = (*velocity, 0.0, 0.0, 0.0)

    def link(self, link: int) -> LinkState:
        data = self._simulation.ready()
        api, model, body = self._simulation.api, self._simulation.model, self.ids[link + 1]
        for compute in (api.mj_kinematics, api.mj_comPos, api.mj_comVel):
            compute(model, data)
        speeds = np.zeros(6)
        api.mj_objectVelocity(model, data, api.mjtObj.mjOBJ_BODY, body, speeds, 0)
        w, x, y, z = data.xquat[body].tolist()
        angular, linear = tuple(speeds[:3].tolist()), tuple(speeds[3:].tolist())
        return LinkState(
            tuple(data.xpos[body].tolist()), (x, y, z, w), linear, angular, tuple(data.xipos[body].tolist())
        )

    def joints(self, joints: Sequence[int]) -> tuple[tuple[float, float, None, float], ...]:
        data = self._simulation.ready()
        return tuple(
            (
                float(data.qpos[self.positions[joint + 1]]),
                float(data.qvel[self.dofs[joint + 1]]),
                None,
                self._simulation.motor_force(self.dofs[joint + 1]),
            )
            for joint in joints
        )

    def joint(self, name: str) -> tuple[float, float]:
        place, data = self.passive_joints[name] + 1, self._simulation.ready()
        return float(data.qpos[self.positions[place]]), float(data.qvel[self.dofs[place]])

    def place_joint(self, name: str, position: float) -> None:
        place, data = self.passive_joints[name] + 1, self._simulation.writable()
        data.qpos[self.positions[place]], data.qvel[self.dofs[place]] = position, 0.0

    def drive_joint(self, name: str, speed: float, force: float) -> None:
        self.passive.drive(self.passive_joints[name], speed, force)

    def set_joint_damping(self, name: str, damping: float) -> None:
        self.passive.set_damping(self.passive_joints[name], damping)

    def set_friction(self, lateral: float, link: int = -1) -> None:
        self.frictions[link + 1] = lateral
        self._simulation.reparametrise()

    def set_material(self, material: Material, link: int = -1) -> None:
        self.materials[link + 1] = material
        self._simulation.reparametrise()

    def set_inertia(self, mass: float, diagonal: Vector, link: int = -1) -> None:
        self.inertias[link] = mass, diagonal
        self._simulation.reparametrise()
