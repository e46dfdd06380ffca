"""Builds the objects that a spec names, and checks that they fit together and start on this machine."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from itertools import pairwise
from operator import itemgetter

import numpy as np

from ..core import Agent, Buffer, Orchestrator, SeedTree, Signature, random_actions
from ..core.experience import transition_layout
from ..environments.build import build_environment, is_setting
from ..errors import KarolosError, PluginError, UsageError, WorkerError, described
from ..orchestrator.local import Local
from ..registry import blaming, find
from ..specification import Part, Spec
from ..specification.parts import Recipe
from ..specification.sweep import MEASURES, directions
from ..specification.tree import PARTS
from ..system import memory
from .demonstrations import check_demonstrations

REPLAY_SETTINGS = {
    "batch_size": "remove it; agent.minibatches and buffer.rollout determine the size of a batch",
    "replay_ratio": "remove it; agent.epochs says how often the agent learns from each transition",
    "warmup_episodes": "remove it; there is no warm-up",
}
"""Settings of `training` that an on-policy agent does not use -> hint."""

TOGETHER = ("robot.", "task.", "environment.", "agent.", "buffer.")
"""Prefixes of settings that must fit together."""


def make_orchestrator(spec: Spec, *, randomize: bool) -> Orchestrator:
    """The spec's environments, spread over processes and threads as the spec says."""
    recipe = spec.recipe(randomize=randomize)
    orchestrator: Orchestrator = spec.orchestrator.make(partial(build_environment, recipe))
    return orchestrator


def make_agent(spec: Spec, signature: Signature, seeds: SeedTree) -> Agent:
    """The spec's agent for these environments, on the spec's device. `seeds` is the run's."""
    from ..agents.device import resolve_device  # noqa: PLC0415  (imports torch)

    device = resolve_device(spec.training.device)
    agent: Agent = spec.agent.make(signature, seeds.child("agent"), device)
    return agent


def import_libraries() -> None:
    """Import torch, which takes long and which every run needs."""
    from ..agents import device  # noqa: F401, PLC0415


def use_threads(spec: Spec) -> None:
    """Compute with the spec's number of threads in this process. Sums in another order could change an episode."""
    from ..agents import device  # noqa: PLC0415  (imports torch)

    device.use_threads(spec.training.threads or 1)


def learner(spec: Spec) -> dict[str, str]:
    """Device of the spec's agent on this machine, and `precision` of its hidden layers if this is a setting."""
    from ..agents.device import resolve_device, uses_bfloat16  # noqa: PLC0415  (imports torch)

    device = resolve_device(spec.training.device)
    precision = getattr(spec.agent.settings, "precision", None)
    if precision is None:
        return {"device": device}
    rounds = uses_bfloat16(precision, device) and not getattr(spec.agent.settings, "per_joint", False)
    return {"device": device, "precision": "bfloat16" if rounds else "float32"}


def make_buffer(spec: Spec, signature: Signature, seeds: SeedTree, *, environments: int, discount: float) -> Buffer:
    """The spec's buffer for this number of environments. `seeds` is the run's."""
    own = seeds.child("buffer")
    buffer: Buffer = spec.buffer.make(signature, own, environments=environments, discount=discount)
    return buffer


def check_parts(spec: Spec, jobs: int = 1) -> str | None:
    """Build the spec's parts once, so that errors show before anything runs.

    Makes the first steps of an episode, which also compile the code that workers load. Builds agent and buffer, and
    discards them. Returns a note if a run may make no gradient update, or if a sweep's objective may be the same in all
    trials.

    Args:
        spec: to check.
        jobs: number of its runs at the same time, which share the machine's memory.

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
        return _doubt(spec, agent, buffer, signature)


@contextmanager
def _making(key: str, part: Part) -> Iterator[None]:
    """Turn an error of a plugin's constructor into a UsageError that names the plugin, or a PluginError at its line."""
    try:
        with blaming():
            yield
    except KarolosError:
        raise
    except (Exception, SystemExit) as error:  # a plugin may raise anything
        what = f"{key} {part.name!r} cannot be made: {described(error)}"
        raise UsageError(what, setting=f"{key}.name") from error


