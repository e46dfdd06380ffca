from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest

from karolos.core import Array
from karolos.robots.ur5 import UR5

# Universal Robots: d, a in m and alpha, standard convention
DENAVIT_HARTENBERG = (
    (0.089159, 0.0, pi / 2),
    (0.0, -0.425, 0.0),
    (0.0, -0.39225, 0.0),
    (0.10915, 0.0, pi / 2),
    (0.09465, 0.0, -pi / 2),
    (0.0823, 0.0, 0.0),
)
TURNED = np.diag([-1.0, -1.0, 1.0, 1.0])
"""The URDF's base is that of the table turned by pi about z, as in ur_description."""


def flange(pose: tuple[float, ...]) -> Array:
    """The flange's frame (4, 4), straight from the table."""
    frame = TURNED
    for (d, a, alpha), q in zip(DENAVIT_HARTENBERG, pose, strict=True):
        frame = frame @ np.array(
            [
                [cos(q), -sin(q) * cos(alpha), sin(q) * sin(alpha), a * cos(q)],
                [sin(q), cos(q) * cos(alpha), -cos(q) * sin(alpha), a * sin(q)],
                [0, sin(alpha), cos(alpha), d],
                [0, 0, 0, 1],
            ]
        )
    return frame


@pytest.mark.parametrize("pose", [(0.0,) * 6, UR5.model.home, (1.1, -0.6, 0.7, -2.2, -1.3, 1.9)])
def test_forward_kinematics_is_that_of_the_published_table(pose: tuple[float, ...]) -> None:
    frame = flange(pose)
    tool = UR5(UR5.Settings()).chain.forward(pose).tool
    np.testing.assert_allclose(tool.position, frame[:3, 3] + 0.137 * frame[:3, 2], atol=1e-6)
    np.testing.assert_allclose(tool.z, frame[:3, 2], atol=1e-6)
