"""Measures the physics of both engines: the tables of docs/physics.md.

python docs/_scripts/physics.py bodies                    bodies without a robot, in some seconds
python docs/_scripts/physics.py robots NAME... [--expert] [--rates 240 480]
    policies that ship or of run folders, or the experts of specs, with the forces of every physics step
"""

from __future__ import annotations

import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from karolos.environments.robot_task import RobotTask
from karolos.evaluation.playing import load_expert, load_player
from karolos.evaluation.policies import Policy
from karolos.evaluation.testing import test_seeds
from karolos.records import RunFolder, shipped
from karolos.simulation.engines import ENGINES, Engine, make_world
from karolos.simulation.interface import Contact, JointLimits
from karolos.simulation.parts import Mechanism
from karolos.simulation.shapes import Cuboid, Cylinder
from karolos.specification import load_spec

GRAVITY, FRICTION, EDGE, MASS = 9.81, 0.5, 0.04, 0.1
COLOUR = (1.0, 0.0, 0.0, 1.0)
PENDULUM = """<robot name="pendulum"><link name="base"><inertial><mass value="1"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hinge" type="revolute">
<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="1" velocity="99"/></joint>
<link name="arm"><inertial><origin xyz=".5 0 0"/><mass value="2"/>
<inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link></robot>"""


def cube(world: Any, place: tuple[float, float, float] = (0.0, 0.0, EDGE / 2), **how: Any) -> Any:
    """A cube on the floor."""
    body = world.body([Cuboid((EDGE,) * 3)], how.get("mass", MASS), COLOUR)
    body.set_friction(1.0)
    body.place(place, how.get("turn", (0.0, 0.0, 0.0, 1.0)))
    return body


def lowest(body: Any) -> float:
    """Height of a cube's lowest corner in m."""
    (_, _, height), (x, y, z, w) = body.pose()
    upright = abs(2 * (x * z - w * y)) + abs(2 * (y * z + w * x)) + abs(1 - 2 * (x * x + y * y))
    return float(height - EDGE / 2 * upright)


def steps(world: Any, seconds: float) -> Iterator[None]:
    for _ in range(round(seconds / world.period)):
        world.step()
        yield


def run(world: Any, seconds: float) -> None:
    for _ in steps(world, seconds):
        pass


def sliding(world: Any, speed: float) -> dict[str, float]:
    """A cube slides until it stops: how high it hops, how long the floor carries it, and how far it gets."""
    body = cube(world)
    run(world, 0.2)
    start, rest = body.pose()[0][0], lowest(body)
    body.set_velocity((speed, 0.0, 0.0))
    heights, carried = [], []
    for _ in steps(world, 2 * speed / (FRICTION * GRAVITY)):
        heights.append(lowest(body) - rest)
        if np.linalg.norm(body.velocity()[0][:2]) > 0.01:
            carried.append(world.forces(body).get((-1, world.floor.index), 0.0) > 0)
    far = speed**2 / (2 * FRICTION * GRAVITY)
    return {
        "hop, mm": max(heights) * 1e3,
        "carried by the floor": float(np.mean(carried)),
        "distance, error": (body.pose()[0][0] - start) / far - 1,
    }


def incline(world: Any, degrees: float) -> dict[str, float]:
    """A cube on a slope: its acceleration, or how far it creeps in 1 s where friction holds it."""
    angle = np.radians(degrees)
    turn = 0.0, float(np.sin(angle / 2)), 0.0, float(np.cos(angle / 2))
    world.floor.place((0.0, 0.0, 0.0), turn)
    x, z = EDGE / 2 * np.sin(angle), EDGE / 2 * np.cos(angle)
    body = cube(world, (float(x), 0.0, float(z)), turn=turn)
    run(world, 0.5)
    start, before = np.array(body.pose()[0]), np.linalg.norm(body.velocity()[0])
    run(world, 0.5)
    wanted = GRAVITY * (np.sin(angle) - FRICTION * np.cos(angle))
    if wanted < 0:
        return {"creep in .5 s, mm": float(np.linalg.norm(np.array(body.pose()[0]) - start)) * 1e3}
    return {"acceleration, error": float((np.linalg.norm(body.velocity()[0]) - before) / 0.5 / wanted - 1)}


