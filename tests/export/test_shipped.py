"""Policies that ship are those of reference runs, and are policies in every command."""

import json
import runpy
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from karolos_cli.main import app
from support.commands import call

import karolos
from karolos.core.seeding import SeedTree
from karolos.environments.build import engine_of
from karolos.evaluation.changed_spec import changed_spec
from karolos.evaluation.playing import load_player
from karolos.evaluation.policies import load_agent, signature_of
from karolos.evaluation.testing import play_episodes
from karolos.evaluation.testing import test_seeds as episode_seeds
from karolos.evaluation.zero_shot import zero_shot_test
from karolos.experiment.start_from import apply, find, pinned
from karolos.export import NumpyPolicy
from karolos.records import RunFolder
from karolos.records.evaluation import Evaluation
from karolos.records.shipped import FOLDER, POLICY, shipped_names
from karolos.simulation.engines import ENGINES
from karolos.specification import spec_from_dict
from karolos.training.assembly import make_agent, make_orchestrator

REFERENCES = runpy.run_path(str(Path(__file__).parents[2] / "docs" / "_scripts" / "references.py"))


def test_a_policy_ships_for_every_pair_of_robot_and_task_and_some_others():
    alone = ("reach", "reach_pose", "push", "pick", "throw", "insert", "stack", "slide", "open", "reorient")
    learned = (*alone, "stack_demos", "slide_demos", "reorient_demos")
    pairs = product(("panda", "ur5", "iiwa"), learned)
    others = ("ur5_pick_cell", "ur5_insert_cell")
    assert {*(f"{robot}_{task}" for robot, task in pairs), *others} == set(shipped_names())


@pytest.mark.parametrize("name", shipped_names())
def test_a_run_that_ships_is_of_its_spec_and_its_policy_acts_as_its_agent_did_and_succeeds_as_it_did(name):
    folder = RunFolder.open(FOLDER / name)
    assert list(REFERENCES["faults"](folder)) == []
    saved = load_agent(folder)
    assert (saved.checkpoint, saved.sha256) == ("last", folder.final()["last"].sha256)
    golden = np.load(folder.path / "golden.npz")
    for act in (NumpyPolicy(folder.path / POLICY), saved.act):
        assert np.abs(act(golden["observation"], golden["desired_goal"]) - golden["action"]).max() < 1e-4
    few = ("orchestrator.processes=0", "orchestrator.environments=1")  # building worlds takes longer than episodes
    spec = changed_spec(saved.spec, few, trained=saved.signature)
    with make_orchestrator(spec, randomize=False) as environments:
        done = play_episodes(environments, saved.agent, episode_seeds(spec.testing.final_seed, 4), steps=0, seconds=0)
    last = Evaluation.joined([folder.final()["last"]], 4)
    # its input is normalised with other last bits, and a throw at the edge of its target may miss then
    assert 4 * done.success_end >= 4 * last.success_end - 1.01


@pytest.mark.parametrize("missing", [False, True])
def test_a_policy_keeps_the_engine_of_its_run_and_one_line_says_so_where_it_plays_in_another(missing, monkeypatch):
    folder = RunFolder.open(FOLDER / "panda_reach")
    own = folder.spec()["environment"]["engine"]
    other = "mujoco" if own == "bullet" else "bullet"
    changed = [f"environment.engine={other}"]
    if missing:
        monkeypatch.setitem(ENGINES, own, ENGINES[own]._replace(module="a_module_that_nobody_has"))
    elif not all(engine.installed for engine in ENGINES.values()):
        pytest.skip("one engine is installed")
    told: list[str] = []
    done = zero_shot_test(folder, [] if missing else changed, episodes=2, on_warning=told.append)
    assert done.overrides == tuple(changed)
    assert done.own.success_end == done.success_end == 1.0
    with load_player(folder, overrides=[] if missing else changed) as player:
        assert told == [player.note]
    assert told[0].startswith(f"the policy learned in the engine {own}")
    assert ("not installed" in told[0], told[0].endswith(other)) == (missing, True)
    assert engine_of(load_agent(folder).spec.environment) == ENGINES[own], "the saved policy names its own engine"
    if not missing:
        with load_player(folder) as player:
            assert (player.note, engine_of(player.spec.environment)) == (None, ENGINES[own])
    assert not (folder.path / "transfers.jsonl").exists()


EXPERT = ("test", "karolos:panda_reach", "--expert", "--episodes", "2", "--json")
TEST = ("test", "panda_reach", "robot=ur5", "--episodes", "4", "--json")


@pytest.mark.parametrize(
    "command", [EXPERT, TEST, ("export", "panda_reach", "--json"), ("compare", "panda_reach", "ur5_reach", "--json")]
)
def test_a_policy_that_ships_is_a_policy_in_every_command(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, out, err = call(app, *command)
    assert code == 0, err
    rows = [json.loads(line) for line in out.splitlines()]
    if command[0] == "test":
        assert rows[0]["success_end"] >= 0.75
    else:
        assert rows[0].get("checkpoint", "last") == "last"
        assert [row["label"] for row in rows if "label" in row] in ([], ["panda_reach", "ur5_reach"])
    kept = {"export": ["panda_reach"], "test": ["runs"] if command == TEST else []}  # `test` in runs/shipped
    assert [path.name for path in tmp_path.iterdir()] == kept.get(command[0], [])
    assert karolos.load("panda_reach").steps == RunFolder.open(FOLDER / "panda_reach").state().steps


def test_a_run_starts_from_a_policy_that_ships(tmp_path):
    resolved = RunFolder.open(FOLDER / "panda_reach").spec()
    spec = spec_from_dict(resolved, ["agent.start_from=panda_reach", "training.steps=32"])
    start = find(spec, tmp_path)
    assert start is not None
    assert pinned(spec, tmp_path).agent.settings.start_sha256 == start.sha256
    agent = make_agent(spec, signature_of(spec), SeedTree(1))
    apply(start, agent)
    golden = np.load(FOLDER / "panda_reach" / "golden.npz")
    acted = agent.act(golden["observation"], golden["desired_goal"], explore=False)
    assert np.abs(acted - golden["action"]).max() < 1e-4
