"""The training loop on whatever is ready: nothing lost, nothing joined, the replay ratio kept, how old actions are."""

import itertools
from functools import partial
from typing import Any

import numpy as np
import pytest
from support.training_parts import Counter, OnPolicyRecorder, train, updates_per_round

from karolos.core import Received
from karolos.orchestrator.local import Local


class Ragged(Local):
    """In this process, but answers come as from workers of different speed: some of them, by a generator."""

    def __init__(self, *given: Any) -> None:
        super().__init__(*given)
        self._late: list[Received] = []
        self._generator = np.random.default_rng(0)
        self.asked: list[int] = []

    def receive(self, at_least: int | None = None) -> Received:
        """So many answers and sometimes more, when there are enough under way; all when episodes are played again."""
        if at_least is None:
            return super().receive()
        self.asked.append(at_least)
        new = super().receive()
        if new.environment.size or new.failures:
            self._late.append(new)
        rows = [(late, row) for late in self._late for row in range(late.environment.size)]
        failures = tuple(failure for late in self._late for failure in late.failures)
        self._generator.shuffle(rows)
        missing = at_least - sum(failure.environment.size for failure in failures)
        count = max(missing, 0) + int(self._generator.integers(2)) if at_least else int(self._generator.integers(2))
        given, kept = rows[:count], rows[count:]
        self._late = [self._row(late, row) for late, row in kept]
        given.sort(key=lambda pair: pair[0].environment[pair[1]])
        parts = [self._row(late, row) for late, row in given] or [new._replace(environment=new.environment[:0])]
        empty = not given
        step = type(new.step)(*(np.concatenate(columns) for columns in zip(*(p.step for p in parts), strict=True)))
        step = type(step)(*(column[:0] for column in step)) if empty else step
        updates = np.concatenate([part.updates for part in parts])[: 0 if empty else None]
        return Received(np.concatenate([part.environment for part in parts]), step, updates, failures)

    @staticmethod
    def _row(received: Received, row: int) -> Received:
        one = slice(row, row + 1)
        step = type(received.step)(*(column[one] for column in received.step))
        return Received(received.environment[one], step, received.updates[one])


train_ragged = partial(train, environments=4, at_least=1, steps=200, orchestrator=Ragged)


def rows_of(recorder, environment):
    """The transitions of one environment in the order in which they were stored."""
    for added in recorder.added:
        for row in np.flatnonzero(added.environment == environment):
            yield [field[row] for field in added]


@pytest.mark.parametrize("at_least", [None, 1, 3])
def test_transitions_continue_an_episode_until_it_ends_and_never_join_two(at_least):
    _, recorder, training = train(environments=4) if at_least is None else train_ragged(at_least=at_least)
    for environment in range(4):
        rows = list(rows_of(recorder, environment))
        assert len(rows) > 10
        for (_, obs, _, _, _, _, after, reached, terminated, truncated), following in itertools.pairwise(rows):
            assert after[0] == obs[0], "a transition stays in its episode"
            assert after[1] == obs[1] + 1 == reached[0]
            if terminated or truncated:
                assert following[1][1] == 0, "a new episode begins at its reset"
                assert following[1][0] != obs[0]
            else:
                np.testing.assert_array_equal(following[1], after)
    assert sum(added.environment.size for added in recorder.added) == training.steps


def test_rounds_act_on_some_and_wait_for_no_more_than_asked():
    progress, recorder, training = train_ragged(at_least=2)
    sizes = {added.environment.size for added in recorder.added}
    assert min(sizes) < 4
    assert max(training.orchestrator.asked) <= 2
    assert len(progress) > 200 / 4


def test_episodes_are_those_of_lockstep_only_their_order_differs():
    """Each episode's seed is that of its environment and index, whatever came first."""
    played = {}
    for name, rounds in (("async", train_ragged()[0]), ("lockstep", train(environments=4, steps=200)[0])):
        played[name] = {(e.environment, e.index): (e.seed, e.steps, e.parameters) for r in rounds for e in r.finished}
    both = played["async"].keys() & played["lockstep"].keys()
    assert len(both) > 30
    assert all(played["async"][key] == played["lockstep"][key] for key in both)
    assert not any((e, k) in played["async"] and (e, k - 1) not in played["async"] for e, k in both if k)


