"""The memory that a run needs at least, estimated from its spec before anything is allocated."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

from ..buffers.storage import transition_layout
from ..core import Signature
from ..errors import UsageError
from ..registry import load
from ..specification import Spec
from ..system import memory

FLOAT_BYTES = 4
"""Size of a float32."""
WORKER_BYTES = 30 << 20
"""Memory of a worker process, beside what it shares with the others."""


def environments_of(spec: Spec) -> int:
    """Number of environments of a run; 1 if the orchestrator's settings do not say."""
    return getattr(spec.orchestrator.settings, "size", 1)


def check_memory(spec: Spec, signature: Signature, jobs: int = 1) -> None:
    """Raise a UsageError if `jobs` runs of the spec need more memory than this machine has."""
    needs = list(_needs(spec, signature))
    needed, available = jobs * sum(need.bytes for need in needs), memory()
    if needed <= available:
        return
    largest = max(needs, key=lambda need: need.bytes)
    what, hint = f"{largest.what} needs {_size(largest.bytes)} of memory", f"lower {largest.setting}"
    if largest.bytes <= available:
        what += f" ({f'{jobs} runs at the same time' if jobs > 1 else 'the whole run'}: {_size(needed)})"
        hint += ", or run fewer seeds at the same time" if jobs > 1 else ""
    raise UsageError(f"{what}, and this machine has {_size(available)}", setting=largest.setting, hint=hint)


class MemoryNeed(NamedTuple):
    """Memory that a part of a run certainly needs."""

    bytes: int
    what: str
    """What needs it, e.g. "a buffer of 1,000 transitions"."""
    setting: str
    """The setting that makes it large, e.g. "buffer.capacity"."""


def _needs(spec: Spec, signature: Signature) -> Iterator[MemoryNeed]:
    """What parts need by their settings `processes`, `hidden`, `capacity` and `rollout`; others are not known."""
    training, environments = spec.training, environments_of(spec)

    processes = getattr(spec.orchestrator.settings, "processes", 0)
    what = f"training and testing with {processes} worker processes each"
    yield MemoryNeed(2 * processes * WORKER_BYTES, what, "orchestrator.processes")
    actions = 2 * environments * signature.max_steps * signature.action.size  # and a copy in a checkpoint
    what = f"the actions of {environments:,} running episodes of up to {signature.max_steps:,} steps"
    yield MemoryNeed(actions * FLOAT_BYTES, what, "orchestrator.environments")

    agent, hidden = load("agents", spec.agent.name), getattr(spec.agent.settings, "hidden", ())
    batch = f"a batch of {training.batch_size:,} transitions"
    if isinstance(hidden, tuple) and hidden:
        inputs = signature.observation.size + signature.desired_goal.size + signature.action.size
        weights = sum((before + 1) * after for before, after in pairwise((inputs, *hidden, 1)))
        what = f"an agent with networks of {' x '.join(map(str, hidden))} units"
        yield MemoryNeed(getattr(agent, "arrays", 1) * weights * FLOAT_BYTES, what, "agent.hidden")
        activations = 0 if agent.on_policy else 2 * training.batch_size * sum(hidden)
        yield MemoryNeed(activations * FLOAT_BYTES, batch, "training.batch_size")

    row, settings = transition_layout(signature).size * FLOAT_BYTES, spec.buffer.settings
    if isinstance(capacity := getattr(settings, "capacity", None), int):
        stored = max(capacity, 2 * min(capacity, training.steps))  # a checkpoint copies what is stored
        yield MemoryNeed(stored * row, f"a buffer of {capacity:,} transitions", "buffer.capacity")
        yield MemoryNeed(training.batch_size * row, batch, "training.batch_size")
    if isinstance(rollout := getattr(settings, "rollout", None), int):
        what = f"a rollout of {rollout:,} steps of {environments:,} environments"
        yield MemoryNeed(rollout * environments * row, what, "buffer.rollout")
    if spec.demonstrations is not None:
        episodes = spec.demonstrations.episodes
        what = f"a buffer for {episodes:,} demonstrations of up to {signature.max_steps:,} steps"
        yield MemoryNeed(2 * episodes * signature.max_steps * row, what, "demonstrations.episodes")


def _size(count: int) -> str:
    for unit, size in (("TB", 1e12), ("GB", 1e9)):
        if count >= size:
            return f"{count / size:,.1f} {unit}"
    return f"{count / 1e6:,.0f} MB"
