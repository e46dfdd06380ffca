"""Every robot with every task as a goal environment of gymnasium.

    gymnasium.make("karolos/UR5PickPlace-v1", control="cartesian", reward="sparse")

The ids are `karolos/<Robot><Task>-v1`, with the names of the classes of all installed plugins. Importing this module
registers them, and so does importing karolos and gymnasium in any order; plugins and pybullet are imported when an
environment is made. `gymnasium.make("karolos:karolos/PandaReach-v1")` needs no import of karolos.
"""

from __future__ import annotations

import copy
import os
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Self

import gymnasium
import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..registry import alternatives, entries

if TYPE_CHECKING:
    from ..core import Environment

NAMESPACE = "karolos"
OBSERVED = ("observation", "achieved_goal", "desired_goal")
_ACRONYMS = {"iiwa": "IIWA"}
_PARTS = (("robots", "robot"), ("tasks", "task"), ("environments", "environment"))

Observation = dict[str, NDArray[np.float32]]


def _render_modes() -> list[str]:
    """The modes that work on this machine. A window needs a display; `check_env` tries every listed mode."""
    return ["human", "rgb_array"] if os.environ.get("DISPLAY") else ["rgb_array"]


@dataclass(frozen=True)
class EpisodeState:
    """An episode up to its current step. The seed and the actions determine it; can be pickled."""

    seed: int
    actions: tuple[NDArray[np.float32], ...]
    generator: Mapping[str, Any]
    """State of the generator that draws the seeds of later episodes."""


class GoalEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """An environment of karolos with goals, with gymnasium's interface for goal environments.

    Observation: a dict of `observation` (o,), `achieved_goal` (a,) and `desired_goal` (d,), float32. Action: (n,) in
    [-1, 1], or the index of a discrete one. The environment itself truncates an episode. `reset(seed=s)` begins
    karolos' episode of the seed s. `reset` opens a closed environment again; `step` and `render` raise
    ClosedEnvironmentError.

    `copy.deepcopy`, `save_state` and `restore_state` play the episode's actions again from its seed, which gives the
    same state bit for bit and takes as long as these steps took.

    Args:
        environment: closed with this one.
        render_mode: None, "rgb_array", or "human" (a window in real time; the environment must support it).
        width: of a picture in pixels.
        height: of a picture in pixels.
        build: builds the environment again, for `copy.deepcopy`; without it `environment` itself is copied.

    Raises:
        UsageError: the environment has no goals.
    """

    metadata = {"render_modes": _render_modes(), "render_fps": 24}  # noqa: RUF012  (gymnasium reads it from the class)
    _spec: gymnasium.envs.registration.EnvSpec | None = None

    def __init__(
        self,
        environment: Environment,
        *,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        build: Callable[[], Environment] | None = None,
    ) -> None:
        signature = environment.signature
        if signature.goal_rule is None:
            raise UsageError("the environment has no goals", setting="environment")
        self.render_mode = render_mode
        self._size = (width, height)
        self.metadata = {**type(self).metadata, "render_fps": environment.rate}
        self._environment = environment
        self._build = build
        self._rule = signature.goal_rule
        self._parameters = signature.parameters.names
        self._drawn = 0.0
        self._closed = False
        self._seed: int | None = None
        self._actions: list[NDArray[np.float32]] = []
        self.action_space = _action_space(signature.action)
        self.observation_space = gymnasium.spaces.Dict(  # type: ignore[assignment]  # a Dict of Boxes is what it gives
            {
                name: gymnasium.spaces.Box(-np.inf, np.inf, (getattr(signature, name).size,), np.float32)
                for name in OBSERVED
            }
        )

    @property
    def spec(self) -> gymnasium.envs.registration.EnvSpec | None:
        """What `gymnasium.make` sets, with the environment's own number of steps."""
        return self._spec

    @spec.setter
    def spec(self, value: gymnasium.envs.registration.EnvSpec | None) -> None:
        steps = self._environment.signature.max_steps
        self._spec = None if value is None else replace(value, max_episode_steps=steps)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the episode of this seed; without a seed, the next episode in the sequence of the last seed.

        There are no options: they are ignored with a warning.
        """
        if options:
            gymnasium.logger.warn(
                f"reset of {type(self).__name__} ignores options={options}: settings are arguments of gymnasium.make"
            )
        super().reset(seed=seed)
        episode = int(self.np_random.integers(2**63 - 1)) if seed is None else int(seed)
        step = self._environment.reset(episode)
        self._closed, self._seed, self._actions = False, episode, []
        info = self._info(step) | {"seed": episode}
        if self._parameters:
            values = self._environment.parameters().tolist()
            info["parameters"] = dict(zip(self._parameters, values, strict=True))
        return _observed(step), info

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step.

        Raises:
            ValueError: a wrong shape, or NaN.
            RuntimeError: the episode is over.
            ClosedEnvironmentError: the environment is closed.
        """
        self._demand_open("step")
        taken = np.array(action, np.float32)
        step = self._environment.step(taken)
        self._actions.append(taken)
        if self.render_mode == "human":  # in real time
            now, period = time.monotonic(), 1 / self._environment.rate
            time.sleep(max(0.0, min(self._drawn + period - now, period)))
            self._drawn = time.monotonic()
        return _observed(step), float(step.reward), bool(step.terminated), bool(step.truncated), self._info(step)

    @staticmethod
    def _info(step: Any) -> dict[str, Any]:
        return {"is_success": bool(step.success), "truncated": bool(step.truncated), "diverged": bool(step.diverged)}

    def compute_reward(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:  # noqa: ARG002
        """Reward (...) of achieved goals (..., a) and desired goals (..., d)."""
        reward = self._rule.reward(np.asarray(achieved_goal, np.float32), np.asarray(desired_goal, np.float32))
        return float(reward) if np.ndim(reward) == 0 else reward

    def compute_terminated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:  # noqa: ARG002
        """Whether the achieved goals end the episode: (...)."""
        ends = self._rule.terminated(np.asarray(achieved_goal, np.float32), np.asarray(desired_goal, np.float32))
        return bool(ends) if np.ndim(ends) == 0 else ends

    def compute_truncated(self, achieved_goal: Any, desired_goal: Any, info: Any) -> Any:  # noqa: ARG002
        """Whether the episode was truncated, which does not depend on goals: from the step's info, else False."""
        shape = np.shape(achieved_goal)[:-1]
        if not shape:
            return bool(info.get("truncated", False)) if isinstance(info, Mapping) else False
        if info is None or isinstance(info, Mapping) or len(info) != np.prod(shape):
            return np.zeros(shape, np.bool_)
        return np.array([bool(one.get("truncated", False)) for one in np.ravel(info)], np.bool_).reshape(shape)

    def save_state(self) -> EpisodeState:
        """The running episode up to its current step, for `restore_state`. Raises RuntimeError without an episode."""
        if self._seed is None:
            raise RuntimeError("there is no episode to save; reset the environment first")
        return EpisodeState(self._seed, tuple(self._actions), copy.deepcopy(self.np_random.bit_generator.state))

    def restore_state(self, state: EpisodeState) -> None:
        """Go to a saved step, of this environment or of another one with the same settings."""
        self.np_random.bit_generator.state = state.generator
        self._play(state.seed, state.actions)

    def _play(self, seed: int, actions: Iterable[NDArray[np.float32]]) -> None:
        self._environment.reset(seed)
        self._closed, self._seed, self._actions = False, seed, list(actions)
        for action in self._actions:
            self._environment.step(action)

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """An environment of its own at the same step of the same episode. A copy has no window."""
        copied = type(self).__new__(type(self))
        memo[id(self)] = copied
        for name, value in vars(self).items():
            if name not in ("_environment", "_build", "_rule"):
                setattr(copied, name, copy.deepcopy(value, memo))
        copied._build, copied._rule = self._build, self._rule
        copied._environment = self._build() if self._build else copy.deepcopy(self._environment, memo)
        if self.render_mode == "human":
            copied.render_mode = None
        if self._seed is not None and not self._closed:
            copied._play(self._seed, self._actions)
        return copied

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3); None for a window."""
        self._demand_open("render")
        return self._environment.render(*self._size) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._environment.close()
        self._closed = True

    def _demand_open(self, call: str) -> None:
        if self._closed:
            raise gymnasium.error.ClosedEnvironmentError(f"{call} after close; reset opens the environment again")


class RobotTaskEnv(GoalEnv):
    """One robot with one task. `render_mode`, `width` and `height` as of `GoalEnv`.

    Args:
        robot: name of a robot.
        task: name of a task.
        randomization: as in a spec, e.g. {"task.gravity": {"name": "normal", "mean": -9.81, "std": 0.1}}.
        settings: of the robot, the task and the environment (`substeps`, `actions`); each goes to the part that
            declares it.

    Raises:
        UsageError: an undeclared setting, or an invalid value.
        PluginError: robot and task are incompatible.
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
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise UsageError(
                f"there is no render mode {render_mode!r}",
                hint=alternatives(render_mode, self.metadata["render_modes"]) + "; human needs a display",
            )
        from .build import build_environment  # noqa: PLC0415  (it imports plugins)

        chosen = {"robot": robot, "task": task, "environment": "robot_task"}
        window = {"window": True} if render_mode == "human" else {}
        environment = build_environment(_recipe(chosen, {**settings, **window}, randomization or {}))
        plain = _recipe(chosen, settings, randomization or {})  # a copy has no window
        build = partial(build_environment, plain)
        super().__init__(environment, render_mode=render_mode, width=width, height=height, build=build)


