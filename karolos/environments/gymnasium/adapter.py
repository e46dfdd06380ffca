"""An environment of gymnasium as an environment of karolos, and its goals as a goal rule for buffers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field as Setting
from pydantic import JsonValue, field_validator, model_validator

from ...core import (
    Array,
    BoolArray,
    Discrete,
    Environment,
    Field,
    FloatArray,
    GoalRule,
    Layout,
    Measure,
    Signature,
    Step,
)
from ...core import Settings as BaseSettings
from ...errors import KarolosError, MachineError, PluginError, UsageError, described
from ..action_set import action_index

ID_SETTING = "environment.id"
MOST_ACTIONS = 100_000
NO_GOAL = np.zeros(0, np.float32)


class InfoMeasure(BaseSettings):
    """A measure in the info of an environment."""

    unit: str = Setting("1", description="unit, e.g. N; 1: none")
    better: Literal["smaller", "larger"] = Setting(description="whether smaller or larger values are better")
    description: str = Setting("", description="one line that says what is measured")


class Gymnasium(Environment):
    """The environment registered in gymnasium under `id`, with Box or Discrete actions.

    Observation: flat as by `gymnasium.spaces.flatten`, one field for each key of a Dict.
    Action: a bounded Box is rescaled from [-1, 1], a Discrete set gives one label for each of its numbers.
    Goals: with `goals: true` those of a goal environment, for hindsight: a Dict of observations with `achieved_goal`
    and `desired_goal`, and a method `compute_reward(achieved (n, a), desired (n, d), info)` that gives rewards (n,).
    The info is an empty dict. A few steps with random actions check it against the rewards of the environment.
    Reward and termination: the environment's.
    What counts as success, with goals: a reward of at least `success_reward`. Without goals: the episode ends with a
    return of at least `success_return`; without it, of at least the `reward_threshold` the id is registered with;
    without either, `info["is_success"]`, and results show only returns until a test has such a success. Returns are
    judged only at the end: with negative rewards every episode begins above any threshold.
    Measures: numbers in the `info` of the last step, by the names in `measures`; undefined where the info lacks one.

    Raises:
        UsageError: unknown id, spaces that karolos cannot use, or a `compute_reward` that disagrees with the rewards;
            names the setting.
        MachineError: a library that the environment needs is missing.
    """

    class Settings(BaseSettings):
        id: str = Setting(min_length=1, description='id as in gymnasium.make, e.g. "CartPole-v1" or "module:Name-v0"')
        kwargs: dict[str, JsonValue] = Setting({}, description="more arguments of gymnasium.make")
        max_steps: int | None = Setting(None, ge=1, le=10_000_000, description="steps per episode; null: as registered")
        success_return: float | None = Setting(
            None, description="an episode with at least this return is a success; null: the id's reward_threshold"
        )
        reward_range: tuple[float, float] | None = Setting(
            None,
            description="smallest and largest reward of a step, if known; they bound the learned values",
        )
        goals: bool = Setting(False, description="keep the goals of a goal environment, for hindsight")
        success_reward: float | None = Setting(
            None,
            description="with goals: a step with at least this reward has reached the goal; null: the reward when the "
            "achieved goal equals the desired one. Needed for dense rewards",
        )
        goal_terminates: bool | None = Setting(
            None,
            description="with goals: whether reaching the goal ends the episode; null: as the environment's "
            "compute_terminated says; false if it has none",
        )
        flatten_goals: bool = Setting(False, description="use the goals of a goal environment as observations")
        measures: dict[str, InfoMeasure] = Setting(
            {}, description="measures of an episode: keys of the last step's info, each with unit and better"
        )
        window: bool = Setting(False, description="show the environment in a window; needs a display")

        @field_validator("id")
        @classmethod
        def _well_formed(cls, name: str) -> str:
            if not all(name.split(":")) or name.count(":") > 1:
                raise ValueError(f'{name!r} must be "Name-v0" or "module:Name-v0"')
            module, _, own = name.rpartition(":")
            stem = module.removesuffix(".py").replace("\\", "/").rpartition("/")[2]
            if module != stem and not all(part.isidentifier() and part != "py" for part in module.split(".")):
                what = f"{module!r} is a file, not the name of a module"
                raise ValueError(f'{what}; write "{stem}:{own}", and put its folder into PYTHONPATH')
            return name

        @model_validator(mode="after")
        def _ordered(self) -> Self:
            if "max_episode_steps" in self.kwargs:
                raise ValueError("kwargs cannot have max_episode_steps; set max_steps instead")
            if self.reward_range and self.reward_range[0] > self.reward_range[1]:
                raise ValueError(f"reward_range must be [smallest, largest], not {self.reward_range}")
            if self.goals and (self.flatten_goals or self.success_return is not None):
                other = "flatten_goals" if self.flatten_goals else "success_return"
                raise ValueError(f"goals and {other} exclude each other")
            if not self.goals and not (self.success_reward is None and self.goal_terminates is None):
                raise ValueError("success_reward and goal_terminates need goals: true")
            return self

        def identity(self) -> dict[str, Any]:
            """The settings that change results."""
            return self.model_dump(mode="json", exclude={"window", "measures"})

    def __init__(self, settings: Gymnasium.Settings) -> None:
        self.settings = settings
        env = make_environment(settings)
        from gymnasium import spaces, spec  # noqa: PLC0415  (imported by now)

        registered = getattr(env.spec, "reward_threshold", None)
        self._success_return = registered if settings.success_return is None else settings.success_return
        try:
            self._space: Any = _observed(env.observation_space, settings)
            limit = _own_limit(env)
            if settings.max_steps and limit and limit < settings.max_steps:
                what = f"{settings.id} itself ends its episodes after {limit} steps"
                hint = f"at most {limit}, or raise that in its arguments, environment.kwargs"
                raise UsageError(what, setting="environment.max_steps", hint=hint)
            steps = settings.max_steps
            if not steps:  # env.spec lacks the registered limit, because it was made without TimeLimit
                made = getattr(env.spec, "id", "")
                if made.rpartition("-v")[0] == settings.id.rpartition(":")[2]:
                    what = f"{settings.id} names no version, and gymnasium takes the newest"
                    raise UsageError(what, setting=ID_SETTING, hint=f"write {made}")
                listed = spec(settings.id.rpartition(":")[2]).max_episode_steps
                steps = min(filter(None, (limit, listed)), default=None)
            if not steps:
                raise UsageError(
                    f"{settings.id} is registered without a largest number of steps", setting="environment.max_steps"
                )
            goals: dict[str, Any] = {}
            self._rule: GymnasiumGoals | None = None
            if settings.goals:
                make = partial(make_environment, settings)
                self._rule = GymnasiumGoals(make, env, settings.id, settings.success_reward, settings.goal_terminates)
                shapes = {name: env.observation_space[name].shape for name in GOALS}
                goals = {name: Layout((Field(name, int(np.prod(shape))),)) for name, shape in shapes.items()}
            named = isinstance(self._space, spaces.Dict)
            parts = self._space.items() if named else [("observation", self._space)]
            self.signature = Signature(
                observation=Layout(tuple(Field(str(key), int(spaces.flatdim(part))) for key, part in parts)),
                action=_action(env.action_space),
                max_steps=steps,
                reward_range=settings.reward_range or (-np.inf, np.inf),
                goal_rule=self._rule,
                has_success=settings.goals or settings.flatten_goals or self._success_return is not None,
                measures=tuple(Measure(name, **dict(one)) for name, one in settings.measures.items()),
                **goals,
            )
        except BaseException:
            env.close()
            raise
        self._env = env
        self.rate = float(env.metadata.get("render_fps") or self.rate)
        self._actions: Any = env.action_space
        self._steps = steps  # no episode is running
        self._return = 0.0
        self._last: Step | None = None
        self._info: Mapping[str, Any] = {}
        """The info of the last step."""
        self._seen = False
        """Whether observations were compared with their space."""

    def reset(self, seed: int) -> Step:
        found = self._env.reset(seed=seed)
        observation, info = self._parts(found, "reset", "observation, info")
        self._steps = 0
        self._return = 0.0
        self._last = self._step(observation, 0.0, False, False, info)
        if self._rule is not None:
            success = self._rule.success(self._last.achieved_goal, self._last.desired_goal)
            self._last = self._last._replace(success=bool(success))
        return self._last

    def step(self, action: Array) -> Step:
        """One step. Raises ValueError for a wrong shape, NaN or an invalid index, RuntimeError after the episode."""
        converted = self._converted(np.asarray(action, np.float64))
        if self._last is None or self._steps >= self.signature.max_steps:
            raise RuntimeError(f"{self.settings.id}: the episode is over; reset the environment first")
        found = self._env.step(converted)
        names = "observation, reward, terminated, truncated, info"
        observation, reward, terminated, truncated, info = self._parts(found, "step", names)
        if np.ndim(reward) or np.asarray(reward).dtype.kind not in "biuf":
            raise self._broken(f"step returns the reward {_line(repr(reward))}, which is not a number")
        for name, value in (("terminated", terminated), ("truncated", truncated)):
            if not isinstance(value, bool | np.bool_):
                raise self._broken(f"step returns {name} {_line(repr(value))}, which is not a bool")
        self._steps += 1
        self._info = info
        reward = float(reward)
        out_of_time = bool(truncated) or self._steps >= self.signature.max_steps
        self._return += reward
        step = self._step(observation, reward, bool(terminated), out_of_time and not terminated, info)
        if not (np.isfinite(reward) and all(np.isfinite(values).all() for values in step[:3])):
            self._steps, self._info = self.signature.max_steps, {}
            return self._last._replace(reward=0.0, terminated=False, truncated=True, success=False, diverged=True)
        if self._rule is not None:
            self._rule.check_end(step)
        self._last = step
        if self._last.terminated or self._last.truncated:
            self._steps = self.signature.max_steps
        return self._last

    def _parts(self, found: Any, method: str, names: str) -> tuple[Any, ...]:
        """Check the result of a method. In the first steps also compare the observation with its space."""
        count = names.count(",") + 1
        if not isinstance(found, tuple) or len(found) != count or not isinstance(found[-1], Mapping):
            raise self._broken(f"{method} returns no tuple ({names}) with a dict at its end")
        if not self._seen and (problem := _difference(self._env.observation_space, found[0])):
            raise self._broken(f"{method} returns {problem}")
        self._seen = method == "step"
        return found

    def _broken(self, what: str) -> PluginError:
        return PluginError(f"{self.settings.id}: {what}", setting=ID_SETTING, hint="correct the environment")

    def _step(self, observation: Any, reward: float, terminated: bool, truncated: bool, info: Any) -> Step:
        from gymnasium.spaces import flatten  # noqa: PLC0415

        achieved = desired = NO_GOAL
        if self._rule is not None:
            achieved, desired = (np.array(observation[name], np.float32).ravel() for name in GOALS)
            success = bool(np.float32(reward) >= self._rule.success_reward)
        elif self._success_return is None:
            success = bool(info.get("is_success", False))
        else:
            success = (terminated or truncated) and self._return >= self._success_return
        flat = np.array(flatten(self._space, observation), np.float32)
        return Step(flat, achieved, desired, reward, terminated, truncated, success)

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

    def measures(self) -> FloatArray:
        values = {one.name: self._info.get(one.name) for one in self.signature.measures}
        try:
            found = np.array(list(values.values()), np.float32)
        except (TypeError, ValueError) as error:
            what = f"the info of {self.settings.id} has other values than numbers: {values}"
            raise UsageError(what, setting="environment.measures", hint="name keys whose values are numbers") from error
        found[np.isinf(found)] = np.nan
        return found

    def render(self, width: int = 640, height: int = 480) -> Array:
        if self._env.render_mode != "rgb_array":
            raise MachineError(f"{self.settings.id} draws no pictures", setting=ID_SETTING)
        from PIL import Image  # noqa: PLC0415

        try:
            picture = Image.fromarray(np.asarray(self._env.render(), np.uint8))
        except Exception as error:  # a missing pygame or graphics card raises errors of any class
            raise MachineError(f"{self.settings.id} cannot be drawn: {_line(error)}", setting=ID_SETTING) from error
        return np.asarray(picture.resize((width, height), Image.Resampling.BILINEAR))

    def close(self) -> None:
        self._steps = self.signature.max_steps  # no episode is running
        if self._rule is not None:
            self._rule.detach()
        self._env.close()


def make_environment(settings: Gymnasium.Settings) -> Any:
    """The environment of `gymnasium.make`, without its limit of steps. Raises UsageError or MachineError."""
    import gymnasium  # noqa: PLC0415  (its import takes .2 s, and settings are read without it)

    if (module := settings.id.rpartition(":")[0]) and (run := _run_that_holds(module)):
        raise UsageError(
            f"the module {module} lies in a folder of runs and is not imported",
            setting=ID_SETTING,
            hint=f"runs hold no code; move it out of {run} if you wrote it",
        )

    def make(**kwargs: Any) -> Any:
        # without the TimeLimit wrapper: steps are counted here, so `max_steps` can exceed the registered limit
        return gymnasium.make(settings.id, max_episode_steps=-1, disable_env_checker=True, **settings.kwargs, **kwargs)

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
        if module and getattr(error.__cause__, "name", None) in (module, module.partition(".")[0]):
            what = f"{settings.id}: Python finds no module {module!r}"
            hint = "put the folder of its file into PYTHONPATH, or install its package"
            raise MachineError(what, setting=ID_SETTING, hint=hint) from error
        raise MachineError(f"{settings.id} needs a missing library: {_line(error)}", setting=ID_SETTING) from error
    except gymnasium.error.Error as error:
        raise UsageError(
            _line(error), setting=ID_SETTING, hint="`python -m pip list` shows what could register it"
        ) from error
    except Exception as error:  # a constructor may raise anything
        raise UsageError(
            f"{settings.id} cannot be made: {described(error)}",
            setting="environment.kwargs" if settings.kwargs else ID_SETTING,
        ) from error
    return env


def _run_that_holds(module: str) -> Path | None:
    """The folder of a run, or of runs below the path, in which a module lies; nothing is imported to find it."""
    top, *inner = module.split(".")
    try:
        spec = find_spec(top)
    except ValueError:  # as for __main__
        return None
    for place in (spec.submodule_search_locations or (spec.origin or "",)) if spec else ():
        path, root = Path(place, *inner).resolve(), Path(place).resolve().parent
        for folder in (path, *path.parents):
            if (folder / "run.json").exists() or (root in folder.parents and any(folder.glob("*/run.json"))):
                return folder
    return None


def _own_limit(env: Any) -> int | None:
    """Number of steps after which the environment itself, or a TimeLimit in it, ends an episode."""
    from gymnasium.wrappers import TimeLimit  # noqa: PLC0415

    limits = [getattr(env.spec, "max_episode_steps", None)]
    while env is not env.unwrapped:
        limits.append(env._max_episode_steps if isinstance(env, TimeLimit) else None)
        env = env.env
    return min(filter(None, limits), default=None)


def _observed(space: Any, settings: Gymnasium.Settings) -> Any:
    """The observed space, without the goals if these are used as goals."""
    from gymnasium import spaces  # noqa: PLC0415

    has_goals = isinstance(space, spaces.Dict) and set(GOALS) <= set(space.spaces)
    if has_goals and not (settings.flatten_goals or settings.goals):
        raise UsageError(
            f"{settings.id} has goals, and the spec does not say how to use them",
            setting="environment.goals",
            hint="goals: true keeps them for hindsight; flatten_goals: true takes them as observations",
        )
    if settings.goals and not has_goals:
        raise UsageError(
            f"{settings.id} has no goals: a goal environment observes a Dict with {' and '.join(GOALS)}",
            setting="environment.goals",
        )
    if not space.is_np_flattenable:
        raise UsageError(f"its observations, {_line(space)}, cannot be laid out flat", setting=ID_SETTING)
    parts = space.values() if isinstance(space, spaces.Dict) else (space,)
    if any(part.dtype == np.uint8 and len(part.shape or ()) > 1 for part in parts):
        raise UsageError(
            f"its observations, {_line(space)}, are pictures, and karolos's networks have no convolutions",
            setting=ID_SETTING,
            hint="choose one that observes vectors, or wrap it: gymnasium.wrappers.FlattenObservation",
        )
    return spaces.Dict({key: part for key, part in space.items() if key not in GOALS}) if settings.goals else space


def _difference(space: Any, value: Any, name: str = "observation") -> str | None:
    """The part of an observation that is not in its space. Numbers may have a higher precision."""
    from gymnasium import spaces  # noqa: PLC0415

    if isinstance(space, spaces.Dict) and isinstance(value, Mapping) and set(space) <= set(value):
        return next(filter(None, (_difference(part, value[key], f"{key!r}") for key, part in space.items())), None)
    inside = not isinstance(space, spaces.Box) or np.can_cast(np.asarray(value).dtype, space.dtype, "same_kind")
    if inside and space.contains(np.asarray(value, space.dtype) if isinstance(space, spaces.Box) else value):
        return None
    return f"{name} {_line(value)}, which is not in its space {_line(space)}"


def _action(space: Any) -> Layout | Discrete:
    from gymnasium import spaces  # noqa: PLC0415

    if isinstance(space, spaces.Discrete):
        if space.n > MOST_ACTIONS:
            what = f"its {space.n:,} actions are more than {MOST_ACTIONS:,}, for which an agent has outputs"
            raise UsageError(what, setting=ID_SETTING)
        return Discrete(tuple(str(space.start + index) for index in range(int(space.n))))
    if not isinstance(space, spaces.Box):
        raise UsageError(f"its actions, {_line(space)}, are neither Box nor Discrete", setting=ID_SETTING)
    if not space.is_bounded():
        raise UsageError(f"its actions, {_line(space)}, have no bounds to rescale to", setting=ID_SETTING)
    return Layout((Field("action", int(np.prod(space.shape))),))


def _line(what: object) -> str:
    """The first line of a message."""
    return (str(what).splitlines() or [type(what).__name__])[0]


GOALS = ("achieved_goal", "desired_goal")
PROBED_STEPS = 32
"""Steps with random actions whose rewards are compared with `compute_reward` before the first episode."""
GOALS_SETTING = "environment.goals"


class GymnasiumGoals(GoalRule):
    """Reward and termination by the environment's `compute_reward` and `compute_terminated`.

    A pickled rule has no environment. It makes one at its first use.

    Args:
        make: makes the environment; can be pickled.
        env: made by it. Episodes are played in it to check the rule.
        success_reward: reward from which a goal is reached; None: the reward where both goals are equal.
        goal_terminates: whether reaching the goal ends an episode; None: as `compute_terminated` says.

    Raises UsageError for goals that cannot be laid out flat, or a `compute_reward` that is missing, not vectorised, or
    disagrees with the environment's rewards.
    """

    def __init__(
        self,
        make: Callable[[], Any],
        env: Any,
        name: str,
        success_reward: float | None,
        goal_terminates: bool | None,
    ) -> None:
        self._make = make
        self._env: Any = env
        self._name = name
        spaces = [env.observation_space[goal] for goal in GOALS]
        for goal, space in zip(GOALS, spaces, strict=True):
            if not space.shape or (not np.issubdtype(space.dtype, np.number) and space.dtype != np.bool_):
                raise UsageError(f"{goal} of {name}, {space}, is not an array of numbers", setting=GOALS_SETTING)
        self._shapes = [tuple(space.shape) for space in spaces]
        self._types = [space.dtype for space in spaces]
        if not callable(self._method("compute_reward")):
            raise UsageError(
                f"{name} has no method compute_reward(achieved_goal, desired_goal, info), which hindsight needs",
                setting=GOALS_SETTING,
                hint="flatten_goals: true takes the goals as observations",
            )
        self._by_method = goal_terminates is None and callable(self._method("compute_terminated"))
        self._goal_terminates = bool(goal_terminates)
        self.success_reward = np.float32(0.0 if success_reward is None else success_reward)
        self._probe(success_reward is not None)

    def reward(self, achieved: Array, desired: Array) -> FloatArray:
        return np.asarray(self._by_rows("compute_reward", achieved, desired), np.float32)

    def success(self, achieved: Array, desired: Array) -> BoolArray:
        return np.asarray(self.reward(achieved, desired) >= self.success_reward)

    def terminated(self, achieved: Array, desired: Array) -> BoolArray:
        if self._by_method:
            return np.asarray(self._by_rows("compute_terminated", achieved, desired), np.bool_)
        if self._goal_terminates:
            return self.success(achieved, desired)
        return super().terminated(achieved, desired)

    def check_end(self, step: Step) -> None:
        """Raise PluginError if a step ends its episode at the goal, or goes on there, and the rule says otherwise."""
        if not step.success or self._by_method or bool(step.terminated) == self._goal_terminates:
            return
        does = "ends" if step.terminated else "does not end"
        raise PluginError(
            f"{self._name} {does} an episode that reaches its goal",
            setting="environment.goal_terminates",
            hint=f"set environment.goal_terminates={str(bool(step.terminated)).lower()}",
        )

    def detach(self) -> None:
        """Forget the environment, which is closed."""
        self._env = None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_env": None}

    def _method(self, name: str) -> Any:
        if self._env is None:
            self._env = self._make()
            self._env.reset(seed=0)
        # a wrapper may have the method too; otherwise the environment has it
        return getattr(self._env, name, None) or getattr(self._env.unwrapped, name, None)

    def _by_rows(self, method: str, achieved: Array, desired: Array) -> Array:
        """The method's result for goals (..., a) and (..., d), in the shape (...)."""
        leading = np.shape(achieved)[:-1]
        if 0 in leading:
            return np.zeros(leading)
        goals = [
            np.asarray(goal).astype(dtype).reshape(-1, *shape)
            for goal, dtype, shape in zip((achieved, desired), self._types, self._shapes, strict=True)
        ]
        compute, count = self._method(method), len(goals[0])
        found = np.asarray(compute(*goals, {}))
        if found.shape != (count,):  # `compute_terminated` is often written for one goal
            found = np.array([compute(one, other, {}) for one, other in zip(*goals, strict=True)])
        return found.reshape(leading)

    def _probe(self, success_reward_is_set: bool) -> None:
        """Play some steps and compare the environment's rewards with those of `compute_reward`."""
        env = self._env
        env.action_space.seed(0)
        observation, _ = env.reset(seed=0)
        seen = []
        for _ in range(PROBED_STEPS):
            observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
            seen.append((*(np.array(observation[goal]) for goal in GOALS), float(reward), info))
            if terminated or truncated:
                env.reset()
        achieved, desired = (np.stack([step[place] for step in seen]) for place in (0, 1))
        given = np.array([step[2] for step in seen])
        try:
            found = np.asarray(self._method("compute_reward")(achieved, desired, {}))
            if found.shape != (PROBED_STEPS,):
                raise ValueError(f"{PROBED_STEPS} goals give rewards of the shape {found.shape}")
            best = None
            if not success_reward_is_set:
                best = np.asarray(self._method("compute_reward")(desired, desired, {}), np.float32)
        except KarolosError:
            raise
        except Exception as error:  # a method may raise anything
            raise UsageError(
                f"compute_reward of {self._name} does not take arrays of goals (n, a) and (n, d) and an empty info: "
                f"{described(error)}",
                setting=GOALS_SETTING,
                hint="compute the rewards (n,) along the last axis, only from the goals",
            ) from error
        wrong = np.flatnonzero(~np.isclose(given, found, rtol=1e-4, atol=1e-5))
        if wrong.size:
            raise UsageError(
                f"{self._name} gave reward {given[wrong[0]]:g}, its compute_reward says {found[wrong[0]]:g}",
                setting=GOALS_SETTING,
                hint="hindsight needs a reward that depends only on the two goals",
            )
        if best is not None:
            if np.unique(given).size > 2 or np.ptp(best):
                raise UsageError(
                    f"{self._name} has dense rewards, which do not show whether the goal is reached",
                    setting="environment.success_reward",
                    hint=f"give the reward of a step that reaches the goal; exactly at the goal it is {best[0] + 0:g}",
                )
            self.success_reward = best[0] + np.float32(0)  # not -0
        for reward, info in ((step[2], step[3]) for step in seen):
            success = bool(np.float32(reward) >= self.success_reward)
            if bool(info.get("is_success", success)) != success:
                raise UsageError(
                    f"a reward of {reward:g} is{'' if success else ' not'} a success with success_reward "
                    f"{self.success_reward:g}, and {self._name} says the opposite",
                    setting="environment.success_reward",
                )
