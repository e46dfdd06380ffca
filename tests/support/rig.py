"""Robots with tasks and worlds, which the end of a test closes; installed engines; an episode of an expert."""

from typing import Any

from karolos.core import Environment, Step
from karolos.environments.build import build_environment
from karolos.environments.robot_task import RobotTask
from karolos.registry import load
from karolos.simulation.engines import ENGINES as KNOWN
from karolos.simulation.engines import Engine, make_world
from karolos.simulation.geometry import UPRIGHT, Quaternion, Vector
from karolos.simulation.shapes import Cuboid
from karolos.specification.parts import Part, Recipe
from support.closing import opened

ENGINES = [name for name, engine in KNOWN.items() if engine.installed]
ROBOTS = ("panda", "ur5", "iiwa")


def part(kind: str, name: str, **settings: Any) -> Part:
    return Part(kind, name, load(kind, name).Settings.model_validate(settings))


def recipe(
    task: str,
    robot: str = "panda",
    *,
    draws: dict[str, Part] | None = None,
    environment: dict[str, Any] | None = None,
    arm: dict[str, Any] | None = None,
    **settings: Any,
) -> Recipe:
    """A robot with a task.

    Args:
        task: its name.
        robot: its name.
        draws: distributions by parameter.
        environment: settings of the environment.
        arm: settings of the robot.
        settings: of the task.
    """
    return Recipe(
        part("environments", "robot_task", **(environment or {})),
        part("robots", robot, **(arm or {})),
        part("tasks", task, **settings),
        tuple(sorted((draws or {}).items())),
    )


def built(recipe: Recipe) -> Environment:
    """Its environment."""
    return opened(build_environment(recipe))


def made(task: str, robot: str = "panda", **how: Any) -> RobotTask:
    """The environment of `recipe`."""
    environment = built(recipe(task, robot, **how))
    assert isinstance(environment, RobotTask)
    return environment


def world(engine: Engine, **how: Any) -> Any:
    """An empty world."""
    return opened(make_world(engine, **how))


def run(world: Any, steps: int) -> None:
    """Simulate control steps."""
    for _ in range(steps):
        world.step()


def box(world: Any, place: Vector, edge: float = 0.04, mass: float = 0.1, turn: Quaternion = UPRIGHT) -> Any:
    """A red cube at this place."""
    body = world.body([Cuboid((edge, edge, edge))], mass, (1.0, 0.0, 0.0, 1.0))
    body.place(place, turn)
    return body


def values(*listed: float) -> Part:
    """One of these values, each equally likely."""
    return part("distributions", "choice", values=listed)


def expert_episode(environment: RobotTask, seed: int) -> list[Step]:
    steps = [environment.reset(seed)]
    expert = environment.expert()
    expert.reset()
    while not (steps[-1].terminated or steps[-1].truncated):
        steps.append(environment.step(expert.act()))
    return steps
