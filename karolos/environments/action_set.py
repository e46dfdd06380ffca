"""Discrete actions: the index that an array names, and a discrete action set for robots."""

from __future__ import annotations

import numpy as np

from ..core import Array, Discrete, Field, Layout

OPENING_FIELD = "gripper_opening"
"""The field of a robot's action with the target of the gripper, -1 closed and 1 open; all other fields are changes."""


def action_index(action: Array, actions: Discrete, who: str) -> int:
    """The index in `actions`: an integer, or one float with an integer value, as stored actions have.

    Raises ValueError, in the name of `who`, for anything else.
    """
    action = np.asarray(action)
    index = float(action.item()) if action.size == 1 else np.nan
    if not (index.is_integer() and 0 <= index < len(actions.labels)):
        raise ValueError(f"{who}: an action is a number from 0 to {len(actions.labels) - 1}, not {action.tolist()}")
    return int(index)


class ActionSet:
    """A robot's actions as a discrete set: one full step along each axis in both directions, and "nothing" as the last.

    The gripper's opening is a position, not a change: one action closes or opens it, and every other action keeps the
    last command.
    """

    def __init__(self, layout: Layout) -> None:
        self._size = layout.size
        self._opening = layout.slice(OPENING_FIELD).start if OPENING_FIELD in layout.names else None
        self._last_opening = 0.0
        steps = [f"{axis} {sign}" for field in layout.fields for axis in _axes(field) for sign in "+-"]
        self.actions = Discrete((*steps, "nothing"))

    def reset(self, opening: float) -> None:
        """Start an episode with this command to the gripper: its opening in [0, 1]."""
        self._last_opening = 2 * opening - 1

    def values(self, index: int) -> list[float]:
        """The continuous action of `index`: numbers in [-1, 1]."""
        values = [0.0] * self._size
        axis, negative = divmod(index, 2)
        if axis < self._size:
            values[axis] = -1.0 if negative else 1.0
        if self._opening is not None:
            if axis == self._opening:
                self._last_opening = values[axis]
            values[self._opening] = self._last_opening
        return values


def _axes(field: Field) -> list[str]:
    """A name for each number of a field: x, y, z for positions and their changes, else 1, 2, ..."""
    if field.size == 1:
        return [field.name]
    names = "xyz" if field.size == 3 and "position" in field.name else range(1, field.size + 1)
    return [f"{field.name} {name}" for name in names]
