"""Plays episodes of a policy step by step, to show them or to count successes."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import fmean

import numpy as np

from ..core import Environment, FloatArray, Moment
from ..environments.build import used
from ..errors import UsageError
from ..records import RunFolder
from ..records.evaluation import Evaluation
from ..specification import Spec
from .changed_spec import changed_spec, engine_note
from .policies import Policy, environment_of, expert_policy, has_window, load_agent
from .testing import measured, test_seeds


@dataclass(frozen=True)
class Player:
    """A policy and the environment to play it in."""

    spec: Spec
    """The run's spec with the changes."""
    environment: Environment
    policy: Policy
    note: str | None
    """One line if the policy learned in another physics engine."""


@contextmanager
def load_player(
    folder: RunFolder, name: str = "best", overrides: Sequence[str] = (), *, window: bool = False
) -> Iterator[Player]:
    """The policy of a run's checkpoint, and one environment, which is closed after the block.

    No parameter is randomized except by the overrides. `window` shows the world, if the environment can.

    Raises as `load_agent` and `changed_spec`, MachineError if there is no display for the window, PluginError if a
    plugin fails in the block.
    """
    saved = load_agent(folder, name)
    spec = changed_spec(saved.spec, overrides, trained=saved.signature)
    with used(environment_of(spec, randomize=True, window=window and has_window(spec))) as environment:
        yield Player(spec, environment, saved.policy(), engine_note(saved.spec, spec))


@contextmanager
def load_expert(spec: Spec, *, window: bool = False) -> Iterator[Player]:
    """The expert of a spec's task, and one environment without randomization, which is closed after the block.

    Raises UsageError if there is no expert, MachineError if there is no display for the window, PluginError if a plugin
    fails in the block.
    """
    with used(environment_of(spec, window=window)) as environment:
        yield Player(spec, environment, expert_policy(environment), None)


class FirstSuccesses(dict[int, int]):
    """Episode -> step at which its goal was first reached. Is called with the moments of the episodes."""

    def __call__(self, moment: Moment) -> None:
        if moment.success:
            self.setdefault(moment.episode, moment.step)

    @property
    def mean(self) -> float | None:
        """The mean over the episodes that reached their goals; None without any."""
        return fmean(self.values()) if self else None


def play(environment: Environment, policy: Policy, *, episodes: int, seed: int) -> Iterator[Moment]:
    """Play the first `episodes` test episodes of `seed`; with `testing.seed` these are the run's test episodes."""
    for episode, episode_seed in enumerate(test_seeds(seed, episodes)):
        yield from play_one(environment, policy, episode, episode_seed)


def play_failures(
    environment: Environment, policy: Policy, *, episodes: int, seed: int, among: int = 1000
) -> Iterator[Moment]:
    """Play the first `episodes` failures among the first `among` test episodes of `seed`. Other episodes are not shown.

    A failure is played twice, because only the end of an episode shows that it failed.

    Raises UsageError if the environment does not define success, or if none of these episodes fails.
    """
    if not environment.signature.has_success:
        raise UsageError("this environment does not define success", hint="leave out --failures")
    found = 0
    for episode, episode_seed in enumerate(test_seeds(seed, among)):
        [end] = deque(play_one(environment, policy, episode, episode_seed), maxlen=1)
        if not end.success:
            yield from play_one(environment, policy, episode, episode_seed)
            found += 1
        if found == episodes:
            return
    if not found:
        raise UsageError(f"none of the first {among:,} episodes fails", hint="leave out --failures")


def play_one(environment: Environment, policy: Policy, episode: int, seed: int) -> Iterator[Moment]:
    """Play the episode of this number, whose own seed is `seed`."""
    state = environment.reset(seed)
    policy.begin()
    step, total = 0, 0.0
    yield Moment(episode, step, bool(state.success), False, total, environment)
    over = False
    while not over:
        state = environment.step(policy.act(state))
        step, total = step + 1, total + float(state.reward)
        over = bool(state.terminated or state.truncated)
        yield Moment(episode, step, bool(state.success), over, total, environment)


def evaluate_alone(
    spec: Spec,
    make: Callable[[Environment], Policy],
    *,
    episodes: int,
    seed: int,
    heard: Callable[[Moment], object] = lambda _: None,
) -> Evaluation:
    """`evaluate` a policy that an environment of the spec gives, such as its expert."""
    with used(environment_of(spec)) as environment:
        return evaluate(environment, make(environment), episodes=episodes, seed=seed, heard=heard)


def evaluate(
    environment: Environment,
    policy: Policy,
    *,
    episodes: int,
    seed: int,
    heard: Callable[[Moment], object] = lambda _: None,
) -> Evaluation:
    """Play test episodes as `play` does, with an untrained policy. `heard` is called with each moment."""
    resets: list[bool] = []
    reached: list[bool] = []
    ends: list[Moment] = []
    measures: list[FloatArray] = []
    for moment in play(environment, policy, episodes=episodes, seed=seed):
        heard(moment)
        if moment.step == 0:
            resets.append(moment.success)
            reached.append(False)
        reached[-1] |= moment.success
        if moment.over:
            ends.append(moment)
            measures.append(environment.measures())
    return Evaluation.of(
        0,
        0.0,
        any=tuple(reached),
        end=tuple(end.success for end in ends),
        reset=tuple(resets),
        returns=tuple(end.total for end in ends),
        lengths=tuple(end.step for end in ends),
        distances=None,
        measures=measured(environment.signature.measures, np.array(measures)),
    )
