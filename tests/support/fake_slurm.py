"""A stand-in for sbatch, squeue, scancel and scontrol: an array's tasks are processes of this machine.

It is called by one of these names. The folder FAKE_SLURM holds one file per task: its process, and its script. A line
of the file `troubles` beside it is what the next squeue does instead: fail, or print that line. The file `cancelled`
gets the arguments of scancel.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path

STATE = Path(os.environ.get("FAKE_SLURM", "."))


def start(task: str, script: str) -> None:
    number, index = task.split("_")
    environment = os.environ | {"SLURM_ARRAY_JOB_ID": number, "SLURM_ARRAY_TASK_ID": index}
    with (STATE.parent / f"{task}.out").open("a") as out:
        process = subprocess.Popen(["bash", script], env=environment, stdout=out, stderr=out, start_new_session=True)
    written = STATE.parent / f"{task}.new"
    written.write_text(f"{process.pid} {script}")
    written.replace(STATE / task)


def is_running(task: Path) -> bool:
    try:
        stat = Path(f"/proc/{task.read_text().split()[0]}/stat").read_text()
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] != "Z"


def trouble() -> str | None:
    """The next trouble of squeue; the last one stays."""
    try:
        first, *rest = (STATE.parent / "troubles").read_text().splitlines()
    except (OSError, ValueError):
        return None
    if rest:
        (STATE.parent / "troubles").write_text("\n".join(rest))
    return first


def main(program: str, arguments: list[str]) -> None:
    if program == "sbatch":
        (last,) = (one.partition("=0-")[2] for one in arguments if one.startswith("--array"))
        number = 1 + len({path.name.split("_")[0] for path in STATE.iterdir()})
        for index in range(int(last) + 1):
            start(f"{number}_{index}", arguments[-1])
        print((STATE.parent / "banner").read_text() if (STATE.parent / "banner").exists() else number)
    elif program == "squeue" and "--version" not in arguments and (wrong := trouble()) not in (None, "fine"):
        if wrong == "fail":
            sys.exit("slurm_load_jobs error: Unable to contact slurm controller (connect failure)")
        print(wrong)
    elif program == "squeue":
        for path in STATE.iterdir():
            if "--version" not in arguments and is_running(path):
                print(f"{path.name} RUNNING")
    elif program == "scontrol":
        start(arguments[-1], (STATE / arguments[-1]).read_text().split()[1])
    elif program == "scancel":
        (STATE.parent / "cancelled").write_text(" ".join(arguments))
        for task in arguments:
            if (STATE / task).exists():
                os.kill(int((STATE / task).read_text().split()[0]), signal.SIGTERM)


if __name__ == "__main__":
    main(Path(sys.argv[0]).name, sys.argv[1:])
