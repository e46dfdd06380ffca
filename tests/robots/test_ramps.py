"""Ramps of joint speeds near the end of a range."""

import numpy as np
import pytest

from karolos.robots.ramps import Ramps
from karolos.simulation.interface import JointLimits


@pytest.mark.parametrize("share", [1.0, 0.5, 0.25, 0.1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_joint_that_brakes_slowly_stops_inside_its_range(share, sign):
    speed, period = 2.0, 1 / 24
    ramps = Ramps(JointLimits((-1.5,), (1.5,), (speed,), (50.0,), ("joint",)), period, (24 * speed * share,))
    for room in np.linspace(0.05, 2.0, 40):  # it begins to brake at other speeds, elsewhere in a control step
        at, velocity = sign * (1.5 - room), 0.0
        ramps.reset([at])
        for _ in range(120):
            (end,) = ramps.ramp([at], [velocity], [sign * speed * period])
            assert abs(end - velocity) <= 24 * speed * share * period + 1e-9
            at, velocity = at + (velocity + end) / 2 * period, end
            assert sign * at < 1.5 or (sign * velocity < 0.02 * speed and sign * at < 1.506), "it meets no hard stop"
        assert sign * at > 1.499
