"""Several environments in worker processes as one vector environment of gymnasium, for `gymnasium.make_vec`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from ..core import BoolArray, BuildEnvironment, Step
from ..environments.build import Facts, build_environment, opened
from ..environments.gymnasium.export import OBSERVED, Goals, Observation, robot_task_recipe
from ..errors import UsageError
from ..specification import spec_from_dict
from ..specification.parts import Recipe
from ..system import cores
from .local import Local

Infos = dict[str, Any]
OPTIONS = ("processes", "autoreset_mode", "render_mode", "max_episode_steps")
"""Arguments of `VectorGoalEnv`. All others are settings of the robot, the task and the environment."""


class VectorGoalEnv(Goals, VectorEnv[Observation, NDArray[Any], NDArray[Any]]):
    """Environments of one recipe, which worker processes step. They share memory with this process.

    Observations, rewards, infos and episodes are those of `gymnasium.vector.SyncVectorEnv` over `GoalEnv`.

    Args:
        recipe: of each environment.
        num_envs: number of environments.
        processes: number of worker processes; None: one per core; 0: this process steps the environments.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or gymnasium's AutoresetMode.
        render_mode: None.
        max_episode_steps: None, or the number of steps that an episode has.

    Raises:
        UsageError: the environment has no goals, or an argument is not allowed.
        KarolosError: an environment cannot be built.
    """

    def __init__(
        self,
        recipe: Recipe,
        num_envs: int = 1,
        *,
        processes: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
    ) -> None:
        with opened(recipe) as environment:
            super().__init__(Facts.of(environment))
        steps, modes = self.facts.signature.max_steps, [*AutoresetMode, *(mode.value for mode in AutoresetMode)]
        if num_envs < 1:
            raise UsageError(f"{num_envs} environments cannot be made", hint="num_envs is at least 1")
        if autoreset_mode not in modes:
            raise UsageError(f"there is no autoreset mode {autoreset_mode!r}", hint=f"there are {modes[3:]}")
        if render_mode is not None:
            raise UsageError("worker processes make no pictures", hint='vectorization_mode="sync" makes them')
        if max_episode_steps not in (None, steps):
            what = f"max_episode_steps cannot be {max_episode_steps}: episodes have {steps}"
            raise UsageError(what, hint=f"give max_steps={max_episode_steps}, a setting of the task")
        self.num_envs, self._mode = num_envs, AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "render_fps": self.facts.rate, "autoreset_mode": self._mode}
        self.single_observation_space, self.single_action_space = self.spaces
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._ids = np.arange(num_envs)
        self._generators = [np_random()[0] for _ in range(num_envs)]
        """Generators of the episodes' seeds, one per environment."""
        self._seeds = [0] * num_envs
        self._over: BoolArray | None = None
        """Environments whose episodes are over and must be reset; None: all of them."""
        build = partial(build_environment, recipe)
        self._orchestrator = _Uneven(min(cores() if processes is None else processes, num_envs), num_envs, build)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, Infos]:
        """Begin episodes.

        Args:
            seed: of the first environment, and the others count up from it; or one per environment; None: the next
                episodes in the sequences of the last ones.
            options: `reset_mask`, (n,) bool: resets only the marked environments.
        """
        which = np.asarray((options or {}).get("reset_mask", np.ones(self.num_envs, np.bool_)))
        seeds = (
            [None if seed is None else seed + i for i in range(self.num_envs)]
            if not isinstance(seed, Sequence)
            else seed
        )
        if which.shape != (self.num_envs,) or which.dtype != np.bool_ or not which.any():
            raise ValueError(f"reset_mask must be an array of {self.num_envs} bool with at least one True")
        if len(seeds) != self.num_envs:
            raise ValueError(f"there are {len(seeds)} seeds for {self.num_envs} environments")
        if self._over is None and not which.all():
            raise gymnasium.error.ResetNeeded("the first reset has no reset_mask")
        self._begin(which, seeds)
        step = self._received()
        if self._over is None:
            self._latest = step
        for latest, new in zip(self._latest, step, strict=True):
            latest[which] = new
        self._over = self._latest.terminated | self._latest.truncated  # also where the physics diverges at once
        return Observation(self._latest, self.facts), self._infos(self._latest, which, begun=which)

    def step(self, actions: NDArray[Any]) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], Infos]:
        """One control step of each environment. With "NextStep" environments whose episodes are over are reset instead.

        Raises:
            ResetNeeded: before a reset, after an error, and with "Disabled" after the end of an episode.
            ValueError: a wrong number of actions.
            KarolosError: an environment failed, or an action is not finite.
        """
        everywhere, begun = np.ones(self.num_envs, np.bool_), self._over
        if begun is None or (self._mode is AutoresetMode.DISABLED and begun.any()):
            places = "" if begun is None else f" with reset_mask; over: {np.flatnonzero(begun).tolist()}"
            raise gymnasium.error.ResetNeeded(f"call reset first{places}")
        given = np.asarray(actions, np.float32).reshape(self.num_envs, -1)
        self._orchestrator.step(self._ids[~begun], given[~begun])  # first: it may refuse the actions
        if begun.any():
            self._begin(begun)
        step = self._latest = self._received()
        over = step.terminated | step.truncated
        infos: Infos = {}
        if self._mode is AutoresetMode.SAME_STEP and over.any():
            final = np.full(self.num_envs, None, object)
            for place in np.flatnonzero(over):
                final[place] = {name: getattr(step, name)[place].copy() for name in OBSERVED}
            _put(infos, over, {"final_obs": final, "final_info": self._infos(step, over, begun=~everywhere)})
            self._begin(over)
            self._latest = Step(*(field.copy() for field in step))
            for latest, new in zip(self._latest, self._received(), strict=True):
                latest[over] = new
            begun = over
        self._over = self._latest.terminated | self._latest.truncated
        infos |= self._infos(self._latest, everywhere, begun=begun)
        ends = step.terminated.copy(), step.truncated.copy()
        return Observation(self._latest, self.facts), step.reward.astype(np.float64), *ends, infos

    def _begin(self, which: BoolArray, seeds: Sequence[int | None] | None = None) -> None:
        """Send resets to the marked environments. A seed that is not given is the next one, as in `GoalEnv`."""
        for place in np.flatnonzero(which).tolist():
            seed = None if seeds is None else seeds[place]
            if seed is not None:
                self._generators[place] = np_random(int(seed))[0]
            self._seeds[place] = int(self._generators[place].integers(2**63 - 1) if seed is None else seed)
        self._orchestrator.reset(self._ids[which], [self._seeds[place] for place in self._ids[which]])

    def _received(self) -> Step:
        received = self._orchestrator.receive()
        for failure in received.failures:
            self._over = None
            raise failure.error
        return received.step

    def _infos(self, step: Step, which: BoolArray, *, begun: BoolArray) -> Infos:
        """Infos of the marked environments, including those that have just `begun` an episode."""
        signature, infos = self.facts.signature, Infos()
        _put(infos, which, {"is_success": step.success, "truncated": step.truncated, "diverged": step.diverged})
        _put(infos, begun, {"seed": np.array(self._seeds)})
        if begun.any() and (names := signature.parameters.names):
            drawn = self._orchestrator.parameters(self._ids).T.astype(np.float64)
            _put(infos, begun, {"parameters": _put({}, begun, dict(zip(names, drawn, strict=True)))})
        stepped = which & ~begun
        if signature.extra_reward != (0.0, 0.0):
            extra = step.reward - self._rule.reward(step.achieved_goal, step.desired_goal)
            _put(infos, stepped & ~step.diverged, {"extra_reward": extra.astype(np.float64)})
        ended = stepped & (step.terminated | step.truncated)
        if signature.measures and ended.any():
            values = self._orchestrator.measures(self._ids).T.astype(np.float64)
            named = {one.name: value for one, value in zip(signature.measures, values, strict=True)}
            _put(infos, ended, {"measures": _put({}, ended, named)})
        return infos

    def close_extras(self, **_: Any) -> None:
        if hasattr(self, "_orchestrator"):  # gymnasium also closes an environment that could not be made
            self._orchestrator.close()


