"""Test episodes: counted right, and the same whatever plays them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.processes import kill_worker

from karolos.core import Environment, Field, GoalRule, Layout, Measure, Signature, Step
from karolos.environments.toy import Toy
from karolos.evaluation.testing import play_episodes, test_seeds
from karolos.orchestrator.local import Local
from karolos.records.evaluation import Evaluation

# What an episode is: whether the goal holds at the reset and after each step, and whether it ends by termination.
Script = tuple[tuple[bool, ...], bool]
SCRIPTS: list[Script] = [
    ((False, True, False), False),  # reached, not held
    ((False, False, True), True),  # reached at the last step, which ends the episode
    ((True, False), False),  # solved at reset, then lost
    ((False, False, False, False, False), False),
    ((True, True), True),
]


class Scripted(Environment):
    """Episode `seed` goes as scripts[seed] says; step k is worth 10 ** -k of reward."""

    def __init__(self, scripts: list[Script]) -> None:
        number = Layout((Field("number", 1),))
        self.signature = Signature(number, number, max_steps=9, desired_goal=number, achieved_goal=number)
        self._scripts = scripts
        self._step = 0

    def reset(self, seed: int) -> Step:
        self._successes, self._terminates = self._scripts[seed]
        self._step = 0
        return self._now(0.0)

    def step(self, action: np.ndarray) -> Step:
        assert action == self._step, "the agent acts on what it sees"
        self._step += 1
        if self._step >= len(self._successes):
            raise RuntimeError("the episode is over")
        return self._now(10.0**-self._step)

    def _now(self, reward: float) -> Step:
        over = self._step > 0 and self._step == len(self._successes) - 1
        seen = np.array([self._step], np.float32)
        return Step(
            seen,
            seen,
            seen,
            reward,
            over and self._terminates,
            over and not self._terminates,
            self._successes[self._step],
        )


class Echo:
    """Acts as it observes, and never explores."""

    def act(self, observation, desired_goal, *, explore):
        assert not explore
        assert len(observation) == len(desired_goal)
        return observation


class Greedy:
    """Walks straight to the goal, each environment on its own."""

    def act(self, observation, desired_goal, *, explore):
        return np.clip((desired_goal - observation) * 5, -1, 1)


def play(scripts: list[Script], size: int) -> Evaluation:
    with Local(Local.Settings(processes=0, environments=size), partial(Scripted, scripts)) as orchestrator:
        return play_episodes(orchestrator, Echo(), range(len(scripts)), steps=7, seconds=1.5)


def expected(scripts: list[Script]) -> Evaluation:
    return Evaluation.of(
        7,
        1.5,
        any=tuple(any(successes) for successes, _ in scripts),
        end=tuple(successes[-1] for successes, _ in scripts),
        reset=tuple(successes[0] for successes, _ in scripts),
        returns=tuple(
            sum(float(np.float32(10.0**-step)) for step in range(1, len(successes))) for successes, _ in scripts
        ),
        lengths=tuple(len(successes) - 1 for successes, _ in scripts),
    )


@pytest.mark.parametrize("size", [1, 2, 3, 5, 8])
def test_any_end_reset_returns_and_lengths_are_those_of_the_episodes(size):
    result = play(SCRIPTS, size)
    assert result.any == (True, True, True, False, True)
    assert result.end == (False, True, False, False, True)
    assert result.reset == (False, False, True, False, True)
    assert result.lengths == (2, 2, 1, 4, 1)
    assert result.returns == pytest.approx((0.11, 0.11, 0.1, 0.1111, 0.1))
    assert (result.success_any, result.success_end, result.episodes) == (0.8, 0.4, 5)


class TenthsOfSteps(GoalRule):
    """The goal is a tenth of a metre away for each step taken."""

    def reward(self, achieved, desired):
        return np.zeros(np.shape(achieved)[:-1], np.float32)

    def success(self, achieved, desired):
        return np.zeros(np.shape(achieved)[:-1], np.bool_)

    def distance(self, achieved, desired):
        return np.float32(0.1) * achieved[..., 0]


class Measured(Scripted):
    def __init__(self, scripts: list[Script]) -> None:
        super().__init__(scripts)
        measures = Measure("steps", "1", "smaller", ""), Measure("won", "m", "larger", "")
        self.signature = replace(self.signature, goal_rule=TenthsOfSteps(), measures=measures)

    def measures(self) -> np.ndarray:
        return np.array([self._step, self._step / 3 if self._successes[self._step] else np.nan], np.float32)


@pytest.mark.parametrize("size", [1, 3, 8])
def test_distances_and_measures_are_those_at_the_end_of_each_episode_and_unknown_without_a_rule(size):
    with Local(Local.Settings(processes=0, environments=size), partial(Measured, SCRIPTS)) as orchestrator:
        result = play_episodes(orchestrator, Echo(), range(len(SCRIPTS)))
    assert result.distances == pytest.approx((0.2, 0.2, 0.1, 0.4, 0.1))
    assert (result.within(0.05), result.within(0.15), result.within(0.25)) == (0, 0.4, 0.8)
    assert result.measures["steps"] == {"unit": "1", "better": "smaller", "mean": 2, "values": (2, 2, 1, 4, 1)}
    assert result.measures["won"]["values"] == (None, 0.666667, None, None, 0.333333)
    assert result.measures["won"]["mean"] == pytest.approx(0.5)
    without = play(SCRIPTS, size)
    assert without.distances is None
    assert without.measures == {}
    assert without.within(0.05) is None


scripts = st.lists(st.tuples(st.lists(st.booleans(), min_size=2, max_size=7).map(tuple), st.booleans()), min_size=1)


@given(scripts=scripts, size=st.integers(1, 12))
def test_every_episode_counts_once_whatever_its_length_and_the_number_of_environments(scripts, size):
    assert play(scripts, size) == expected(scripts)


def test_short_episodes_are_not_favoured():
    """Successes end soon; whoever takes the first to finish finds .75 here."""
    scripts = [((False, True), True) if seed % 2 else ((False,) * 8, False) for seed in range(8)]
    assert play(scripts, 2).success_any == 0.5


def test_which_environment_plays_an_episode_is_fixed_beforehand():
    seen: list[tuple[int, int]] = []

    class Watched(Local):
        def reset(self, environments, seeds):
            seen.extend(zip(np.asarray(environments).tolist(), seeds, strict=True))
            super().reset(environments, seeds)

    with Watched(Local.Settings(processes=0, environments=2), partial(Scripted, SCRIPTS)) as orchestrator:
        play_episodes(orchestrator, Echo(), range(5))
    assert sorted(seen) == [(0, 0), (0, 2), (0, 4), (1, 1), (1, 3)]


class Diverging(Scripted):
    """An episode of one entry is over at its reset."""

    def _now(self, reward: float) -> Step:
        step = super()._now(reward)
        over = len(self._successes) == 1
        return step._replace(truncated=step.truncated or over, diverged=over)


def test_an_episode_that_is_over_at_its_reset_counts_as_one():
    scripts: list[Script] = [((False,), False), ((False, True), False), ((True,), False), ((False,), False)]
    with Local(Local.Settings(processes=0, environments=2), partial(Diverging, scripts)) as orchestrator:
        result = play_episodes(orchestrator, Echo(), range(4))
    assert result.lengths == (0, 1, 0, 0)
    assert result.end == (False, True, True, False)


def test_a_test_without_episodes_is_refused():
    with (
        Local(Local.Settings(processes=0), partial(Scripted, SCRIPTS)) as orchestrator,
        pytest.raises(ValueError, match="at least one"),
    ):
        play_episodes(orchestrator, Echo(), [])


def test_any_layout_finds_the_same():
    toy = Toy.Settings(dimensions=2, speed=0.1, max_steps=12)
    seeds = test_seeds(3, 25)
    results = []
    for processes, threads, environments in ((0, 1, 1), (0, 1, 7), (2, 1, 3), (1, 2, 20)):
        layout = Local.Settings(processes=processes, threads=threads, environments=environments)
        with Local(layout, partial(Toy, toy)) as orchestrator:
            results.append(play_episodes(orchestrator, Greedy(), seeds))
    assert results[1:] == results[:1] * 3
    assert 0 < results[0].success_end < 1, "some goals lie too far away to be reached in time"


def test_test_seeds_depend_on_their_root_alone_and_grow_at_the_end():
    assert test_seeds(0, 5) == test_seeds(0, 9)[:5]
    assert len(set(test_seeds(0, 500)) | set(test_seeds(1, 500))) == 1000
    assert all(0 <= seed < 2**63 for seed in test_seeds(0, 100))


def test_an_episode_whose_environment_fails_is_played_again():
    """Its worker is killed between two steps: the result is that of a test in peace, and the failure is told."""
    toy = Toy.Settings(dimensions=2, max_steps=6, reward="dense")
    results, heard = [], []
    for kills in (0, 2):
        with Local(Local.Settings(processes=2, environments=2), partial(Toy, toy)) as orchestrator:
            results.append(play_episodes(orchestrator, Killing(kills), test_seeds(0, 9), on_failure=heard.append))
    assert results[0] == results[1]
    assert [failure.environment.tolist() for failure in heard] == [[0, 1], [0, 1]]


class Killing(Greedy):
    """Kills worker 0 before its third and sixth action, if it is to kill as often."""

    def __init__(self, kills):
        self.kills, self.acts = kills, 0

    def act(self, observation, desired_goal, *, explore):
        self.acts += 1
        if self.acts % 3 == 0 and self.kills:
            self.kills -= 1
            kill_worker(0)
        return super().act(observation, desired_goal, explore=explore)
