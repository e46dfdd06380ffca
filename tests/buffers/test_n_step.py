"""Multi-step transitions against a reference that walks the episodes one step at a time."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.worlds import Counting, SameStep, counting_signature, feed, make_buffer

from karolos.buffers.uniform import Uniform
from karolos.core import Batch

DISCOUNT = 0.9


def make(steps: int, *, max_steps: int, ring_size: int, rule: SameStep | None = None, **settings: object) -> Any:
    signature = counting_signature(max_steps, rule=rule)
    return make_buffer(Uniform, signature, ring_size, discount=DISCOUNT, n_step=steps, **settings)


def worth(episode: int, step: int) -> float:
    return episode + step / 8


def rows(batch: Batch) -> list[tuple[tuple[int, int], tuple[int, int], float, float, float]]:
    """(episode, step) before and after, reward, terminated, discount of each transition."""
    return [
        ((int(here[1]), int(here[2])), (int(there[1]), int(there[2])), float(reward), float(end), float(discount))
        for here, there, reward, end, discount in zip(
            batch.observation, batch.next_observation, batch.reward, batch.terminated, batch.discount, strict=True
        )
    ]


@given(
    st.integers(2, 5),
    st.lists(st.tuples(st.integers(1, 6), st.booleans()), min_size=1, max_size=8),
    st.integers(0, 5),
    st.integers(6, 14),
)
def test_windows_stop_at_ends_and_at_what_is_stored_and_sum_what_they_span(steps, episodes, running, ring_size):
    buffer, world = make(steps, max_steps=6, ring_size=ring_size), Counting(1)
    ends: dict[int, tuple[int, bool]] = {}
    for length, fallen in [*episodes, (running, False)]:
        episode = world.current[0][0]
        last = episode > len(episodes)
        for step in range(length):
            over = step == length - 1 and not last
            one = world.step([0], over=[over], fallen=fallen)
            buffer.add(one._replace(reward=np.float32([worth(episode, step)])))
        ends[episode] = (length, fallen and not last)
    for here, there, reward, terminated, discount in rows(buffer.sample(300)):
        episode, first = here
        length, falls = ends[episode]
        span = min(steps, length - first)
        assert there == (episode, first + span)
        assert reward == pytest.approx(sum(DISCOUNT**k * worth(episode, first + k) for k in range(span)), rel=1e-5)
        assert discount == pytest.approx(DISCOUNT**span)
        assert terminated == float(falls and first + span == length)


@pytest.mark.parametrize("ends", [False, True])
def test_a_window_stops_at_the_first_step_that_reaches_a_relabelled_goal(ends):
    rule = SameStep(ends=ends)
    hindsight = {"strategy": "future", "ratio": 1.0, "min_displacement": 0}
    buffer, world = make(4, max_steps=9, ring_size=40, rule=rule, hindsight=hindsight), Counting(1)
    feed(buffer, world, 9, length=9)
    batch = buffer.sample(500)
    seen = set()
    for (here, there, reward, terminated, discount), goal in zip(rows(batch), batch.desired_goal, strict=True):
        away = int(goal[1]) - here[1]  # steps to the goal
        span = min(4, 9 - here[1], away)
        seen.add((away, span))
        assert there == (1, here[1] + span)
        assert discount == pytest.approx(DISCOUNT**span)
        assert reward == pytest.approx(DISCOUNT ** (away - 1) if away <= span else 0.0)
        assert terminated == float(ends and away <= span)
    assert {(1, 1), (3, 3), (4, 4), (6, 4)} <= seen
