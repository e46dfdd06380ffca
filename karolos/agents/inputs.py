"""Conversion of the arrays of environments and buffers to the normalised tensors of agents, and back."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..core import Batch, FloatArray, State

ALL_OBSERVED = 500
"""Number of first updates whose batches all enter the statistics of the normaliser."""
OBSERVED_EVERY = 4
"""Later only every n-th batch enters them: the statistics hardly move, and it takes 2 % of an update."""
ADOPTED_ROWS = 1_000_000
"""Number of rows that an exported policy's statistics stand for. Runs of 30,000 updates see twice this number."""
INPUT_CLIP = 5.0
"""Default bound of normalised inputs. Source: OpenAI baselines, HER (norm_clip)."""
SMALLEST_SPREAD = 0.01
"""Lower bound of a column's standard deviation. Source: OpenAI baselines, HER (norm_eps)."""
NONE_MISSING = slice(0, 0)
"""No columns: only the goals enter, not their difference."""


class Normaliser:
    """Running mean and standard deviation of columns (merged as in Chan et al. 1979).

    Only `update` changes the statistics; acting and tests leave them unchanged.

    Args:
        clip: normalised columns are clipped to +- this.
        missing: the columns with desired minus achieved goal.
        fine: factor of these columns over their spread; not the clip but tanh bounds them.
        alike: columns of several things of one kind, a row each: divided by the root mean square over all of them.
    """

    def __init__(
        self,
        columns: int,
        device: torch.device | str,
        *,
        clip: float = INPUT_CLIP,
        missing: slice = NONE_MISSING,
        fine: float = 1.0,
        alike: Sequence[Sequence[int]] = (),
    ) -> None:
        self.clip, self.missing, self.fine = clip, missing, fine
        self._alike = torch.tensor(alike, dtype=torch.int64, device=device)
        self.count = 0
        """Rows seen so far."""
        self.mean = torch.zeros(columns, dtype=torch.float64, device=device)
        self._squares = torch.zeros(columns, dtype=torch.float64, device=device)
        self.shift = torch.zeros(columns, device=device)
        """The shift in `(x - shift) * scale`: float32, (columns,)."""
        self.scale = torch.ones(columns, device=device)

    @property
    def spread(self) -> Tensor:
        """Standard deviation of each column, at least SMALLEST_SPREAD; 1 before the first update."""
        if not self.count:
            return torch.ones_like(self._squares)
        return (self._squares / self.count).sqrt_().clamp_(min=SMALLEST_SPREAD)

    def update(self, rows: Tensor) -> None:
        """Add rows (n, columns) to the statistics."""
        self.count += rows.shape[0]
        deviation = rows.double().sub_(self.mean)  # from the current mean, so that the sums of squares stay exact
        sums = deviation.sum(0)
        change = sums / self.count
        self._squares.add_(deviation.square_().sum(0)).addcmul_(sums, change, value=-1)
        self.mean.add_(change)
        self._refresh()

    def _refresh(self) -> None:
        self.shift.copy_(self.mean)
        self.scale.copy_(self.spread.reciprocal_())
        self.shift[self.missing] = 0.0
        if self.count:  # before the first update inputs pass unchanged, also in an agent that was loaded
            self.scale[self.missing] *= self.fine
            if len(self._alike):
                square = (self._squares / self.count + self.mean.square())[self._alike].mean(0)
                self.shift[self._alike] = 0.0
                self.scale[self._alike] = square.sqrt().clamp_(min=SMALLEST_SPREAD).reciprocal().float()

    def __call__(self, rows: Tensor) -> Tensor:
        """(n, columns) normalised and bounded; a new tensor. With fewer columns: the first ones."""
        columns = rows.shape[1]
        scaled = (rows - self.shift[:columns]).mul_(self.scale[:columns])
        if self.missing == NONE_MISSING:
            return scaled.clamp_(-self.clip, self.clip)
        squashed = torch.tanh(scaled[:, self.missing])
        scaled.clamp_(-self.clip, self.clip)[:, self.missing] = squashed
        return scaled

    def adopt(self, shift: Tensor, scale: Tensor) -> None:
        """Adopt the statistics that give `(x - shift) * scale`, as those of ADOPTED_ROWS rows.

        Further columns, which only critics observe, keep mean 0 and deviation 1.
        """
        mean, squares = torch.zeros_like(self.mean), torch.full_like(self.mean, ADOPTED_ROWS)
        mean[: len(shift)], squares[: len(scale)] = shift, ADOPTED_ROWS / scale.double().square()
        squares[self.missing] *= self.fine**2
        self.load_state({"count": ADOPTED_ROWS, "mean": mean, "squares": squares})

    def state(self) -> State:
        return {"count": self.count, "mean": self.mean.clone(), "squares": self._squares.clone()}

    def load_state(self, state: State) -> None:
        self.count = int(state["count"])
        self.mean.copy_(torch.as_tensor(state["mean"]))
        self._squares.copy_(torch.as_tensor(state["squares"]))
        self._refresh()


