"""An environment of gymnasium as an environment of karolos."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field as Setting
from pydantic import JsonValue, model_validator

from ..core import Array, Discrete, Environment, Field, FloatArray, Layout, Signature, Step
from ..core import Settings as BaseSettings
from ..errors import KarolosError, MachineError, UsageError
from .action_set import action_index

ID = "environment.id"
GOALS = ("achieved_goal", "desired_goal")


class Gymnasium(Environment):
    """The environment registered in gymnasium under `id`, with Box or Discrete actions.

    Observation: flat as by `gymnasium.spaces.flatten`, one field for each key of a Dict.
    Action: a bounded Box is rescaled from [-1, 1], a Discrete set gives one label for each of its numbers.
    Goals: none. A buffer relabels with a pure rule, and `compute_reward` is a method of an environment.
    Reward and termination: the environment's.
    What counts as success: the episode ends with a return of at least `success_return`; without it, of at least the
    `reward_threshold` the id is registered with; without either, `info["is_success"]`. Returns are judged at the end
    only: where rewards are negative, every episode begins above any threshold.

    Raises:
        UsageError: unknown id, or spaces that karolos cannot use; names the setting.
        MachineError: a library that the environment needs is missing.
    """

    class Settings(BaseSettings):
        id: str = Setting(min_length=1, description='as for gymnasium.make, e.g. "CartPole-v1" or "module:Name-v0"')
        kwargs: dict[str, JsonValue] = Setting({}, description="further arguments of gymnasium.make")
        max_steps: int | None = Setting(None, ge=1, description="steps per episode; null: as the id is registered")
        success_return: float | None = Setting(
            None, description="return from which an episode is a success; null: the id's reward_threshold"
        )
        reward_range: tuple[float, float] | None = Setting(
            None,
            description="smallest and largest reward of a step, where known: it bounds the learned values",
        )
        flatten_goals: bool = Setting(False, description="take the goals of a goal environment as observations")
        window: bool = Setting(False, description="show the environment in a window; needs a display")

        @model_validator(mode="after")
        def _ordered(self) -> Gymnasium.Settings:
            if self.reward_range and self.reward_range[0] > self.reward_range[1]:
                raise ValueError(f"reward_range must go from the smallest to the largest, not {self.reward_range}")
            return self

        def identity(self) -> dict[str, Any]:
            """The settings that results depend on."""
            return self.model_dump(mode="json", exclude={"window"})

    def __init__(self, settings: Gymnasium.Settings) -> None:
        self.settings = settings
        env = self._make(settings)
        try:
            self._space: Any = env.observation_space
            observation = _observation(self._space, settings)
            steps = settings.max_steps or getattr(env.spec, "max_episode_steps", None) or _registered_steps(settings.id)
            if not steps:
                raise UsageError(
                    f"{settings.id} is registered without a largest number of steps", where="environment.max_steps"
                )
            self.signature = Signature(
                observation=observation,
                action=_action(env.action_space),
                max_steps=steps,
                reward_range=settings.reward_range or (-np.inf, np.inf),
            )
        except BaseException:
            env.close()
            raise
        self._env = env
        self._actions: Any = env.action_space
        registered = getattr(env.spec, "reward_threshold", None)
        self._success_return = registered if settings.success_return is None else settings.success_return
        self._steps = steps  # no episode is running
        self._return = 0.0
        self._last: Step | None = None

    @staticmethod
    def _make(settings: Gymnasium.Settings) -> Any:
        import gymnasium  # noqa: PLC0415  (its import takes .2 s, and settings are read without it)

        def make(**kwargs: Any) -> Any:
            # without the TimeLimit wrapper: steps are counted here, so `max_steps` can exceed the registered limit
            return gymnasium.make(
                settings.id, max_episode_steps=-1, disable_env_checker=True, **settings.kwargs, **kwargs
            )

        try:
            env = make()
            modes = env.metadata.get("render_modes") or ()
            mode = "human" if settings.window else "rgb_array"
            if "render_mode" not in settings.kwargs and mode in modes:
                env.close()
                env = make(render_mode=mode)
        except KarolosError:
            raise
        except (gymnasium.error.DependencyNotInstalled, ImportError) as error:
            raise MachineError(f"{settings.id} needs a missing library: {_line(error)}", where=ID) from error
        except gymnasium.error.Error as error:
            raise UsageError(
                _line(error), where=ID, hint="`python -m pip list` shows what could register it"
            ) from error
        except TypeError as error:
            raise UsageError(
                f"{settings.id} does not take these arguments: {_line(error)}", where="environment.kwargs"
            ) from error
        return env

    def reset(self, seed: int) -> Step:
        observation, info = self._env.reset(seed=seed)
        self._steps = 0
        self._return = 0.0
        self._last = self._step(self._flat(observation), 0.0, False, False, info)
        return self._last

    def step(self, action: Array) -> Step:
        """One step. Raises ValueError for a wrong shape, NaN or an invalid index, RuntimeError after the episode."""
        converted = self._converted(np.asarray(action, np.float64))
        if self._last is None or self._steps >= self.signature.max_steps:
            raise RuntimeError(f"{self.settings.id}: the episode is over; reset the environment first")
        observation, reward, terminated, truncated, info = self._env.step(converted)
        self._steps += 1
        flat, reward = self._flat(observation), float(reward)
        if not (np.isfinite(reward) and np.isfinite(flat).all()):
            self._steps = self.signature.max_steps
            return self._last._replace(terminated=False, truncated=True, success=False, diverged=True)
        self._return += reward
        out_of_time = bool(truncated) or self._steps >= self.signature.max_steps
        self._last = self._step(flat, reward, bool(terminated), out_of_time and not terminated, info)
        if self._last.terminated or self._last.truncated:
            self._steps = self.signature.max_steps
        return self._last

    def _step(self, flat: FloatArray, reward: float, terminated: bool, truncated: bool, info: Any) -> Step:
        if self._success_return is None:
            success = bool(info.get("is_success", False))
        else:
            success = (terminated or truncated) and self._return >= self._success_return
        no_goal = np.zeros(0, np.float32)
        return Step(flat, no_goal, no_goal, reward, terminated, truncated, success)

    def _flat(self, observation: Any) -> FloatArray:
        from gymnasium.spaces import flatten  # noqa: PLC0415

        return np.array(flatten(self._space, observation), np.float32)

    def _converted(self, action: Array) -> Any:
        """The action in the environment's own space."""
        kind, space = self.signature.action, self._actions
        if isinstance(kind, Discrete):
            return space.start + action_index(action, kind, self.settings.id)
        if action.shape != (kind.size,) or not np.isfinite(action).all():
            raise ValueError(f"{self.settings.id}: an action is {kind.size} finite numbers, not {action.tolist()}")
        low, high = space.low.astype(np.float64).ravel(), space.high.astype(np.float64).ravel()
        middle = low + (np.clip(action, -1, 1) + 1) / 2 * (high - low)
        return np.clip(middle.astype(space.dtype).reshape(space.shape), space.low, space.high)

    def render(self, width: int = 640, height: int = 480) -> Array:
        if self._env.render_mode != "rgb_array":
            raise MachineError(f"{self.settings.id} draws no pictures", where=ID)
        try:
            picture = np.asarray(self._env.render(), np.uint8)
        except Exception as error:  # a missing pygame or graphics card raises errors of any class
            raise MachineError(f"{self.settings.id} cannot be drawn: {_line(error)}", where=ID) from error
        from PIL import Image  # noqa: PLC0415

        return np.asarray(Image.fromarray(picture).resize((width, height), Image.Resampling.BILINEAR))

    def close(self) -> None:
        self._env.close()


