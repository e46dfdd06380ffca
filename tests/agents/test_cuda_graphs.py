"""That updates can be recorded and replayed, as a CUDA graph does it, shown on a CPU.

`Tape` keeps what a CUDA graph keeps: operations, and the memory that they read and write; nothing of Python. A number
that an update computes in Python, or a tensor that it makes anew and leaves for the next one, would show.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from support.parts import batch, signature
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from karolos.agents.cuda_graphs import RUNS_BEFORE, GraphedUpdates
from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.networks import MLP
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Discrete, Signature
from karolos.core.seeding import SeedTree


class Keeping(TorchDispatchMode):
    """Writes down every operation, and what was in memory before one wrote to it."""

    def __init__(self) -> None:
        super().__init__()
        self.kept: list[tuple[Any, tuple[Any, ...], dict[str, Any], list[torch.Tensor]]] = []
        self.before: list[tuple[torch.Tensor, torch.Tensor]] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        schema = func._schema.arguments
        given = dict(zip([argument.name for argument in schema], args, strict=False)) | kwargs
        for argument in schema:
            if argument.alias_info is not None and argument.alias_info.is_write and argument.name in given:
                written = [leaf for leaf in tree_leaves(given[argument.name]) if isinstance(leaf, torch.Tensor)]
                self.before += [(tensor, tensor.clone()) for tensor in written]
        found = func(*args, **kwargs)
        results = [leaf for leaf in tree_leaves(found) if isinstance(leaf, torch.Tensor)]
        self.kept.append((func, args, kwargs, results))
        return found


class Tape:
    """A recording on a CPU: as a CUDA graph it does nothing while it records, and replays on the same memory."""

    made = 0

    def __init__(self, generator: torch.Generator) -> None:
        self._generator = generator
        type(self).made += 1

    def capture(self, work: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        drawn = self._generator.get_state()
        with Keeping() as keeping:
            found = work()
        for tensor, before in reversed(keeping.before):
            tensor.copy_(before)
        self._generator.set_state(drawn)
        self._kept = keeping.kept
        return found

    def replay(self) -> None:
        for func, args, kwargs, results in self._kept:
            again = [leaf for leaf in tree_leaves(func(*args, **kwargs)) if isinstance(leaf, torch.Tensor)]
            for place, result in zip(results, again, strict=True):
                if place.data_ptr() != result.data_ptr():
                    place.copy_(result)


def with_rates_in_memory(agent: Any) -> Any:
    """The same agent; its optimisers take their learning rates from tensors, as on a GPU."""
    optimisers = getattr(agent, "optimisers", None) or {"network": agent._optimiser}
    for optimiser in optimisers.values():
        optimiser._rate = torch.full((), optimiser.learning_rate)
    return agent


def recorded(agent: Any) -> Any:
    """The same agent, as if on a device where updates are recorded."""
    agent = with_rates_in_memory(agent)
    networks = [value for value in vars(agent).values() if isinstance(value, MLP)]
    generator = getattr(agent, "generator", None) or agent._generator
    agent._graphed = GraphedUpdates(torch.device("cpu"), networks, generator, Tape)
    return agent


FALLING = {"learning_rate_end": 0.0, "learning_rate_updates": 60}
CASES = [
    (SAC, {"precision": "float32"}),
    (SAC, {"precision": "bfloat16", "layer_norm": True, "policy_delay": 2, "temperature_min": 0.01}),
    (SAC, {"critic": {}, "gradient_norm": 1.0, **FALLING}),
    (SAC, {"imitation": 1.0, "entropy_in_target": True, "clip_targets": False}),
    (TD3, {"imitation": 1.0, **FALLING}),
    (DDPG, {"precision": "bfloat16", "action_penalty": 1.0}),
    (DQN, {"dueling": True}),
    (DQN, {"loss": "squared", "target_interval": 3, "tau": 1.0, **FALLING}),
]


def of(kind: Any) -> Signature:
    base = signature()
    if kind is not DQN:
        return base
    return Signature(**{**vars(base), "action": Discrete(("left", "right", "wait"))})


@pytest.mark.parametrize(("kind", "options"), CASES)
def test_replayed_updates_are_those_that_are_written(kind: Any, options: dict[str, Any]) -> None:
    def learned(prepare: Callable[[Any], Any]) -> Any:
        agent = kind(kind.Settings.model_validate({"hidden": (16, 16), **options}), of(kind), SeedTree(0))
        agent = prepare(agent)
        watched = []
        for seed in range(6 * 8 + 5):
            fixed = {"action": seed % 3} if kind is DQN else {}
            data = batch(16, of(kind), seed, **fixed)
            shown = (np.arange(16) % 4 == 0).astype(np.float32)
            watched.append(
                {name: torch.as_tensor(v) for name, v in agent.learn(data._replace(demonstrated=shown)).items()}
            )
            agent.act(data.observation, data.desired_goal, explore=True)
        return agent.state(), watched

    Tape.made = 0
    state, watched = learned(with_rates_in_memory)
    assert Tape.made == 0
    again, watched_again = learned(recorded)
    assert Tape.made >= 2
    assert_close(state, again)
    for ours, theirs in zip(watched, watched_again, strict=True):
        assert ours.keys() == theirs.keys()
        for name, value in ours.items():
            torch.testing.assert_close(theirs[name], value, msg=lambda text, name=name: f"{name}: {text}")


def assert_close(one: Any, other: Any, path: str = "") -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key, value in one.items():
            assert_close(value, other[key], f"{path}.{key}")
    else:
        torch.testing.assert_close(
            torch.as_tensor(other), torch.as_tensor(one), msg=lambda text: f"{path}: {text}", equal_nan=True
        )


def test_a_batch_of_another_size_is_another_recording() -> None:
    agent = recorded(
        SAC(SAC.Settings.model_validate({"hidden": (8,), "precision": "float32"}), signature(), SeedTree(0))
    )
    Tape.made = 0
    for size in (8, 16) * (2 * RUNS_BEFORE + 2):
        agent.learn(batch(size, signature(), size))
    assert Tape.made >= 2
    assert {size for _, size in agent._graphed._captures} == {8, 16}


def test_nothing_is_recorded_on_a_cpu() -> None:
    agent = SAC(SAC.Settings.model_validate({"hidden": (8,)}), signature(), SeedTree(0))
    for seed in range(10):
        agent.learn(batch(8, signature(), seed))
    assert not agent._graphed._captures


def test_a_number_that_python_computes_would_show() -> None:
    """The tape keeps what a CUDA graph keeps: here a count that stays what it was."""
    total, count = torch.zeros(()), [0]
    field = torch.ones(1)

    def work() -> dict[str, Any]:
        count[0] += 1
        total.add_(field[0] * count[0])
        return {"total": total}

    tape = Tape(torch.Generator())
    tape.capture(work)
    assert total == 0
    tape.replay()
    tape.replay()
    assert total == 2  # not 1 + 2