class _Uneven(Local):
    """Spreads environments over processes; their number need not be a multiple of the processes."""

    def __init__(self, processes: int, size: int, build: BuildEnvironment) -> None:
        self._bounds = [size * place // processes for place in range(processes + 1)] if processes else []
        super().__init__(Local.Settings(processes=min(processes, 1), environments=size), build)

    def _layout(self) -> list[list[range]]:
        return [[range(*bounds)] for bounds in zip(self._bounds, self._bounds[1:], strict=False)]


def _put(infos: Infos, which: BoolArray, entries: Mapping[str, Any]) -> Infos:
    """Add entries of the marked environments, 0 for others, and the mask under `_name`, as gymnasium does."""
    if not which.any():
        return infos
    for name, value in entries.items():
        plain = isinstance(value, np.ndarray) and value.dtype != object
        infos[name] = np.where(which, value, value.dtype.type(0)) if plain else value
        infos[f"_{name}"] = which.copy()
    return infos


def robot_task_envs(
    num_envs: int = 1,
    *,
    robot: str,
    task: str,
    randomization: Mapping[str, Mapping[str, Any]] | None = None,
    **settings: Any,
) -> VectorGoalEnv:
    """Several `RobotTaskEnv`; arguments as of `VectorGoalEnv` and of that class."""
    own = {name: settings.pop(name) for name in OPTIONS if name in settings}
    return VectorGoalEnv(robot_task_recipe(robot, task, settings, randomization or {}), num_envs, **own)


def spec_envs(num_envs: int = 1, *, spec: Mapping[str, Any], randomize: bool = False, **own: Any) -> VectorGoalEnv:
    """Several `SpecEnv`; arguments as of `VectorGoalEnv` and of that class."""
    return VectorGoalEnv(spec_from_dict(spec).recipe(randomize=randomize), num_envs, **own)
