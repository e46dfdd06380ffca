"""Builds the objects that a spec names, and tries them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from functools import partial

import numpy as np

from ..core import Agent, Buffer, Orchestrator, SeedTree, Signature, Step, random_actions
from ..environments.build import build_environment, is_setting
from ..errors import KarolosError, PluginError, WorkerError
from ..orchestrator.local import Local
from ..registry import blaming
from ..specification import Spec
from ..specification.parts import Recipe


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
    if not any(one.is_foreign or one.name == "gymnasium" for one in parts):
        processes = 0  # our own code does not end its process
    settings = Local.Settings(processes=processes, environments=1, failures=0, time_limit=limit)
    steps: list[Step] = []
    try:
        with Local(settings, partial(build_environment, recipe)) as environments, blaming():
            for seed in range(episodes):
                environments.reset([0], [seed])
                count = 0 if seed else STEPS
                for action in (*random_actions(environments.signature, count, generator), None):
                    step = environments.receive().step
                    if not seed:
                        steps.append(Step(*map(np.copy, step)))
                    if step.diverged[0]:
                        raise PluginError("the first steps diverge: numbers are not finite, or an object is far away")
                    if action is None or step.terminated[0] or step.truncated[0]:
                        break
                    environments.step([0], action[None])
            _check_rewards_and_rule(environments.signature, steps)
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


def _check_rewards_and_rule(signature: Signature, steps: Sequence[Step]) -> None:
    """Raise a PluginError for a reward beyond its range, or a goal rule that does not judge each of several goals.

    The first step is that of the reset.
    """
    low, high = signature.reward_range
    for reward in (float(step.reward[0]) for step in steps[1:]):
        if not low - 1e-4 <= reward <= high + 1e-4:  # float32 rounds
            what = f"the environment gave reward {reward:g}, outside its reward_range [{low:g}, {high:g}]"
            raise PluginError(what, hint="declare the whole range, because learned values are limited to it")
    if (rule := signature.goal_rule) is None:
        return
    achieved = np.concatenate([step.achieved_goal for step in steps])
    desired = np.concatenate([step.desired_goal for step in steps])
    for name in ("success", "reward", "terminated"):
        if (shape := np.shape(getattr(rule, name)(achieved, desired))) != (len(steps),):
            what = f"the goal rule's {name} has the shape {shape} for {len(steps)} goals, not ({len(steps)},)"
            raise PluginError(what, hint="compute it for each row, e.g. np.linalg.norm(achieved - desired, axis=-1)")
