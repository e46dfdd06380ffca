"""From the arrays of an environment or a buffer to the tensors that agents compute with, and back."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..core import Batch, FloatArray
from .normaliser import Normaliser

ALL_OBSERVED = 500
"""The batches of this many first updates all enter the statistics of the normaliser."""
OBSERVED_EVERY = 4
"""Later one batch in this many does: the statistics hardly move, and it takes 2 % of an update."""
REPORT_EVERY = 8
"""One update in this many reports metrics: computing them takes 2 % of an update."""


class TensorBatch(NamedTuple):
    """A batch on the device. Observation and goal stand side by side, normalised: the input of a network."""

    both_inputs: Tensor
    """(2 n, columns): `next_input` above `input`."""
    next_input: Tensor
    input: Tensor
    action: Tensor
    reward: Tensor
    discount: Tensor
    """Of the next state's value; 0 after a terminated transition."""
    weight: Tensor
    """Of each transition in a loss: its importance weight / n. A loss is the weighted sum over the batch."""
    demonstrated: Tensor | None
    """1 where the action is to be imitated, else 0: (n,)."""


def is_observed(update: int) -> bool:
    """Whether the batch of this update (the first is 0) enters the statistics of the normaliser."""
    return update < ALL_OBSERVED or update % OBSERVED_EVERY == 0


def tensor_batch(batch: Batch, normaliser: Normaliser, device: torch.device, *, observe: bool = True) -> TensorBatch:
    """The batch as tensors. With `observe` its inputs, relabelled goals included, first enter the statistics."""
    count, columns = batch.observation.shape
    rows = np.empty((2 * count, columns + batch.desired_goal.shape[1]), np.float32)
    rows[:count, :columns] = batch.next_observation
    rows[count:, :columns] = batch.observation
    rows[:count, columns:] = rows[count:, columns:] = batch.desired_goal

    def tensor(array: FloatArray) -> Tensor:
        return torch.from_numpy(array).to(device)

    unscaled = tensor(rows)
    if observe:
        normaliser.update(unscaled[count:])
    both = normaliser(unscaled)
    return TensorBatch(
        both_inputs=both,
        next_input=both[:count],
        input=both[count:],
        action=tensor(batch.action),
        reward=tensor(batch.reward),
        discount=tensor(batch.discount * (1 - batch.terminated)),
        weight=tensor(batch.weight / np.float32(count)),
        demonstrated=None if batch.demonstrated is None else tensor(batch.demonstrated),
    )


def network_input(
    observation: FloatArray, desired_goal: FloatArray, normaliser: Normaliser, device: torch.device
) -> Tensor:
    """Observations (n, o) and goals (n, g) side by side, normalised; the statistics stay unchanged."""
    rows = torch.cat((torch.from_numpy(observation), torch.from_numpy(desired_goal)), 1)
    return normaliser(rows.to(device))


def to_array(tensor: Tensor) -> FloatArray:
    array: FloatArray = tensor.cpu().numpy()
    return array


def saturation(action: Tensor) -> Tensor:
    """Fraction of the action's numbers beyond +- 0.99."""
    return (action.abs() > 0.99).float().mean()
