"""What domain randomization does to a cube: friction and mass act as the laws of physics say, and leave nothing."""

import numpy as np
import pytest
from support.rig import ENGINES, expert_episode, made, part, values

from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError
from karolos.simulation.interface import FLOOR_FRICTION, GRAVITY

SPEED = 1.0


def slide(engine: str, drawn: dict[str, float]) -> float:
    """How far in m the cube slides when it is let go at 1 m/s, away from the arm."""
    draws = {f"task.{name}": values(value) for name, value in drawn.items()}
    environment = made("push", draws=draws, environment={"engine": engine})
    environment.reset(0)
    cube = environment.task.cube
    cube.place((-0.6, 0.0, cube.half))
    cube.body.set_velocity((0.0, SPEED, 0.0))
    for _ in range(40):
        environment.step(np.zeros(3))
    assert np.linalg.norm(cube.velocity) < 1e-3
    assert abs(cube.position[0] + 0.6) < 0.02
    return cube.position[1]


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(
    ("drawn", "friction"),
    [
        ({}, FLOOR_FRICTION),
        ({"object_friction": 0.5}, 0.5 * FLOOR_FRICTION),
        ({"floor_friction": 0.3}, 0.3),
        ({"object_friction": 0.6, "floor_friction": 0.6}, 0.36),
        ({"gravity": -4.0}, FLOOR_FRICTION * 4.0 / -GRAVITY),
        ({"object_mass": 2.0}, FLOOR_FRICTION),
    ],
)
def test_a_cube_slides_as_far_as_coulombs_law_says(engine, drawn, friction):
    far = SPEED**2 / (2 * friction * -GRAVITY)
    assert slide(engine, drawn) == pytest.approx(far, rel=0.01 if engine == "mujoco" else 0.12)


def shoulder_torque(mass: float) -> tuple[float, float]:
    """What the Panda's second joint needs to hold a cube of this mass in kg, in N m; how far away the cube is, in m."""
    environment = made("pick_place", draws={"task.object_mass": values(mass)}, start_grasped=1.0)
    environment.reset(2)
    for step in range(30):
        environment.step(np.array([0.0, 0.0, 0.5 if step < 8 else 0.0, -1.0]))
    cube, robot = environment.task.cube, environment.robot
    assert robot.pads_touching(cube.body) == 2
    assert cube.lowest > 0.05, "it is held in the air"
    torque = robot.body.joints([1])[0][3]
    x, y, _ = cube.position
    return torque, float(np.hypot(x, y))


def test_a_heavier_cube_needs_as_much_more_torque_as_its_weight_and_distance():
    (light, distance), (heavy, _) = shoulder_torque(0.1), shoulder_torque(0.6)
    assert abs(heavy - light) == pytest.approx(0.5 * -GRAVITY * distance, rel=0.25)


def test_what_one_episode_drew_does_not_reach_the_next():
    draws = {
        "task.object_mass": part("distributions", "log_uniform", low=0.02, high=1.0),
        "task.object_friction": part("distributions", "uniform", low=0.1, high=2.0),
        "task.floor_friction": part("distributions", "uniform", low=0.1, high=1.0),
        "robot.link_mass": part("distributions", "uniform", low=0.8, high=1.2),
    }
    used, fresh = made("pick_place", draws=draws), made("pick_place", draws=draws)
    drawn = []
    for seed in range(3):
        expert_episode(used, seed)
        drawn.append(used.parameters())
    assert len({values.tobytes() for values in drawn}) == 3
    for one, other in zip(expert_episode(used, 9), expert_episode(fresh, 9), strict=True):
        for ours, theirs in zip(one, other, strict=True):
            np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(used.parameters(), fresh.parameters())


@pytest.mark.parametrize("task", ["pick_place", "push"])
@pytest.mark.parametrize("place", [(0.5, 0.0, -1.0), (0.0, 12.0, 0.02), (float("nan"), 0.0, 0.0)])
def test_a_cube_that_is_lost_ends_the_episode_as_truncated_and_diverged(task, place):
    environment: RobotTask = made(task)
    start = environment.reset(1)
    still = np.zeros(environment.signature.action.size)
    assert environment.step(still).reward == -1
    cube = environment.task.cube
    if not place[2] > 0:
        cube.body.pose = lambda: (place, (0.0, 0.0, 0.0, 1.0))  # what an engine gives after it has blown up
    else:
        cube.body.place(place)
    step = environment.step(still)
    assert step.truncated
    assert step.diverged
    assert step.reward == 0, "the reward of the step before is not counted twice"
    assert not step.terminated
    assert not step.success
    assert all(np.isfinite(part).all() for part in step)
    with pytest.raises(RuntimeError, match="over"):
        environment.step(still)
    np.testing.assert_array_equal(environment.reset(1).observation, start.observation)
    assert environment.divergences == 1


def test_a_softer_cube_is_refused_where_the_engine_has_one_stiffness():
    if "bullet" in ENGINES:
        with pytest.raises(UsageError, match=r"task.object_stiffness: the engine bullet has no stiffness"):
            made("push", environment={"engine": "bullet"}, object_stiffness=1e5)
    depths = []
    for stiffness in (1e4, 1e6):
        environment = made("push", object_stiffness=stiffness)
        environment.reset(0)
        for _ in range(5):
            environment.step(np.zeros(3))
        depths.append(-environment.task.cube.lowest)
    # four corners, each a spring in a row with the floor's 4e6 N/m
    assert depths[0] == pytest.approx(0.1 * -GRAVITY / 4 * (1 / 1e4 + 1 / 4e6), rel=0.05)
    assert depths[1] < depths[0] / 50