def rolling(world: Any, degrees: float) -> dict[str, float]:
    """A cylinder rolls down the floor, which leans: 2/3 g sin a."""
    angle = np.radians(degrees)
    turn = (0.0, float(np.sin(angle / 2)), 0.0, float(np.cos(angle / 2)))
    world.floor.place((0.0, 0.0, 0.0), turn)
    body = world.body([Cylinder(EDGE, 2 * EDGE, orientation=(0.5**0.5, 0.0, 0.0, 0.5**0.5))], MASS, COLOUR)
    body.place((EDGE * np.sin(angle), 0.0, EDGE * np.cos(angle)), turn)
    run(world, 0.25)
    before = np.linalg.norm(body.velocity()[0])
    run(world, 0.5)
    wanted = 2 / 3 * GRAVITY * np.sin(angle)
    return {"acceleration, error": float((np.linalg.norm(body.velocity()[0]) - before) / 0.5 / wanted - 1)}


def dropping(world: Any) -> dict[str, float]:
    """A cube falls .5 m: how deep it goes into the floor, and how high it comes back."""
    body = cube(world, (0.0, 0.0, EDGE / 2 + 0.5))
    heights = np.array([lowest(body) for _ in steps(world, 1.2)])
    landed = int(np.argmax(heights < 0.002))
    return {"depth, mm": -min(0.0, heights.min()) * 1e3, "rebound, mm": heights[landed:].max() * 1e3}


def stacking(world: Any) -> dict[str, float]:
    """Three cubes on each other for 10 s: how far the top one moves."""
    bodies = [cube(world, (0.0, 0.0, EDGE * (level + 0.5))) for level in range(3)]
    run(world, 10.0)
    (x, y, z), _ = bodies[-1].pose()
    return {"drift, mm": float(np.hypot(x, y)) * 1e3, "sinking, mm": (2.5 * EDGE - z) * 1e3}


def pressing(world: Any) -> dict[str, float]:
    """A cube under a weight of 10 kg: how deep it goes into the floor."""
    body = cube(world)
    weight = world.body([Cuboid((EDGE,) * 3)], 10.0, COLOUR)
    weight.place((0.0, 0.0, 1.5 * EDGE))
    run(world, 2.0)
    return {"depth, mm": -lowest(body) * 1e3}


def swinging(world: Any) -> dict[str, float]:
    """A passive pendulum released from the horizontal: its energy after 10 s, as a share of m g l."""
    body = world.load(Mechanism(ElementTree.fromstring(PENDULUM)), position=(0.0, 0.0, 3.0))
    motors = world.motors(body, ["arm"], JointLimits((-9.0,), (9.0,), (99.0,), (1e-9,)), None)
    motors.write([0.0], 0.0)
    run(world, 10.0)
    (angle,), (speed,), _ = motors.read()
    energy = (0.1 + 2 * 0.5**2) * speed**2 / 2 - 2 * GRAVITY * 0.5 * np.sin(angle)
    return {"energy, change": float(energy / (2 * GRAVITY * 0.5))}


def hole(play: float) -> list[Cuboid]:
    """Four boxes, 25 mm high, around a square of 20 mm and this play in m in all."""
    wall, height = 0.02, 0.025
    middle = 0.01 + play / 2 + wall / 2
    sides = ((middle, 0.0), (-middle, 0.0), (0.0, middle), (0.0, -middle))
    return [Cuboid((wall, 0.08, height) if x else (0.08, wall, height), position=(x, y, height / 2)) for x, y in sides]


def deepest(points: Sequence[Contact]) -> float:
    """How deep two bodies overlap, in mm."""
    return -1e3 * min((point.distance for point in points), default=0.0)


def inserting(world: Any) -> dict[str, float]:
    """A peg of 20 mm falls into a frame of four boxes with 1 mm of play: how deep, and how deep into the walls."""
    frame = world.body(hole(0.001), 0.0, COLOUR)
    peg = world.body([Cuboid((0.02, 0.02, 0.06))], MASS, COLOUR)
    peg.place((0.0003, -0.0002, 0.03 + 0.025 + 0.002))
    deep = max(deepest(world.contacts(peg, frame, -1)) for _ in steps(world, 1.0))
    return {"left above the ground, mm": (peg.pose()[0][2] - 0.03) * 1e3, "depth into walls, mm": deep}