class TensorBatch(NamedTuple):
    """A batch on the device. Observation and goal are joined and normalised: the input of a network.

    The critics' inputs end with the columns that only critics observe.
    """

    both_inputs: Tensor
    """(2 n, columns): `next_input` above `input`."""
    next_input: Tensor
    input: Tensor
    next_critic_input: Tensor
    critic_input: Tensor
    action: Tensor
    reward: Tensor
    discount: Tensor
    """The discount of the next state's value; 0 after a terminated transition."""
    weight: Tensor
    """The weight of each transition in a loss: importance weight / n. A loss is the weighted sum over the batch."""
    demonstrated: Tensor | None
    """1 where the action is to be imitated, else 0: (n,)."""


def tensor_batch(
    batch: Batch,
    normaliser: Normaliser,
    device: torch.device,
    update: int = 0,
    critic_only: int = 0,
    observed_goal: tuple[Sequence[int], Sequence[int]] = ((), ()),
) -> TensorBatch:
    """The batch of an agent's update (the first is 0) as tensors.

    Before that, its inputs with the relabelled goals enter the statistics: in every early update, later in some.
    `critic_only`: how many of the last columns of observations the policy does not see; `observed_goal`: see Signature.
    """
    count, size = batch.observation.shape
    columns = size - critic_only
    goals = columns + batch.desired_goal.shape[1]
    width = goals + len(observed_goal[0])
    rows = np.empty((2 * count, width + critic_only), np.float32)
    rows[:count, :columns] = batch.next_observation[:, :columns]
    rows[count:, :columns] = batch.observation[:, :columns]
    rows[:count, columns:goals] = rows[count:, columns:goals] = batch.desired_goal
    if observed_goal[0]:
        places, seen = observed_goal
        rows[:, goals:width] = rows[:, columns:goals][:, places] - rows[:, seen]
    rows[:count, width:] = batch.next_observation[:, columns:]
    rows[count:, width:] = batch.observation[:, columns:]

    def tensor(array: FloatArray) -> Tensor:
        return torch.from_numpy(array).to(device)

    unscaled = tensor(rows)
    if update < ALL_OBSERVED or update % OBSERVED_EVERY == 0:
        normaliser.update(unscaled[count:])
    full = normaliser(unscaled)
    both = full[:, :width].contiguous()  # the same tensor where critics see no more
    return TensorBatch(
        both_inputs=both,
        next_input=both[:count],
        input=both[count:],
        next_critic_input=full[:count],
        critic_input=full[count:],
        action=tensor(batch.action),
        reward=tensor(batch.reward),
        discount=tensor(batch.discount * (1 - batch.terminated)),
        weight=tensor(batch.weight / np.float32(count)),
        demonstrated=None if batch.demonstrated is None else tensor(batch.demonstrated),
    )
