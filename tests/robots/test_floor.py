"""Arms that strike the floor."""

from typing import Any

import numpy as np
import pytest
from support.rig import ENGINES, ROBOTS, made

DEEPEST = 0.005


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("robot", ROBOTS)
def test_full_joint_actions_bring_no_link_deep_into_the_floor(robot, engine):
    environment = made("reach", robot, environment={"engine": engine}, arm={"control": "joint"})
    arm: Any = environment.robot
    depth = 0.0
    for seed in range(20):
        draws = np.random.default_rng(seed)
        step = environment.reset(seed)
        world: Any = environment.world
        while not step.truncated:
            step = environment.step(draws.choice([-1.0, 1.0], environment.signature.action.size))
            for link in arm.body.links().values():
                depth = max([depth, *(-contact.distance for contact in world.contacts(arm.body, world.floor, link))])
    assert 0.0 < depth < DEEPEST
