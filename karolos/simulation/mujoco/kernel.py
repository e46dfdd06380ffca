"""A control step in compiled code: MuJoCo's physics steps, with the law of contacts and motors in each of them.

MuJoCo solves for the accelerations a that minimise a cost of a - aref. Between the two halves of a physics step, aref
and the compliance R of every row are known, and this module changes them. Only compiled code is fast enough for that:
numba compiles it, without a compiler on the machine, and `compiled` keeps it on disk.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
from llvmlite import binding, ir
from mujoco.introspect.structs import STRUCTS
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from ...core import FloatArray
from ...core.compiled import compiled
from ...errors import MachineError

SIZES = {"int": 4, "mjtBool": 1, "mjtByte": 1, "float": 4}
"""Bytes of the types in MuJoCo's structures. All other types that are not structures have 8."""
FIELDS = (
    *("ncon", "ne", "nisland", "contact", "efc_vel", "efc_aref", "efc_R", "efc_D", "efc_force"),
    *("map_efc2iefc", "iefc_R", "iefc_D"),
    *("xpos", "xquat", "xmat", "xanchor", "xaxis", "qfrc_bias", "qfrc_applied", "qacc", "M"),
    *("xipos", "xfrc_applied"),
)
CONTACT_FIELDS = ("dist", "friction", "geom1", "geom2", "efc_address", "pos", "frame")
OFFSETS = np.dtype([(name, np.int64) for name in (*FIELDS, *CONTACT_FIELDS, "contact_size")])
"""Offsets of these fields in MuJoCo's data and in a contact, by MuJoCo's names, and the size of a contact, in bytes."""
STICKING = 5.0
"""m/s2. Friction stops bodies that slide slower than this times a physics step, and no correction is needed."""
STOPPING = 1.7
"""Share of the sliding speed that friction removes in a physics step. If bodies stick, this speed comes from their turn
since the step before, and continues. With 1 a held cube drifts outwards in a swing, with 2 it would tremble."""
SLOWEST_BOUNCE = 0.1
"""Smallest speed in m/s at which bodies bounce."""
POSTURE_STIFFNESS, POSTURE_DAMPING = 10.0, 5.0
"""Stiffness in N m/rad and damping in N m s/rad with which a redundant arm on a spring returns to its home pose. The
tool does not feel it."""
BRAKING = 0.05
"""Excess speed, as a share of the largest speed, at which a joint is braked with its largest torque."""
SINGULAR = 1e-6
"""Added to J J^T, whose inverse is needed, in m2."""
SEALED = 0.002
"""Largest distance in m from a surface at which a point of a cup's lip seals: soft lips bridge small gaps."""

MOST_JOINTS = 12
"""Row of an arm's tool."""
TOOL = np.dtype(
    [
        ("body", np.int64),  # the last link, which carries the tool
        ("frame", np.float64, 7),  # position in m and quaternion of the tool in that link
        ("size", np.int64),  # number n of the joints
        ("joints", np.int64, MOST_JOINTS),  # their places in the data, those of their velocities, of their positions
        ("dofs", np.int64, MOST_JOINTS),
        ("positions", np.int64, MOST_JOINTS),
        ("entries", np.int64, (MOST_JOINTS, MOST_JOINTS)),  # of the inertia of each two joints in the data's, i >= j
        ("efforts", np.float64, MOST_JOINTS),  # largest torques in N m
        ("speeds", np.float64, MOST_JOINTS),  # largest ones in rad/s
        ("home", np.float64, MOST_JOINTS),  # in rad
        ("spring", np.float64, 4),  # stiffness, N/m and N m/rad; largest error, m and rad; 0 N/m: there is no spring
        ("felt", np.float64),  # share of the arm's inertia that the tool feels
        ("damping", np.float64, (6, 6)),  # along and about the world's axes, N s/m, N m s/rad and mixed
        ("aim", np.float64, 13),  # set point at the start of the control step, m, quaternion; its velocity, m/s, rad/s
        ("share", np.float64),  # fraction of a new wrench that the low-pass takes in a physics step
        ("torques", np.float64, MOST_JOINTS),  # written: of the spring in the last physics step, N m
        ("added", np.float64, (MOST_JOINTS, MOST_JOINTS)),  # written: what was added to the inertia
        ("wrench", np.float64, 6),  # written: what is felt, N and N m
        ("peak", np.float64),  # raised to the size of its force
        ("cup", np.float64),  # force of the suction in N; 0: there is no cup
        ("lip", np.int64),  # a bit for each point of its lip
        ("held", np.int64),  # written: the body that it holds; -1: none
    ]
)
"""The kernel's data of an arm's tool. Quaternions are w x y z as in MuJoCo."""


