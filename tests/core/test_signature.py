"""The signature of environments refuses what later code would not understand."""

import numpy as np
import pytest

from karolos.core import Discrete, Field, Layout, Signature

ONE = Layout((Field("place", 1),))
GOOD = {"observation": ONE, "action": ONE, "max_steps": 5}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"observation": 3}, "observation must be a Layout, not 3"),
        ({"achieved_goal": None}, "achieved_goal must be a Layout, not None"),
        ({"action": ("left", "right")}, r"action must be a Layout or Discrete, not \('left'"),
        ({"max_steps": 0}, "max_steps must be a positive integer, not 0"),
        ({"max_steps": 12.5}, "max_steps must be a positive integer, not 12.5"),
        ({"reward_range": None}, r"reward_range must be \(smallest, largest\), not None"),
        ({"reward_range": (0.0, -1.0)}, "reward_range must be"),
        ({"extra_reward": (np.nan, 0.0)}, "extra_reward must be"),
        ({"goal_rule": len}, "goal_rule must be a GoalRule"),
    ],
)
def test_wrong_values_are_refused_by_name(change, told):
    with pytest.raises((TypeError, ValueError), match=f"^a signature's {told}"):
        Signature(**GOOD | change)


def test_numbers_of_numpy_and_lists_are_accepted():
    Signature(ONE, Discrete(("left", "right")), np.int64(5), [-1, 0])
