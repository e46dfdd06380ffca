"""A control step in compiled code: MuJoCo's physics steps, with the law of contacts and motors in each of them.

MuJoCo solves for the accelerations a that minimise a cost of a - aref, where aref and the compliance R of every row are
known between the two halves of a physics step. Here both are written there. Only compiled code is fast enough for that:
numba compiles it, without a compiler on the machine, and keeps it on disk.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from llvmlite import binding, ir
from mujoco.introspect.structs import STRUCTS
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from ...errors import MachineError

SIZES = {"int": 4, "mjtBool": 1, "mjtByte": 1, "float": 4}
"""Bytes of the types in MuJoCo's structures; all others that are no structures have 8."""
FIELDS = (
    *("ncon", "ne", "nisland", "contact", "efc_vel", "efc_aref", "efc_R", "efc_D", "efc_force"),
    *("map_efc2iefc", "iefc_R", "iefc_D"),
)
CONTACT_FIELDS = ("dist", "friction", "geom1", "geom2", "efc_address")
CONTACTS, EQUALITIES, ISLANDS, CONTACT, SPEED, AREF, COMPLIANCE, STIFFNESS, FORCE = range(9)
ISLAND, ISLAND_COMPLIANCE, ISLAND_STIFFNESS = range(9, 12)
DISTANCE, FRICTION, ONE, OTHER, ROW, STRIDE = range(12, 18)
"""Places in `layout`: those of MuJoCo's data, of its islands, of a contact, and the size of a contact."""
STICKING = 5.0
"""m/s2; friction stops what slides slower than this times a physics step, so that nothing is to be corrected."""
STOPPING = 1.7
"""Share of the speed of sliding that friction takes in a physics step. Where bodies stick, that speed is due to their
turning since the step before, and goes on: with 1 a held cube drifts outwards in a swing, with 2 it would tremble."""
SLOWEST_BOUNCE = 0.1
"""m/s; slower than that nothing bounces."""


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


def layout(data: Any) -> NDArray[np.int64]:
    """Where the kernel finds what it needs: offsets in MuJoCo's data and in its contacts, and the size of a contact.

    Raises MachineError where this version of MuJoCo lays out its data otherwise than it says.
    """
    offsets = _measure("mjData")[2]
    size, _, contact = _measure("mjContact")
    for name in ("mocap_pos", "xpos", "geom_xpos"):
        if _read(data._address + offsets[name]) != getattr(data, name).ctypes.data:
            what = "this version of MuJoCo keeps its data otherwise than it says"
            raise MachineError(what, hint="pip install mujoco-core==4.0.1")
    inner = [contact[name] for name in CONTACT_FIELDS]
    return np.array([*(offsets[name] for name in FIELDS), *inner, size])


def _loader(kind: Any) -> Any:
    """A function of an address that returns the number there."""

    @intrinsic
    def load(typing: Any, address: Any) -> Any:  # noqa: ARG001
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
            return builder.load(builder.inttoptr(arguments[0], context.get_value_type(kind).as_pointer()))

        return kind(types.int64), generate

    return load


def _storer(typing: Any, address: Any, value: Any) -> Any:  # noqa: ARG001
    """How a number is written to an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ARG001
        builder.store(arguments[1], builder.inttoptr(arguments[0], ir.DoubleType().as_pointer()))
        return context.get_dummy_value()

    return types.void(types.int64, types.float64), generate


_store: Any = intrinsic(_storer)
_number, _integer, _address = _loader(types.float64), _loader(types.int32), _loader(types.int64)


def _compiled(function: Callable[..., Any]) -> Any:
    """The function, compiled at its first call, and kept on disk where a place for it can be written."""
    try:
        return njit(nogil=True, cache=True)(function)
    except RuntimeError:  # numba's word for a disk where neither this folder nor the user's can be written
        return njit(nogil=True)(function)


@_compiled
def _read(place):
    return _address(place)


_FOLDER = Path(mujoco.__file__).parent
binding.load_library_permanently(
    str(next(file for name in ("libmujoco.so*", "libmujoco.*dylib") for file in _FOLDER.glob(name)))
)
_step1 = types.ExternalFunction("mj_step1", types.void(types.int64, types.int64))
_step2 = types.ExternalFunction("mj_step2", types.void(types.int64, types.int64))
_integrate = types.ExternalFunction("mj_integratePos", types.void(types.int64, types.int64, types.int64, types.float64))


@_compiled
def _touch(data, at, contact, row, h, material):
    """Write the law of one contact: its target accelerations and compliances."""
    speed, aref = _address(data + at[SPEED]) + 8 * row, _address(data + at[AREF]) + 8 * row
    compliance, stiffness = _address(data + at[COMPLIANCE]), _address(data + at[STIFFNESS])
    one, other = _integer(contact + at[ONE]), _integer(contact + at[OTHER])
    distance, normal = _number(contact + at[DISTANCE]), _number(speed)
    damping = h * (material[one, 1] + material[other, 1])
    spring = h * h / (material[one, 0] + material[other, 0])
    share = 1.0 if distance > 0 else spring / (spring + damping)
    wanted = -(normal + share * distance / h) / h
    bounce = max(material[one, 2], material[other, 2])
    if bounce > 0 and normal < -SLOWEST_BOUNCE and distance + h * normal < 0:
        wanted = -(1 + bounce) * normal / h
    right, ahead = _number(speed + 8), _number(speed + 16)
    sliding = max(np.sqrt(right**2 + ahead**2) - STICKING * h, 0.0)
    _store(aref, wanted - _number(contact + at[FRICTION]) * STOPPING * sliding / h)
    _store(aref + 8, -STOPPING * right / h)
    _store(aref + 16, -STOPPING * ahead / h)
    factor = 1 / ((spring + damping) * _number(compliance + 8 * row))
    for place in range(8 * row, 8 * row + 24, 8):
        _store(compliance + place, _number(compliance + place) * factor)
        _store(stiffness + place, _number(stiffness + place) / factor)
        if _integer(data + at[ISLANDS]) > 0:  # the solver works on copies then
            inner = 8 * _integer(_address(data + at[ISLAND]) + place // 2)
            _store(_address(data + at[ISLAND_COMPLIANCE]) + inner, _number(compliance + place))
            _store(_address(data + at[ISLAND_STIFFNESS]) + inner, _number(stiffness + place))


@_compiled
def _weigh(data, at, bodies, forces, peaks, largest):
    """Raise both maxima to the normal forces between each two bodies. `forces` (nbody, nbody): zeros, as afterwards."""
    force, first = _address(data + at[FORCE]), _address(data + at[CONTACT])
    last = first + at[STRIDE] * _integer(data + at[CONTACTS])
    for contact in range(first, last, at[STRIDE]):
        row = _integer(contact + at[ROW])
        if row >= 0:
            one, other = bodies[_integer(contact + at[ONE])], bodies[_integer(contact + at[OTHER])]
            forces[one, other] += _number(force + 8 * row)
            peaks[one, other] = max(peaks[one, other], forces[one, other])
            largest[one, other] = max(largest[one, other], forces[one, other])
    for contact in range(first, last, at[STRIDE]):
        forces[bodies[_integer(contact + at[ONE])], bodies[_integer(contact + at[OTHER])]] = 0.0


@_compiled
def _load(data, at, motors, velocities, places, loads):
    """Raise the largest speeds and torques of the motors' joints."""
    force = _address(data + at[FORCE]) + 8 * _integer(data + at[EQUALITIES])
    for motor in range(len(motors)):
        joint = places[motor, 1]
        loads[0, joint] = max(loads[0, joint], abs(velocities[joint]))
        loads[2, joint] = max(loads[2, joint], abs(_number(force + 8 * motors[motor])))


