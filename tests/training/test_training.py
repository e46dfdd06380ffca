"""The training loop: what it hands to the buffer, when it learns, and that counts alone decide."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from support.training_parts import Counter, train, updates_per_round

from karolos.core import random_actions
from karolos.core.seeding import SeedTree


def test_steps_are_counted_over_all_environments_and_rounds_stop_when_they_are_taken():
    progress, _, training = train(steps=20)
    assert [round.steps for round in progress] == [3, 6, 9, 12, 15, 18, 21]
    assert training.steps == 21


def test_transitions_continue_an_episode_until_it_ends_and_never_join_two():
    _, recorder, _ = train()
    for environment in range(3):
        steps = [[field[environment] for field in added] for added in recorder.added]
        for (_, obs, _, _, _, _, after, reached, terminated, truncated), following in itertools.pairwise(steps):
            assert after[0] == obs[0], "a transition stays in its episode"
            assert after[1] == obs[1] + 1 == reached[0]
            if terminated or truncated:
                assert following[1][1] == 0, "a new episode begins at its reset"
                assert following[1][0] != obs[0]
            else:
                np.testing.assert_array_equal(following[1], after)


def test_the_last_observation_of_an_episode_reaches_the_buffer():
    _, recorder, _ = train()
    ends = [added.next_observation[added.truncated | added.terminated] for added in recorder.added]
    lengths = np.concatenate(ends)[:, 1]
    assert lengths.size > 5
    assert set(lengths) <= {2.0, 3.0, 4.0}


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


def test_same_seed_gives_the_same_transitions_and_another_seed_others():
    (_, first, _), (_, second, _) = train(), train()
    for one, other in zip(first.added, second.added, strict=True):
        for field, again in zip(one, other, strict=True):
            np.testing.assert_array_equal(field, again)
    seeds = {SeedTree(run).child("environment", i, k).integer() for run in (7, 8) for i in range(3) for k in range(3)}
    assert len(seeds) == 18


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
def test_seed_tree_is_addressed_not_spawned(interesting):
    tree = SeedTree(3)
    before = tree.child(*interesting).integer()
    tree.child("something", "else").generator().random()
    assert tree.child(*interesting).integer() == before
    assert SeedTree(4).child(*interesting).integer() != before