def leaning(world: Any) -> dict[str, float]:
    """A peg of 20 mm in such a frame with .5 mm of play, which lies on its side: the peg presses on it with 25 N."""
    turn = (0.0, 0.5**0.5, 0.0, 0.5**0.5)
    frame = world.body(hole(0.0005), 0.0, COLOUR)
    frame.place((0.0, 0.0, 0.2), turn)
    peg = world.body([Cuboid((0.02, 0.02, 0.06))], 25 / GRAVITY, COLOUR)
    peg.place((0.0125, 0.0, 0.2), turn)
    run(world, 1.0)
    return {"depth, share of the play": deepest(world.contacts(peg, frame, -1)) / 0.5}


TRIALS: dict[str, tuple[Callable[..., dict[str, float]], tuple[float, ...]]] = {
    "sliding at .3 m/s": (sliding, (0.3,)),
    "sliding at 1.5 m/s": (sliding, (1.5,)),
    "slope of 25 degrees (friction .5 holds)": (incline, (25,)),
    "slope of 28 degrees": (incline, (28,)),
    "slope of 30 degrees": (incline, (30,)),
    "cylinder on a slope of 10 degrees": (rolling, (10,)),
    "fall from .5 m": (dropping, ()),
    "stack of three, 10 s": (stacking, ()),
    "pressed with 98 N": (pressing, ()),
    "pendulum, 10 s": (swinging, ()),
    "peg in a frame with 1 mm of play": (inserting, ()),
    "peg pressed with 25 N in .5 mm of play": (leaning, ()),
}


@contextmanager
def opened(engine: Engine, rate: int) -> Iterator[Any]:
    """A world with one physics step per control step."""
    world: Any = make_world(engine, substeps=1, rate=rate)
    try:
        yield world
    finally:
        world.close()


def measure(engine: Engine, trial: str, rate: int = 240) -> dict[str, float]:
    """What one trial gives in an engine."""
    function, settings = TRIALS[trial]
    with opened(engine, rate) as world:
        return function(world, *settings)


MOVING = 0.01
"""m/s from which on a cube moves."""


@contextmanager
def watched(environment: RobotTask, look: Callable[[], None]) -> Iterator[None]:
    """Call `look` after every physics step of the environment's world."""
    world: Any = environment.world
    if environment.settings.engine == "bullet":
        simulate = world.api.stepSimulation

        def simulate_and_look() -> None:
            simulate()
            look()

        world.api.stepSimulation = simulate_and_look
        yield
        world.api.stepSimulation = simulate
        return
    simulation, advance = world._simulation, world._simulation.advance

    def advance_and_look(motors: Any) -> None:
        targets = [part.targets for part in motors]
        for number in range(simulation.substeps):
            for part, rows in zip(motors, targets, strict=True):
                part.targets = rows[number : number + 1]
            simulation._arguments = None  # they hold the targets
            advance(motors)
            look()
        for part, rows in zip(motors, targets, strict=True):
            part.targets = rows
        simulation._arguments = None

    simulation.advance = advance_and_look
    yield
    simulation.advance = advance


class Watch:
    """What happens to a cube and an arm in the physics steps of an episode."""

    def __init__(self, environment: RobotTask) -> None:
        self.environment = environment
        self.reset()

    def reset(self) -> None:
        self.pad = self.into_pads = self.into_floor = self.arm_on_floor = self.joint = self.tool = 0.0
        self.moving = self.carried = self.touched = 0

    def __call__(self) -> None:
        robot: Any = self.environment.robot
        world: Any = self.environment.world
        body: Any = self.environment.task.cube.body  # type: ignore[attr-defined]
        touching = False
        for link in (*robot.body.links().values(), -1):
            points = world.contacts(robot.body, body, link)
            force = sum(point.force for point in points)
            touching |= force > 0
            if points and link in robot.motors.pads:
                self.pad = max(self.pad, force)
            if points:
                self.into_pads = max(self.into_pads, -min(point.distance for point in points))
            if link != -1:
                on_floor = sum(point.force for point in world.contacts(robot.body, world.floor, link))
                self.arm_on_floor = max(self.arm_on_floor, on_floor)
        floor = world.contacts(body, world.floor, -1)
        self.into_floor = max([self.into_floor, *(-point.distance for point in floor)])
        if np.linalg.norm(body.velocity()[0][:2]) > MOVING:
            self.moving += 1
            self.carried += sum(point.force for point in floor) > 0
            self.touched += touching
        positions, speeds, _ = robot.motors.read()
        self.joint = max(self.joint, float(np.max(np.abs(speeds) / robot.limits.velocity)))
        configuration = robot.chain.forward(positions)
        self.tool = max(self.tool, float(np.linalg.norm(robot.chain.velocity(configuration, speeds))))


