"""What the example promises: files as the script writes them, a plug with one orientation, arms that seat it."""

from math import pi
from pathlib import Path

import pytest
from karolos_assembly.make_parts import parts
from karolos_assembly.seat_plug import FLOOR, PARTS, PLASTIC, PLUG, TOP
from karolos_deploy import Bundle, Executor
from karolos_deploy.drivers.simulation import Simulation

from karolos.environments.robot_task import RobotTask
from karolos.evaluation.playing import evaluate
from karolos.evaluation.policies import expert_policy
from karolos.export.bundle import export_bundle
from karolos.launchers.experiment import Experiment
from karolos.plugins.contracts import candidate, cases
from karolos.records import RunFolder
from karolos.registry import find, load
from karolos.simulation.engines import make_world
from karolos.simulation.geometry import rotation_about
from karolos.simulation.shapes import Mesh, volume_of
from karolos.specification import load_spec


def test_it_is_found_by_its_entry_point() -> None:
    assert find("tasks", "seat_plug").distribution == "karolos-assembly"


def test_the_files_are_those_that_the_script_writes() -> None:
    for name, data in parts().items():
        assert (PARTS / name).read_bytes() == data


@pytest.mark.parametrize(("turn", "height"), [(0.0, FLOOR), (pi, TOP)])
def test_the_plug_falls_into_the_jig_one_way_round(turn: float, height: float) -> None:
    world = make_world("mujoco")
    plug, jig = (
        world.body([Mesh(PARTS / "plug.stl", scale=0.001)], 0.03, (1.0, 0.5, 0.0, 1.0)),
        world.load(PARTS / "jig.urdf"),
    )
    plug.set_inertia(0.03, (1.0, 1.0, 1.0))  # it does not tip
    jig.place((0.0, 0.0, 0.0))
    plug.place((0.0, 0.0, TOP + 0.001), rotation_about((0.0, 0.0, turn)))
    for _ in range(20):
        world.step()
    assert plug.pose()[0][2] == pytest.approx(height, abs=5e-4)
    world.close()


def test_it_keeps_what_every_task_promises() -> None:
    """With the Panda alone, and the expert's promise below; `karolos plugins check task seat_plug` takes minutes."""
    for case in cases(candidate("tasks", "seat_plug"), alone=True):
        case()


@pytest.mark.parametrize("robot", ["desk_arm", "panda", "ur5", "iiwa"])
def test_the_expert_seats_the_plug_with_every_arm(robot: str) -> None:
    arm, task = load("robots", robot), load("tasks", "seat_plug")
    environment = RobotTask(RobotTask.Settings(), robot=arm(arm.Settings()), task=task(task.Settings()))
    assert evaluate(environment, expert_policy(environment), episodes=5, seed=0).success_end == 1
    environment.close()


def test_a_policy_leaves_as_a_bundle_that_moves_the_simulated_robot(tmp_path: Path) -> None:
    """Trained for a moment only. Each observation of its logged episode follows from what a robot reads."""
    smoke = Path(__file__).parents[1] / "specs" / "smoke" / "seat_plug.yaml"
    (run,) = Experiment(load_spec(smoke)).run(tmp_path / "runs").runs
    bundle = Bundle(export_bundle(RunFolder.open(run.folder), tmp_path / "bundle").folder)
    assert bundle.replay_episode() == 50
    assert bundle.contract["robot"]["payload"] == pytest.approx(PLASTIC * volume_of(PLUG)), "the hand is the arm's"
    driver = Simulation(bundle, {"clock": "simulated"})
    executor = Executor(bundle, driver, rate=125)
    executor.check()
    assert executor.run(0, steps=5).steps == 5
    driver.close()
