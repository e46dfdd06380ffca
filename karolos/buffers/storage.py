"""Where transitions lie: one table of float32 rows, one ring of rows ("lane") per environment; demonstrations in lanes
of their own.

A transition is one row, so that a batch is one gather whose columns are the batch's fields. An episode is contiguous in
its lane, seam included, so that the steps before and after a transition are found by counting, without a search.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..core import Array, Field, FloatArray, Layout, Signature, State, Transitions
from ..errors import UsageError

Slots = np.ndarray
"""Row numbers of the table: (n,) int64. Lane l holds the rows l * lane_size ... (l + 1) * lane_size - 1."""


def row_layout(signature: Signature) -> Layout:
    """The columns of a stored transition of this environment.

    `step`: how many steps of its episode came before. `length`: how many steps its episode took; 0 while it runs.
    """
    observation, achieved, desired = (
        signature.observation.size,
        signature.achieved_goal.size,
        signature.desired_goal.size,
    )
    return Layout(
        (
            Field("observation", observation),
            Field("next_observation", observation),
            Field("achieved_goal", achieved),
            Field("next_achieved_goal", achieved),
            Field("desired_goal", desired),
            Field("action", signature.action.size),
            Field("reward", 1),
            Field("terminated", 1),
            Field("step", 1),
            Field("length", 1),
        )
    )


class Rows:
    """Rows gathered from the table, (n, width), addressed by column name. Valid until the next gather."""

    def __init__(self, layout: Layout) -> None:
        self._columns = {field.name: layout.slice(field.name) for field in layout.fields}
        self.table = np.zeros((0, layout.size), np.float32)
        self._views: dict[str, FloatArray] = {}
        self._numbers: dict[str, FloatArray] = {}

    def resize(self, size: int) -> None:
        if size != self.table.shape[0]:
            self.table = np.empty((size, self.table.shape[1]), np.float32)
            self._views = {name: self.table[:, columns] for name, columns in self._columns.items()}
            self._numbers = {name: view[:, 0] for name, view in self._views.items() if view.shape[1] == 1}

    def __getitem__(self, name: str) -> FloatArray:
        """The named columns of all rows, (n, size of the field): a view, also for writing."""
        return self._views[name]

    def number(self, name: str) -> FloatArray:
        """A field of one column, (n,): a view."""
        return self._numbers[name]


class Storage:
    """A table of transitions, with one ring of rows per environment.

    Args:
        signature: of the environments that fill it.
        capacity: transitions in all, split evenly over the environments; what remains of the division is not used.
        environments: how many lanes.

    Raises:
        UsageError: a lane could not hold one whole episode.
    """

    def __init__(self, signature: Signature, capacity: int, environments: int) -> None:
        self.environments = environments
        self.lane_size = capacity // environments
        if self.lane_size < signature.max_steps:
            raise UsageError(
                f"{capacity} transitions over {environments} environments leave {self.lane_size} for each,"
                f" less than one episode of {signature.max_steps} steps",
                where="buffer.capacity",
                hint=f"set buffer.capacity to {environments * signature.max_steps} or more, or use fewer environments",
            )
        self.layout = row_layout(signature)
        self.table = np.zeros((0, self.layout.size), np.float32)
        self.rows = Rows(self.layout)
        self._incoming = Rows(self.layout)
        self._columns = {field.name: self.layout.slice(field.name) for field in self.layout.fields}
        self._length = self._columns["length"].start
        self.written = np.zeros(0, np.int64)
        """Transitions ever written to each lane."""
        self.running = np.zeros(0, np.int64)
        """Steps so far of the episode that each lane's environment plays."""
        self._counted: tuple[Array, Array] | None = None
        self._full = False
        """Whether every lane is, so that counts stay as they are."""
        self._set_lanes(environments)

    @property
    def lanes(self) -> int:
        """One for each environment, then those that hold demonstrations."""
        return len(self.written)

    def _set_lanes(self, lanes: int) -> None:
        """Have so many lanes; those that stay keep what they hold. Memory is taken when it is written to."""
        table, written, running = self.table, self.written, self.running
        stay = min(lanes, len(written))
        self.table = np.zeros((self.lane_size * lanes, self.layout.size), np.float32)
        self.written, self.running = np.zeros(lanes, np.int64), np.zeros(lanes, np.int64)
        self.written[:stay], self.running[:stay] = written[:stay], running[:stay]
        self._counted = None
        used = self.used()
        self.table[used] = table[used]

    @property
    def filled(self) -> np.ndarray:
        """Transitions that each lane holds: (lanes,)."""
        return np.minimum(self.written, self.lane_size)

    def __len__(self) -> int:
        return int(self._counts()[0][-1])

    def _counts(self) -> tuple[Array, Array]:
        """How many transitions lie in each lane and those before it, and what leads from a rank to a slot: (lanes,)."""
        if self._counted is None:
            filled = self.filled
            ends = np.cumsum(filled)
            self._counted = ends, np.arange(self.lanes) * self.lane_size - ends + filled
            self._full = bool((filled == self.lane_size).all())
        return self._counted

    @property
    def kept(self) -> int:
        """Transitions of demonstrations."""
        return int(self.written[self.environments :].sum())

    def add(self, transitions: Transitions) -> Slots:
        """Store one transition of each environment named; returns where. Each environment is named once per call."""
        lanes = transitions.environment
        rows = self._incoming
        rows.resize(lanes.size)
        for name in ("observation", "next_observation", "achieved_goal", "next_achieved_goal", "desired_goal"):
            rows[name][:] = getattr(transitions, name)
        rows["action"][:] = transitions.action
        rows.number("reward")[:] = transitions.reward
        rows.number("terminated")[:] = transitions.terminated
        rows.number("step")[:] = self.running[lanes]
        rows.number("length")[:] = 0
        slots: Slots = lanes * self.lane_size + self.written[lanes] % self.lane_size
        self.table[slots] = rows.table
        self.written[lanes] += 1
        self.running[lanes] += 1
        if not self._full:
            self._counted = None
        for lane in lanes[np.asarray(transitions.terminated | transitions.truncated, np.bool_)].tolist():
            self._end_episode(lane)
        return slots

    def add_demonstrations(self, episodes: Sequence[Transitions]) -> Slots:
        """Store whole episodes in lanes of their own, where nothing overwrites them; returns where."""
        lengths = [len(episode.reward) for episode in episodes]
        lane, room, found = self.lanes - 1, 0, []
        places = []
        for length in lengths:
            if length > room:
                lane, room = lane + 1, self.lane_size
            places.append(lane)
            room -= length
        self._set_lanes(lane + 1)
        for episode, length, lane in zip(episodes, lengths, places, strict=True):
            for step in range(length):
                one = {name: field[step : step + 1] for name, field in episode._asdict().items()}
                found.append(self.add(Transitions(**one | {"environment": np.array([lane])})))
            self.cut(np.array([lane]))
        return np.concatenate([*found, np.zeros(0, np.int64)])

    def demonstrated(self, slots: Slots) -> FloatArray | None:
        """1 where a slot holds a demonstration, else 0: (n,); None where there are none at all."""
        if self.lanes == self.environments:
            return None
        return np.asarray(slots >= self.environments * self.lane_size, np.float32)

    def cut(self, lanes: np.ndarray) -> None:
        """End the running episodes of these lanes as they stand; a lane without one stays as it is."""
        for lane in lanes[self.running[lanes] > 0].tolist():
            self._end_episode(lane)

    def _end_episode(self, lane: int) -> None:
        """Write the episode's length, now that it is known, beside each of its transitions."""
        steps = int(self.running[lane])
        last = int(self.written[lane]) - 1
        places = np.arange(last - min(steps, self.lane_size) + 1, last + 1) % self.lane_size
        self.table[lane * self.lane_size + places, self._length] = steps
        self.running[lane] = 0

    def at(self, ranks: Array) -> Slots:
        """The slots of the transitions with these ranks (n,), counted lane by lane over all that is stored."""
        ends, offsets = self._counts()
        # A lane fills from its first row on, so the k-th transition of a lane lies in its k-th row.
        return np.asarray(ranks + offsets[np.searchsorted(ends, ranks, side="right")])

    def names(self, slots: Slots) -> Slots:
        """A number for the transition that lies in each slot now, which no later one there shares: (n,) int64."""
        return np.asarray(slots + self._turns(slots) * len(self.table))

    def resolve(self, names: Slots) -> tuple[Slots, Array]:
        """The slots that `names` gave numbers for, and whether the same transition still lies there: (n,) both."""
        slots = names % len(self.table)
        return slots, self._turns(slots) == names // len(self.table)

    def _turns(self, slots: Slots) -> Array:
        """How often each slot was overwritten."""
        lanes, places = np.divmod(slots, self.lane_size)
        return np.asarray((self.written[lanes] - 1 - places) // self.lane_size)

    def gather(self, slots: Slots) -> Rows:
        """The transitions at these slots; the rows are overwritten by the next call."""
        self.rows.resize(slots.size)
        np.take(self.table, slots, axis=0, out=self.rows.table, mode="clip")
        return self.rows

    def column(self, name: str, slots: Slots) -> FloatArray:
        """One field of the transitions at these slots, (n, size of the field): a copy."""
        found: FloatArray = self.table[slots, self._columns[name]]
        return found

    def lengths(self, slots: Slots, rows: Rows) -> Array:
        """Steps stored of each row's episode, whether it has ended or not: (n,) int64."""
        lengths = rows.number("length").astype(np.int64)
        return np.where(lengths > 0, lengths, self.running[slots // self.lane_size])

    def older(self, slots: Slots) -> Array:
        """How many transitions of the same lane, written before each one, are still there: (n,) int64."""
        lanes = slots // self.lane_size
        age = (self.written[lanes] - 1 - slots) % self.lane_size  # lane * lane_size vanishes in the modulus
        return np.asarray(self.filled[lanes] - 1 - age)

    def shifted(self, slots: Slots, offset: Array) -> Slots:
        """The slots that lie `offset` steps later (earlier, if negative) in the same lanes."""
        base = slots - slots % self.lane_size
        return np.asarray(base + (slots - base + offset) % self.lane_size)

    def state(self) -> State:
        used = self.used()
        return {"table": self.table[used], "written": self.written.copy(), "running": self.running.copy()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of a buffer of another shape."""
        written, table = np.asarray(state["written"]), np.asarray(state["table"])
        fits = written.ndim == 1 and len(written) >= self.environments and table.shape[1:] == self.table.shape[1:]
        if not fits or table.shape[0] != np.minimum(written, self.lane_size).sum():
            raise UsageError(
                "the stored buffer has another number of environments, capacity or kind of transition",
                where="buffer",
                hint="resume with the spec the run was started with",
            )
        self._set_lanes(len(written))
        self.written[:] = written
        self.running[:] = state["running"]
        self._counted = None
        self.table[self.used()] = table

    def used(self) -> Slots:
        """All slots that hold something, lane by lane."""
        return np.concatenate(
            [lane * self.lane_size + np.arange(count) for lane, count in enumerate(self.filled.tolist())]
        )
