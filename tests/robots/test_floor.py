"""Arms that strike the floor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from support.rig import made

DEEPEST = 0.005


@pytest.mark.parametrize("robot", ["panda", "ur5", "iiwa"])
def test_full_joint_actions_bring_no_link_deep_into_the_floor(robot: str) -> None:
    environment = made("reach", robot, control="joint")
    arm: Any = environment.robot
    depth = 0.0
    for seed in range(20):
        draws = np.random.default_rng(seed)
        step = environment.reset(seed)
        world = environment.world
        while not step.truncated:
            step = environment.step(draws.choice([-1.0, 1.0], environment.signature.action.size))
            points = world.api.getContactPoints(arm.body.index, world.floor.index, physicsClientId=world.client)
            depth = max([depth, *(-point[8] for point in points)])
    environment.close()
    assert 0.0 < depth < DEEPEST
