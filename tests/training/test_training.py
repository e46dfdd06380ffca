"""The training loop: what it hands to the buffer, when it learns, that counts alone decide, and that it goes on."""

from dataclasses import replace

import numpy as np
import pytest
from support.training_parts import Counter, OnPolicyRecorder, Recorder, train, updates_per_round

from karolos.core import random_actions
from karolos.core.seeding import SeedTree
from karolos.errors import UsageError


def test_steps_are_counted_over_all_environments_and_rounds_stop_when_they_are_taken():
    progress, _, training = train(steps=20)
    assert [round.steps for round in progress] == [3, 6, 9, 12, 15, 18, 21]
    assert training.steps == 21


def test_learning_starts_after_warm_up_and_keeps_the_replay_ratio():
    progress, recorder, training = train(steps=300, replay_ratio=2.0, batch_size=4)
    first = next(round for round in progress if round.updates)
    assert first.episodes >= 2
    warm_up = next(index for index, round in enumerate(progress) if round.episodes >= 2)
    learning_steps = progress[-2].steps - progress[warm_up].steps
    assert training.updates == int(learning_steps * 2.0 / 4)
    assert recorder.learned == training.updates == len(recorder.priorities)


def test_pretraining_updates_come_before_the_first_environment_step():
    progress, recorder, training = train(pretraining_updates=150, steps=30)
    _, _, without = train(steps=30)
    assert [(round.steps, round.updates) for round in progress[:4]] == [(0, 64), (0, 128), (0, 150), (3, 150)]
    assert all(round.warming_up for round in progress[:3])
    assert [stored for _, stored in recorder.sampled[:151]] == [0] * 150 + [recorder.sampled[150][1]]
    assert recorder.sampled[150][1] > 0
    assert training.updates == without.updates + 150


def test_an_update_learns_from_what_was_stored_before_the_round():
    progress, recorder, _ = train()
    stored_before = [index for index, updates in enumerate(updates_per_round(progress)) for _ in range(updates)]
    assert [stored for _, stored in recorder.sampled] == stored_before


def test_warm_up_acts_at_random_and_then_asks_the_agent():
    _, recorder, _ = train(warmup_episodes=4)
    spread = [np.ptp(added.action) > 0 for added in recorder.added]
    assert spread[0]
    assert not spread[-1]
    assert spread == sorted(spread, reverse=True)


def test_episode_records_tell_length_reward_success_and_parameters():
    progress, _, training = train()
    records = [record for round in progress for record in round.finished]
    assert len(records) == training.episodes > 5
    for record in records:
        assert record.steps == record.seed % 3 + 2
        assert record.total_reward == sum(range(1, record.steps + 1))
        assert record.any
        assert record.end == (record.steps == 2)
        assert not record.reset
        assert record.parameters == (record.seed % 7,)
    for environment in range(3):
        assert [r.index for r in records if r.environment == environment] == list(
            range(sum(r.environment == environment for r in records))
        )


def test_a_step_that_diverged_is_counted_and_never_reaches_the_buffer(monkeypatch):
    monkeypatch.setattr(Counter, "diverges", True)
    progress, recorder, training = train(steps=90)
    records = [record for round in progress for record in round.finished]
    diverged = [record for record in records if record.diverged]
    assert 0 < len(diverged) < len(records)
    assert not any(added.truncated.any() for added in recorder.added)
    stored = sum(added.environment.size for added in recorder.added)
    assert stored == training.steps - len(diverged)
    assert sorted(i for _, ids in recorder.cuts for i in ids) == sorted(record.environment for record in diverged)


def test_time_between_rounds_is_not_training_time(monkeypatch):
    clock = iter(range(0, 10_000, 5))
    monkeypatch.setattr("karolos.training.training.time.perf_counter", lambda: float(next(clock)))
    progress, _, _ = train(steps=9)
    assert [round.seconds for round in progress] == [5.0, 10.0, 15.0], (
        "each round takes 5, the 5 between are not counted"
    )


def test_random_actions_fill_the_action_range():
    actions = random_actions(Counter.signature, 500, SeedTree(0).generator())
    assert actions.shape == (500, 2)
    assert actions.dtype == np.float32
    assert -1 <= actions.min() < -0.9
    assert 0.9 < actions.max() <= 1


@pytest.mark.parametrize("interesting", [("a",), ("a", 1), (1, "a")])
def test_seeds_are_addressed_not_spawned_and_all_different(interesting):
    tree = SeedTree(3)
    before = tree.child(*interesting).integer()
    tree.child("something", "else").generator().random()
    assert tree.child(*interesting).integer() == before
    assert SeedTree(4).child(*interesting).integer() != before
    seeds = {SeedTree(run).child("environment", i, k).integer() for run in (7, 8) for i in range(3) for k in range(3)}
    assert len(seeds) == 18


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
    expected, whole, _ = train(recorder=kind(), steps=100, warmup_episodes=4)
    found, recorder, training = train(recorder=kind(), steps=100, warmup_episodes=4, rounds=at)
    recorder.begun.clear()
    found += train(recorder=recorder, steps=100, warmup_episodes=4, state=training.state())[0]
    assert recorder.begun[0][0] > at, "an episode that goes on does not begin"
    assert [replace(round, seconds=0) for round in found] == [replace(round, seconds=0) for round in expected]
    for ours, theirs in zip(recorder.added, whole.added, strict=True):
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one, other)


def test_the_state_of_another_number_of_environments_is_refused():
    state = train(environments=3, rounds=1)[2].state()
    with pytest.raises(UsageError, match="3 environments with 2 action columns, and this one 2 with 2"):
        train(environments=2, state=state)
