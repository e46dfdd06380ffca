"""What stands where in a flat vector, and which actions a discrete set has."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Field:
    """A named run of numbers in a flat vector."""

    name: str
    size: int
    unit: str = "1"


@dataclass(frozen=True)
class Layout:
    """The fields of a flat float32 vector, in order, so that parts can be addressed by name."""

    fields: tuple[Field, ...] = ()

    def __post_init__(self) -> None:
        names = [field.name for field in self.fields]
        if len(set(names)) != len(names):
            raise ValueError(f"a layout names a field twice: {names}")

    @property
    def size(self) -> int:
        return sum(field.size for field in self.fields)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(field.name for field in self.fields)

    def slice(self, name: str) -> slice:
        """Where the field lies in the vector. Raises KeyError for a name the layout does not have."""
        start = 0
        for field in self.fields:
            if field.name == name:
                return slice(start, start + field.size)
            start += field.size
        raise KeyError(f"no field {name!r}; the layout has {', '.join(self.names) or 'none'}")

    def __add__(self, other: Layout) -> Layout:
        return Layout(self.fields + other.fields)


NO_FIELDS = Layout()


@dataclass(frozen=True)
class Discrete:
    """A discrete action set: an action is the index of one of these labels."""

    labels: tuple[str, ...]

    @property
    def size(self) -> int:
        """Columns that one stored action takes."""
        return 1
