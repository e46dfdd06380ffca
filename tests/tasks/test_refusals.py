"""What cannot work is refused before anything is simulated, by a line that names the setting."""

import pytest
from support.rig import made, values

from karolos.errors import UsageError

CARTESIAN = {"arm": {"control": "cartesian"}}
HOLE_ERRORS = {"hole_error": 0.002, "hole_turn_error": 0.03}


@pytest.mark.parametrize(
    ("task", "how", "said"),
    [
        ("pick_place", {"object_size": 0.15}, "does not fit into the gripper"),
        ("reach", {"threshold": 0.3}, r"task\.threshold: 0\.3 m leaves no goal"),
        ("throw", CARTESIAN, r"robot\.control.*joint"),
        ("throw", {"arm": {"joint_step": 0.02}}, "joint_step"),
        ("reach_pose", CARTESIAN, r"robot\.control: these actions do not turn the tool"),
        ("reorient", CARTESIAN, r"robot\.control: these actions do not turn the tool"),
        ("insert", CARTESIAN, r"^robot\.control: these actions do not turn the tool[^\n]*$"),
        (
            "reach_pose",
            {"arm": {"control": "impedance"}, "environment": {"engine": "bullet"}},
            r"robot\.control: the engine bullet has no impedance control",
        ),
        *(
            (
                "insert",
                {"draws": {f"task.{name}": values(0.0, most + 0.001)}, **HOLE_ERRORS},
                rf"{name}: .* outside the allowed range; allowed is 0 to {most:g} ",
            )
            for name, most in HOLE_ERRORS.items()
        ),
    ],
)
def test_a_task_that_cannot_be_done_so_is_refused(task, how, said):
    with pytest.raises(UsageError, match=said):
        made(task, **how)
