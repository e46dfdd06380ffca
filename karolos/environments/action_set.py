"""Discrete actions: which one an array names, and a discrete set for robots."""

from __future__ import annotations

import numpy as np

from ..core import Array, Discrete, Field, Layout

OPENING = "gripper_opening"
"""The field of a robot's action that says where the gripper shall be, -1 closed and 1 open; all others are changes."""
NOTHING = "nothing"


def chosen(action: Array, actions: Discrete, who: str) -> int:
    """The index that an action names: an integer, or one float that holds it exactly, as stored actions do.

    Raises ValueError, in the name of `who`, where it is none of the set.
    """
    action = np.asarray(action)
    index = float(action.item()) if action.size == 1 else np.nan
    if not (index.is_integer() and 0 <= index < len(actions.labels)):
        raise ValueError(f"{who}: an action is a number from 0 to {len(actions.labels) - 1}, not {action.tolist()}")
    return int(index)


class ActionSet:
    """What a robot can do, as a discrete set: one full step along each axis in both directions, and nothing.

    The opening of a gripper is a place, not a change: one step closes or opens it all the way, and every other action
    leaves it where it was last asked to be. "Nothing" is the last of the set.

    Args:
        layout: of the robot's continuous action.
    """

    def __init__(self, layout: Layout) -> None:
        self._size = layout.size
        self._opening = layout.slice(OPENING).start if OPENING in layout.names else None
        self._held = 0.0
        steps = [f"{axis} {sign}" for field in layout.fields for axis in _axes(field) for sign in "+-"]
        self.actions = Discrete((*steps, NOTHING))

    def reset(self, opening: float) -> None:
        """A new episode begins with the gripper at this opening, in [0, 1]."""
        self._held = 2 * opening - 1

    def values(self, index: int) -> list[float]:
        """The continuous action that stands behind `index`: numbers in [-1, 1]."""
        values = [0.0] * self._size
        axis, back = divmod(index, 2)
        if axis < self._size:
            values[axis] = -1.0 if back else 1.0
        if self._opening is not None:
            if axis == self._opening:
                self._held = values[axis]
            values[self._opening] = self._held
        return values


def _axes(field: Field) -> list[str]:
    """A name for each number of a field: x, y, z for places and their changes, else 1, 2, ..."""
    if field.size == 1:
        return [field.name]
    names = "xyz" if field.size == 3 and "position" in field.name else range(1, field.size + 1)
    return [f"{field.name} {name}" for name in names]
