"""The on-policy buffer: every transition once and in order, whatever environments answer and wherever they end."""

import numpy as np
import pytest
from support.worlds import Counting, counting_signature

from karolos.buffers.on_policy import OnPolicy
from karolos.core import Rollout
from karolos.core.seeding import SeedTree
from karolos.errors import RunError, UsageError


def made(*, rollout: int, environments: int) -> OnPolicy:
    settings = OnPolicy.Settings(rollout=rollout)
    return OnPolicy(settings, counting_signature(5), SeedTree(0), environments=environments, discount=0.9)


def places(rollout: Rollout) -> list[list[tuple[int, int]]]:
    """(episode, step) of the stored rows of each environment, in their order."""
    found = []
    for environment in range(rollout.reward.shape[1]):
        rows = rollout.observation[rollout.stored[:, environment], environment].astype(int).tolist()
        assert {row[0] for row in rows} <= {environment}
        found.append([(episode, step) for _, episode, step in rows])
    return found


def test_every_transition_is_given_exactly_once_and_in_order_over_many_rollouts():
    buffer, world = made(rollout=4, environments=3), Counting(3)
    given: list[list[tuple[int, int]]] = [[], [], []]
    for call in range(24):
        buffer.add(world.step([2, 0, 1], over=[call % 5 == 4, call % 3 == 2, False]))
        if len(buffer):
            for environment, rows in enumerate(places(buffer.sample(len(buffer)))):
                given[environment] += rows
    assert given == world.given


def test_ends_stand_where_episodes_end_and_where_the_rollout_does():
    buffer, world = made(rollout=4, environments=2), Counting(2)
    for call in range(4):
        buffer.add(world.step([0, 1], over=[call == 1, call == 2], fallen=call == 2))
    rollout = buffer.sample(8)
    assert rollout.ended.T.tolist() == [[False, True, False, True], [False, False, True, True]]
    assert rollout.terminated.T.tolist() == [[False] * 4, [False, False, True, False]]


def test_a_cut_episode_ends_at_its_last_sound_step_as_if_truncated():
    buffer, world = made(rollout=4, environments=2), Counting(2)
    buffer.cut(np.array([0, 1]))  # nothing runs yet
    for call in range(4):
        if call == 2:  # environment 1 diverged: its step is no experience
            buffer.cut(np.array([1]))
            buffer.add(world.step([0], over=[False]))
        else:
            buffer.add(world.step([0, 1], over=[False, False]))
    rollout = buffer.sample(7)
    assert rollout.stored.T.tolist() == [[True] * 4, [True, True, True, False]]
    assert rollout.ended[:3].T.tolist() == [[False] * 3, [False, True, True]]
    assert not rollout.terminated.any()


def test_rows_of_an_older_rollout_are_not_stored_in_a_shorter_one():
    buffer, world = made(rollout=3, environments=2), Counting(2)
    for _ in range(3):
        buffer.add(world.step([0, 1], over=[True, True]))
    buffer.sample(6)
    for _ in range(3):
        buffer.add(world.step([1], over=[False]))
    rollout = buffer.sample(3)
    assert places(rollout) == [[], world.given[1][3:]]


def test_a_rollout_is_neither_overwritten_nor_given_in_parts_and_actions_are_those_that_were_given():
    buffer, world = made(rollout=2, environments=1), Counting(1)
    wild = np.float32([[7.5, -3.25]])
    buffer.add(world.step([0], over=[False])._replace(action=wild))
    with pytest.raises(RunError, match="not complete"):
        buffer.sample(1)
    buffer.add(world.step([0], over=[False]))
    with pytest.raises(RunError, match="was not sampled"):
        buffer.add(world.step([0], over=[False]))
    with pytest.raises(ValueError, match="2 transitions, not 1"):
        buffer.sample(1)
    np.testing.assert_array_equal(buffer.sample(2).action[0], wild)


@pytest.mark.parametrize("other", [{"rollout": 2, "environments": 2}, {"rollout": 4, "environments": 3}])
def test_the_state_of_another_shape_is_refused(other):
    buffer, world = made(**other), Counting(3)
    for _ in range(2 if other["rollout"] == 2 else 3):
        buffer.add(world.step(range(other["environments"]), over=[False] * other["environments"]))
    state = buffer.state()
    with pytest.raises(UsageError, match="another number"):
        made(rollout=1, environments=2).load_state(state)