def _check_amounts(spec: Spec, agent: Agent, buffer: Buffer) -> None:
    """Raise a UsageError for an amount of training that the agent does not use or that is impossible."""
    amounts, size = spec.training, environments_of(spec)
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
    amounts, size = spec.training, environments_of(spec)
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


@contextmanager
def located(spec: Spec) -> Iterator[None]:
    """Add to an error the place of its setting or plugin: file:line:column, or the override."""
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
    """Place at which the setting `path`, or the first one below it, or its part was set. None for default parts."""
    if path is None:
        return None
    part = path.partition(".")[0]  # the part holds a setting that was not set
    near = [key for one in (path, part) for key in spec.origins if key == one or key.startswith(f"{one}.")]
    place = next((spec.origins[key] for key in near if spec.origins[key] != "default"), None)
    if place is None or place.startswith("override "):
        return place
    changed = {origin for key, origin in spec.origins.items() if key.startswith(TOGETHER)}  # may be contradicted
    overrides = sorted(origin for origin in changed if origin.startswith("override "))
    return f"{place} with {' and '.join(overrides)}" if overrides else place


FLOAT_BYTES = 4
"""Size of a float32."""
WORKER_BYTES = 30 << 20
"""Private memory of a worker process in bytes."""


def environments_of(spec: Spec) -> int:
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
    training, environments = spec.training, environments_of(spec)

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


STEPS = 3
"""Steps of the first episode, with random actions."""
EPISODES = 16
"""Number of episodes that begin if randomization samples worlds. With up to eight worlds, nearly all are tried."""


def try_environments(spec: Spec) -> Signature:
    """Make the first steps of an episode, and return the signature of the environments.

    If randomization samples worlds, several training episodes and one test episode begin. Foreign environments are
    tried in a worker process, as in a run: they may end their process, or hang.

    Raises:
        KarolosError: an environment cannot be made, fails, or diverges at once; names a setting or a plugin.
    """
    recipe = spec.recipe(randomize=True)
    if not any(is_setting(recipe, name) for name, _ in recipe.randomization):
        return _tried(spec, recipe, 1)
    _tried(spec, spec.recipe(randomize=False), 1)
    return _tried(spec, recipe, EPISODES)


def _tried(spec: Spec, recipe: Recipe, episodes: int) -> Signature:
    given, generator = spec.orchestrator.settings, np.random.default_rng(0)
    processes, limit = getattr(given, "processes", 1), getattr(given, "time_limit", 60.0)
    parts = filter(None, (recipe.environment, recipe.robot, recipe.task))
    if all(find(one.kind, one.name).distribution == "karolos" and one.name != "gymnasium" for one in parts):
        processes = 0  # our own code does not end its process
    settings = Local.Settings(processes=processes, environments=1, failures=0, time_limit=limit)
    try:
        with Local(settings, partial(build_environment, recipe)) as environments:
            for seed in range(episodes):
                environments.reset([0], [seed])
                count = 0 if seed else STEPS
                for action in (*random_actions(environments.signature, count, generator), None):
                    step = environments.receive().step
                    if step.diverged[0]:
                        raise PluginError("the first steps diverge: numbers are not finite, or an object is far away")
                    if action is None or step.terminated[0] or step.truncated[0]:
                        break
                    environments.step([0], action[None])
            return environments.signature
    except KarolosError as error:
        if error.setting is not None:
            raise
        # the numbers of worker and environment are left out: there is only one of each
        place = re.sub("^(worker|environment|building)[^:]*(: )?", "", error.where or "")
        key = None if error.plugin else "environment.name" if spec.task is None else "task.name"
        what = ": ".join(filter(None, (place, error.what)))
        kind = PluginError if isinstance(error, WorkerError) else type(error)
        raise kind(what, setting=key, plugin=error.plugin, hint=error.hint) from None
