"""Every robot with every task as a goal environment of gymnasium.

    gymnasium.make("karolos/UR5PickPlace-v1", control="cartesian", reward="sparse")

The ids are `karolos/<Robot><Task>-v1`, with the names of the classes of all installed plugins. Importing this module
registers them; plugins and pybullet are imported when an environment is made. Gymnasium imports a module that an id
names: `gymnasium.make("karolos.environments.gymnasium_export:karolos/PandaReach-v1")` needs no import of karolos.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..registry import alternatives, entries

if TYPE_CHECKING:
    from ..core import Environment

NAMESPACE = "karolos"
FRAMES_PER_SECOND = 24
OBSERVED = ("observation", "achieved_goal", "desired_goal")
_ACRONYMS = {"iiwa": "IIWA"}
_PARTS = (("robots", "robot"), ("tasks", "task"), ("environments", "environment"))

Observation = dict[str, NDArray[np.float32]]


def _render_modes() -> list[str]:
    """The modes that work on this machine. A window needs a display; `check_env` tries every listed mode."""
    return ["human", "rgb_array"] if sys.platform != "linux" or os.environ.get("DISPLAY") else ["rgb_array"]


class GoalEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """An environment of karolos with goals, with gymnasium's interface for goal environments.

    Observation: a dict of `observation` (o,), `achieved_goal` (a,) and `desired_goal` (d,), float32. Action: (n,) in
    [-1, 1], or the index of a discrete one. The environment itself truncates an episode. `reset(seed=s)` begins
    karolos' episode of the seed s.

    Args:
        environment: closed with this one.
        render_mode: None, "rgb_array", or "human" (a window in real time; the environment must support it).
        width: of a picture in pixels.
        height: of a picture in pixels.

    Raises:
        UsageError: the environment has no goals.
    """

    metadata = {"render_modes": _render_modes(), "render_fps": FRAMES_PER_SECOND}  # noqa: RUF012  (gymnasium reads it from the class)

    def __init__(
        self, environment: Environment, *, render_mode: str | None = None, width: int = 640, height: int = 480
    ) -> None:
        signature = environment.signature
        if signature.goal_rule is None:
            raise UsageError("the environment has no goals", where="environment")
        self.render_mode = render_mode
        self._size = (width, height)
        self._environment = environment
        self._rule = signature.goal_rule
        self._parameters = signature.parameters.names
        self._drawn = 0.0
        self.action_space = _action_space(signature.action)
        self.observation_space = gymnasium.spaces.Dict(  # type: ignore[assignment]  # a Dict of Boxes is what it gives
            {
                name: gymnasium.spaces.Box(-np.inf, np.inf, (getattr(signature, name).size,), np.float32)
                for name in OBSERVED
            }
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin the episode of this seed; without a seed, the next episode in the sequence of the last seed."""
        if options:
            raise UsageError(f"reset has no options, not {', '.join(map(repr, options))}")
        super().reset(seed=seed)
        episode = int(self.np_random.integers(2**63 - 1)) if seed is None else int(seed)
        step = self._environment.reset(episode)
        info = self._info(step) | {"seed": episode}
        if self._parameters:
            values = self._environment.parameters().tolist()
            info["parameters"] = dict(zip(self._parameters, values, strict=True))
        return _observed(step), info

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One control step. Raises ValueError for a wrong shape or NaN, RuntimeError when the episode is over."""
        step = self._environment.step(np.asarray(action, np.float32))
        if self.render_mode == "human":  # in real time
            now = time.monotonic()
            time.sleep(max(0.0, min(self._drawn + 1 / FRAMES_PER_SECOND - now, 1 / FRAMES_PER_SECOND)))
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

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (height, width, 3); None for a window."""
        return self._environment.render(*self._size) if self.render_mode == "rgb_array" else None

    def close(self) -> None:
        self._environment.close()


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
        super().__init__(environment, render_mode=render_mode, width=width, height=height)


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
        raise UsageError(f"{first['msg']}, not {first['input']!r}", where=path) from error


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
