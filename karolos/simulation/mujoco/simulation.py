"""A MuJoCo model with its state and bodies. It is compiled after its structure has changed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Sequence
from importlib import import_module
from threading import Lock
from typing import Any

import numpy as np

from ...errors import MachineError, PluginError
from ..geometry import UPRIGHT, Quaternion, Vector, rotated
from ..interface import GRAVITY, OBJECT_MATERIAL, LinkState, Material

IMPEDANCE_RATIO = 100.0
"""Ratio of the stiffness of friction to that of the normal direction. With a larger one a held object creeps less."""
JOINT_IMPEDANCE = (0.99, 0.995, 0.001, 0.5, 2.0)
"""`solimp` of joint limits and the coupling of fingers."""
SMALLEST_MOBILITY = 1e-3
"""Inverse mass in 1/kg and inverse inertia in 1/(kg m2) of a tool in a direction in which its arm cannot move it."""
OLDEST_VERSION = 4_000_001
"""The oldest version that works, 4.0.1."""
_IMPORTING = Lock()


def _mujoco() -> Any:
    """The module, imported when a world is built, so that specs are checked without it.

    Raises MachineError for a version that is too old.
    """
    with _IMPORTING:
        if "mujoco" not in sys.modules:
            import mujoco  # noqa: PLC0415

            if mujoco.mj_version() < OLDEST_VERSION:
                raise MachineError(
                    f"MuJoCo {mujoco.mj_versionString()} is too old",
                    hint="pip uninstall mujoco mujoco-core, then pip install mujoco-core",
                )
            log = mujoco.MjLogConfig.get()  # warnings would be written into a file in the current folder
            log.logto_console = log.logto_file = False
            mujoco.MjLogConfig.set(log)
        return sys.modules["mujoco"]


class Simulation:
    """A model that is compiled at its first use after a change of structure. MuJoCo compiles before it simulates.

    The state survives. Parameters are written into the model at the first use after a change.

    Constraints and integrator see the same inertia: joint damping is made implicit by `Motors`, and MuJoCo's own
    implicit damping is off. With `implicitfast`, pads would slip.

    Args:
        substeps: physics steps per control step.
        timestep: seconds of a physics step.
        declare: adds parts that depend on all bodies to the spec, before it is compiled.
        write: writes the parameters of these parts into the model.

    Attributes:
        parts: bodies and motors. After a compilation each finds its places in the model. Then it writes its parameters,
            starting from the masses and inertias of the structure.
    """

    def __init__(
        self, substeps: int, timestep: float, declare: Callable[[], None], write: Callable[[Any], None]
    ) -> None:
        self.api = api = _mujoco()
        self.substeps, self.timestep = substeps, timestep
        self.stiff = 2 * timestep, 1.0
        """`solref` of the stiffest constraints that the time step allows."""
        self.parts: list[Any] = []
        self.links: dict[int, tuple[int, int]] = {}
        """Index of the body and number of its link, -1 for the base, of each of MuJoCo's bodies."""
        self.arms: list[Any] = []
        """Motors of arms with a tool, in the order of the rows of `tools`."""
        self.sprung: dict[int, tuple[int, int]] = {}
        """Row in `tools` and number of the joint of each degree of freedom that a spring moves."""
        self.model: Any = None
        self.spec = api.MjSpec()
        self.spec.compiler.degree = False
        option = self.spec.option
        option.timestep = timestep
        option.integrator = api.mjtIntegrator.mjINT_EULER
        option.cone = api.mjtCone.mjCONE_ELLIPTIC
        option.impratio = IMPEDANCE_RATIO
        option.gravity = (0.0, 0.0, GRAVITY)
        # a state that diverged must be seen, so it is not reset
        option.disableflags = api.mjtDisableBit.mjDSBL_AUTORESET | api.mjtDisableBit.mjDSBL_EULERDAMP
        option.enableflags = api.mjtEnableBit.mjENBL_DIAGEXACT
        self._declare, self._write = declare, write
        self.kernel = import_module(".kernel", __package__)  # heavy, so it is imported when a world is built
        self._data: Any = None
        self._scratch: Any = None
        self._structure_changed = self._parameters_changed = True
        self._arguments: tuple[Any, ...] | None = None
        self.stepped = False
        """Whether forces and contacts are valid: no state was written since they were computed."""
        self.material: Any = None
        """Compliance (m/N), damping (N s/m) and restitution of each geom: (ngeom, 3)."""
        self.peaks: Any = None
        """Largest normal force between each two bodies in the last control step: (nbody, nbody)."""
        self.largest: Any = None
        """The same since joints of an arm were last written."""
        self.loads: Any = None
        """Largest speed, acceleration and torque of each motor since then, by degree of freedom: (3, nv)."""

    def restructure(self) -> None:
        """Compile the model before its next use."""
        self._structure_changed = True

    def reparametrise(self) -> None:
        """Write all parameters into the model before its next use."""
        self._parameters_changed = True

    def ready(self) -> Any:
        """MuJoCo's data, of a model that has the present structure and parameters."""
        if self._structure_changed:
            self._compile()
        if self._parameters_changed:
            self._write_parameters()
        return self._data

    def writable(self) -> Any:
        """MuJoCo's data before a state is written.

        Contacts and the solver's warm start are reset, so that an episode repeats bit for bit in a used world.
        """
        data = self.ready()
        data.qacc_warmstart[:] = 0.0
        self.stepped = False
        return data

    def advance(self, motors: Sequence[Any]) -> None:
        """Simulate one control step."""
        self.ready()
        if self._arguments is None or len(motors) != 1:  # the copies that several motors need are not kept
            self._arguments = self._gather(motors)
        self._advance(*self._arguments)
        self.stepped = True

    def _gather(self, motors: Sequence[Any]) -> tuple[Any, ...]:
        """The arguments of `kernel.advance`."""
        data, names = self._data, self.kernel.Driven._fields[1:]
        if len(motors) == 1:
            driven = [getattr(motors[0], name) for name in names]
        else:
            empty = np.zeros((self.substeps, 0)), *[np.zeros(0)] * 3, np.zeros((0, 2), np.int64)
            driven = [
                np.concatenate([none, *(getattr(part, name) for part in motors)], axis=1 if name == "targets" else 0)
                for none, name in zip(empty, names, strict=True)
            ]
        return (
            self.model._address,
            data._address,
            self._layout,
            self.timestep,
            data.qpos,
            data.qvel,
            self.kernel.Driven(self.rows[driven[-1][:, 1]], *driven),
            self._touching,
            self.loads,
            self._carried,
            self._springs,
            self.suction if self._cups else None,
        )

    def motor_force(self, dof: int) -> float:
        """Torque or force (N m or N) of the motor of a degree of freedom in the last physics step."""
        if self.stepped and dof in self.sprung:
            return float(self.tools["torques"][self.sprung[dof]])
        row = int(self.rows[dof])
        return float(self._data.efc_force[self._data.ne + row]) if self.stepped and row >= 0 else 0.0

    def root_of_mass(self, row: int, home: Sequence[float]) -> Any:
        """The square root (6, 6) of the mass of the tool of this row at home, in kg, kg m2 and mixed."""
        api, model, data, tool, size = self.api, self.model, self._scratch, self.tools[row], len(home)
        dofs, carrier = tool["dofs"][:size], tool["body"]
        data.qpos[tool["positions"][:size]] = home
        api.mj_fwdPosition(model, data)
        point = data.xpos[carrier] + data.xmat[carrier].reshape(3, 3) @ tool["frame"][:3]
        jacobian = np.zeros((6, model.nv))
        api.mj_jac(model, data, jacobian[:3], jacobian[3:], point, carrier)
        inertia = np.tril(data.M[tool["entries"][:size, :size]])
        inertia += np.tril(inertia, -1).T
        values, axes = np.linalg.eigh(jacobian[:, dofs] @ np.linalg.solve(inertia, jacobian[:, dofs].T))
        return (axes / np.sqrt(np.maximum(values, SMALLEST_MOBILITY))) @ axes.T

    def _compile(self) -> None:
        self._declare()
        try:
            if self._data is None:
                self.model = self.spec.compile()
                self._data = self.api.MjData(self.model)
            else:
                self.model, self._data = self.spec.recompile(self.model, self._data)
        except ValueError as error:
            raise PluginError(f"mujoco cannot compile the model: {' '.join(str(error).split())}") from error
        if self.model.ntree == 1:  # its constraints are always one island, so the solver need not look for others
            self.model.opt.disableflags |= self.api.mjtDisableBit.mjDSBL_ISLAND
        self._scratch = self.api.MjData(self.model)
        self._layout = self.kernel.layout(self._data)
        self.tools = np.zeros(len(self.arms), self.kernel.TOOL)
        self.hands, self.lips = np.full((2, self.model.ngeom), -1)
        self.suction = np.zeros((len(self.arms), self.substeps), np.bool_)
        self.material = np.zeros((self.model.ngeom, 3))
        self.peaks, self.largest = np.zeros((2, self.model.nbody, self.model.nbody))
        self.loads = np.zeros((3, self.model.nv))
        self._masses, self._inertias = self.model.body_mass.copy(), self.model.body_inertia.copy()
        self.links.clear()
        for part in self.parts:
            part.find(self.model)
        self._springs = np.array(sorted({row for row, _ in self.sprung.values()})) if self.sprung else None
        self._cups = bool(self.tools["cup"].any())
        self._touching = self.kernel.Touching(self.material, self.model.geom_bodyid, self.peaks, self.largest)
        self._carried = self.kernel.Hands(self.tools, self.hands, self.lips)
        self._advance = self.kernel.advance.unchecked()  # with or without springs and cups
        self._structure_changed = self.stepped = False
        self._parameters_changed = True

    def _write_parameters(self) -> None:
        model = self.model
        model.body_mass[:], model.body_inertia[:] = self._masses, self._inertias
        model.jnt_solref[:], model.jnt_solimp[:] = self.stiff, JOINT_IMPEDANCE
        for part in self.parts:
            part.write_parameters(model)
        self._write(model)
        driven = model.dof_frictionloss > 0
        self.rows = np.where(driven, np.cumsum(driven) - 1, -1)
        """Row of each degree of freedom's motor among the constraints, after those of equality; -1 without a motor."""
        self.api.mj_setConst(model, self._scratch)  # it uses the data that it gets as workspace
        self._arguments, self._parameters_changed = None, False


LINK_FRICTION = 0.5
"""Lateral friction coefficient of a link for which none was set."""


class MujocoBody:
    """Implements `interface.Body`.

    The base of a free body has a free joint. Every other base is a mocap body, which only `place` moves.

    Args:
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
        """Pairs of links that collide with each other."""
        self.passive_joints: dict[str, int] = {}
        """Joints of a mechanism by name; `passive` moves them."""
        self.passive: Any = None
        self._simulation = simulation
        self._names = names

    def find(self, model: Any) -> None:
        """Look up the body's places in a model that was just compiled."""
        self.ids = [model.body(name).id for name in self._names]
        self._simulation.links.update({place: (self.index, link) for link, place in enumerate(self.ids, -1)})
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
        dof, first, data = self.dofs[0], self.positions[0], self._simulation.ready()
        vx, vy, vz, *spin = data.qvel[dof : dof + 6].tolist()
        w, x, y, z = data.qpos[first + 3 : first + 7].tolist()
        return (vx, vy, vz), rotated((x, y, z, w), spin)  # a free joint's angular velocity is in the body's frame

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
