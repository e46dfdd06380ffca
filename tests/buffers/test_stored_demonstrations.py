"""Demonstrations in replay buffers: never overwritten, sampled and relabelled as all else, saved and loaded."""

from typing import Any

import numpy as np
import pytest
from support.worlds import Counting, SameStep, counting_signature, feed, make_buffer, places

from karolos.buffers.priority import Priority
from karolos.buffers.uniform import Uniform
from karolos.core import Transitions

BUFFERS = [Uniform, Priority]
STEPS = 5


def make(buffer: Any, **settings: Any) -> Any:
    return make_buffer(buffer, counting_signature(STEPS), **({"capacity": 24, "environments": 2} | settings))


def episodes(count: int, first: int = 100) -> list[Transitions]:
    """Whole episodes of STEPS steps, numbered from `first` on."""
    world = Counting(1)
    found = []
    for episode in range(first, first + count):
        world.current[0] = [episode, 0]
        steps = [world.step([0], over=[step == STEPS - 1]) for step in range(STEPS)]
        found.append(Transitions(*(np.concatenate(field) for field in zip(*steps, strict=True))))
    return found


def filled(buffer: Any, rounds: int, world: Counting | None = None) -> Counting:
    world = world or Counting(2)
    feed(buffer, world, rounds, length=STEPS)
    return world


def sampled(buffer: Any, size: int = 2000) -> set[tuple[int, int]]:
    """(episode, step) of what comes in a batch."""
    return set(places(buffer.sample(size)))


@pytest.mark.parametrize("buffer", BUFFERS)
def test_demonstrations_are_never_overwritten_and_batches_say_which_they_are(buffer):
    made = make(buffer)
    made.add_demonstrations(episodes(5))
    shown = {(episode, step) for episode in range(100, 105) for step in range(STEPS)}
    assert sampled(made) == shown
    world = filled(made, 60)
    batch = made.sample(2000)
    assert set(places(batch)) == shown | world.stored(12)
    np.testing.assert_array_equal(batch.demonstrated, batch.observation[:, 1] >= 100)
    assert len(made) == 25 + 24


@pytest.mark.parametrize("buffer", BUFFERS)
def test_goals_in_hindsight_and_returns_over_several_steps_are_of_the_same_demonstration(buffer):
    made = make(buffer, n_step=3)
    made.add_demonstrations(episodes(4))
    batch = made.sample(500)
    np.testing.assert_array_equal(batch.next_observation[:, 1], batch.observation[:, 1])
    taken = batch.next_observation[:, 2] - batch.observation[:, 2]
    np.testing.assert_array_equal(taken, np.minimum(3, STEPS - batch.observation[:, 2]))
    made = make(buffer, hindsight={"ratio": 1.0, "min_displacement": 0.0})
    made.add_demonstrations(episodes(4))
    batch = made.sample(500)
    np.testing.assert_array_equal(batch.desired_goal[:, 0], batch.observation[:, 1])
    assert (batch.desired_goal[:, 1] > batch.observation[:, 2]).all()
    reached = SameStep().reward(batch.next_observation[:, 1:], batch.desired_goal)
    np.testing.assert_array_equal(batch.reward, reached)


@pytest.mark.parametrize("share", [None, 0.25])
@pytest.mark.parametrize("buffer", BUFFERS)
def test_a_fresh_buffer_goes_on_with_the_demonstrations_of_a_saved_one(buffer, share):
    first, second = make(buffer), make(buffer)
    first.add_demonstrations(episodes(5), share)
    world = filled(first, 17)
    first.update_priorities(first.sample(64).slot, np.arange(64, dtype=np.float32))
    second.load_state(first.state())
    for made in (first, second):
        filled(made, 5, Counting(2))
    assert len(world.given[0]) == 17
    for _ in range(3):
        ours, theirs = first.sample(64), second.sample(64)
        assert share is None or theirs.demonstrated.sum() == 16
        for one, other in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one, other)
        for made, batch in ((first, ours), (second, theirs)):
            made.update_priorities(batch.slot, np.arange(64, dtype=np.float32))


def test_demonstrations_begin_with_the_largest_priority_and_what_was_there_keeps_its_own():
    made = make(Priority, alpha=1.0)
    filled(made, 10)
    batch = made.sample(64)
    made.update_priorities(batch.slot, np.full(64, 7, np.float32))
    before = made.metrics()
    made.add_demonstrations(episodes(2))
    after = made.metrics()
    assert after["priority_max"] == before["priority_max"] == pytest.approx(7, rel=1e-5)
    total = before["priority_mean"] * before["transitions"] + 10 * 7
    assert after["priority_mean"] * after["transitions"] == pytest.approx(total, rel=1e-5)


