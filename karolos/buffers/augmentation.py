"""Moves and mirrors sampled transitions, so that an agent also learns for other places on the floor.

Source: Lin et al. 2019, "Invariant Transform Experience Replay", arXiv 1909.10707, which mirrors whole episodes. Here
each sampled transition is mirrored or not, and moved, after hindsight has given it its goal.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import Field as Setting

from ..core import BoolArray, Discrete, FloatArray, Kind, Layout, Signature
from ..core import Settings as BaseSettings
from ..core.compiled import compiled
from ..core.experience import transition_layout
from ..core.settings import LATER
from ..errors import PluginError, UsageError
from .storage import StoredTransitions

SIGNS: Mapping[Kind, tuple[int, ...]] = {
    "scalar": (1,),
    "point": (1, -1, 1),
    "vector": (1, -1, 1),
    "axial": (-1, 1, -1),
    "rotation": (1, -1, 1, -1, 1, -1),
    "wrench": (1, -1, 1, -1, 1, -1),
}
"""Kind of a field -> factors of its columns in a mirror at the plane y = 0.

A rotation R becomes M R M with M = diag(1, -1, 1): the rotation of the mirrored object, with its own y axis reversed.
For a symmetric object this is the same object.
"""


class Augmentation:
    """Changes sampled transitions in place, by the kinds of their fields, see `Field.kind`.

    It is correct if robot and task are the same everywhere on the floor and in a mirror. That holds if actions move the
    tool, except at the edge of the workspace and for an arm's own asymmetry. If actions move joints, it holds only if
    observations say how each moves the tool (`robot.joint_slots`).

    Raises:
        UsageError: the kind of a field is not known, or actions are discrete.
        PluginError: the kinds of a field have fewer columns than the field.
    """

    class Settings(BaseSettings):
        mirror: bool = Setting(True, description="mirror half of the transitions at the plane y = 0 of the world")
        shift: float = Setting(
            0.1, ge=0, le=10, description="largest shift of a transition along x and y of the world, m"
        )
        lift: float = Setting(
            0.0,
            ge=0,
            le=10,
            json_schema_extra=LATER,
            description="largest shift of a transition along z, m; only for tasks in which nothing stands on the floor",
        )
        twist: float = Setting(
            0.0,
            ge=0,
            le=3.1416,
            json_schema_extra=LATER,
            description="largest turn of the frames of tool and goal about their own z, the same for both, rad; for "
            "tasks in which the direction of the tool's x axis is arbitrary, with actions along the axes of the base",
        )
        batches: int | None = Setting(
            None, ge=1, description="number of batches to change; later batches are left as they are; null: change all"
        )

    def __init__(self, settings: Augmentation.Settings, signature: Signature) -> None:
        if isinstance(signature.action, Discrete):
            raise UsageError("discrete actions have no mirror image", setting="buffer.augmentation", hint="remove it")
        self.settings = settings
        self.batches = 0
        """Number of batches so far."""
        changed = {
            "observation": signature.observation,
            "next_observation": signature.observation,
            "desired_goal": signature.desired_goal,
            "action": signature.action,
        }
        columns = transition_layout(signature)
        self._signs, self._axes = np.ones(columns.size, np.float32), np.zeros(columns.size, np.int64)
        """Factors in a mirror; 1, 2 or 3 where a column is an x, y or z of a place, else 0."""
        rotations = list[int]()
        for name, layout in changed.items():
            column = columns.slice(name).start
            for kind, sign, place in _columns(layout):
                self._signs[column] = sign
                self._axes[column] = place + 1 if kind == "point" else 0
                if kind == "rotation" and place == 0:
                    rotations.append(column)
                column += 1
        self._rotations = np.array(rotations, np.int64)
        """Where rotations begin."""

    def apply(self, stored: StoredTransitions, generator: np.random.Generator) -> None:
        """Mirror half of the transitions and move all, each on its own. Columns only for hindsight do not change."""
        size, settings = len(stored.table), self.settings
        self.batches += 1
        if settings.batches is not None and self.batches > settings.batches:
            return
        mirrored = generator.random(size, np.float32) < (0.5 if settings.mirror else 0.0)
        way = np.zeros((size, 3), np.float32)
        way[:, :2] = (2 * generator.random((size, 2), np.float32) - 1) * np.float32(settings.shift)
        if settings.lift:
            way[:, 2] = (2 * generator.random(size, np.float32) - 1) * np.float32(settings.lift)
        self.change(stored, mirrored, way)
        if settings.twist:
            _twist(stored.table, settings.twist * (2 * generator.random(size, np.float32) - 1), self._rotations)

    def change(self, stored: StoredTransitions, mirrored: BoolArray, way: FloatArray) -> None:
        """Mirror the marked transitions (n,), then move each by its vector in `way` (n, 3), in m."""
        _change(stored.table, mirrored, way, self._signs, self._axes)


@compiled
def _change(table: Any, mirrored: Any, way: Any, signs: Any, axes: Any) -> None:
    for row in range(len(table)):
        for column in range(table.shape[1]):
            if mirrored[row]:
                table[row, column] *= signs[column]
            if axes[column]:
                table[row, column] += way[row, axes[column] - 1]


@compiled
def _twist(table: Any, angles: Any, rotations: Any) -> None:
    """Turn the frames whose first two columns begin at `rotations` about their own z by these angles (n,) in rad."""
    for row in range(len(table)):
        k, s = np.cos(angles[row]), np.sin(angles[row])
        for start in rotations:
            for column in range(start, start + 3):
                x, y = table[row, column], table[row, column + 3]
                table[row, column] = k * x + s * y
                table[row, column + 3] = k * y - s * x


def _columns(layout: Layout) -> list[tuple[Kind, int, int]]:
    """Kind, factor in a mirror, and place within its kind, of each column of a layout."""
    columns = list[tuple[Kind, int, int]]()
    for field in layout.fields:
        if field.kind is None:
            raise UsageError(
                f"it is unknown how {field.name} changes if the scene is mirrored or moved",
                setting="buffer.augmentation",
                hint="set it to null; it needs actions that move the tool, and fields that have a `kind`",
            )
        kinds = field.kind if isinstance(field.kind, tuple) else (field.kind,) * field.size
        found = [(kind, sign, place) for kind in kinds for place, sign in enumerate(SIGNS[kind])][: field.size]
        if len(found) < field.size:
            raise PluginError(f"{field.name} has {field.size} columns, its kinds have {len(found)}", setting="task")
        columns += found
    return columns
