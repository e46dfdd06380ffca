"""Builds the objects that a spec names, and checks whether they fit together."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from ..core import Agent, Buffer, Orchestrator, Signature
from ..core.seeding import SeedTree
from ..environments.build import build_environment
from ..errors import KarolosError, UsageError, described
from ..registry import blaming, load
from ..specification import Part, Spec
from ..specification.sweep import MEASURES, directions
from ..specification.tree import PARTS
from .demonstrations import check_demonstrations
from .memory import check_memory, environments_of
from .trial import try_environments

REPLAY_SETTINGS = {
    "batch_size": "remove it; agent.minibatches and buffer.rollout determine the size of a batch",
    "replay_ratio": "remove it; agent.epochs says how often the agent learns from each transition",
    "warmup_episodes": "remove it; there is no warm-up",
}
"""Settings of `training` that an on-policy agent does not use, and what to do instead."""

TOGETHER = ("robot.", "task.", "environment.", "agent.", "buffer.")
"""Beginnings of settings that have to fit together."""


def make_orchestrator(spec: Spec, *, randomize: bool) -> Orchestrator:
    """The spec's environments, distributed over processes and threads as the spec says."""
    part, build = spec.orchestrator, partial(build_environment, spec.recipe(randomize=randomize))
    orchestrator: Orchestrator = load("orchestrators", part.name)(part.settings, build)
    return orchestrator


def make_agent(spec: Spec, signature: Signature, seeds: SeedTree) -> Agent:
    """The spec's agent for these environments, on the spec's device. `seeds` is the run's."""
    from ..agents.device import resolve_device  # noqa: PLC0415  (imports torch)

    part, device = spec.agent, resolve_device(spec.training.device)
    agent: Agent = load("agents", part.name)(part.settings, signature, seeds.child("agent"), device)
    return agent


def learner(spec: Spec) -> dict[str, str]:
    """How the spec's agent learns on this machine: `device`, and `precision` of hidden layers if it is a setting."""
    from ..agents.device import resolve_device, uses_bfloat16  # noqa: PLC0415  (imports torch)

    device = resolve_device(spec.training.device)
    precision = getattr(spec.agent.settings, "precision", None)
    if precision is None:
        return {"device": device}
    return {"device": device, "precision": "bfloat16" if uses_bfloat16(precision, device) else "float32"}


def make_buffer(spec: Spec, signature: Signature, seeds: SeedTree, *, environments: int, discount: float) -> Buffer:
    """The spec's buffer for this number of environments. `seeds` is the run's."""
    part = spec.buffer
    buffer: Buffer = load("buffers", part.name)(
        part.settings, signature, seeds.child("buffer"), environments=environments, discount=discount
    )
    return buffer


def check_parts(spec: Spec, jobs: int = 1) -> str | None:
    """Build the spec's parts once, so that what does not fit or fails at once is refused before anything runs.

    Makes the first steps of an episode, which compile what workers then load. Builds the agent and the buffer, and
    discards them. Returns a note if a run of the spec may make no gradient update, or a sweep's objective may say
    nothing.

    Args:
        spec: to check.
        jobs: runs of it at the same time, which share the machine's memory.

    Raises:
        UsageError: two parts do not fit together, or need too much memory; names the setting and where it was set.
        KarolosError: a plugin or the machine prevents it.
    """
    with located(spec):
        signature, size = try_environments(spec), environments_of(spec)
        check_memory(spec, signature, jobs)
        with _making("agent", spec.agent):
            agent = make_agent(spec, signature, SeedTree(0))
        with _making("buffer", spec.buffer):
            buffer = make_buffer(spec, signature, SeedTree(0), environments=size, discount=agent.discount)
        _check_amounts(spec, agent, buffer)
        if spec.sweep is not None:
            directions(spec.sweep.objectives, signature.measures)
        agent.check(buffer, demonstrations=spec.demonstrations is not None)
        if spec.demonstrations is not None:
            buffer.add_demonstrations(())
            check_demonstrations(spec.recipe(randomize=True), spec.demonstrations)
        return _without_updates(spec, agent, buffer, signature.max_steps) or _without_success(spec, signature)


