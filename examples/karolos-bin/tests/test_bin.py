"""What the example promises: found by its entry point, and a cube that is let go above the bin lies in it."""

import numpy as np

from karolos.environments.robot_task import RobotTask
from karolos.plugins.contracts import candidate, cases
from karolos.registry import find, load


def test_it_is_found_by_its_entry_point() -> None:
    assert find("tasks", "bin").distribution == "karolos-bin"


def test_a_cube_that_is_let_go_above_the_bin_lies_in_it_and_one_that_is_held_does_not() -> None:
    arm, task = load("robots", "panda"), load("tasks", "bin")
    settings = task.Settings(start_above=1.0)
    environment = RobotTask(RobotTask.Settings(substeps=20), robot=arm(arm.Settings()), task=task(settings))
    for gripper, success in ((1.0, True), (-1.0, False)):
        for seed in range(3):
            assert not environment.reset(seed).success
            for _ in range(25):
                state = environment.step(np.array([0.0, 0.0, 0.0, gripper], np.float32))
            assert state.success is success
    environment.close()


def test_it_keeps_what_every_task_promises() -> None:
    """With the Panda alone; `karolos plugins check task bin` takes minutes."""
    for case in cases(candidate("tasks", "bin"), alone=True):
        case()
