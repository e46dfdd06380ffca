"""How long tests/torture lasts, and the command that it tortures.

TORTURE=50 TORTURE_SEED=7 pytest -s tests/torture/test_flips.py
"""

import os
import subprocess
import sys
from typing import Any

TIMES = int(os.environ.get("TORTURE", "1"))
"""How many times as much as usual is tried."""
SEED = int(os.environ.get("TORTURE_SEED", "1"))


def karolos(*arguments: str, **how: Any) -> subprocess.Popen[Any]:
    """The command in a process of its own."""
    command = [sys.executable, "-m", "karolos_cli", *arguments]
    return subprocess.Popen(command, **{"stdout": subprocess.DEVNULL, **how})
