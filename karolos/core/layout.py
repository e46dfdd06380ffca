"""The names of the columns of flat vectors, and discrete action sets."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Kind = Literal["scalar", "point", "vector", "axial", "rotation", "wrench"]


@dataclass(frozen=True)
class Field:
    """Consecutive columns of a flat vector under one name."""

    name: str
    size: int
    unit: str = "1"
    critic_only: bool = False
    """Whether a critic alone may observe it, so that a policy acts without. Such fields stand at the end."""
    kind: Kind | tuple[Kind, ...] | None = None
    """What becomes of it when everything is moved along the floor or seen in a mirror, see `augmentation`.

    scalar: nothing. point: a place in the world (x, y or x, y, z). vector: a difference of places, a velocity, a force,
    a direction. axial: a turn, an angular velocity, a torque (about x, y, z or about z alone). rotation: the first two
    columns of a rotation matrix. wrench: a vector, then an axial one. Several: one after the other, of 3 columns, 6
    columns (rotation, wrench) or one (scalar). None: it is not known.
    """


@dataclass(frozen=True)
class Layout:
    """The fields of a flat float32 vector, in order."""

    fields: tuple[Field, ...] = ()

    def __post_init__(self) -> None:
        names = [field.name for field in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"a layout has a field name twice: {names}")

    @property
    def size(self) -> int:
        return sum(field.size for field in self.fields)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(field.name for field in self.fields)

    @property
    def acting(self) -> Layout:
        """What a policy observes: the fields that are not for a critic alone."""
        return Layout(tuple(field for field in self.fields if not field.critic_only))

    def slice(self, name: str) -> slice:
        """The columns of the field. Raises KeyError for an unknown name."""
        start = 0
        for field in self.fields:
            if field.name == name:
                return slice(start, start + field.size)
            start += field.size
        raise KeyError(f"no field {name!r}; the layout has {', '.join(self.names) or 'none'}")

    def column(self, place: int) -> str:
        """What a column is called: its field, and its place there from 0."""
        names = [f"{field.name}[{inside}]" for field in self.fields for inside in range(field.size)]
        return names[place]

    def __add__(self, other: Layout) -> Layout:
        return Layout(self.fields + other.fields)


NO_FIELDS = Layout()


@dataclass(frozen=True)
class Discrete:
    """A discrete action set: an action is the index of one of these labels."""

    labels: tuple[str, ...]

    @property
    def size(self) -> int:
        """Columns of a stored action."""
        return 1
