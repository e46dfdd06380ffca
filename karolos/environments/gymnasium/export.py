"""Environments of karolos with gymnasium's interface; `karolos.gym` registers robots with tasks."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray
from pydantic import ValidationError

from ...core import Discrete, Environment, Step
from ...errors import UsageError, alternatives
from ...registry import load
from ...simulation.engines import ENGINES
from ...specification import Spec, spec_from_dict
from ...specification.parts import Part, Recipe
from ..build import Facts, build_environment
from ..robot_task import RobotTask

OBSERVED = ("observation", "achieved_goal", "desired_goal")
RENDER_MODES = ["human", "rgb_array"] if any(one.has_window for one in ENGINES.values()) else ["rgb_array"]
"""Render modes that work on this machine: a window needs a display, and `check_env` tries every listed mode."""


class Observation(dict[str, NDArray[np.float32]]):
    """A dict of `observation`, `achieved_goal` and `desired_goal` that knows the environment it comes from.

    Leading axes: none, or one over environments. A policy reads the `facts`. A copy made from the entries has none.
    """

    def __init__(self, step: Step, facts: Facts) -> None:
        super().__init__({name: np.array(getattr(step, name)) for name in OBSERVED})
        self.facts = facts


class Goals:
    """The methods about goals of gymnasium's goal environments, for one environment or several."""

    def __init__(self, facts: Facts) -> None:
        if facts.signature.goal_rule is None:
            raise UsageError("the environment has no goals", setting="environment")
        self.facts = facts
        self._rule = facts.signature.goal_rule

    @property
    def spaces(self) -> tuple[gymnasium.spaces.Dict, gymnasium.Space[Any]]:
        """The spaces of one environment's observations and actions."""
        signature = self.facts.signature
        sizes = {name: getattr(signature, name).size for name in OBSERVED}
        boxes: dict[str, gymnasium.Space[Any]] = {
            name: gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32) for name, size in sizes.items()
        }
        if isinstance(signature.action, Discrete):
            return gymnasium.spaces.Dict(boxes), gymnasium.spaces.Discrete(len(signature.action.labels))
        return gymnasium.spaces.Dict(boxes), gymnasium.spaces.Box(-1.0, 1.0, (signature.action.size,), np.float32)

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:
        """Reward (...) of achieved goals (..., a) and desired goals (..., d), with the part of it in the step's info.

        A batch has a list of infos, or one info for all. With None or {} nothing is added.
        """
        reward = self._rule.reward(np.asarray(achieved_goal, np.float32), np.asarray(desired_goal, np.float32))
        if self.facts.signature.extra_reward != (0.0, 0.0):
            if info is None or isinstance(info, Mapping):
                reward = reward + np.float32((info or {}).get("extra_reward", 0.0))
            else:
                extra = np.array([one.get("extra_reward", 0.0) for one in info], np.float32)
                reward = reward + extra.reshape(np.shape(reward))
        return float(reward) if np.ndim(reward) == 0 else reward

    def compute_terminated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:  # noqa: ARG002
        """Whether the achieved goals end the episode: (...)."""
        ends = self._rule.terminated(np.asarray(achieved_goal, np.float32), np.asarray(desired_goal, np.float32))
        return bool(ends) if np.ndim(ends) == 0 else ends

    def compute_truncated(self, achieved_goal: Any, desired_goal: Any, info: Mapping[str, Any]) -> bool:  # noqa: ARG002
        """Whether the step that gave this info was truncated, which does not depend on goals."""
        return bool(info.get("truncated", False))


