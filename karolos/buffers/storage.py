"""Storage of transitions: a table of float32 rows, with one ring per environment and more rings for demonstrations.

A transition is one row, so a batch is one gather whose columns are the batch's fields. An episode is contiguous in its
ring, also across the ring's end, so index arithmetic finds the steps before and after a transition.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..core import Array, FloatArray, Layout, Signature, State, Transitions
from ..core.experience import SCALARS, transition_layout
from ..errors import UsageError

Slots = NDArray[np.int64]
"""Row numbers of the table: (n,) int64. Ring r holds the rows r * ring_size ... (r + 1) * ring_size - 1."""


class StoredTransitions(dict[str, FloatArray]):
    """Transitions of the table by the names of its columns, as writable views. Valid until the next gather.

    A field is (n, size of the field), one of `SCALARS` is (n,).
    """

    def __init__(self, layout: Layout, size: int = 0) -> None:
        self.layout = layout
        self.table = np.empty((size, layout.size), np.float32)
        for field in layout.fields:
            view = self.table[:, layout.slice(field.name)]
            self[field.name] = view[:, 0] if field.name in SCALARS else view

    def resized(self, size: int) -> StoredTransitions:
        """These transitions, or new ones if their number is not `size`."""
        return self if size == len(self.table) else StoredTransitions(self.layout, size)


class Storage:
    """A table of transitions, with one ring of rows per environment.

    Args:
        capacity: transitions in total, split evenly over the environments; the remainder of the division is unused.

    Raises:
        UsageError: a ring is shorter than one episode.
    """

    def __init__(self, signature: Signature, capacity: int, environments: int) -> None:
        self.environments = environments
        self.ring_size = capacity // environments
        if self.ring_size < signature.max_steps:
            raise UsageError(
                f"{capacity} transitions over {environments} environments leave {self.ring_size} for each,"
                f" less than one episode of {signature.max_steps} steps",
                setting="buffer.capacity",
                hint=f"set buffer.capacity to {environments * signature.max_steps} or more, or use fewer environments",
            )
        self.layout = transition_layout(signature)
        self.table = np.zeros((0, self.layout.size), np.float32)
        self._gathered, self._incoming = StoredTransitions(self.layout), StoredTransitions(self.layout)
        self._columns: dict[str, int | slice] = {
            field.name: self.layout.slice(field.name) for field in self.layout.fields
        }
        self._columns |= {name: self.layout.slice(name).start for name in SCALARS}
        self.written = np.zeros(0, np.int64)
        """Transitions written to each ring since the start: (rings,)."""
        self.running = np.zeros(0, np.int64)
        """Steps of the running episode in each ring: (rings,)."""
        self._cached_counts: tuple[Array, Array] | None = None
        self._full = False
        """Whether every ring is full, so that the counts no longer change."""
        self._set_rings(environments)

    @property
    def rings(self) -> int:
        """Number of rings: one per environment, then those of demonstrations."""
        return len(self.written)

    def _set_rings(self, rings: int) -> None:
        """Change the number of rings and copy the contents of those that remain. Memory is allocated on first write."""
        table, written, running = self.table, self.written, self.running
        remaining = min(rings, len(written))
        self.table = np.zeros((self.ring_size * rings, self.layout.size), np.float32)
        self.written, self.running = np.zeros(rings, np.int64), np.zeros(rings, np.int64)
        self.written[:remaining], self.running[:remaining] = written[:remaining], running[:remaining]
        self._cached_counts = None
        used = self.used()
        self.table[used] = table[used]

    @property
    def filled(self) -> NDArray[np.int64]:
        """Transitions in each ring: (rings,)."""
        return np.minimum(self.written, self.ring_size)

    def __len__(self) -> int:
        return int(self._counts()[0][-1])

    def _counts(self) -> tuple[Array, Array]:
        """Cumulative number of transitions over the rings, and each ring's offset from rank to slot: (rings,)."""
        if self._cached_counts is None:
            filled = self.filled
            ends = np.cumsum(filled)
            self._cached_counts = ends, np.arange(self.rings) * self.ring_size - ends + filled
            self._full = bool((filled == self.ring_size).all())
        return self._cached_counts

    @property
    def demonstrations(self) -> int:
        """Number of demonstrated transitions."""
        return int(self.written[self.environments :].sum())

    def add(self, transitions: Transitions) -> Slots:
        """Store at most one transition of each environment; returns their slots."""
        rings = transitions.environment
        self._incoming = incoming = self._incoming.resized(rings.size)
        for name, column in incoming.items():
            if name not in {"step", "length"}:
                column[:] = getattr(transitions, name)
        incoming["step"][:] = self.running[rings]
        incoming["length"][:] = 0
        slots: Slots = rings * self.ring_size + self.written[rings] % self.ring_size
        self.table[slots] = incoming.table
        self.written[rings] += 1
        self.running[rings] += 1
        if not self._full:
            self._cached_counts = None
        for ring in rings[np.asarray(transitions.terminated | transitions.truncated, np.bool_)].tolist():
            self._end_episode(ring)
        return slots

    def add_demonstrations(self, episodes: Sequence[Transitions]) -> Slots:
        """Store whole episodes in additional rings, which nothing overwrites; returns their slots."""
        ring, space = self.rings - 1, 0
        rings = []
        for episode in episodes:
            if len(episode.reward) > space:
                ring, space = ring + 1, self.ring_size
            rings.append(ring)
            space -= len(episode.reward)
        self._set_rings(ring + 1)
        slots = [np.zeros(0, np.int64)]
        for episode, ring in zip(episodes, rings, strict=True):
            for step in range(len(episode.reward)):
                row = {name: field[step : step + 1] for name, field in episode._asdict().items()}
                slots.append(self.add(Transitions(**row | {"environment": np.array([ring])})))
            self.cut(np.array([ring]))
        return np.concatenate(slots)

    def demonstrated(self, slots: Slots) -> FloatArray | None:
        """1 where a slot holds a demonstration, else 0: (n,); None without demonstrations."""
        if self.rings == self.environments:
            return None
        return np.asarray(slots >= self.environments * self.ring_size, np.float32)

    def cut(self, rings: NDArray[np.int64]) -> None:
        """End the running episodes of these rings; a ring without a running episode does not change."""
        for ring in rings[self.running[rings] > 0].tolist():
            self._end_episode(ring)

    def _end_episode(self, ring: int) -> None:
        """Write the episode's length into each of its rows."""
        steps = int(self.running[ring])
        last = int(self.written[ring]) - 1
        places = np.arange(last - min(steps, self.ring_size) + 1, last + 1) % self.ring_size
        self.table[ring * self.ring_size + places, self._columns["length"]] = steps
        self.running[ring] = 0

    def at(self, ranks: Array) -> Slots:
        """The slots of the transitions with these ranks (n,): 0 .. len - 1, counted ring by ring."""
        ends, offsets = self._counts()
        # A ring fills from its first row, so its k-th transition is in its k-th row.
        return np.asarray(ranks + offsets[np.searchsorted(ends, ranks, side="right")])

    def identifiers(self, slots: Slots) -> Slots:
        """Unique numbers of the transitions in these slots, (n,) int64: an overwriting transition gets another."""
        return np.asarray(slots + self._overwritten(slots) * len(self.table))

    def resolve(self, identifiers: Slots) -> tuple[Slots, Array]:
        """The slots of these transitions, and whether each is still stored: (n,) both."""
        slots = identifiers % len(self.table)
        return slots, self._overwritten(slots) == identifiers // len(self.table)

    def _overwritten(self, slots: Slots) -> Array:
        """Number of times that each slot was overwritten."""
        rings, places = np.divmod(slots, self.ring_size)
        return np.asarray((self.written[rings] - 1 - places) // self.ring_size)

    def gather(self, slots: Slots) -> StoredTransitions:
        """The transitions at these slots; the next call overwrites them."""
        self._gathered = self._gathered.resized(slots.size)
        np.take(self.table, slots, axis=0, out=self._gathered.table, mode="clip")
        return self._gathered

    def column(self, name: str, slots: Slots) -> FloatArray:
        """One field of the transitions at these slots, as in `StoredTransitions`: a copy."""
        column: FloatArray = self.table[slots, self._columns[name]]
        return column

    def lengths(self, slots: Slots, stored: StoredTransitions) -> Array:
        """Steps of each transition's episode, so far if it still runs: (n,) int64."""
        lengths = stored["length"].astype(np.int64)
        return np.where(lengths > 0, lengths, self.running[slots // self.ring_size])

    def older(self, slots: Slots) -> Array:
        """Number of stored transitions in the same ring that are older than each one: (n,) int64."""
        rings = slots // self.ring_size
        age = (self.written[rings] - 1 - slots) % self.ring_size  # the modulus removes ring * ring_size
        return np.asarray(self.filled[rings] - 1 - age)

    def shifted(self, slots: Slots, offset: Array) -> Slots:
        """The slots `offset` steps later in the same rings; earlier if negative."""
        base = slots - slots % self.ring_size
        return np.asarray(base + (slots - base + offset) % self.ring_size)

    def state(self) -> State:
        used = self.used()
        return {"table": self.table[used], "written": self.written.copy(), "running": self.running.copy()}

    def load_state(self, state: State) -> None:
        """Load a state. Raises UsageError if it belongs to a buffer of another shape."""
        written, table = np.asarray(state["written"]), np.asarray(state["table"])
        fits = written.ndim == 1 and len(written) >= self.environments and table.shape[1:] == self.table.shape[1:]
        if not fits or table.shape[0] != np.minimum(written, self.ring_size).sum():
            raise UsageError(
                "the stored buffer has another number of environments, capacity or kind of transition",
                setting="buffer",
                hint="resume with the spec the run was started with",
            )
        self._set_rings(len(written))
        self.written[:] = written
        self.running[:] = state["running"]
        self._cached_counts = None
        self.table[self.used()] = table

    def used(self) -> Slots:
        """All slots in use, ring by ring."""
        return np.concatenate(
            [ring * self.ring_size + np.arange(count) for ring, count in enumerate(self.filled.tolist())]
        )
