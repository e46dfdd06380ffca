"""Prioritised replay: odds, weights, and names that outlive their slots."""

from typing import Any

import numpy as np
import pytest
from support.worlds import Counting, counting_signature, feed, make_buffer, places

from karolos.buffers.priority import Priority
from karolos.errors import RunError


def make(capacity: int = 40, *, environments: int = 1, **settings: object) -> Any:
    return make_buffer(Priority, counting_signature(5), capacity, environments=environments, **settings)


def set_errors(buffer: Priority, errors: dict[tuple[int, int], float], default: float) -> None:
    """Give every stored transition an error, by (episode, step)."""
    for _ in range(60):
        batch = buffer.sample(32)
        buffer.update_priorities(batch.slot.copy(), np.array([errors.get(place, default) for place in places(batch)]))


def test_a_transition_is_sampled_in_proportion_to_its_error_to_the_alpha():
    buffer = make(alpha=0.5)
    feed(buffer, Counting(1), 5)
    set_errors(buffer, {(1, 0): 16.0, (1, 1): 4.0}, default=1.0)
    drawn = [place for _ in range(200) for place in places(buffer.sample(50))]
    shares = {place: drawn.count(place) / len(drawn) for place in set(drawn)}
    odds = {(1, 0): 4.0, (1, 1): 2.0, (1, 2): 1.0, (1, 3): 1.0, (1, 4): 1.0}
    for place, odd in odds.items():
        assert shares[place] == pytest.approx(odd / 9, rel=0.05)


def test_importance_weights_make_the_mean_over_a_batch_that_over_all_transitions():
    buffer = make(alpha=0.8, beta=1.0)
    feed(buffer, Counting(1), 5)
    set_errors(buffer, {(1, 0): 9.0, (1, 1): 3.0}, default=0.5)
    weighted = total = 0.0
    for _ in range(400):
        batch = buffer.sample(64)
        scale = batch.weight / batch.weight.min()  # the common factor of a batch is its own
        weighted += float((scale * batch.observation[:, 2]).sum())
        total += float(scale.sum())
    assert weighted / total == pytest.approx(np.mean(range(5)), abs=0.03), "steps 0 to 4, each counted alike"


def test_new_transitions_have_the_largest_priority_seen():
    buffer = make(alpha=1.0)
    world = Counting(1)
    feed(buffer, world, 5)
    set_errors(buffer, {(1, 3): 50.0}, default=0.01)
    feed(buffer, world, 5)
    drawn = [place for _ in range(40) for place in places(buffer.sample(60))]
    for step in range(5):
        assert drawn.count((2, step)) / len(drawn) == pytest.approx(1 / 6, rel=0.15)


def test_a_batch_takes_one_transition_from_each_share():
    buffer = make(alpha=0.0)
    feed(buffer, Counting(1), 5)
    counts = [places(buffer.sample(50)).count((1, step)) for step in range(5)]
    assert all(abs(count - 10) <= 1 for count in counts)


def test_a_priority_for_an_overwritten_transition_is_dropped():
    buffer = make(capacity=5, alpha=1.0)
    world = Counting(1)
    feed(buffer, world, 5)
    old = buffer.sample(64).slot.copy()
    feed(buffer, world, 5)
    before = buffer.state()["odds"]
    buffer.update_priorities(old, np.full(64, 1000.0))
    np.testing.assert_array_equal(buffer.state()["odds"], before)
    fresh = buffer.sample(8)
    buffer.update_priorities(fresh.slot.copy(), np.full(8, 1000.0))
    assert (buffer.state()["odds"] != before).any()


def test_identifiers_lead_to_their_transitions_until_they_are_overwritten():
    buffer = make(capacity=14, environments=2)
    world = Counting(2)
    for step in range(40):
        buffer.add(world.step([0, 1] if step % 3 else [1], over=[step % 5 == 4] * (2 if step % 3 else 1)))
        batch = buffer.sample(8)
        storage = buffer.storage
        slots, stored = storage.resolve(batch.slot)
        assert stored.all()
        np.testing.assert_array_equal(storage.column("observation", slots), batch.observation)


def test_beta_rises_to_1_over_the_batches_given():
    buffer = make(beta=0.4, beta_updates=10)
    feed(buffer, Counting(1), 5)
    betas = []
    for _ in range(12):
        betas.append(buffer.beta)
        buffer.sample(4)
    np.testing.assert_allclose(betas, [min(0.4 + 0.06 * count, 1.0) for count in range(12)])


def test_an_error_that_is_not_a_number_is_refused():
    buffer = make()
    feed(buffer, Counting(1), 5)
    with pytest.raises(RunError, match="not a number"):
        buffer.update_priorities(buffer.sample(2).slot, np.array([1.0, np.nan]))
