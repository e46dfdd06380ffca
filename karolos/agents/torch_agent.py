"""What the agents of karolos share: optimisers, a generator, and the state of everything that they store."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Any, ClassVar

import torch
from torch import Tensor

from ..core import FLOAT_BYTES, Agent, Experience, MemoryNeed, RunSize, Signature, State
from .optimisation import Adam


class TorchAgent(Agent[Experience]):
    """An agent whose state consists of the attributes in `stored`, its optimisers and its generator."""

    stored: tuple[str, ...]
    """Attributes that learning or acting depends on: tensors, counters, and parts with `state` and `load_state`."""
    optimisers: dict[str, Adam]
    generator: torch.Generator
    arrays: ClassVar[int] = 8
    """Arrays of the size of a network that it holds: parameters, targets, gradients, moments of Adam. Measured."""

    @classmethod
    def memory(cls, settings: Any, signature: Signature, size: RunSize) -> Iterator[MemoryNeed]:
        inputs = signature.observation.size + signature.desired_goal.size + signature.action.size
        weights = sum((before + 1) * after for before, after in pairwise((inputs, *settings.hidden, 1)))
        what = f"an agent with networks of {' x '.join(map(str, settings.hidden))} units"
        yield MemoryNeed(cls.arrays * weights * FLOAT_BYTES, what, "agent.hidden")
        if not cls.on_policy:
            activations = 2 * size.batch_size * sum(settings.hidden) * FLOAT_BYTES
            yield MemoryNeed(activations, f"a batch of {size.batch_size:,} transitions", "training.batch_size")

    def state(self) -> State:
        """Everything that learning and acting depend on."""
        values = {name: getattr(self, name) for name in self.stored}
        for name, value in values.items():
            if not isinstance(value, int):
                values[name] = value.clone() if isinstance(value, Tensor) else value.state()
        optimisers = {name: optimiser.state() for name, optimiser in self.optimisers.items()}
        return {**values, "optimisers": optimisers, "generator": self.generator.get_state()}

    def load_state(self, state: State) -> None:
        """Raises UsageError when the state is of networks of another shape."""
        for name in self.stored:
            value = getattr(self, name)
            if isinstance(value, int):
                setattr(self, name, int(state[name]))
            elif isinstance(value, Tensor):
                value.copy_(torch.as_tensor(state[name]))
            else:
                value.load_state(state[name])
        for name, optimiser in self.optimisers.items():
            optimiser.load_state(state["optimisers"][name])
        self.generator.set_state(torch.as_tensor(state["generator"]))
