"""Acting on whatever is ready: how many answers `receive` waits for, and how old the policy behind them was."""

import numpy as np
import pytest
from support.fake_environments import FINE, RAISE, SLOW
from support.layouts import THREADS, TWO, every_layout, make, reset, step


@every_layout
def test_every_answer_arrives_once_and_the_least_number_is_kept(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, SLOW, FINE, FINE, FINE)
        seen: list[int] = []
        while len(seen) < 4:
            ids = orchestrator.receive(at_least=1).environment.tolist()
            assert ids == sorted(ids)
            assert ids
            seen += ids
        assert sorted(seen) == [0, 1, 2, 3]
        assert orchestrator.receive(at_least=1).environment.size == 0, "nothing pending gives nothing"


@pytest.mark.parametrize("layout", [TWO, THREADS], ids=["2", "threads"])
def test_who_is_ready_goes_on_while_others_are_busy(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, SLOW, FINE, FINE, FINE)
        assert orchestrator.receive(at_least=2).environment.tolist() == [2, 3]
        orchestrator.step([2, 3], np.zeros((2, 1), np.float32))
        received = orchestrator.receive()
        assert received.environment.tolist() == [0, 1, 2, 3]
        assert received.step.observation[:, 1].tolist() == [1, 1, 2, 2]


def test_asking_for_none_does_not_wait():
    with make(TWO) as orchestrator:
        reset(orchestrator)
        step(orchestrator, SLOW, SLOW, SLOW, SLOW)
        assert orchestrator.receive(at_least=0).environment.size == 0
        assert orchestrator.receive().environment.size == 4


def test_asking_for_more_than_is_pending_gives_what_there_is():
    with make(TWO) as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, FINE)
        assert orchestrator.receive(at_least=4).environment.tolist() == [0, 1]


def test_a_failure_counts_as_an_answer():
    """The loop has to act on it; waiting for others instead could wait for ever."""
    with make(TWO, failures=1) as orchestrator:
        reset(orchestrator)
        step(orchestrator, SLOW, SLOW, RAISE)
        received = orchestrator.receive(at_least=1)
        assert (received.environment.tolist(), received.failed.tolist()) == ([], [2])
        assert orchestrator.receive().environment.tolist() == [0, 1]


@every_layout
def test_the_policy_behind_each_action_comes_back_with_its_step(layout):
    with make(layout) as orchestrator:
        orchestrator.reset(range(4), range(4))
        assert orchestrator.receive().updates.tolist() == [-1] * 4
        orchestrator.step([1, 3], np.zeros((2, 1), np.float32), updates=7)
        orchestrator.step([0], np.zeros((1, 1), np.float32), updates=9)
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.updates.tolist()) == ([0, 1, 3], [9, 7, 7])
