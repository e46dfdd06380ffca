"""What continuous-control agents share around their losses: a batch on the device, exploration, bounds of values."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..core import Batch, Discrete, FloatArray, Signature
from ..errors import UsageError
from .normaliser import Normaliser

ALL_OBSERVED = 500
"""Updates of which each batch enters the statistics that inputs are normalised by."""
OBSERVED_EVERY = 4
"""And after them one of so many: thirteen operations that take 2 % of an update."""


class Fed(NamedTuple):
    """A batch as tensors, before anything is computed from it."""

    rows: Tensor
    """Observation and goal side by side, (2 n, columns): where the transitions lead, then where they begin."""
    action: Tensor
    reward: Tensor
    discount: Tensor
    """0 where nothing lies beyond."""
    weight: Tensor
    share: Tensor
    """Of each transition in a loss, which is a weighted mean: weight / n."""
    demonstrated: Tensor | None
    """1 where an expert took the action, else 0: (n,)."""

    def to(self, device: torch.device) -> Fed:
        """The same, there."""
        return self._each(lambda field: field.to(device))

    def clone(self) -> Fed:
        """A copy in memory of its own."""
        return self._each(torch.clone)

    def _each(self, change: Callable[[Tensor], Tensor]) -> Fed:
        changed: dict[str, Any] = {
            name: None if field is None else change(field) for name, field in self._asdict().items()
        }
        return Fed(**changed)


class Inputs(NamedTuple):
    """A batch on the device; observation and goal side by side, normalised. Other fields as in `Fed`."""

    observed: Tensor
    """(2 n, columns): where the transitions lead, then where they begin."""
    there: Tensor
    here: Tensor
    action: Tensor
    reward: Tensor
    discount: Tensor
    weight: Tensor
    share: Tensor
    demonstrated: Tensor | None


def is_observed(update: int) -> bool:
    """Whether the batch of this update (the first is 0) enters the statistics: later ones hardly move them."""
    return update < ALL_OBSERVED or update % OBSERVED_EVERY == 0


def feed(batch: Batch) -> Fed:
    """The batch as tensors, on the CPU."""
    count, columns = batch.observation.shape
    rows = np.empty((2 * count, columns + batch.desired_goal.shape[1]), np.float32)
    rows[:count, :columns] = batch.next_observation
    rows[count:, :columns] = batch.observation
    rows[:count, columns:] = rows[count:, columns:] = batch.desired_goal
    tensor = torch.from_numpy
    return Fed(
        rows=tensor(rows),
        action=tensor(batch.action),
        reward=tensor(batch.reward),
        discount=tensor(batch.discount * (1 - batch.terminated)),
        weight=tensor(batch.weight),
        share=tensor(batch.weight / np.float32(count)),
        demonstrated=None if batch.demonstrated is None else tensor(batch.demonstrated),
    )


def normalised(fed: Fed, normaliser: Normaliser, *, observe: bool = True) -> Inputs:
    """The batch as losses need it. If asked to, what it observes enters the statistics first, relabelled goals too."""
    count = len(fed.reward)
    if observe:
        normaliser.update(fed.rows[count:])
    observed = normaliser(fed.rows)
    return Inputs(observed, observed[:count], observed[count:], *fed[1:])


def acting_inputs(
    observation: FloatArray, desired_goal: FloatArray, normaliser: Normaliser, device: torch.device
) -> Tensor:
    """Observations (n, o) and goals (n, g) side by side, normalised; the statistics stay as they are."""
    rows = torch.cat((torch.from_numpy(observation), torch.from_numpy(desired_goal)), 1)
    return normaliser(rows.to(device))


def some_random(action: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """Actions (n, a), each replaced with probability `share` by a uniform one in [-1, 1]."""
    if share == 0:
        return action
    drawn = torch.rand((len(action), action.shape[1] + 1), generator=generator, device=action.device)
    return torch.where(drawn[:, :1] < share, drawn[:, 1:] * 2 - 1, action)


def require_continuous(signature: Signature, agent: str) -> int:
    """Columns of an action. Raises UsageError where actions are discrete."""
    if isinstance(signature.action, Discrete):
        raise UsageError(
            f"{agent} gives continuous actions, and this environment takes one of "
            f"{len(signature.action.labels)} discrete ones",
            where="agent",
            hint="choose dqn, or continuous actions: a robot has them with environment.actions=continuous",
        )
    return signature.action.size


def value_bounds(signature: Signature, discount: float, *, clip: bool) -> tuple[float, float]:
    """The least and the largest value that the declared rewards make possible; infinite where nothing is to be cut."""
    if not clip:
        return -math.inf, math.inf
    low, high = signature.reward_range
    ever = 1 / (1 - discount)  # what a reward of 1 at each step comes to; an end may leave it at one step's
    return min(low, low * ever), max(high, high * ever)


def saturation(action: Tensor) -> Tensor:
    """Share of action columns at the edge of their range."""
    return (action.detach().abs() > 0.99).float().mean()


def to_array(actions: Tensor) -> FloatArray:
    found: FloatArray = actions.cpu().numpy()
    return found