class GoalEnv(Goals, gymnasium.Env[Observation, NDArray[np.float32]]):
    """An environment of karolos with goals, with gymnasium's interface for goal environments.

    Observation: a dict of `observation` (o,), `achieved_goal` (a,) and `desired_goal` (d,), float32. Action: (n,) in
    [-1, 1], or the index of a discrete one. The environment itself truncates an episode. `reset(seed=s)` begins
    karolos' episode of the seed s; without a seed, the next episode in the sequence of the last one. A reset has no
    options.

    Args:
        environment: closed with this one.
        render_mode: None, "rgb_array", or "human" (a window in real time; the environment must support it).
        width: of a picture in pixels.
        height: of a picture in pixels.

    Raises UsageError if the environment has no goals.
    """

    metadata = {"render_modes": RENDER_MODES, "render_fps": 24}  # noqa: RUF012  (gymnasium reads it from the class)
    _spec: EnvSpec | None = None

    def __init__(
        self, environment: Environment, *, render_mode: str | None = None, width: int = 640, height: int = 480
    ) -> None:
        super().__init__(Facts.of(environment))
        self.render_mode = render_mode
        self._size = (width, height)
        self.metadata = {**type(self).metadata, "render_fps": environment.rate}
        if isinstance(environment, RobotTask) and "window" not in ENGINES[environment.settings.engine].abilities:
            self.metadata["render_modes"] = ["rgb_array"]
        self._environment = environment
        self._shown = 0.0
        """When the window last showed a step, in s."""
        self.observation_space, self.action_space = self.spaces  # type: ignore[assignment]  # Discrete has an index

    @property
    def spec(self) -> EnvSpec | None:
        """The spec that `gymnasium.make` sets, with the environment's own number of steps."""
        return self._spec

    @spec.setter
    def spec(self, value: EnvSpec | None) -> None:
        steps = self._environment.signature.max_steps
        self._spec = None if value is None else replace(value, max_episode_steps=steps)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode. The info has its seed and the sampled parameters."""
        super().reset(seed=seed, options=options)
        self._refuse_longer_limits()
        episode = int(self.np_random.integers(2**63 - 1)) if seed is None else int(seed)
        step = self._environment.reset(episode)
        names, values = self._environment.signature.parameters.names, self._environment.parameters().tolist()
        info = self._info(step, started=False) | {"seed": episode}
        if names:
            info["parameters"] = dict(zip(names, values, strict=True))
        return Observation(step, self.facts), info

    def _refuse_longer_limits(self) -> None:
        """Raise UsageError for a TimeLimit around this environment that would never end an episode."""
        steps, caller = self._environment.signature.max_steps, sys._getframe(2)
        while caller is not None:
            wrapper = caller.f_locals.get("self") if caller.f_code.co_name == "reset" else None
            if isinstance(wrapper, gymnasium.wrappers.TimeLimit) and wrapper._max_episode_steps > steps:
                what = f"a limit of {wrapper._max_episode_steps} steps has no effect: episodes end after {steps}"
                raise UsageError(what, hint=f"give max_steps={wrapper._max_episode_steps}, a setting of the task")
            caller = caller.f_back  # type: ignore[assignment]

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step. At the end of an episode the info has its measures, nan where undefined.

        Raises ValueError for a wrong shape or NaN, RuntimeError after the end of the episode.
        """
        step = self._environment.step(np.array(action, np.float32))
        if self.render_mode == "human":  # in real time
            now, period = time.monotonic(), 1 / self._environment.rate
            time.sleep(max(0.0, min(self._shown + period - now, period)))
            self._shown = time.monotonic()
        info, measures = self._info(step), self._environment.signature.measures
        if measures and (step.terminated or step.truncated):
            values = self._environment.measures().tolist()
            info["measures"] = {one.name: value for one, value in zip(measures, values, strict=True)}
        return Observation(step, self.facts), float(step.reward), bool(step.terminated), bool(step.truncated), info

    def _info(self, step: Step, *, started: bool = True) -> dict[str, Any]:
        info = {"is_success": bool(step.success), "truncated": bool(step.truncated), "diverged": bool(step.diverged)}
        if self._environment.signature.extra_reward == (0.0, 0.0) or step.diverged or not started:
            return info
        return {**info, "extra_reward": float(step.reward - self._rule.reward(step.achieved_goal, step.desired_goal))}

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3); None for a window."""
        return self._environment.render(*self._size) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._environment.close()


class RobotTaskEnv(GoalEnv):
    """One robot with one task. `render_mode`, `width` and `height` as of `GoalEnv`.

    Args:
        randomization: as in a spec, e.g. {"task.gravity": {"name": "normal", "mean": -9.81, "std": 0.1}}.
        settings: of the robot, the task and the environment (`substeps`, `actions`); each goes to the part that
            declares it.

    Raises:
        UsageError: an undeclared setting, or an invalid value; or robot and task are incompatible.
    """

    def __init__(
        self,
        robot: str,
        task: str,
        *,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        randomization: Mapping[str, Mapping[str, Any]] | None = None,
        **settings: Any,
    ) -> None:
        recipe = robot_task_recipe(robot, task, settings, randomization or {})
        super().__init__(_opened(recipe, render_mode), render_mode=render_mode, width=width, height=height)


class SpecEnv(GoalEnv):
    """The environment of a spec, with all its settings. `render_mode`, `width` and `height` as of `GoalEnv`.

    `gymnasium.make(environment.spec)` makes another one, `gymnasium.make_vec(environment.spec, num_envs=8)` several.

    Args:
        spec: a spec, or a dictionary of that shape, such as `Spec.dump()`.
        randomize: whether to sample the spec's `randomization` at each reset, as in training. Tests do not.

    Raises UsageError if the environment has no goals, and as `build_environment`.
    """

    def __init__(
        self,
        spec: Spec | Mapping[str, Any],
        *,
        randomize: bool = False,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
    ) -> None:
        spec = spec if isinstance(spec, Spec) else spec_from_dict(spec)
        environment = _opened(spec.recipe(randomize=randomize), render_mode)
        super().__init__(environment, render_mode=render_mode, width=width, height=height)
        picture = {"render_mode": render_mode, "width": width, "height": height} if render_mode else {}
        self.spec = EnvSpec(
            f"karolos/{spec.name}",
            f"{__name__}:SpecEnv",
            vector_entry_point="karolos.orchestrator.vector:spec_envs",
            kwargs={"spec": spec.alone().dump(), "randomize": randomize, **picture},
        )


def _opened(recipe: Recipe, render_mode: str | None) -> Environment:
    """The recipe's environment, with a window for "human"."""
    if render_mode not in (None, *RENDER_MODES):
        raise UsageError(
            f"there is no render mode {render_mode!r}",
            hint=alternatives(str(render_mode), RENDER_MODES) + "; human needs a display and engine=bullet",
        )
    if render_mode == "human" and "window" in type(recipe.environment.settings).model_fields:
        settings = recipe.environment.settings.model_copy(update={"window": True})
        recipe = replace(recipe, environment=replace(recipe.environment, settings=settings))
    return build_environment(recipe)


