from __future__ import annotations

from math import cos, pi, sin

import numpy as np
import pytest

from karolos.core import Array
from karolos.robots.iiwa import Iiwa

# LBR iiwa 14 R820: d in m and alpha, standard convention; every a is 0 (.36, .42, .40, and .126 to the flange)
DENAVIT_HARTENBERG = (
    (0.36, -pi / 2),
    (0.0, pi / 2),
    (0.42, pi / 2),
    (0.0, -pi / 2),
    (0.40, -pi / 2),
    (0.0, pi / 2),
    (0.126, 0.0),
)


def flange(pose: tuple[float, ...]) -> Array:
    """The flange's frame (4, 4), straight from the table."""
    frame = np.eye(4)
    for (d, alpha), q in zip(DENAVIT_HARTENBERG, pose, strict=True):
        frame = frame @ np.array(
            [
                [cos(q), -sin(q) * cos(alpha), sin(q) * sin(alpha), 0],
                [sin(q), cos(q) * cos(alpha), -cos(q) * sin(alpha), 0],
                [0, sin(alpha), cos(alpha), d],
                [0, 0, 0, 1],
            ]
        )
    return frame


@pytest.mark.parametrize("pose", [(0.0,) * 7, Iiwa.model.home, (1.1, -0.6, 0.7, -1.2, -1.3, 1.9, 2.4)])
def test_forward_kinematics_is_that_of_the_published_table(pose: tuple[float, ...]) -> None:
    frame = flange(pose)
    tool = Iiwa(Iiwa.Settings()).chain.forward(pose).tool
    np.testing.assert_allclose(tool.position, frame[:3, 3] + 0.137 * frame[:3, 2], atol=1e-6)
    np.testing.assert_allclose(tool.z, frame[:3, 2], atol=1e-6)