def _registered_steps(name: str) -> int | None:
    """The registered limit, which the spec of an environment made without TimeLimit lacks."""
    from gymnasium import spec  # noqa: PLC0415

    return spec(name.rpartition(":")[2]).max_episode_steps  # its module is imported by now


def _observation(space: Any, settings: Gymnasium.Settings) -> Layout:
    from gymnasium import spaces  # noqa: PLC0415

    if isinstance(space, spaces.Dict) and set(GOALS) <= set(space.spaces) and not settings.flatten_goals:
        raise UsageError(
            f"{settings.id} has goals, and gymnasium's rule for them cannot be shared with a buffer",
            where=ID,
            hint="flatten_goals: true takes them as observations; `robot` and `task` have hindsight",
        )
    if not space.is_np_flattenable:
        raise UsageError(f"its observations, {_line(space)}, cannot be laid out flat", where=ID)
    if isinstance(space, spaces.Dict):
        parts = tuple(Field(str(key), int(spaces.flatdim(part))) for key, part in space.spaces.items())
        return Layout(parts)
    return Layout((Field("observation", int(spaces.flatdim(space))),))


def _action(space: Any) -> Layout | Discrete:
    from gymnasium import spaces  # noqa: PLC0415

    if isinstance(space, spaces.Discrete):
        return Discrete(tuple(str(space.start + index) for index in range(int(space.n))))
    if not isinstance(space, spaces.Box):
        raise UsageError(f"its actions, {_line(space)}, are neither Box nor Discrete", where=ID)
    if not space.is_bounded():
        raise UsageError(f"its actions, {_line(space)}, have no bounds to rescale to", where=ID)
    return Layout((Field("action", int(np.prod(space.shape))),))


def _line(what: object) -> str:
    """The first line of a message."""
    return (str(what).splitlines() or [type(what).__name__])[0]