@pytest.mark.parametrize("ratio", [0.5, 2.0, 16.0])
def test_the_replay_ratio_is_kept_to_one_step_of_every_environment(ratio):
    progress, _, _ = train_ragged(steps=400, replay_ratio=ratio)
    since = next(round.steps for round in progress if not round.warming_up)
    for before, round in itertools.pairwise(progress):
        due = (before.steps - since) * ratio / 4
        assert due - max(4 * ratio / 4, 1) - 1 <= round.updates <= max(due, 0)


def test_learning_makes_way_for_environments_that_have_answered():
    """With sixteen updates for each step of four environments, some rounds leave a part of them for later."""
    progress, _, _ = train_ragged(steps=400, replay_ratio=16.0)
    rounds = zip(progress, updates_per_round(progress), strict=True)
    learned = {updates for round, updates in rounds if not round.warming_up}
    assert any(count % 4 for count in learned), learned


def test_policy_lag_is_the_updates_between_an_action_and_its_storing():
    """The recorder acts with the number of updates so far, in thousandths, which the stored action thus tells."""
    _, recorder, training = train_ragged(steps=400, replay_ratio=4.0, warmup_episodes=0)
    made_before = np.array([stored for _, stored in recorder.sampled])
    lags = [
        int((made_before <= place).sum()) - round(1000 * float(action[0]))
        for place, added in enumerate(recorder.added)
        for action in added.action
    ]
    assert min(lags) >= 0
    assert len(set(lags)) > 3
    assert training.collector.read_policy_lag() == {"policy_lag_mean": np.mean(lags), "policy_lag_max": max(lags)}
    assert training.collector.read_policy_lag() == {}, "reading resets it"


def test_policy_lag_in_lockstep_is_what_was_learned_while_the_environments_stepped():
    progress, _, training = train(steps=60)
    learned = updates_per_round(progress)
    assert training.collector.read_policy_lag() == {"policy_lag_mean": np.mean(learned), "policy_lag_max": max(learned)}


def test_stored_actions_are_those_the_environments_took():
    Counter.actions.clear()
    _, recorder, _ = train_ragged(steps=100)
    stored = sorted(float(row[4][0]) for environment in range(4) for row in rows_of(recorder, environment))
    taken = sorted(float(action[0]) for action in Counter.actions)
    assert len(taken) - len(stored) <= 4, "except those under way at the end"
    assert set(stored) <= set(taken)


@pytest.mark.parametrize("lockstep", [True, False])
def test_environments_that_fail_lose_their_episodes_and_begin_others(monkeypatch, lockstep):
    monkeypatch.setattr(Counter, "fails", True)
    amounts = {"environments": 4, "steps": 300, "failures": 50}
    progress, recorder, training = train(**amounts) if lockstep else train_ragged(**amounts)
    failures = [failure for round in progress for failure in round.failures]
    failed = [i for failure in failures for i in failure.environment.tolist()]
    assert len(failed) > 3
    assert {type(failure.error).__name__ for failure in failures} == {"WorkerError"}
    assert sorted(i for _, ids in recorder.cuts for i in ids) == sorted(failed)
    records = [record for round in progress for record in round.finished]
    assert not any(record.seed % 11 == 0 or record.seed % 5 == 0 for record in records)
    assert sum(added.environment.size for added in recorder.added) == training.steps
    for environment in range(4):
        for one, following in itertools.pairwise(rows_of(recorder, environment)):
            if following[1][1] != 0:
                np.testing.assert_array_equal(one[6], following[1])


@pytest.mark.parametrize("at", [1, 5, 40])
def test_training_goes_on_from_a_saved_state(at):
    """Not bit for bit: but running episodes go on, and the counts are right."""
    _, recorder, training = train_ragged(rounds=at)
    state = training.state()
    before = [list(rows_of(recorder, environment)) for environment in range(4)]
    progress, _, again = train_ragged(recorder=recorder, state=state)
    assert progress[0].steps >= training.steps
    assert again.steps == sum(added.environment.size for added in recorder.added) >= 200
    for environment, rows in enumerate(before):
        following = list(rows_of(recorder, environment))[len(rows)]
        if rows and not (rows[-1][8] or rows[-1][9]):
            np.testing.assert_array_equal(following[1], rows[-1][6])
        else:
            assert following[1][1] == 0


def test_an_on_policy_agent_cannot_go_on_with_some():
    with pytest.raises(ValueError, match="cannot wait for 1 answers"):
        train_ragged(recorder=OnPolicyRecorder())
