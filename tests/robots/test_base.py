"""Where an arm stands."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest
from support.rig import expert_episode, part

from karolos.environments.build import build_environment
from karolos.environments.robot_task import RobotTask
from karolos.simulation.engines import Engine, installed
from karolos.spec.parts import Recipe

ENGINES = [name for name in get_args(Engine) if installed(name)]
ROBOTS = ("panda", "ur5", "iiwa")


def build(robot: str, task: str, engine: str, **settings: Any) -> RobotTask:
    recipe = Recipe(
        part("environments", "robot_task", engine=engine), part("robots", robot, **settings), part("tasks", task)
    )
    made = build_environment(recipe)
    assert isinstance(made, RobotTask)
    return made


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_middle_of_the_workspace_is_above_the_origin(robot: str) -> None:
    centred, plain = (build(robot, "reach", "bullet", base=base).robot for base in ("centred", "origin"))
    assert plain.base == (0.0, 0.0, 0.0)
    assert centred.workspace.centre[:2] == pytest.approx((0, 0), abs=1e-12)
    assert centred.workspace.low[2] == plain.workspace.low[2]
    np.testing.assert_allclose(np.subtract(centred.home, plain.home), centred.base, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("task", ["reach", "push", "pick_place", "throw"])
def test_an_episode_is_that_of_an_arm_at_the_origin_moved(task: str, engine: str) -> None:
    centred, plain = (build("ur5", task, engine, base=base) for base in ("centred", "origin"))
    x, y, z = centred.robot.base
    layout = plain.signature.observation
    positions = [layout.slice(name) for name in ("tool_position", "object_position") if name in layout.names]
    for seed in range(2):
        steps, expected = expert_episode(centred, seed), expert_episode(plain, seed)
        assert len(steps) == len(expected)
        assert steps[-1].success
        assert expected[-1].success
        goals = zip(steps[0].desired_goal, expected[0].desired_goal, centred.robot.base, strict=False)
        assert all(a == pytest.approx(b + by, abs=1e-6) for a, b, by in goals)
        for a, b in zip(steps[:3], expected[:3], strict=True):
            for columns in positions:
                np.testing.assert_allclose(a.observation[columns], b.observation[columns] + (x, y, z), atol=1e-3)
    np.testing.assert_allclose(np.subtract(centred.camera.target, plain.camera.target), centred.robot.base)
    for made in (centred, plain):
        made.close()
