"""How hard insertion is: two simple programs, the expert and the policy that ships, over the play of the hole.

python docs/_scripts/insertion.py   play them and write the table of docs/insert.md
"""

from __future__ import annotations

from collections.abc import Iterator
from math import hypot
from pathlib import Path
from typing import cast

import numpy as np

from karolos.core import Expert, FloatArray
from karolos.environments.robot_task import RobotTask
from karolos.evaluation.playing import play
from karolos.evaluation.policies import Policy, environment_of, expert_policy, load_agent
from karolos.records import RunFolder, shipped
from karolos.simulation.geometry import multiply, rotated, rotation_about
from karolos.specification import load_spec
from karolos.tasks.insert import OVER, STRAIGHT, Insert

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "insert.md"
BEGIN, END = "<!-- written by docs/_scripts/insertion.py -->", "<!-- end -->"
SHIPPED = "panda_insert"
EPISODES, SEED = 200, 7
HOLES = {
    ".5 mm": (),
    ".2 mm": ("task.play=0.0002",),
    ".1 mm": ("task.play=0.0001",),
    ".2 mm, known to 2 mm, 2 degrees": ("task.play=0.0002", "task.hole_error=0.002", "task.hole_turn_error=0.035"),
}
SINK, ABOVE = 0.02, 0.004
"""m/s downwards; m of the tip above the mouth on the way to the hole."""


class Down(Expert):
    """Goes over the hole as it is known, `aligned` with the peg turned as the hole is, and then straight down."""

    def __init__(self, environment: RobotTask, *, aligned: bool) -> None:
        self._robot, self._task, self._aligned = environment.robot, environment.task, aligned
        self.reset()

    def reset(self) -> None:
        self._sinks = False

    def act(self) -> FloatArray:
        robot, task = self._robot, self._task
        assert isinstance(task, Insert)
        x, y, z = task.tip_from_hole
        turn = task.turn if self._aligned and not self._sinks else (0.0, 0.0, 0.0)
        self._sinks = self._sinks or (hypot(x, y) < OVER and hypot(*turn) < STRAIGHT)
        tip = np.array(task.tip) + ((0, 0, -SINK * robot.period) if self._sinks else (-x, -y, max(ABOVE - z, 0.0)))
        rotation = rotation_about(turn)
        arm = np.subtract(task.tip, robot.tool.position).tolist()
        place = tip - rotated(rotation, arm)
        return robot.towards(tuple(place.tolist()), 0.0, multiply(rotation, robot.tool.orientation))


def policies(environment: RobotTask) -> Iterator[tuple[str, Policy | None]]:
    """Each way to insert, with its name."""
    for name, expert in (
        ("straight down", Down(environment, aligned=False)),
        ("aligned, then down", Down(environment, aligned=True)),
    ):
        yield name, Policy(lambda _, expert=expert: np.asarray(expert.act(), np.float32), expert.reset)
    yield "expert", expert_policy(environment)
    saved = load_agent(RunFolder.open(shipped.FOLDER / SHIPPED))
    fits = saved.signature.observation.size == environment.signature.observation.size
    yield "learned (`panda_insert`)", saved.policy() if fits else None


def cell(environment: RobotTask, policy: Policy | None) -> str:
    """Success and the force that .99 of the episodes do not exceed."""
    if policy is None:
        return ""
    force = [measure.name for measure in environment.signature.measures].index("insertion_force")
    ends = [
        (moment.success, environment.measures()[force])
        for moment in play(environment, policy, episodes=EPISODES, seed=SEED)
        if moment.over
    ]
    successes, forces = np.array(ends).T
    return f"{successes.mean():.3f}, {np.nanquantile(forces, 0.99):.0f} N"


def table() -> str:
    rows = []
    for hole, overrides in HOLES.items():
        spec = load_spec(ROOT / "specs" / f"{SHIPPED}.yaml", overrides)
        environment = cast("RobotTask", environment_of(spec))
        found = {name: cell(environment, policy) for name, policy in policies(environment)}
        environment.close()
        rows.append([hole, *found.values()])
    head = ["play", *found]
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, ["---"] * len(head), *rows))


if __name__ == "__main__":
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(BEGIN)
    PAGE.write_text(f"{before}{BEGIN}\n{table()}\n{END}{rest.partition(END)[2]}", encoding="utf-8")
