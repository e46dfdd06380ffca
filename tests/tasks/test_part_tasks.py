"""Parts of somebody in tasks: experts pick an L from an STL and open a drawer from a URDF, on three arms."""

from __future__ import annotations

from pathlib import Path

import pytest
from support.part_tasks import DRAWER, OpenDrawer, PickPart, with_part
from support.prisms import L, prism
from support.rig import ENGINES, ROBOTS, expert_episode

from karolos.simulation.interface import Task


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("task", [PickPart, OpenDrawer])
def test_experts_pick_an_l_and_open_a_drawer_with_every_arm(
    task: type[Task], engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    if task is PickPart:
        pytest.importorskip("coacd")
        part = prism(tmp_path / "l.stl", L, 20.0)
    else:
        part = tmp_path / "drawer.urdf"
        part.write_text(DRAWER)
    for robot in ROBOTS:
        environment = with_part(task, part, robot, engine)
        for seed in range(3 if engine == "mujoco" else 1):
            assert expert_episode(environment, seed)[-1].success, robot
        environment.close()
