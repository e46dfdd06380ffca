"""The training loop with on-policy agents, with environments that fail, and from a saved state."""

from __future__ import annotations

import itertools
from types import SimpleNamespace

import numpy as np
import pytest
from support.training_parts import Counter, OnPolicyRecorder, Recorder, train, updates_per_round

from karolos.core.seeding import SeedTree
from karolos.errors import UsageError
from karolos.orchestrator.local import Local
from karolos.training.training import Training


def test_an_environment_that_fails_loses_its_episode_and_begins_another(monkeypatch):
    monkeypatch.setattr(Counter, "fails", True)
    progress, recorder, training = train(steps=200, failures=50)
    failed = [
        (place, i) for place, round in enumerate(progress) for f in round.failures for i in f.environment.tolist()
    ]
    assert len(failed) > 3
    assert {type(f.error).__name__ for round in progress for f in round.failures} == {"WorkerError"}
    assert sorted(i for _, ids in recorder.cuts for i in ids) == sorted(i for _, i in failed)
    records = [record for round in progress for record in round.finished]
    assert not any(record.seed % 11 == 0 or record.seed % 5 == 0 for record in records)
    stored = sum(added.environment.size for added in recorder.added)
    assert stored == training.steps
    for environment in range(3):
        rows = [added for added in recorder.added if environment in added.environment]
        for one, next_one in itertools.pairwise(rows):
            before, after = one.environment == environment, next_one.environment == environment
            if next_one.observation[after][0, 1] != 0:
                np.testing.assert_array_equal(one.next_observation[before], next_one.observation[after])


def test_an_agent_hears_of_every_episode_that_begins():
    progress, recorder, _ = train()
    assert recorder.begun[0] == (0, [0, 1, 2])
    heard = [(place, i) for place, ids in recorder.begun[1:] for i in ids]
    assert heard == [(place + 1, r.environment) for place, round in enumerate(progress) for r in round.finished]


def test_an_on_policy_agent_learns_at_the_end_of_the_round_that_completes_its_rollout():
    progress, recorder, training = train(recorder=OnPolicyRecorder(), steps=30)
    assert updates_per_round(progress) == [0, 0, 5, 0, 0, 5, 0, 0, 5, 0]
    assert recorder.sampled == [(9, 3), (9, 6), (9, 9)]
    assert [float(added.action[0, 0]) for added in recorder.added] == pytest.approx(
        [3.0] * 3 + [3.001] * 3 + [3.002] * 3 + [3.003], abs=1e-6
    )
    assert training.updates == 15
    assert not any(round.warming_up for round in progress), "it never acts at random"


def test_actions_are_clipped_for_the_environment_and_stored_as_they_were_given():
    Counter.actions.clear()
    _, recorder, _ = train(recorder=OnPolicyRecorder(), steps=9)
    assert {tuple(action) for action in Counter.actions} == {(1.0, -1.0)}
    assert all((np.abs(added.action) > 2.9).all() for added in recorder.added)


@pytest.mark.parametrize("kind", [Recorder, OnPolicyRecorder])
@pytest.mark.parametrize("at", [1, 7, 20])
def test_training_goes_on_bit_for_bit_from_a_saved_state(kind, at):
    amounts = SimpleNamespace(steps=100, batch_size=4, replay_ratio=2.0, warmup_episodes=4)
    settings = Local.Settings(processes=0, environments=3)

    def rounds(training, recorder):
        for round in training.rounds():
            yield round.steps, round.episodes, round.updates, round.warming_up, round.finished, recorder.added[-1]

    whole = kind()
    with Local(settings, Counter) as local:
        expected = list(rounds(Training(local, whole, whole, amounts, SeedTree(7)), whole))
    first = kind()
    with Local(settings, Counter) as local:
        training = Training(local, first, first, amounts, SeedTree(7))
        found = list(itertools.islice(rounds(training, first), at))
        state = training.state()
    first.begun.clear()
    with Local(settings, Counter) as local:
        again = Training(local, first, first, amounts, SeedTree(7))
        again.load_state(state)
        found += list(rounds(again, first))
    assert first.begun[0][0] > at, "an episode that goes on does not begin"
    assert len(found) == len(expected)
    for ours, theirs in zip(found, expected, strict=True):
        assert ours[:-1] == theirs[:-1]
        for one, other in zip(ours[-1], theirs[-1], strict=True):
            np.testing.assert_array_equal(one, other)


def test_the_state_of_another_number_of_environments_is_refused():
    recorder = Recorder()
    amounts = SimpleNamespace(steps=9, batch_size=4, replay_ratio=2.0, warmup_episodes=0)
    states = []
    for environments in (3, 2):
        settings = Local.Settings(processes=0, environments=environments)
        with Local(settings, Counter) as local:
            training = Training(local, recorder, recorder, amounts, SeedTree(7))
            if states:
                with pytest.raises(UsageError, match="3 environments with 2 action columns, and this one 2 with 2"):
                    training.load_state(states[0])
            else:
                next(training.rounds())
                states.append(training.state())
