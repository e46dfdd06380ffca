"""Playing a policy: the test episodes moment by moment, and their results."""

import numpy as np
import pytest

from karolos.core import Array, Environment, Field, Layout, Signature, Step
from karolos.environments.toy import Toy
from karolos.errors import UsageError
from karolos.evaluation.playing import evaluate, play, play_failures
from karolos.evaluation.policies import Policy, random_policy
from karolos.evaluation.testing import test_seeds
from karolos.records.evaluation import Evaluation


def test_moments_follow_an_episode_from_its_reset_to_its_end_on_the_seeds_of_the_tests():
    environment = Toy(Toy.Settings(max_steps=5))
    goals, begun = [], []

    def act(step: Step) -> Array:
        goals.append(step.desired_goal)
        return np.zeros(2, np.float32)

    policy = Policy(act, lambda: begun.append(len(goals)))
    moments = [(m.episode, m.step, m.over) for m in play(environment, policy, episodes=3, seed=8)]
    assert moments == [(episode, step, step == 5) for episode in range(3) for step in range(6)]
    other = Toy(Toy.Settings(max_steps=5))
    assert begun == [0, 5, 10]
    np.testing.assert_array_equal(goals[::5], [other.reset(seed).desired_goal for seed in test_seeds(8, 3)])


class Scripted(Environment):
    """Episode k, counted from the first reset, succeeds at the steps that `episodes[k]` marks; 0 is the reset."""

    def __init__(self, episodes: list[str]) -> None:
        one = Layout((Field("one", 1),))
        self.signature = Signature(observation=one, action=one, max_steps=9)
        self._episodes = iter(episodes)

    def reset(self, seed: int) -> Step:
        self._marks, self._at = next(self._episodes), 0
        return self._now()

    def step(self, action: Array) -> Step:
        self._at += 1
        return self._now()

    def _now(self) -> Step:
        over = self._at == len(self._marks) - 1
        nothing = np.zeros(1, np.float32)
        return Step(nothing, nothing, nothing, 0.0, over, False, self._marks[self._at] == "x")


STILL = Policy(lambda _: np.zeros(1, np.float32))


def test_success_is_counted_at_some_step_and_at_the_end():
    found = evaluate(Scripted(["..x.x", "...x.", ".....", "x."]), STILL, episodes=4, seed=0)
    assert (found.any, found.end) == ((True, True, False, True), (True, False, False, False))
    assert (found.reset, found.lengths) == ((False, False, False, True), (4, 4, 4, 1))


def test_failures_are_the_episodes_that_do_not_succeed_at_their_end():
    marks = ["..x", ".x.", ".x.", ".x", "....", "....", ".."]  # a failure is played twice
    played = list(play_failures(Scripted(marks), STILL, episodes=2, seed=0))
    assert [(moment.episode, moment.step) for moment in played] == [(1, 0), (1, 1), (1, 2), *((3, n) for n in range(4))]
    with pytest.raises(UsageError, match="none of the first 2 episodes fails"):
        list(play_failures(Scripted(["..x", ".x"]), STILL, episodes=2, seed=0, among=2))


def test_the_same_seed_gives_the_same_evaluation():
    def found(seed: int) -> Evaluation:
        environment = Toy(Toy.Settings())
        return evaluate(environment, random_policy(environment, seed), episodes=60, seed=seed)

    assert found(3) == found(3)
    assert 0 < found(3).success_any < 1
