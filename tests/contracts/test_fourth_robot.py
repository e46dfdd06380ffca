"""A robot that no task has heard of: every task works with it, and what robots promise is promised by it too."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_robot
from building import CONTROLS, goes_with
from fourth_robot import small_arm

from karolos.environments.robot_task import RobotTask
from karolos.errors import PluginError
from karolos.playing import expert_policy
from karolos.registry import load, names
from karolos.robots.arm import Arm
from karolos.scoring import score

ENOUGH = {"pick_place": 0.9, "push": 0.9, "reach": 1.0}
"""Share of episodes that the expert solves at the least; any other task has to be solved once."""


def joined(robot: type[Arm], task: str, *, control: str | None = None, **settings: Any) -> RobotTask:
    plugin = load("tasks", task)
    return RobotTask(
        RobotTask.Settings.model_validate({}),
        robot=robot(robot.Settings.model_validate({} if control is None else {"control": control})),
        task=plugin(plugin.Settings.model_validate(settings)),
    )


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> type[Arm]:
    return small_arm(tmp_path_factory.mktemp("urdf"))


@pytest.fixture(scope="module", params=CONTROLS)
def environment(request: pytest.FixtureRequest, small: type[Arm]) -> Iterator[RobotTask]:
    made = joined(small, "reach", control=request.param, max_steps=test_robot.LONG)
    yield made
    made.close()


# the contract tests of robots that are in the registry, collected here with the fixture above
for _name, _promise in vars(test_robot).items():
    if _name.startswith("test_") and "environment" in inspect.signature(_promise).parameters:
        globals()[_name] = _promise


@pytest.mark.parametrize("task", names("tasks"))
@pytest.mark.parametrize("control", CONTROLS)
def test_every_task_is_solved_by_its_expert(small: type[Arm], task: str, control: str) -> None:
    if not goes_with(task, control):
        pytest.skip(f"{task} is not done in {control} control")
    made = joined(small, task, control=control)
    found = score(made, expert_policy(made), episodes=10, seed=0)
    assert made.blow_ups == 0
    made.close()
    assert found.success_end >= ENOUGH.get(task, 0.1)


def test_a_cube_lies_where_this_robot_works_and_as_its_gripper_is_held(small: type[Arm]) -> None:
    made = joined(small, "pick_place", start_grasped=0.5)
    box, yaw = made.robot.workspace, made.robot.home_yaw
    rotation = made.signature.observation.slice("object_rotation")
    for seed in range(10):
        step = made.reset(seed)
        assert box.contains(step.desired_goal.tolist(), 1e-6)
        assert box.contains(step.achieved_goal.tolist(), 1e-3)
        column = step.observation[rotation][:2]
        assert abs(np.sin(2 * (np.arctan2(column[1], column[0]) - yaw))) < 1e-5, "aligned but for quarter turns"
    made.close()


def test_a_robot_without_gripper_is_refused_where_one_is_needed_and_solves_the_rest(tmp_path: Path) -> None:
    bare = small_arm(tmp_path, fingers=False)
    for task in names("tasks"):
        if load("tasks", task).uses_gripper:
            with pytest.raises(PluginError, match="Small: this robot has no gripper"):
                joined(bare, task)
            continue
        made = joined(bare, task)
        assert score(made, expert_policy(made), episodes=5, seed=0).success_end >= 0.8, task
        made.close()
