"""Checks before a run: a spec's parts fit together, make sense, and have enough memory on this machine."""

from __future__ import annotations

import math
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import pairwise
from operator import itemgetter

from ..core import Agent, Buffer, SeedTree, Signature
from ..core.experience import transition_layout
from ..errors import MachineError, UsageError
from ..specification import Spec
from ..specification.sweep import MEASURES, directions
from ..system import memory
from ..training.assembly import make_agent, make_buffer, try_environments
from ..training.demonstrations import check_demonstrations

REPLAY_SETTINGS = {
    "batch_size": "remove it; agent.minibatches and buffer.rollout determine the size of a batch",
    "replay_ratio": "remove it; agent.epochs says how often the agent learns from each transition",
    "warmup_episodes": "remove it; there is no warm-up",
}
"""Settings of `training` that an on-policy agent does not use -> hint."""
FLOAT_BYTES = 4
WORKER_BYTES = 30 << 20
"""Private memory of a worker process in bytes."""


def check_parts(spec: Spec, jobs: int = 1) -> str | None:
    """Build the spec's parts once, so that errors show before anything runs.

    Makes the first steps of an episode, which also compile the code that workers load. Builds agent and buffer, and
    discards them. `jobs` runs at the same time share the machine's memory. Returns a note if a run may make no gradient
    update, or if a sweep's objective may be the same in all trials.

    Raises:
        UsageError: two parts do not fit together, or need too much memory; names the setting and where it was set.
        KarolosError: a plugin or the machine prevents it.
    """
    with spec.located():
        _check_libraries(spec)
        signature, size = try_environments(spec), environment_count(spec)
        check_memory(spec, signature, jobs)
        with spec.making("agent"):
            agent = make_agent(spec, signature, SeedTree(0))
        with spec.making("buffer"):
            buffer = make_buffer(spec, signature, SeedTree(0), environments=size, discount=agent.discount)
        _check_amounts(spec, agent, buffer)
        if spec.sweep is not None:
            directions(spec.sweep.objectives, signature.measures)
        with spec.making("agent"):
            agent.check(buffer, demonstrations=spec.demonstrations is not None)
        if spec.demonstrations is not None:
            buffer.add_demonstrations(())
            check_demonstrations(spec.recipe(randomize=True), spec.demonstrations)
        return _doubt(spec, agent, buffer, signature)


def _check_libraries(spec: Spec) -> None:
    """Raise a MachineError if orchestrator or launcher need a library that is not installed."""
    for key, part in (("orchestrator", spec.orchestrator), ("launcher", spec.launcher)):
        library = part and getattr(part.plugin, "library", None)
        if part and library and find_spec(library) is None:
            hint = f"pip install 'karolos[{library}]'"
            raise MachineError(f"{part.name} is not installed", setting=f"{key}.name", hint=hint)


def _check_amounts(spec: Spec, agent: Agent, buffer: Buffer) -> None:
    """Raise a UsageError for an amount of training that the agent does not use or that is impossible."""
    amounts, size = spec.training, environment_count(spec)
    if (amounts.at_least or 0) > size:
        raise UsageError(
            f"{amounts.at_least} environments are never ready at the same time, because there are only {size}",
            setting="training.minimum_batch",
            hint="lower it, or use more environments",
        )
    if not amounts.steps and not (spec.demonstrations and spec.demonstrations.updates):
        hint = "set demonstrations.updates, or take environment steps"
        raise UsageError("there is nothing to learn from: no step and no update", setting="training.steps", hint=hint)
    capacity = buffer.capacity
    if not agent.on_policy:
        if capacity is not None and amounts.batch_size > capacity:
            raise UsageError(
                f"a batch of {amounts.batch_size} is larger than the buffer, which stores {capacity} transitions",
                setting="training.batch_size" if _is_set(spec, "batch_size") else "buffer.capacity",
                hint="lower training.batch_size, or raise buffer.capacity",
            )
        share = None if spec.demonstrations is None else spec.demonstrations.share
        if share is not None and not 0 < round(share * amounts.batch_size) < amounts.batch_size:
            count = round(share * amounts.batch_size)
            raise UsageError(
                f"{count} of {amounts.batch_size} transitions of a batch would be demonstrations",
                setting="demonstrations.share",
                hint="let it be at least 1 and leave at least 1; or set null: sampled like other transitions",
            )
        return
    if amounts.mode == "async":
        raise UsageError(
            f"{spec.agent.name} learns from whole rollouts of its latest policy, so it waits for all environments",
            setting="training.mode",
            hint="use lockstep, or an agent that learns from replay",
        )
    for name, hint in REPLAY_SETTINGS.items():
        if _is_set(spec, name):
            raise UsageError(
                f"{spec.agent.name} does not use {name}, which is {getattr(amounts, name):g}: it learns from its own"
                " latest actions, as often as its own settings say",
                setting=f"training.{name}",
                hint=hint,
            )


