"""A release within a control step: when the gripper opens, on both engines."""

from collections.abc import Sequence

import numpy as np
import pytest
from support.rig import ENGINES, made

from karolos.core import Array
from karolos.environments.robot_task import RobotTask


def throwing(engine: str, *, timed: bool = True, delay: float = 0.0) -> RobotTask:
    arm = {"timed_release": timed, "gripper_delay": delay}
    return made("throw", "ur5", environment={"engine": engine}, arm=arm, end_at_release=1.0)


def swing(environment: RobotTask, commands: Sequence[float]) -> Array:
    """Where the cube lands (2,) when the arm swings and the gripper is told that, one command a step, closed before."""
    environment.reset(0)
    for command in [-1.0] * 4 + [*commands] + [1.0] * 10:
        action = np.zeros(environment.signature.action.size, np.float32)
        action[0], action[-1] = 1.0, command
        step = environment.step(action)
        if step.terminated:
            return step.achieved_goal[:2]
    raise AssertionError("nothing was thrown")


@pytest.mark.parametrize("engine", ENGINES)
def test_the_gripper_opens_later_in_the_step_the_less_it_is_told_to_open(engine):
    environment = throwing(engine)
    environment.reset(0)
    held = 2 * environment.robot.opening - 1
    early, late = swing(environment, [1.0]), swing(environment, [-1.0, 1.0])
    step = late - early
    assert np.linalg.norm(step) > 0.05, "the swing is so fast that a step matters"  # m
    along = [
        float((swing(environment, [held + share * (1 - held)]) - early) @ step / (step @ step))
        for share in (0.85, 0.65, 0.45, 0.25, 0.05)  # a control step has 10 physics steps
    ]
    assert along == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9], abs=0.05)


@pytest.mark.parametrize("engine", ENGINES)
def test_an_episode_forgets_the_release_of_the_one_before(engine):
    environment = throwing(engine)
    first = swing(environment, [0.3])
    assert np.array_equal(swing(environment, [0.3]), first)


@pytest.mark.parametrize("engine", ENGINES)
def test_without_it_the_gripper_opens_at_the_beginning_of_the_step(engine):
    environment = throwing(engine, timed=False)
    assert swing(environment, [0.3]) == pytest.approx(swing(environment, [1.0]), abs=1e-3)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("later", [0.3, 1.3])
def test_a_delayed_gripper_opens_that_much_later_across_control_steps(engine, later):
    prompt, delayed = throwing(engine, timed=False), throwing(engine, timed=False, delay=later / 24)
    early, late = swing(prompt, [1.0]), swing(prompt, [-1.0, 1.0])
    along = float((swing(delayed, [1.0]) - early) @ (late - early) / ((late - early) @ (late - early)))
    assert along == pytest.approx(later, abs=0.1)
    delayed.robot.apply("gripper_delay", 0.0)  # as randomization does
    assert np.array_equal(swing(delayed, [1.0]), early)
