"""The memory that a run needs at least, estimated from its spec before anything is allocated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

from ..buffers.storage import row_layout
from ..core import Discrete, Signature
from ..errors import UsageError
from ..machine import memory
from ..registry import load
from ..spec import Spec

NUMBER = 4
"""Bytes of a float32."""
ARRAYS = 16
"""Arrays of the size of a network that an agent with a policy and critics holds: parameters, gradients and moments of
the optimiser, of policy, critics and targets. Measured: 21 for SAC."""
FEW_ARRAYS = 8
"""The same for PPO and DQN. Measured: 8."""
WORKER = 30 << 20
"""Bytes of a worker process, beside what it shares with the others."""


@dataclass(frozen=True)
class Need:
    """The memory of one part of a run."""

    bytes: int
    what: str
    where: str
    """The setting that makes it large."""


def check_memory(spec: Spec, signature: Signature, jobs: int = 1) -> None:
    """Raise a UsageError if `jobs` runs of the spec need more memory than this machine has."""
    needs = list(_needs(spec, signature))
    needed, available = jobs * sum(need.bytes for need in needs), memory()
    if needed <= available:
        return
    largest = max(needs, key=lambda need: need.bytes)
    what, hint = f"{largest.what} needs {_size(largest.bytes)} of memory", f"lower {largest.where}"
    if largest.bytes <= available:
        what += f" ({f'{jobs} runs at the same time' if jobs > 1 else 'the whole run'}: {_size(needed)})"
        hint += ", or run fewer seeds at the same time" if jobs > 1 else ""
    raise UsageError(f"{what}, and this machine has {_size(available)}", where=largest.where, hint=hint)


def _needs(spec: Spec, signature: Signature) -> Iterator[Need]:
    """Estimates of what certainly needs memory. Settings of plugins count where karolos's own have them."""
    agent, buffer, layout = spec.agent.settings, spec.buffer.settings, spec.orchestrator.settings
    size, row = _amount(layout, "size", 1), row_layout(signature).size * NUMBER
    processes = _amount(layout, "processes")
    workers = f"training and testing with {processes} worker processes each"
    yield Need(2 * processes * WORKER, workers, "orchestrator.processes")
    actions = 2 * size * signature.max_steps * signature.action.size * NUMBER  # and a copy in a checkpoint
    episodes = f"the actions of {size:,} running episodes of up to {signature.max_steps:,} steps"
    yield Need(actions, episodes, "orchestrator.environments")
    hidden = getattr(agent, "hidden", ())
    hidden = hidden if isinstance(hidden, tuple) else ()
    inputs = signature.observation.size + signature.desired_goal.size + signature.action.size
    weights = sum((before + 1) * after for before, after in pairwise((inputs, *hidden, 1)))
    on_policy = load("agents", spec.agent.name).on_policy
    layers = " x ".join(map(str, hidden))
    arrays = FEW_ARRAYS if on_policy or isinstance(signature.action, Discrete) else ARRAYS
    yield Need(arrays * weights * NUMBER, f"an agent with networks of {layers} units", "agent.hidden")
    if on_policy:
        rollout = _amount(buffer, "rollout")
        yield Need(rollout * size * row, f"a rollout of {rollout:,} steps of {size:,} environments", "buffer.rollout")
        return
    if spec.demonstrations is not None:
        count = spec.demonstrations.episodes
        demonstrations = f"a buffer for {count:,} demonstrations of up to {signature.max_steps:,} steps"
        yield Need(2 * count * signature.max_steps * row, demonstrations, "demonstrations.episodes")
    capacity, batch = _amount(buffer, "capacity"), spec.training.batch_size
    filled = 2 * min(capacity, spec.training.steps)  # a checkpoint copies what is stored
    yield Need(max(capacity, filled) * row, f"a buffer of {capacity:,} transitions", "buffer.capacity")
    yield Need(batch * (row + 2 * NUMBER * sum(hidden)), f"a batch of {batch:,} transitions", "training.batch_size")


def _amount(settings: object, name: str, default: int = 0) -> int:
    """A setting that is a number; the default if a part of another package means something else by the name."""
    value = getattr(settings, name, default)
    return value if isinstance(value, int) else default


def _size(count: int) -> str:
    for unit, size in (("TB", 1e12), ("GB", 1e9)):
        if count >= size:
            return f"{count / size:,.1f} {unit}"
    return f"{count / 1e6:,.0f} MB"