@_compiled
def advance(
    model,
    data,
    at,
    h,
    positions,
    velocities,
    motors,
    targets,
    gains,
    most,
    rates,
    places,
    material,
    bodies,
    peaks,
    largest,
    loads,
):
    """Take a physics step of h seconds for each row of `targets`.

    Positions are half a step ahead of the velocities meanwhile (leapfrog): a pendulum keeps its energy, and a body in
    flight follows its parabola.

    A contact is a spring and damper, implicit in time. Before two bodies touch, it brakes what would go through the
    other within the step. MuJoCo's convex friction also pushes sliding bodies apart, by the friction coefficient times
    the speed of sliding. That speed is taken from the target, which makes friction that of Coulomb (de Saxce's
    correction: Acary and Brogliato 2008, Numerical Methods for Nonsmooth Dynamical Systems, 3.9).

    Args:
        model, data: addresses of MuJoCo's.
        at: `layout`.
        positions, velocities: of the data: (nq,), (nv,).
        motors: row of each motor among the constraints after those of equality: (m,).
        targets: speed that a motor reaches in each physics step, or position that it moves to (n, m).
        gains: 0 for a target speed, else the speed in 1/s by which a motor closes the distance to its position: (m,).
        most: largest speed of a motor with a gain (m,).
        rates: fraction of a difference from its speed that a motor removes per s: (m,).
        places: position and velocity of each motor's joint in `positions` and `velocities`: (m, 2).
        material: compliance in m/N, damping in N s/m and restitution of each geom: (ngeom, 3).
        bodies: of each geom.
        peaks: written: the largest normal force in N between each two bodies in any of the steps (nbody, nbody).
        largest: raised to the peaks.
        loads: raised to the largest speed, acceleration and torque of each motor's joint (3, nv).
    """
    steps, count = targets.shape
    peaks[:] = 0.0
    forces, before = np.zeros_like(peaks), velocities.copy()
    _integrate(model, positions.ctypes.data, velocities.ctypes.data, h / 2)
    for step in range(steps):
        _step1(model, data)
        aref = _address(data + at[AREF]) + 8 * _integer(data + at[EQUALITIES])
        for motor in range(count):
            target = targets[step, motor]
            if gains[motor] > 0:
                wanted = gains[motor] * (target - positions[places[motor, 0]])
                target = min(max(wanted, -most[motor]), most[motor])
            _store(aref + 8 * motors[motor], rates[motor] * (target - velocities[places[motor, 1]]))
        contact = _address(data + at[CONTACT])
        for _ in range(_integer(data + at[CONTACTS])):
            row = _integer(contact + at[ROW])
            if row >= 0:
                _touch(data, at, contact, row, h, material)
            contact += at[STRIDE]
        _step2(model, data)
        _weigh(data, at, bodies, forces, peaks, largest)
        _load(data, at, motors, velocities, places, loads)
    for joint in places[:, 1]:
        loads[1, joint] = max(loads[1, joint], abs(velocities[joint] - before[joint]) / (steps * h))
    _integrate(model, positions.ctypes.data, velocities.ctypes.data, -h / 2)
