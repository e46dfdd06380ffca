"""Parts of somebody in tasks: experts pick an L from an STL and open a drawer from a URDF, on three arms."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.part_tasks import DRAWER, OpenDrawer, PickPart, with_part
from support.prisms import L, prism
from support.rig import ENGINES, ROBOTS, expert_episode

from karolos.simulation.interface import Task


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize(("engine", "episodes"), [("mujoco", 3), ("bullet", 1)])
@pytest.mark.parametrize("task", [PickPart, OpenDrawer])
def test_an_expert_picks_an_l_and_opens_a_drawer(
    task: type[Task], engine: str, episodes: int, robot: str, tmp_path: Path
) -> None:
    if task is PickPart:
        pytest.importorskip("coacd")
        part = prism(tmp_path / "l.stl", L, 20.0)
    else:
        part = tmp_path / "drawer.urdf"
        part.write_text(DRAWER)
    if engine not in ENGINES:
        pytest.skip("not installed")
    environment = with_part(task, part, robot, engine)
    for seed in range(episodes):
        assert expert_episode(environment, seed)[-1].success
    environment.close()
