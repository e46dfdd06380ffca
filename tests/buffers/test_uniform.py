"""The replay buffer: what it keeps, what it gives, and that it goes on where it stopped."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.worlds import Counting, counting_signature, goals, make_buffer, places

from karolos.buffers.uniform import Uniform
from karolos.core import Field, Layout, Signature
from karolos.errors import PluginError, UsageError


def make(signature: Signature, capacity: int, **settings: Any) -> Any:
    return make_buffer(Uniform, signature, capacity, **settings)


@st.composite
def histories(draw: st.DrawFn) -> tuple[int, int, int, list[list[bool]]]:
    """Environments, steps an episode may take, ring size, and for each call whom it names (None) or ends (True)."""
    environments = draw(st.integers(1, 3))
    max_steps = draw(st.integers(1, 6))
    ring_size = draw(st.integers(max_steps, max_steps + 7))
    calls = draw(
        st.lists(
            st.lists(st.sampled_from((None, False, True)), min_size=environments, max_size=environments),
            min_size=1,
            max_size=40,
        )
    )
    return environments, max_steps, ring_size, calls


def play(buffer: Uniform, world: Counting, max_steps: int, calls: list[list[bool | None]]) -> None:
    for call in calls:
        named = [environment for environment, what in enumerate(call) if what is not None]
        if named:
            over = [bool(call[e]) or world.current[e][1] + 1 >= max_steps for e in named]
            buffer.add(world.step(named, over=over))


def allowed_goals(world: Counting, ring_size: int, strategy: str) -> dict[tuple[int, int], set[tuple[int, int]]]:
    """For each stored transition, the goals of its episode that the strategy allows; found by search."""
    found = {}
    for history in world.given:
        stored = history[-ring_size:]
        for episode, step in stored:
            steps = [other for of, other in stored if of == episode]
            chosen = {"future": [s for s in steps if s >= step], "final": [max(steps)], "episode": steps}[strategy]
            found[episode, step] = {(episode, other + 1) for other in chosen}
    return found


@pytest.mark.parametrize("strategy", ["future", "final", "episode"])
@given(history=histories())
def test_hindsight_goals_come_from_what_is_left_of_the_same_episode(strategy, history):
    environments, max_steps, ring_size, calls = history
    hindsight = {"strategy": strategy, "ratio": 1.0, "min_displacement": 0.0}
    buffer = make(
        counting_signature(max_steps), ring_size * environments, environments=environments, hindsight=hindsight
    )
    world = Counting(environments)
    play(buffer, world, max_steps, calls)
    if not any(world.given):
        return
    allowed = allowed_goals(world, ring_size, strategy)
    batch = buffer.sample(64)
    for place, goal in zip(places(batch), goals(batch), strict=True):
        assert goal in allowed[place]


@pytest.mark.parametrize("strategy", ["future", "final", "episode"])
@pytest.mark.parametrize("steps", [3, 5, 17, 23])
def test_every_goal_the_strategy_names_is_drawn_over_the_ring_seam_too(strategy, steps):
    hindsight = {"strategy": strategy, "ratio": 1.0, "min_displacement": 0.0}
    buffer = make(counting_signature(5), 14, environments=2, hindsight=hindsight)
    world = Counting(2)
    for step in range(steps):
        buffer.add(world.step([0, 1], over=[step % 5 == 4, step % 4 == 3]))
    batch = buffer.sample(4000)
    drawn: dict[tuple[int, int], set[tuple[int, int]]] = {}
    for place, goal in zip(places(batch), goals(batch), strict=True):
        drawn.setdefault(place, set()).add(goal)
    assert drawn == allowed_goals(world, 7, strategy)


@given(history=histories())
def test_holds_exactly_the_latest_transitions_of_each_environment(history):
    environments, max_steps, ring_size, calls = history
    buffer = make(counting_signature(max_steps), ring_size * environments, environments=environments)
    world = Counting(environments)
    play(buffer, world, max_steps, calls)
    kept = world.stored(ring_size)
    assert len(buffer) == len(kept)
    if kept:
        assert set(places(buffer.sample(2000))) == kept


def test_every_transition_is_equally_likely_however_unevenly_the_environments_step():
    buffer = make(counting_signature(50), 200, environments=2)
    world = Counting(2)
    for step in range(40):
        named = [0, 1] if step % 4 == 0 else [1]
        buffer.add(world.step(named, over=[False] * len(named)))
    counts: dict[tuple[int, int], int] = {}
    for place in places(buffer.sample(50_000)):
        counts[place] = counts.get(place, 0) + 1
    assert len(counts) == 50
    assert min(counts.values()) > 1000 - 5 * 32  # 1000 expected, standard deviation 31.3
    assert max(counts.values()) < 1000 + 5 * 32


def test_a_batch_row_is_one_transition_as_it_was_stored():
    buffer = make(counting_signature(4), 40, environments=2)
    world = Counting(2)
    for step in range(7):
        buffer.add(world.step([0, 1], over=[step % 4 == 3, step % 3 == 2]))
    batch = buffer.sample(100)
    np.testing.assert_array_equal(batch.next_observation, batch.observation + np.float32([0, 0, 1]))
    assert (batch.desired_goal == -7).all()
    assert (batch.action == np.float32([0.25, -0.5])).all()
    assert (batch.discount == np.float32(0.9)).all()
    assert (batch.weight == 1).all()
    assert batch.slot.shape == batch.reward.shape == batch.terminated.shape == (100,)


def test_a_saved_state_does_not_change_with_the_buffer():
    buffer = make(counting_signature(5), 10)
    world = Counting(1)
    for _ in range(5):
        buffer.add(world.step([0], over=[False]))
    saved = buffer.state()
    before = saved["storage"]["table"].copy()
    for _ in range(8):
        buffer.add(world.step([0], over=[True]))
    np.testing.assert_array_equal(saved["storage"]["table"], before)


def test_state_of_another_shape_is_refused():
    with pytest.raises(UsageError, match="another number of environments"):
        make(counting_signature(5), 30, environments=3).load_state(make(counting_signature(5), 30).state())


def test_capacity_below_an_episode_per_environment_and_hindsight_without_goals_that_fit_are_refused():
    with pytest.raises(UsageError, match=r"buffer\.capacity.*set buffer\.capacity to 150"):
        make(counting_signature(50), 149, environments=3)
    plain = Signature(Layout((Field("x", 2),)), Layout((Field("a", 1),)), max_steps=5)
    with pytest.raises(UsageError, match="needs an environment with goals"):
        make(plain, 10, hindsight={})
    assert len(make(plain, 10)) == 0
    small = replace(counting_signature(5), achieved_goal=Layout((Field("x", 1),)))
    with pytest.raises(PluginError, match="achieved goal has 1 columns"):
        make(small, 10, hindsight={})


def test_an_episode_that_is_cut_gives_goals_of_its_own_and_none_to_the_next():
    world = Counting(2)
    buffer = make(counting_signature(5), 40, environments=2, hindsight={"strategy": "future", "ratio": 1.0})
    for _ in range(3):
        buffer.add(world.step([0, 1], over=[False, False]))
    world.current[0] = world.begin()  # its simulation diverged; the other environment goes on
    buffer.cut(np.array([0]))
    for step in range(5):
        buffer.add(world.step([0, 1], over=[step == 4, step == 1]))
    batch = buffer.sample(2000)
    pairs = set(zip(places(batch), goals(batch), strict=True))
    assert all(place[0] == goal[0] and goal[1] > place[1] for place, goal in pairs)
    assert {goal for place, goal in pairs if place == (1, 0)} == {(1, 1), (1, 2), (1, 3)}
    assert {goal for place, goal in pairs if place == (2, 0)} == {(2, step) for step in range(1, 6)}


def test_cutting_where_no_episode_runs_changes_nothing():
    world = Counting(1)
    buffer = make(counting_signature(5), 40)
    buffer.cut(np.array([0]))
    buffer.add(world.step([0], over=[True]))
    before = buffer.state()["storage"]["table"]
    buffer.cut(np.array([0]))
    np.testing.assert_array_equal(buffer.state()["storage"]["table"], before)
