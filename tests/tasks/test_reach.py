from __future__ import annotations

import numpy as np
import pytest

from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError
from karolos.robots.panda import Panda
from karolos.tasks.reach import Reach


def environment(**settings: object) -> RobotTask:
    return RobotTask(
        RobotTask.Settings.model_validate({}),
        robot=Panda(Panda.Settings.model_validate({})),
        task=Reach(Reach.Settings.model_validate(settings)),
    )


@pytest.mark.parametrize(("goals", "edges"), [("box", (0.3, 0.3, 0.3)), ("workspace", (0.4, 0.5, 0.385))])
def test_goals_fill_their_box_in_the_middle_of_the_workspace(goals: str, edges: tuple[float, ...]) -> None:
    made = environment(goals=goals)
    drawn = np.array([made.reset(seed).desired_goal for seed in range(400)])
    centre = made.robot.workspace.centre
    for axis, edge in enumerate(edges):
        low, high = centre[axis] - edge / 2, centre[axis] + edge / 2
        assert low - 1e-6 <= drawn[:, axis].min() < low + 0.05 * edge
        assert high - 0.05 * edge < drawn[:, axis].max() <= high + 1e-6
    made.close()


def test_goal_is_reached_and_the_rewards_say_so() -> None:
    made = environment()
    assert made.signature.reward_range == (-1.0, 0.0)
    step = made.reset(0)
    goal = tuple(step.desired_goal.tolist())
    rewards = []
    while not step.truncated:
        step = made.step(made.robot.towards(goal, 0.0))
        assert step.reward == (0.0 if step.success else -1.0)
        assert not step.terminated
        rewards.append(step.reward)
    assert step.success
    assert rewards[0] == -1
    assert len(rewards) == made.signature.max_steps == 50
    made.close()


def test_dense_reward_is_minus_the_distance() -> None:
    made = environment(reward="dense")
    step = made.reset(0)
    step = made.step(np.zeros(3))
    assert step.reward == pytest.approx(-np.linalg.norm(step.achieved_goal - step.desired_goal), abs=1e-6)
    made.close()


def test_threshold_that_leaves_no_goal_is_refused() -> None:
    with pytest.raises(UsageError, match=r"task.threshold: 0.3 m leaves no goal"):
        environment(threshold=0.3)


def test_marker_stands_at_the_goal() -> None:
    made = environment()
    made.reset(0)
    without = made.render(80, 60).astype(int)
    made.world._markers[0][0].place((0.0, 0.0, -50.0))
    assert np.abs(made.render(80, 60) - without).max() > 20
    made.close()