def _action_space(action: Any) -> Any:
    from ..core import Discrete  # noqa: PLC0415

    if isinstance(action, Discrete):
        return gymnasium.spaces.Discrete(len(action.labels))
    return gymnasium.spaces.Box(-1.0, 1.0, (action.size,), np.float32)


def _observed(step: Any) -> Observation:
    """Copies: the environment uses one array for the goal throughout an episode."""
    return {name: getattr(step, name).copy() for name in OBSERVED}


def _recipe(chosen: Mapping[str, str], settings: Mapping[str, Any], randomization: Mapping[str, Any]) -> Any:
    """A recipe in which each part has the settings that it declares."""
    from ..registry import load  # noqa: PLC0415
    from ..spec.parts import (  # noqa: PLC0415
        OfKind,
        Part,
        Recipe,
    )

    models = {what: load(kind, chosen[what]).Settings for kind, what in _PARTS}
    allowed = sorted({name for model in models.values() for name in model.model_fields} - {"window"})
    for name in settings:
        if name not in allowed and name != "window":
            raise UsageError(
                f"neither robot {chosen['robot']!r} nor task {chosen['task']!r} has a setting {name!r}",
                hint=alternatives(name, [*allowed, "randomization", "render_mode", "width", "height"]),
            )
    parts = {}
    for kind, what in _PARTS:
        own = {name: value for name, value in settings.items() if name in models[what].model_fields}
        parts[what] = Part(kind, chosen[what], _checked(what, lambda model=models[what], own=own: model(**own)))
    drawn = tuple(
        (name, _checked(f"randomization.{name}", lambda value=value: OfKind("distributions").validate(dict(value))))
        for name, value in sorted(randomization.items())
    )
    return Recipe(**parts, randomization=drawn)


def _checked(where: str, make: Any) -> Any:
    from pydantic import ValidationError  # noqa: PLC0415

    try:
        return make()
    except ValidationError as error:
        first = error.errors()[0]
        path = ".".join([where, *map(str, first["loc"])])
        raise UsageError(f"{first['msg']}, not {first['input']!r}", setting=path) from error


def environment_ids() -> dict[str, tuple[str, str]]:
    """Robot and task behind each id, e.g. "karolos/PandaReach-v1": ("panda", "reach"). Imports no plugin."""
    robots, tasks = (_class_names(kind) for kind in ("robots", "tasks"))
    return {
        f"{NAMESPACE}/{robot_class}{task_class}-v1": (robot, task)
        for robot, robot_class in robots.items()
        for task, task_class in tasks.items()
    }


def _class_names(kind: str) -> dict[str, str]:
    """The class name of each plugin; where two are equal, the plugin's own name in capitalized words instead."""
    classes = {
        entry.name: _ACRONYMS.get(entry.name) or entry.target.partition(":")[2].rpartition(".")[2]
        for entry in entries(kind)
    }
    names = list(classes.values())
    return {
        plugin: name if names.count(name) == 1 else "".join(word.capitalize() for word in plugin.split("_"))
        for plugin, name in classes.items()
    }


def register() -> None:
    """Register all pairs in gymnasium. A second call has no effect."""
    for name, (robot, task) in environment_ids().items():
        if name not in gymnasium.registry:
            gymnasium.register(
                name,
                entry_point="karolos.environments.gymnasium_export:RobotTaskEnv",
                kwargs={"robot": robot, "task": task},
            )


register()