def robot_task_recipe(robot: str, task: str, settings: Mapping[str, Any], randomization: Mapping[str, Any]) -> Recipe:
    """A recipe in which each part has the settings that it declares."""
    named = {"robot": ("robots", robot), "task": ("tasks", task), "environment": ("environments", "robot_task")}
    models = {what: load(*plugin).Settings for what, plugin in named.items()}
    allowed = {name for model in models.values() for name in model.model_fields}
    for name in settings:
        if name not in allowed:
            raise UsageError(
                f"neither robot {robot!r} nor task {task!r} has a setting {name!r}",
                hint=alternatives(name, [*sorted(allowed), "randomization", "render_mode", "width", "height"]),
            )
    parts = {}
    for what, plugin in named.items():
        own = {name: value for name, value in settings.items() if name in models[what].model_fields}
        parts[what] = Part(*plugin, _valid(what, models[what].model_validate, own))
    drawn = ((name, _valid(f"randomization.{name}", _distribution, dict(one))) for name, one in randomization.items())
    return Recipe(**parts, randomization=tuple(sorted(drawn)))


def _distribution(given: dict[str, Any]) -> Part:
    return Part.of("distributions", given.pop("name", ""), given)


def _valid(where: str, validate: Callable[[Any], Any], value: Any) -> Any:
    try:
        return validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join([where, *map(str, first["loc"])])
        raise UsageError(f"{first['msg']}, not {first['input']!r}", setting=path) from error