def episodes(environment: RobotTask, policy: Policy, count: int, seed: int) -> dict[str, float]:
    """What `Watch` sees in test episodes: quantiles over episodes, shares of the steps in which the cube moves."""
    watch, seen, success = Watch(environment), [], []
    with watched(environment, watch):
        for number in test_seeds(seed, count):
            step = environment.reset(number)
            policy.begin()
            watch.reset()
            while not (step.terminated or step.truncated):
                step = environment.step(policy.act(step))
            success.append(step.success)
            seen.append(dict(vars(watch)))
    moving = max(sum(one["moving"] for one in seen), 1)

    def quantile(key: str, share: float) -> float:
        return float(np.quantile([one[key] for one in seen], share))

    return {
        "success": float(np.mean(success)),
        "pads or hand in the cube, mm, 99 %": 1e3 * quantile("into_pads", 0.99),
        "cube in the floor, mm, 99 %": 1e3 * quantile("into_floor", 0.99),
        "force of a pad, N, 95 %": quantile("pad", 0.95),
        "arm on the floor, N, 99 %": quantile("arm_on_floor", 0.99),
        "cube carried by the floor": sum(one["carried"] for one in seen) / moving,
        "cube touched": sum(one["touched"] for one in seen) / moving,
        "fastest joint, share of its limit, 99 %": quantile("joint", 0.99),
        "fastest tool, m/s": quantile("tool", 1.0),
    }


def played(name: str, count: int, engine: Engine, rate: int, *, expert: bool) -> dict[str, float]:
    """`episodes` of a policy that ships or of a run folder, or of the expert of a spec."""
    changes = [f"environment.engine={engine}", f"environment.physics_rate={rate}"]
    if expert:
        loading = load_expert(load_spec(name, overrides=changes))
    else:
        folder = Path(name) if Path(name).is_dir() else shipped.FOLDER / name
        loading = load_player(RunFolder.open(folder), "best", changes)
    with loading as player:
        assert isinstance(player.environment, RobotTask)
        return episodes(player.environment, player.policy, count, player.spec.testing.seed)


def table(rows: dict[tuple[str, str], dict[str, float]]) -> str:
    """A table in Markdown: a row per key and quantity, a column per second part of the keys."""
    columns = list(dict.fromkeys(column for _, column in rows))
    lines = ["| what | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for first in dict.fromkeys(first for first, _ in rows):
        quantities = dict.fromkeys(key for (name, _), found in rows.items() if name == first for key in found)
        for quantity in quantities:
            found = [rows.get((first, column), {}).get(quantity) for column in columns]
            cells = ["" if value is None else f"{value:.3g}" if abs(value) >= 5e-4 else "0" for value in found]
            lines.append(f"| {first}: {quantity} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = ArgumentParser(description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("what", choices=("bodies", "robots"))
    parser.add_argument("names", nargs="*", help="robots: specs (--expert), run folders or policies that ship")
    parser.add_argument("--expert", action="store_true", help="play the experts of specs instead of policies")
    parser.add_argument("--episodes", type=int, default=100)
    parser.add_argument("--rates", type=int, nargs="*", default=[240])
    parser.add_argument("--engines", nargs="*", default=[name for name, engine in ENGINES.items() if engine.installed])
    given = parser.parse_args()
    rows = {}
    for engine, rate in product(given.engines, given.rates):
        column = f"{engine} {rate} Hz"
        if given.what == "bodies":
            rows |= {(trial, column): measure(engine, trial, rate) for trial in TRIALS}
        for name in given.names:
            rows[name, column] = played(name, given.episodes, engine, rate, expert=given.expert)
    sys.stdout.write(table(rows) + "\n")


if __name__ == "__main__":
    main()