def _doubt(spec: Spec, agent: Agent, buffer: Buffer, signature: Signature) -> str | None:
    """Why a run may make no gradient update, or why all trials of a sweep may have the same objective; else None."""
    amounts, size = spec.training, environment_count(spec)
    budget = f"training.steps is {amounts.steps}"
    if agent.on_policy:
        if buffer.capacity is not None and buffer.capacity > amounts.steps:
            return f"a run makes no update: a rollout takes {buffer.capacity} steps, and {budget}"
    elif spec.demonstrations is None or not spec.demonstrations.updates:
        if amounts.replay_ratio == 0:
            return "a run makes no update: training.replay_ratio is 0"
        episodes = amounts.warmup_episodes
        warmup = math.ceil(episodes / size) * signature.max_steps * size
        if warmup >= amounts.steps:
            return f"a run may make no update: {episodes} warm-up episodes take up to {warmup} steps, and {budget}"
    objectives = () if spec.sweep is None or signature.has_success else spec.sweep.objectives
    for name in objectives:
        if name != "return" and not name.startswith(MEASURES):
            return f"the environment defines no success, so {name} may stay 0: set sweep.objective=return"
    return None


def _is_set(spec: Spec, name: str) -> bool:
    """Whether this setting of `training` differs from its default. A resolved spec lists its defaults, too."""
    return bool(getattr(spec.training, name) != type(spec.training).model_fields[name].default)


def environment_count(spec: Spec) -> int:
    """Number of environments of a run; 1 if the orchestrator's settings do not say."""
    return getattr(spec.orchestrator.settings, "size", 1)


def check_memory(spec: Spec, signature: Signature, jobs: int = 1) -> None:
    """Raise a UsageError if `jobs` runs of the spec need more memory than this machine has."""
    needs = list(_needs(spec, signature))
    needed, available = jobs * sum(size for size, _, _ in needs), memory()
    if needed <= available:
        return
    largest, part, setting = max(needs, key=itemgetter(0))
    what, hint = f"{part} needs {_size(largest)} of memory", f"lower {setting}"
    if largest <= available:
        what += f" ({f'{jobs} runs at the same time' if jobs > 1 else 'the whole run'}: {_size(needed)})"
        hint += ", or run fewer seeds at the same time" if jobs > 1 else ""
    raise UsageError(f"{what}, and this machine has {_size(available)}", setting=setting, hint=hint)


def _needs(spec: Spec, signature: Signature) -> Iterator[tuple[int, str, str]]:
    """The memory that parts need at least: bytes, the part in words, and the setting that makes it large.

    Parts are known by their settings `processes`, `hidden`, `capacity` and `rollout`.
    """
    training, environments = spec.training, environment_count(spec)

    processes = getattr(spec.orchestrator.settings, "processes", 0)
    what = f"training and testing with {processes} worker processes each"
    yield 2 * processes * WORKER_BYTES, what, "orchestrator.processes"
    actions = 2 * environments * signature.max_steps * signature.action.size  # and a copy in a checkpoint
    what = f"the actions of {environments:,} running episodes of up to {signature.max_steps:,} steps"
    yield actions * FLOAT_BYTES, what, "orchestrator.environments"

    agent, hidden = spec.agent.plugin, getattr(spec.agent.settings, "hidden", ())
    batch = f"a batch of {training.batch_size:,} transitions"
    if isinstance(hidden, tuple) and hidden:
        inputs = signature.observation.size + signature.desired_goal.size + signature.action.size
        weights = sum((before + 1) * after for before, after in pairwise((inputs, *hidden, 1)))
        what = f"an agent with networks of {' x '.join(map(str, hidden))} units"
        yield getattr(agent, "arrays", 1) * weights * FLOAT_BYTES, what, "agent.hidden"
        activations = 0 if agent.on_policy else 2 * training.batch_size * sum(hidden)
        yield activations * FLOAT_BYTES, batch, "training.batch_size"

    row, settings = transition_layout(signature).size * FLOAT_BYTES, spec.buffer.settings
    if isinstance(capacity := getattr(settings, "capacity", None), int):
        stored = max(capacity, 2 * min(capacity, training.steps))  # a checkpoint copies the stored transitions
        yield stored * row, f"a buffer of {capacity:,} transitions", "buffer.capacity"
        yield training.batch_size * row, batch, "training.batch_size"
    if isinstance(rollout := getattr(settings, "rollout", None), int):
        what = f"a rollout of {rollout:,} steps of {environments:,} environments"
        yield rollout * environments * row, what, "buffer.rollout"
    if spec.demonstrations is not None:
        episodes = spec.demonstrations.episodes
        what = f"a buffer for {episodes:,} demonstrations of up to {signature.max_steps:,} steps"
        yield 2 * episodes * signature.max_steps * row, what, "demonstrations.episodes"


def _size(count: int) -> str:
    for unit, size in (("TB", 1e12), ("GB", 1e9)):
        if count >= size:
            return f"{count / size:,.1f} {unit}"
    return f"{count / 1e6:,.0f} MB"