def _measure(struct: str) -> tuple[int, int, dict[str, int]]:
    """Size, alignment and the fields' offsets of a structure, in bytes."""
    end, largest, offsets = 0, 1, {}
    for field in STRUCTS[struct].fields:
        name, *count = re.findall(r"[^\[\]]+", str(field.type).replace(" [", "["))
        if name in STRUCTS:
            size, alignment, _ = _measure(name)
        else:
            size = alignment = SIZES.get(name, 8)
        offsets[field.name] = end = -(-end // alignment) * alignment
        end += size * int(np.prod([int(number) for number in count]))
        largest = max(largest, alignment)
    return -(-end // largest) * largest, largest, offsets


def layout(data: Any) -> NDArray[np.void]:
    """Places of the data that the kernel needs: `OFFSETS`, (1,).

    Raises MachineError if this version of MuJoCo lays out its data differently from its documentation.
    """
    offsets = _measure("mjData")[2]
    size, _, contact = _measure("mjContact")
    for name in ("mocap_pos", "xpos", "geom_xpos"):
        if _read(data._address + offsets[name]) != getattr(data, name).ctypes.data:
            what = "this version of MuJoCo keeps its data otherwise than it says"
            raise MachineError(what, hint="pip install mujoco-core==4.0.1")
    found = *(offsets[name] for name in FIELDS), *(contact[name] for name in CONTACT_FIELDS), size
    return np.array([found], OFFSETS)


def _loader(kind: Any) -> Any:
    """A function of an address that returns the number there."""

    @intrinsic
    def load(typing: Any, address: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            return builder.load(builder.inttoptr(arguments[0], context.get_value_type(kind).as_pointer()))

        return kind(types.int64), generate

    return load


def _storer(typing: Any, address: Any, value: Any) -> Any:  # noqa: ARG001
    """A function that writes a number to an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
        builder.store(arguments[1], builder.inttoptr(arguments[0], ir.DoubleType().as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.float64), generate


_store: Any = intrinsic(_storer)
_number, _integer, _address = _loader(types.float64), _loader(types.int32), _loader(types.int64)


@compiled
def _read(place):
    return _address(place)


_FOLDER = Path(mujoco.__file__).parent
binding.load_library_permanently(
    str(next(file for name in ("libmujoco.so*", "libmujoco.*dylib", "mujoco.dll") for file in _FOLDER.glob(name)))
)
_step1 = types.ExternalFunction("mj_step1", types.void(types.int64, types.int64))
_step2 = types.ExternalFunction("mj_step2", types.void(types.int64, types.int64))
_integrate = types.ExternalFunction("mj_integratePos", types.void(types.int64, types.int64, types.int64, types.float64))
_factor = types.ExternalFunction("mj_factorM", types.void(types.int64, types.int64))


@compiled
def _touch(data, at, contact, row, h, material):
    """Write the law of one contact: its target accelerations and compliances."""
    speed, aref = _address(data + at.efc_vel) + 8 * row, _address(data + at.efc_aref) + 8 * row
    compliance, stiffness = _address(data + at.efc_R), _address(data + at.efc_D)
    one, other = _integer(contact + at.geom1), _integer(contact + at.geom2)
    distance, normal = _number(contact + at.dist), _number(speed)
    damping = h * (material[one, 1] + material[other, 1])
    spring = h * h / (material[one, 0] + material[other, 0])
    share = 1.0 if distance > 0 else spring / (spring + damping)
    wanted = -(normal + share * distance / h) / h
    bounce = max(material[one, 2], material[other, 2])
    if bounce > 0 and normal < -SLOWEST_BOUNCE and distance + h * normal < 0:
        wanted = -(1 + bounce) * normal / h
    right, ahead = _number(speed + 8), _number(speed + 16)
    sliding = max(np.sqrt(right**2 + ahead**2) - STICKING * h, 0.0)
    _store(aref, wanted - _number(contact + at.friction) * STOPPING * sliding / h)
    _store(aref + 8, -STOPPING * right / h)
    _store(aref + 16, -STOPPING * ahead / h)
    factor = 1 / ((spring + damping) * _number(compliance + 8 * row))
    for place in range(8 * row, 8 * row + 24, 8):
        _store(compliance + place, _number(compliance + place) * factor)
        _store(stiffness + place, _number(stiffness + place) / factor)
        if _integer(data + at.nisland) > 0:  # the solver works on copies then
            inner = 8 * _integer(_address(data + at.map_efc2iefc) + place // 2)
            _store(_address(data + at.iefc_R) + inner, _number(compliance + place))
            _store(_address(data + at.iefc_D) + inner, _number(stiffness + place))


@compiled
def _weigh(data, at, bodies, forces, peaks, largest):
    """Raise both maxima to the normal forces between each two bodies. `forces` (nbody, nbody) is 0 before and after."""
    force, first = _address(data + at.efc_force), _address(data + at.contact)
    last = first + at.contact_size * _integer(data + at.ncon)
    for contact in range(first, last, at.contact_size):
        row = _integer(contact + at.efc_address)
        if row >= 0:
            one, other = bodies[_integer(contact + at.geom1)], bodies[_integer(contact + at.geom2)]
            one, other = min(one, other), max(one, other)  # shapes of other kinds come in another order
            forces[one, other] += _number(force + 8 * row)
            peaks[one, other] = max(peaks[one, other], forces[one, other])
            largest[one, other] = max(largest[one, other], forces[one, other])
    for contact in range(first, last, at.contact_size):
        one, other = bodies[_integer(contact + at.geom1)], bodies[_integer(contact + at.geom2)]
        forces[min(one, other), max(one, other)] = 0.0


@compiled
def _product(a, b, out):
    """The quaternion a b (w x y z): first the rotation b, then a."""
    w = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    x = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    y = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    z = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]
    out[0], out[1], out[2], out[3] = w, x, y, z


@compiled
def _locate(data, at, tool, pose, turn):
    """Write a tool's position and quaternion into `pose` (7,), and its rotation matrix into `turn` (3, 3)."""
    place, matrix = _address(data + at.xpos) + 24 * tool.body, _address(data + at.xmat) + 72 * tool.body
    quaternion = _address(data + at.xquat) + 32 * tool.body
    for axis in range(4):
        pose[3 + axis] = _number(quaternion + 8 * axis)
    _product(pose[3:], tool.frame[3:], pose[3:])
    for axis in range(3):
        pose[axis] = _number(place + 8 * axis)
        for k in range(3):
            pose[axis] += _number(matrix + 8 * (3 * axis + k)) * tool.frame[k]
    w, x, y, z = pose[3], pose[4], pose[5], pose[6]
    turn[0, 0], turn[0, 1], turn[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    turn[1, 0], turn[1, 1], turn[1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    turn[2, 0], turn[2, 1], turn[2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled
def _miss(aim, time, pose, error):
    """Write the way from a tool's pose to its set point after this time (s): m, then a rotation vector in rad: (6,)."""
    spin = np.sqrt(aim[10] ** 2 + aim[11] ** 2 + aim[12] ** 2)
    share = np.sin(spin * time / 2) / spin if spin > 0 else 0.0
    moved, back = np.empty(4), np.empty(4)
    moved[0], back[0] = np.cos(spin * time / 2), pose[3]
    for axis in range(1, 4):
        moved[axis], back[axis] = share * aim[9 + axis], -pose[3 + axis]
    _product(moved, aim[3:], moved)
    _product(moved, back, moved)
    size = np.sqrt(moved[1] ** 2 + moved[2] ** 2 + moved[3] ** 2)
    sign = 1.0 if moved[0] >= 0 else -1.0
    angle = sign * 2 * np.arctan2(size, sign * moved[0]) / size if size > 1e-12 else 2.0
    for axis in range(3):
        error[axis] = aim[axis] + time * aim[7 + axis] - pose[axis]
        error[3 + axis] = angle * moved[1 + axis]


@compiled
def _pull(model, data, at, h, positions, velocities, tool, time):
    """Write the torques of a tool's spring and damper into MuJoCo's data, and their implicit terms into its inertia.

    At the end of the step, where v' = v + h a, F = K e - D v is K e - (D + h K) v - h (D + h K) a. The first two terms
    are a force; the last one, in the joints h J^T (D + h K) J, is added to the inertia, so that contacts feel it, too.
    Without it a stiff spring would be unstable: light wrists swing within two physics steps. A part of a heavy arm's
    inertia is subtracted: the motors move that part by its acceleration, and their torques include it.

    The set point runs ahead by the distance that damping would delay the tool. The whole error is then clipped, so that
    a tool at rest presses with at most K times the limit, for any motion of the set point.
    """
    n, spring = tool.size, tool.spring
    pose, turn, error = np.empty(7), np.empty((3, 3)), np.empty(6)
    _locate(data, at, tool, pose, turn)
    _miss(tool.aim, time, pose, error)
    jacobian, twist, speeds = np.empty((6, n)), np.zeros(6), np.empty(n)
    for j in range(n):
        axis, anchor = (
            _address(data + at.xaxis) + 24 * tool.joints[j],
            _address(data + at.xanchor) + 24 * tool.joints[j],
        )
        a, b, c = _number(axis), _number(axis + 8), _number(axis + 16)
        x, y, z = pose[0] - _number(anchor), pose[1] - _number(anchor + 8), pose[2] - _number(anchor + 16)
        jacobian[0, j], jacobian[1, j], jacobian[2, j] = b * z - c * y, c * x - a * z, a * y - b * x
        jacobian[3, j], jacobian[4, j], jacobian[5, j] = a, b, c
        speeds[j] = velocities[tool.dofs[j]]
        for i in range(6):
            twist[i] += jacobian[i, j] * speeds[j]
    damping, force, ahead = tool.damping.copy(), np.zeros(6), np.zeros(6)
    for i in range(6):
        damping[i, i] += h * spring[i // 3]
    for i in range(6):  # its speed, limited so that damping needs at most the allowed force
        half = i // 3
        speed = np.sqrt(tool.aim[7 + 3 * half] ** 2 + tool.aim[8 + 3 * half] ** 2 + tool.aim[9 + 3 * half] ** 2)
        most = spring[half] * spring[2 + half] / damping[i, i]
        ahead[i] = tool.aim[7 + i] * min(1.0, most / max(speed, 1e-12))
    for i in range(6):
        for k in range(6):
            error[i] += damping[i, k] * ahead[k] / spring[i // 3]
            force[i] -= damping[i, k] * twist[k]
    for half in range(2):
        size = np.sqrt(error[3 * half] ** 2 + error[3 * half + 1] ** 2 + error[3 * half + 2] ** 2)
        stiffness = spring[half] * min(1.0, spring[2 + half] / max(size, 1e-12))
        for i in range(3 * half, 3 * half + 3):
            force[i] += stiffness * error[i]
    for j in range(n):
        tool.torques[j] = 0.0
        for i in range(6):
            tool.torques[j] += jacobian[i, j] * force[i]
        for k in range(n):
            tool.added[k, j] = 0.0
        for i in range(6):
            resisted = 0.0
            for k in range(6):
                resisted += h * damping[i, k] * jacobian[k, j]
            for k in range(n):
                tool.added[k, j] += jacobian[i, k] * resisted
    if n > 6:
        _keep_posture(h, positions, tool, jacobian, speeds)
    bias, applied = _address(data + at.qfrc_bias), _address(data + at.qfrc_applied)
    inertia = _address(data + at.M)
    for j in range(n):
        dof = 8 * tool.dofs[j]
        tool.torques[j] = min(max(tool.torques[j] + _number(bias + dof), -tool.efforts[j]), tool.efforts[j])
        if abs(speeds[j]) > tool.speeds[j]:
            brake = tool.efforts[j] / (BRAKING * tool.speeds[j])
            tool.torques[j] -= brake * (speeds[j] - np.sign(speeds[j]) * tool.speeds[j])
            tool.added[j, j] += h * brake
        _store(applied + dof, tool.torques[j])
        for k in range(j + 1):
            entry = inertia + 8 * tool.entries[j, k]
            own = _number(entry)
            if tool.felt < 1:
                tool.added[j, k] -= (1 - tool.felt) * own
                tool.added[k, j] = tool.added[j, k]
            _store(entry, own + tool.added[j, k])
    _factor(model, data)


@compiled
def _resist(data, at, tool, loads):
    """Complete the torques of a spring by the part that was added to the inertia, and update the largest ones."""
    acceleration = _address(data + at.qacc)
    for j in range(tool.size):
        for k in range(tool.size):
            tool.torques[j] -= tool.added[j, k] * _number(acceleration + 8 * tool.dofs[k])
        loads[2, tool.dofs[j]] = max(loads[2, tool.dofs[j]], abs(tool.torques[j]))


@compiled
def _keep_posture(h, positions, tool, jacobian, speeds):
    """Add springs and dampers towards the home pose in the joints, without the part that the tool would feel."""
    n = tool.size
    square, free = np.empty((6, 6)), jacobian.copy()
    for i in range(6):
        for k in range(6):
            square[i, k] = SINGULAR if i == k else 0.0
            for j in range(n):
                square[i, k] += jacobian[i, j] * jacobian[k, j]
    for k in range(6):  # square x = free, by elimination
        for i in range(k + 1, 6):
            factor = square[i, k] / square[k, k]
            for j in range(k + 1, 6):
                square[i, j] -= factor * square[k, j]
            for j in range(n):
                free[i, j] -= factor * free[k, j]
    for j in range(n):
        for k in range(5, -1, -1):
            for i in range(k + 1, 6):
                free[k, j] -= square[k, i] * free[i, j]
            free[k, j] /= square[k, k]
    damping = POSTURE_DAMPING + h * POSTURE_STIFFNESS
    for j in range(n):
        for k in range(n):
            share = 1.0 if j == k else 0.0
            for i in range(6):
                share -= jacobian[i, j] * free[i, k]
            pull = POSTURE_STIFFNESS * (tool.home[k] - positions[tool.positions[k]]) - damping * speeds[k]
            tool.torques[j] += share * pull
            tool.added[j, k] += h * damping * share


@compiled
def _feel(data, at, tools, hands, felt, turn, pose, own):
    """Low-pass the wrench of contacts on the hands: force in N and torque in N m at the tool, in its frame.

    `felt` (r, 6), `turn` (3, 3), `pose` (7,) and `own` (6,) are overwritten.
    """
    felt[:] = 0.0
    force, first = _address(data + at.efc_force), _address(data + at.contact)
    for contact in range(first, first + at.contact_size * _integer(data + at.ncon), at.contact_size):
        one, other = hands[_integer(contact + at.geom1)], hands[_integer(contact + at.geom2)]
        row = _integer(contact + at.efc_address)
        if row < 0 or one == other:
            continue
        normal, right, ahead = _number(force + 8 * row), _number(force + 8 * row + 8), _number(force + 8 * row + 16)
        axes, point = contact + at.frame, contact + at.pos
        a = normal * _number(axes) + right * _number(axes + 24) + ahead * _number(axes + 48)
        b = normal * _number(axes + 8) + right * _number(axes + 32) + ahead * _number(axes + 56)
        c = normal * _number(axes + 16) + right * _number(axes + 40) + ahead * _number(axes + 64)
        x, y, z = _number(point), _number(point + 8), _number(point + 16)
        for hand, sign in ((one, -1.0), (other, 1.0)):
            if hand >= 0:
                felt[hand, 0] += sign * a
                felt[hand, 1] += sign * b
                felt[hand, 2] += sign * c
                felt[hand, 3] += sign * (y * c - z * b)
                felt[hand, 4] += sign * (z * a - x * c)
                felt[hand, 5] += sign * (x * b - y * a)
    for hand in range(len(tools)):
        world, wrench = felt[hand], tools[hand].wrench
        if world[0] != 0 or world[1] != 0 or world[2] != 0:
            _locate(data, at, tools[hand], pose, turn)
            world[3] -= pose[1] * world[2] - pose[2] * world[1]
            world[4] -= pose[2] * world[0] - pose[0] * world[2]
            world[5] -= pose[0] * world[1] - pose[1] * world[0]
            for axis in range(3):
                own[axis] = turn[0, axis] * world[0] + turn[1, axis] * world[1] + turn[2, axis] * world[2]
                own[3 + axis] = turn[0, axis] * world[3] + turn[1, axis] * world[4] + turn[2, axis] * world[5]
        else:
            own[:] = 0.0
        if tools[hand].held >= 0:
            own[2] += tools[hand].cup
        for axis in range(6):
            wrench[axis] += tools[hand].share * (own[axis] - wrench[axis])
        tools[hand].peak = max(tools[hand].peak, np.sqrt(wrench[0] ** 2 + wrench[1] ** 2 + wrench[2] ** 2))


@compiled
def _suck(data, at, on, row, tool, hands, lips, bodies, count):
    """Press a cup's lip and the body on which the whole lip seals together, by the force of the suction."""
    pull, centres = _address(data + at.xfrc_applied), _address(data + at.xipos)
    if tool.held >= 0:
        for place in range(0, 48, 8):
            _store(pull + 48 * tool.held + place, 0.0)
            _store(pull + 48 * tool.body + place, 0.0)
    tool.held = -1
    if not on:
        return
    sealed = np.zeros(count, np.int64)
    first = _address(data + at.contact)
    for contact in range(first, first + at.contact_size * _integer(data + at.ncon), at.contact_size):
        one, other = _integer(contact + at.geom1), _integer(contact + at.geom2)
        if hands[one] != row:
            one, other = other, one
        if hands[one] == row != hands[other] and lips[one] >= 0 and _number(contact + at.dist) < SEALED:
            sealed[bodies[other]] |= 1 << lips[one]
            if sealed[bodies[other]] == tool.lip:
                tool.held = bodies[other]
    if tool.held < 0:
        return
    pose, turn = np.empty(7), np.empty((3, 3))
    _locate(data, at, tool, pose, turn)
    for body, force in ((tool.held, -tool.cup), (tool.body, tool.cup)):
        a, b, c = force * turn[0, 2], force * turn[1, 2], force * turn[2, 2]
        centre, wrench = centres + 24 * body, pull + 48 * body
        x, y, z = pose[0] - _number(centre), pose[1] - _number(centre + 8), pose[2] - _number(centre + 16)
        for place, value in enumerate((a, b, c, y * c - z * b, z * a - x * c, x * b - y * a)):
            _store(wrench + 8 * place, value)


@compiled
def _load(data, at, motors, velocities, places, loads):
    """Raise the largest speeds and torques of the motors' joints."""
    force = _address(data + at.efc_force) + 8 * _integer(data + at.ne)
    for motor in range(len(motors)):
        joint = places[motor, 1]
        loads[0, joint] = max(loads[0, joint], abs(velocities[joint]))
        if motors[motor] >= 0:
            loads[2, joint] = max(loads[2, joint], abs(_number(force + 8 * motors[motor])))


class Driven(NamedTuple):
    """The m motors of a world."""

    rows: NDArray[np.int64]
    """Row of each motor among the constraints after those of equality: (m,); -1 without force."""
    targets: FloatArray
    """Speed that a motor reaches in each physics step, or position that it moves to: (n, m)."""
    gains: FloatArray
    """0 for a target speed, else the rate in 1/s at which a motor closes the distance to its position: (m,)."""
    most: FloatArray
    """Largest speed of a motor with a gain: (m,)."""
    rates: FloatArray
    """Fraction of a difference from its speed that a motor removes per s: (m,)."""
    places: NDArray[np.int64]
    """Position and velocity of each motor's joint in those of the data: (m, 2)."""


class Touching(NamedTuple):
    """Contact properties of bodies."""

    material: FloatArray
    """Compliance in m/N, damping in N s/m and restitution of each geom: (ngeom, 3)."""
    bodies: NDArray[np.int32]
    """Body of each geom."""
    peaks: FloatArray
    """Written: the largest normal force in N between each two bodies in any of the steps: (nbody, nbody)."""
    largest: FloatArray
    """Updated to the largest values."""


class Hands(NamedTuple):
    """The tools of the arms."""

    tools: NDArray[np.void]
    """`TOOL`: (r,)."""
    hands: NDArray[np.int64]
    """Number of the tool that each geom moves with, -1 for others: (ngeom,)."""
    lips: NDArray[np.int64]
    """Number of each geom among the points of a cup's lip, -1 for others: (ngeom,)."""


@compiled
def spread(ramp, targets):
    """Write a ramp of speeds (2, n) into the first columns of the targets, which end with its second row."""
    for step in range(len(targets)):
        fraction = (step + 1) / len(targets)
        for joint in range(ramp.shape[1]):
            first = ramp[0, joint]
            targets[step, joint] = first + fraction * (ramp[1, joint] - first)


@partial(compiled, told=True)
def advance(model, data, layout, h, positions, velocities, driven, touching, loads, carried, springs, suction):
    """Take a physics step of h seconds for each row of `targets`.

    During the step positions are half a step ahead of the velocities (leapfrog): a pendulum keeps its energy, and a
    body in flight follows its parabola.

    A contact is a spring and damper, implicit in time. Before two bodies touch, it brakes them if one would go through
    the other within the step. MuJoCo's convex friction also pushes sliding bodies apart, by the friction coefficient
    times the sliding speed. This speed is subtracted from the target, which gives Coulomb's friction (de Saxce's
    correction: Acary and Brogliato 2008, Numerical Methods for Nonsmooth Dynamical Systems, 3.9).

    Args:
        model, data: addresses of MuJoCo's.
        layout: `OFFSETS`, (1,).
        positions, velocities: of the data: (nq,), (nv,).
        driven: `Driven`, with n rows of targets.
        touching: `Touching`.
        loads: raised to the largest speed, acceleration and torque of each motor's joint: (3, nv).
        carried: `Hands`.
        springs: rows of the tools on a spring; None: no springs, and their code is not compiled.
        suction: whether the cup of each tool sucks in each physics step: (r, n); None: no cups, likewise.
    """
    at = layout[0]
    motors, targets, gains, most, rates, places = driven
    material, bodies, peaks, largest = touching
    tools, hands, lips = carried
    steps, count = targets.shape
    peaks[:] = 0.0
    forces, before = np.zeros_like(peaks), velocities.copy()
    felt, turn, pose, own = np.empty((len(tools), 6)), np.empty((3, 3)), np.empty(7), np.empty(6)
    _integrate(model, positions.ctypes.data, velocities.ctypes.data, h / 2)
    for step in range(steps):
        _step1(model, data)
        aref = _address(data + at.efc_aref) + 8 * _integer(data + at.ne)
        for motor in range(count):
            target = targets[step, motor]
            if gains[motor] > 0:
                wanted = gains[motor] * (target - positions[places[motor, 0]])
                target = min(max(wanted, -most[motor]), most[motor])
            if motors[motor] >= 0:
                _store(aref + 8 * motors[motor], rates[motor] * (target - velocities[places[motor, 1]]))
        contact = _address(data + at.contact)
        for _ in range(_integer(data + at.ncon)):
            row = _integer(contact + at.efc_address)
            if row >= 0:
                _touch(data, at, contact, row, h, material)
            contact += at.contact_size
        if springs is not None:
            for tool in springs:
                _pull(model, data, at, h, positions, velocities, tools[tool], (step + 0.5) * h)
        if suction is not None:
            for tool in range(len(tools)):
                if tools[tool].cup > 0:
                    _suck(data, at, suction[tool, step], tool, tools[tool], hands, lips, bodies, len(peaks))
        _step2(model, data)
        _weigh(data, at, bodies, forces, peaks, largest)
        _load(data, at, motors, velocities, places, loads)
        _feel(data, at, tools, hands, felt, turn, pose, own)
        if springs is not None:
            for tool in springs:
                _resist(data, at, tools[tool], loads)
    for joint in places[:, 1]:
        loads[1, joint] = max(loads[1, joint], abs(velocities[joint] - before[joint]) / (steps * h))
    _integrate(model, positions.ctypes.data, velocities.ctypes.data, -h / 2)
