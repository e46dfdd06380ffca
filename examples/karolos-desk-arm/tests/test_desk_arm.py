"""What a robot promises, of `desk_arm`."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from karolos.environments.robot_task import RobotTask
from karolos.playing import expert_policy
from karolos.registry import find, load
from karolos.scoring import score


def joined(task: str, control: str = "cartesian", **settings: int) -> RobotTask:
    robot, plugin = load("robots", "desk_arm"), load("tasks", task)
    return RobotTask(
        RobotTask.Settings(), robot=robot(robot.Settings(control=control)), task=plugin(plugin.Settings(**settings))
    )


def test_it_is_found_by_its_entry_point() -> None:
    assert find("robots", "desk_arm").distribution == "karolos-desk-arm"


@pytest.mark.parametrize("control", ["cartesian", "joint"])
@pytest.mark.parametrize("task", ["reach", "push"])
def test_tasks_that_have_never_heard_of_it_are_solved_by_their_experts(task: str, control: str) -> None:
    environment = joined(task, control)
    found = score(environment, expert_policy(environment), episodes=5, seed=0)
    environment.close()
    assert environment.blow_ups == 0
    assert found.success_end >= 0.8


def test_home_lies_in_the_workspace_and_the_tool_points_down() -> None:
    robot = joined("reach").robot
    assert robot.workspace.contains(robot.home)
    np.testing.assert_allclose(robot.forward(robot.home_joints).tool.z, (0, 0, -1), atol=1e-3)


def test_the_tool_reaches_every_corner_of_the_declared_workspace() -> None:
    environment = joined("reach", max_steps=10_000)
    robot = environment.robot
    low, high = robot.workspace.low, robot.workspace.high
    for share in product((0.0, 0.5, 1.0), repeat=3):
        x, y, z = (a + (b - a) * part for a, b, part in zip(low, high, share, strict=True))
        environment.reset(0)
        for _ in range(45):
            environment.step(robot.towards((x, y, z), 0.0))
        assert np.linalg.norm(np.subtract(robot.tool_position, (x, y, z))) < 0.005
    environment.close()


def test_joints_keep_to_their_speeds_under_the_hardest_actions() -> None:
    environment = joined("reach", "joint", max_steps=10_000)
    draws = np.random.default_rng(0)
    environment.reset(0)
    for _ in range(100):
        environment.step(np.sign(draws.uniform(-1, 1, environment.signature.action.size)))
        fastest = np.abs(environment.robot.joint_velocities)
        assert (fastest <= 1.05 * np.array(environment.robot.limits.velocity)).all()
    environment.close()
