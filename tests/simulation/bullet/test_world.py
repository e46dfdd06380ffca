from __future__ import annotations

import subprocess
import sys


def test_robots_and_tasks_are_described_without_pybullet_and_torch() -> None:
    code = (
        "import sys\n"
        "from karolos.environments.robot_task import RobotTask\n"
        "from karolos.robots.panda import Panda\n"
        "from karolos.tasks.reach import Reach\n"
        "make = lambda kind: kind.Settings.model_validate({})\n"
        "made = RobotTask(make(RobotTask), robot=Panda(make(Panda)), task=Reach(make(Reach)))\n"
        "assert made.signature.action.size == 3\n"
        "assert not {'pybullet', 'torch'} & set(sys.modules), 'heavy'\n"
        "made.reset(0)\n"
        "assert 'torch' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout == done.stderr == "", "pybullet's greeting must not reach the user"
