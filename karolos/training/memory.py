"""The memory that a run needs at least, estimated from its spec before anything is allocated."""

from __future__ import annotations

from collections.abc import Iterator

from ..core import FLOAT_BYTES, MemoryNeed, RunSize, Signature
from ..errors import UsageError
from ..registry import load
from ..specification import Spec
from ..system import memory

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


def _needs(spec: Spec, signature: Signature) -> Iterator[MemoryNeed]:
    agent, buffer, demonstrations = spec.agent, spec.buffer, spec.demonstrations
    episodes = demonstrations.episodes if demonstrations is not None else 0
    size = RunSize(environments_of(spec), spec.training.steps, spec.training.batch_size, episodes)
    processes = getattr(spec.orchestrator.settings, "processes", 0)
    what = f"training and testing with {processes} worker processes each"
    yield MemoryNeed(2 * processes * WORKER_BYTES, what, "orchestrator.processes")
    actions = 2 * size.environments * signature.max_steps * signature.action.size  # and a copy in a checkpoint
    what = f"the actions of {size.environments:,} running episodes of up to {signature.max_steps:,} steps"
    yield MemoryNeed(actions * FLOAT_BYTES, what, "orchestrator.environments")
    yield from load("agents", agent.name).memory(agent.settings, signature, size)
    yield from load("buffers", buffer.name).memory(buffer.settings, signature, size)


def _size(count: int) -> str:
    for unit, size in (("TB", 1e12), ("GB", 1e9)):
        if count >= size:
            return f"{count / size:,.1f} {unit}"
    return f"{count / 1e6:,.0f} MB"
