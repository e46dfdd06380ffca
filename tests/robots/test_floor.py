"""Arms that strike the floor."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest

from karolos.plugins.contracts import candidate
from karolos.plugins.contracts.joined import join
from karolos.simulation.engines import Engine, installed

DEEPEST = 0.005


@pytest.mark.parametrize("engine", [name for name in get_args(Engine) if installed(name)])
@pytest.mark.parametrize("robot", ["panda", "ur5", "iiwa"])
def test_full_joint_actions_bring_no_link_deep_into_the_floor(robot: str, engine: Engine) -> None:
    environment = join(candidate("robots", robot, engine, control="joint"), candidate("tasks", "reach"))
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
    environment.close()
    assert 0.0 < depth < DEEPEST
