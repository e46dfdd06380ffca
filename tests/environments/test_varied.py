from typing import Any

import numpy as np
import pytest
from support.rig import ENGINES, built, part, recipe, values

from karolos.core import Environment
from karolos.environments.build import VariedRobotTask
from karolos.environments.robot_task import RobotTask
from karolos.errors import UsageError
from karolos.specification.parts import Part

SIZES = (0.04, 0.045, 0.05)


def build(drawn: dict[str, Part], task: str = "push", **how: Any) -> Environment:
    return built(recipe(task, "ur5", draws=drawn, **how))


def test_each_value_is_drawn_recorded_and_follows_from_the_seed():
    made = build({"task.object_size": values(*SIZES), "task.object_mass": values(0.2)})
    assert isinstance(made, VariedRobotTask)
    assert made.signature.parameters.names == ("task.object_mass", "task.object_size")
    seen = {}
    for seed in range(12):
        lowest = made.reset(seed).achieved_goal[2]
        mass, size = made.parameters()
        assert mass == np.float32(0.2)
        assert lowest == pytest.approx(size / 2)  # the height of its centre
        seen[seed] = size
    assert set(seen.values()) == {np.float32(size) for size in SIZES}
    for seed in reversed(range(12)):
        made.reset(seed)
        assert made.parameters()[1] == seen[seed]


@pytest.mark.parametrize("engine", ENGINES)
def test_an_episode_is_that_of_the_environment_with_this_setting(engine):
    made = build({"robot.finger_opening": values(0.0, 0.5)}, environment={"engine": engine})
    alone = {
        opening: build({}, environment={"engine": engine}, arm={"finger_opening": opening}) for opening in (0.0, 0.5)
    }
    assert all(isinstance(one, RobotTask) for one in alone.values())
    generator = np.random.default_rng(0)
    drawn = set()
    for seed in (*range(6), 0):
        steps = [made.reset(seed)]
        opening = float(made.parameters()[0])
        drawn.add(opening)
        expected = [alone[opening].reset(seed)]
        for action in generator.uniform(-1, 1, (5, 3)).astype(np.float32):
            steps.append(made.step(action))
            expected.append(alone[opening].step(action))
        for one, other in zip(steps, expected, strict=True):
            np.testing.assert_array_equal(one.observation, other.observation)
    assert drawn == {0.0, 0.5}


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize(("opening", "pushed"), [(0.0, False), (0.5, True)])
def test_open_fingers_reach_further(engine, opening, *, pushed):
    made = build({}, environment={"engine": engine}, arm={"finger_opening": opening})
    assert isinstance(made, RobotTask)
    made.reset(0)
    robot, cube = made.robot, made.task.cube  # type: ignore[attr-defined]
    x, y = 0.5, 0.0
    # from the tool's centre along y: the closed fingers end at .6 cm, these open ones at 2.7, the cube begins at 2.2
    cube.place_with_tool(robot, (x, y + 0.042, cube.half), (x, y, robot.workspace.low[2] + 0.004), 0.0)
    for _ in range(3):
        made.step(np.zeros(3, np.float32))
    moved = abs(cube.position[1] - (y + 0.042)) > 0.002
    assert moved == pushed


def test_the_expert_is_that_of_the_episode():
    made = build({"task.object_size": values(0.04, 0.05)})
    assert isinstance(made, VariedRobotTask)
    successes = 0
    for seed in range(6):
        state, expert = made.reset(seed), made.expert()
        expert.reset()
        while not (state.terminated or state.truncated):
            state = made.step(np.asarray(expert.act(), np.float32))
        successes += bool(state.success)
    assert successes >= 5


def test_a_parameter_that_is_a_setting_too_needs_no_other_world():
    made = build({"task.start_near": values(0.0, 1.0)})
    assert isinstance(made, RobotTask)
    recorded = set()
    for seed in range(12):
        made.reset(seed)
        recorded |= set(made.parameters().tolist())
    assert recorded == {0.0, 1.0}, "whether the episode began there, not how probable that was"


@pytest.mark.parametrize(
    ("drawn", "message"),
    [
        (
            {"task.object_size": part("distributions", "uniform", low=0.03, high=0.05)},
            r"randomization\.task\.object_size: .* cannot be sampled by 'uniform'; list values",
        ),
        ({"robot.finger_opening": values(0, 2)}, r"robot\.finger_opening cannot be 2: .* less than or equal to 1"),
        (
            {"task.max_steps": values(10, 20), "robot.finger_opening": values(0, 0.5)},
            r"randomization\.task\.max_steps: .* another length",
        ),
        ({"task.threshold": values(0.03, 0.05)}, "another rule of reward and success"),
        (
            {"task.object_size": values(*np.linspace(0.03, 0.05, 33).tolist())},
            "these values make 33 worlds; at most 32",
        ),
        ({"task.object_colour": values(1)}, "no parameter is called 'task.object_colour'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(drawn, message):
    with pytest.raises(UsageError, match=message):
        build(drawn)


def test_fingers_that_the_task_moves_cannot_be_held_open():
    with pytest.raises(UsageError, match=r"robot\.finger_opening: the task moves the gripper"):
        build({}, task="pick_place", arm={"finger_opening": 0.5})
