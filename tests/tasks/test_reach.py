import numpy as np
import pytest
from support.rig import made


@pytest.mark.parametrize(("goals", "edges"), [("box", (0.3, 0.3, 0.3)), ("workspace", (0.4, 0.5, 0.385))])
def test_goals_fill_their_box_in_the_middle_of_the_workspace(goals, edges):
    environment = made("reach", goals=goals)
    drawn = np.array([environment.reset(seed).desired_goal for seed in range(400)])
    centre = environment.robot.workspace.centre
    for axis, edge in enumerate(edges):
        low, high = centre[axis] - edge / 2, centre[axis] + edge / 2
        assert low - 1e-6 <= drawn[:, axis].min() < low + 0.05 * edge
        assert high - 0.05 * edge < drawn[:, axis].max() <= high + 1e-6


def test_marker_stands_at_the_goal():
    environment = made("reach")
    environment.reset(0)
    without = environment.render(80, 60).astype(int)
    environment.world._markers[0][0].place((0.0, 0.0, -50.0))
    assert np.abs(environment.render(80, 60) - without).max() > 20
