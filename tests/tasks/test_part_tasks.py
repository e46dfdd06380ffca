"""Parts of somebody in tasks: an expert picks an L from an STL, on three arms."""

from itertools import product

import pytest
from support.part_tasks import PickPart, with_part
from support.prisms import L, prism
from support.rig import ENGINES, ROBOTS, expert_episode


def test_an_expert_picks_an_l_with_every_arm(tmp_path, monkeypatch):
    pytest.importorskip("coacd")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    part = prism(tmp_path / "l.stl", L, 20.0)
    for engine, robot in product(ENGINES, ROBOTS):
        environment = with_part(PickPart, part, robot, engine)
        for seed in range(3 if engine == "mujoco" else 1):
            assert expert_episode(environment, seed)[-1].success, (engine, robot)