@contextmanager
def _making(key: str, part: Part) -> Iterator[None]:
    """Turn an error of a plugin's constructor into a UsageError that names the plugin, or a PluginError at its line."""
    try:
        with blaming():
            yield
    except KarolosError:
        raise
    except (Exception, SystemExit) as error:  # the constructor is anybody's
        what = f"{key} {part.name!r} cannot be made: {described(error)}"
        raise UsageError(what, setting=f"{key}.name") from error


def _check_amounts(spec: Spec, agent: Agent, buffer: Buffer) -> None:
    """Raise a UsageError for an amount of training that the agent does not use or that is impossible."""
    amounts, size = spec.training, environments_of(spec)
    if (amounts.at_least or 0) > size:
        raise UsageError(
            f"a batch of {amounts.at_least} environments is never ready, because there are {size}",
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
                f"{count} of {amounts.batch_size} transitions of a batch would be demonstrated",
                setting="demonstrations.share",
                hint="between 1 and all but 1; or null: as often as other transitions",
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


def _without_updates(spec: Spec, agent: Agent, buffer: Buffer, max_steps: int) -> str | None:
    """Why a run whose episodes last `max_steps` makes no gradient update; None if it makes some."""
    amounts, size = spec.training, environments_of(spec)
    if agent.on_policy:
        if buffer.capacity is None or buffer.capacity <= amounts.steps:
            return None
        return f"a run makes no update: a rollout takes {buffer.capacity} steps, and training.steps is {amounts.steps}"
    if spec.demonstrations is not None and spec.demonstrations.updates:
        return None
    if amounts.replay_ratio == 0:
        return "a run makes no update: training.replay_ratio is 0"
    warmup = math.ceil(amounts.warmup_episodes / size) * max_steps * size
    if warmup < amounts.steps:
        return None
    return (
        f"a run may make no update: {amounts.warmup_episodes} warm-up episodes take up to {warmup} steps, and "
        f"training.steps is {amounts.steps}"
    )


def _without_success(spec: Spec, signature: Signature) -> str | None:
    """Why the objective of the spec's sweep may be the same for all trials; None if it is well-defined."""
    undefined = (
        []
        if spec.sweep is None
        else [name for name in spec.sweep.objectives if name != "return" and not name.startswith(MEASURES)]
    )
    if signature.has_success or not undefined:
        return None
    return f"the environment defines no success, so {undefined[0]} may stay 0: set sweep.objective=return"


def _is_set(spec: Spec, name: str) -> bool:
    """Whether this setting of `training` differs from its default. A resolved spec lists its defaults, too."""
    return bool(getattr(spec.training, name) != type(spec.training).model_fields[name].default)


@contextmanager
def located(spec: Spec) -> Iterator[None]:
    """Add to an error that names a setting or a part's plugin where that was set: file:line:column, or the override."""
    try:
        yield
    except KarolosError as error:
        parts = ((key, getattr(spec, key)) for key in PARTS)
        named = next((key for key, part in parts if part and (part.kind, part.name) == error.plugin), None)
        if named is not None and error.setting is None:
            error.setting, error.what = f"{named}.name", ": ".join(filter(None, (error.where, error.what)))
            error.where = None
        error.where = _origin(spec, error.setting) or error.where
        raise


def _origin(spec: Spec, path: str | None) -> str | None:
    """Where the setting `path`, or the first one below it, or its part was set. None for default parts."""
    if path is None:
        return None
    part = path.partition(".")[0]  # which holds a setting that was not set
    near = [key for one in (path, part) for key in spec.origins if key == one or key.startswith(f"{one}.")]
    place = next((spec.origins[key] for key in near if spec.origins[key] != "default"), None)
    if place is None or place.startswith("override "):
        return place
    changed = {origin for key, origin in spec.origins.items() if key.startswith(TOGETHER)}  # what it may contradict
    overrides = sorted(origin for origin in changed if origin.startswith("override "))
    return f"{place} with {' and '.join(overrides)}" if overrides else place
