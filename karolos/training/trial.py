"""The first steps of a spec's environments, as a run makes them: what fails there is told before anything runs."""

from __future__ import annotations

import re
from functools import partial

import numpy as np

from ..core import Signature
from ..core.signature import random_actions
from ..environments.build import build_environment
from ..environments.varied import is_setting
from ..errors import KarolosError, PluginError, WorkerError
from ..orchestrator.local import Local
from ..registry import find
from ..specification import Spec
from ..specification.parts import Recipe

STEPS = 3
"""Steps of the first episode, with random actions."""
EPISODES = 16
"""Episodes that begin where worlds are drawn. There may be eight worlds, and hardly one is left out."""


def try_environments(spec: Spec) -> Signature:
    """Make the first steps of an episode, where worlds are drawn of several and of a test. Returns the signature.

    Environments that are not karolos's own are tried in a worker process, as a run does: they may end it, or hang.

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
    processes = min(processes, int(not _is_own(recipe)))
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
        # There is one worker with one environment.
        place = re.sub("^(worker|environment|building)[^:]*(: )?", "", error.where or "")
        key = None if error.plugin else "environment.name" if spec.task is None else "task.name"
        what = ": ".join(filter(None, (place, error.what)))
        kind = PluginError if isinstance(error, WorkerError) else type(error)
        raise kind(what, setting=key, plugin=error.plugin, hint=error.hint) from None


def _is_own(recipe: Recipe) -> bool:
    """Whether nobody else's code is run."""
    parts = filter(None, (recipe.environment, recipe.robot, recipe.task))
    return all(find(one.kind, one.name).distribution == "karolos" and one.name != "gymnasium" for one in parts)
