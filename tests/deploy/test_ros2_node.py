"""The logic of the ROS 2 example, without ROS."""

import runpy
from pathlib import Path

import numpy as np
import pytest
from karolos_deploy import Bundle, Fault

pytestmark = pytest.mark.xdist_group("bundle")
NODE = runpy.run_path(str(Path(__file__).parents[2] / "examples" / "ros2" / "policy_node.py"))


def test_messages_become_the_actions_of_the_bundle_and_a_jump_stops_them(whole):
    sent: list[list[float]] = []
    cell = NODE["Cell"](str(whole), [0.5, 0.1, 0.15], lambda positions, _: sent.append(positions))
    logged = Bundle(whole).episode()
    joints = list(logged["positions"][0])
    cell.cycle(0.0)
    assert not sent, "nothing is known yet"
    cell.on_pose(logged["measured_object_position"][0], (0.0, 0.0, 0.0, 1.0))
    cell.on_twist((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    for count in range(50):
        mixed = [*reversed(joints if not sent else sent[-1])]
        cell.on_joints(count / 250, [*reversed(cell.names)], mixed, [0.0] * 6)
        cell.cycle(count / 250)
    assert len(sent) == 50
    at = [cell.bundle.chain.at(positions).position for positions in (joints, sent[-1])]
    assert np.linalg.norm(at[1] - logged["measured_object_position"][0]) < np.linalg.norm(
        at[0] - logged["measured_object_position"][0]
    )
    cell.on_joints(0.2, cell.names, [value + 0.5 for value in sent[-1]], [0.0] * 6)
    with pytest.raises(Fault, match="jump"):
        cell.cycle(0.2)
    assert len(sent) == 50