@pytest.mark.parametrize("buffer", BUFFERS)
def test_a_share_of_each_batch_is_demonstrated(buffer):
    made = make(buffer)
    made.add_demonstrations(episodes(2), 0.25)
    assert made.sample(40).demonstrated.all()  # there is nothing else
    world = filled(made, 12)
    for _ in range(5):
        batch = made.sample(40)
        assert batch.demonstrated.sum() == 10
        np.testing.assert_array_equal(batch.demonstrated, batch.observation[:, 1] >= 100)
        made.update_priorities(batch.slot, np.linspace(0.1, 5, 40, dtype=np.float32))
    assert sampled(made) == {(episode, step) for episode in (100, 101) for step in range(STEPS)} | world.stored(12)


def test_a_share_is_sampled_by_priority_and_weights_correct_the_bias_within_each_part():
    made = make(Priority, alpha=1.0, beta=1.0)
    made.add_demonstrations(episodes(2), 0.5)
    filled(made, 10)
    batch = made.sample(400)
    errors = np.where(batch.observation[:, 2] == 0, 4.0, 1.0).astype(np.float32)
    made.update_priorities(batch.slot, errors)
    batch = made.sample(4000)
    demonstrated, first = batch.demonstrated > 0, batch.observation[:, 2] == 0
    assert demonstrated.mean() == 0.5
    for part in (demonstrated, ~demonstrated):  # first steps: 4 of 4 + 1 + 1 + 1 + 1
        assert first[part].mean() == pytest.approx(0.5, abs=0.02)
        np.testing.assert_allclose(batch.weight[part & ~first], 1, rtol=1e-4)
        np.testing.assert_allclose(batch.weight[part & first], 0.25, rtol=1e-4)


@pytest.mark.parametrize("beta", [0.4, 1.0])
def test_importance_weights_leave_demonstrations_their_share_of_the_loss(beta):
    made = make(Priority, capacity=2000, alpha=0.6, beta=beta, beta_updates=10**9)
    made.add_demonstrations(episodes(2), 0.25)  # 10 demonstrated transitions beside 2,000
    filled(made, 1000)
    generator = np.random.default_rng(0)
    for _ in range(50):
        batch = made.sample(256)
        made.update_priorities(batch.slot, generator.gamma(2, size=256) + batch.demonstrated * 2)
    batches = (made.sample(256) for _ in range(50))
    shares = [batch.weight @ batch.demonstrated / batch.weight.sum() for batch in batches]
    assert np.mean(shares) == pytest.approx(0.25, abs=0.03)


@pytest.mark.parametrize("share", [None, 0.25])
@pytest.mark.parametrize("buffer", BUFFERS)
def test_an_empty_list_of_demonstrations_changes_nothing(buffer, share):
    plain, empty = make(buffer), make(buffer)
    empty.add_demonstrations([], share)
    for made in (plain, empty):
        filled(made, 10)
    for _ in range(3):
        for one, other in zip(plain.sample(16), empty.sample(16), strict=True):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("with_demonstrations", [False, True])
@pytest.mark.parametrize("buffer", BUFFERS)
def test_relabelled_transitions_are_imitated_if_hindsight_says_so(buffer, with_demonstrations):
    plain, imitating = (
        make(buffer, hindsight={"ratio": 0.5, "min_displacement": 0.0, "imitate": imitate}) for imitate in (False, True)
    )
    for made in (plain, imitating):
        filled(made, 10)
        if with_demonstrations:
            made.add_demonstrations(episodes(2))
    before, after = plain.sample(500), imitating.sample(500)
    np.testing.assert_array_equal(before.desired_goal, after.desired_goal)
    demonstrated = before.observation[:, 1] >= 100
    if with_demonstrations:
        np.testing.assert_array_equal(before.demonstrated, demonstrated)
    else:
        assert before.demonstrated is None
    relabelled = after.desired_goal[:, 0] == after.observation[:, 1]  # episodes never have their own number as goal
    assert 0.4 < relabelled.mean() < 0.6
    np.testing.assert_array_equal(after.demonstrated, demonstrated | relabelled)
