"""Where an arm stands."""

import numpy as np
import pytest
from support.rig import ENGINES, ROBOTS, expert_episode, made


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_middle_of_the_workspace_is_above_the_origin(robot):
    centred, plain = (made("reach", robot, arm={"base": base}).robot for base in ("centred", "origin"))
    assert plain.base == (0.0, 0.0, 0.0)
    assert centred.workspace.centre[:2] == pytest.approx((0, 0), abs=1e-12)
    assert centred.workspace.low[2] == plain.workspace.low[2]
    np.testing.assert_allclose(np.subtract(centred.home, plain.home), centred.base, atol=1e-12)


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("task", ["reach", "push", "pick_place", "throw"])
def test_an_episode_is_that_of_an_arm_at_the_origin_moved(task, engine):
    centred, plain = (
        made(task, "ur5", environment={"engine": engine}, arm={"base": base}) for base in ("centred", "origin")
    )
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
