"""The goals of a goal environment of gymnasium as a goal rule that buffers can use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...core import Array, BoolArray, FloatArray, GoalRule, Step
from ...errors import KarolosError, PluginError, UsageError

GOALS = ("achieved_goal", "desired_goal")
PROBED_STEPS = 32
"""Steps with random actions whose rewards are compared with `compute_reward` before the first episode."""
GOALS_SETTING = "environment.goals"


class GymnasiumGoals(GoalRule):
    """Reward and termination by the environment's `compute_reward` and `compute_terminated`.

    The environment stays behind when the rule is pickled; elsewhere the rule makes one of its own at its first use.

    Args:
        make: makes the environment; can be pickled.
        env: made by it. Episodes are played in it to check the rule.
        name: of the environment, for messages.
        success_reward: reward from which a goal is reached; None: the reward where both goals are equal.
        goal_terminates: whether reaching the goal ends an episode; None: as `compute_terminated` says.

    Raises:
        UsageError: goals that cannot be laid out flat, or a `compute_reward` that is missing, not vectorised, or
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
        except Exception as error:  # the method is anybody's
            line = (str(error).splitlines() or [""])[0]
            raise UsageError(
                f"compute_reward of {self._name} does not take arrays of goals (n, a) and (n, d) and an empty info: "
                f"{type(error).__name__}: {line}",
                setting=GOALS_SETTING,
                hint="compute the rewards (n,) along the last axis, from the goals alone",
            ) from error
        wrong = np.flatnonzero(~np.isclose(given, found, rtol=1e-4, atol=1e-5))
        if wrong.size:
            raise UsageError(
                f"{self._name} gave reward {given[wrong[0]]:g}, its compute_reward says {found[wrong[0]]:g}",
                setting=GOALS_SETTING,
                hint="hindsight needs a reward that depends on the two goals alone",
            )
        if best is not None:
            if np.unique(given).size > 2 or np.ptp(best):
                raise UsageError(
                    f"{self._name} has dense rewards, which do not say when the goal is reached",
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
