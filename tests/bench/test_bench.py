"""Each benchmark at toy size: its rows, and what it refuses."""

import json
import multiprocessing
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
import yaml

from bench import experts
from bench.__main__ import main
from bench.peer import PEERS
from karolos.agents.device import uses_bfloat16
from karolos.errors import MachineError, UsageError
from karolos.evaluation.testing import test_seeds as episode_seeds
from karolos.experiment.check import check_parts
from karolos.plugins.inspection import pair
from karolos.simulation.engines import BULLET
from karolos.specification import load_spec

ROOT = Path(__file__).parents[2]
COLUMNS = ["benchmark", "case", "value", "unit", "peer", "peer_value", "ratio", "ratio_min", "ratio_max"]


def rows_of(capfd: pytest.CaptureFixture[str], *arguments: str) -> list[dict]:
    with pytest.raises(SystemExit) as end:
        main([*arguments, "--json"])
    out, err = capfd.readouterr()
    assert end.value.code == 0, err
    rows = [json.loads(line) for line in out.splitlines()]
    assert all(list(row)[:9] == COLUMNS and row["benchmark"] == arguments[0] for row in rows)
    assert all(row["value"] > 0 for row in rows)
    return rows


def test_each_precision_has_a_row_with_sampling_and_one_without(capfd):
    rows = rows_of(capfd, "updates", "--only", "sac", "--seconds", "0.1")
    assert [row["case"] for row in rows] == [
        f"sac {precision}{what}, 1 thread"
        for precision in ("float32", "bfloat16")[: 1 + uses_bfloat16("auto", "cpu")]
        for what in ("", ", learning alone")
    ]
    assert {row["unit"] for row in rows} == {"updates/s"}


@pytest.mark.usefixtures("real_processes")
def test_what_libraries_print_does_not_reach_standard_output():
    command = [sys.executable, "-m", "bench", "environment", "--control", "joint", "--seconds", "0.1"]
    command += ["--engine", BULLET.or_another().name]  # PyBullet prints when it is imported
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    assert done.stdout.startswith("benchmark    case")
    assert len(done.stdout.splitlines()) == 4


def test_time_and_memory_of_both_replay_buffers_are_measured(capfd):
    rows = {row["case"]: row for row in rows_of(capfd, "buffers", "--transitions", "20000", "--seconds", "0.1")}
    laid_out = rows["rows of 20,000 transitions as laid out"]
    assert laid_out["value"] == pytest.approx(20_000 * 67 * 4 / 1e9, rel=0.2), "pick-and-place takes some 67 numbers"
    for name in ("uniform", "priority"):
        memory = rows[f"{name}, memory of 20,000 transitions"]["value"]
        assert laid_out["value"] < memory < 1.5 * laid_out["value"], "priorities, episodes and goals come on top"
    assert {case: row["unit"] for case, row in rows.items() if "memory" not in case and row is not laid_out} == {
        "uniform, batch of 256 with hindsight": "ms",
        "uniform, adding 1,000 transitions of 16 environments": "ms",
        "priority, batch of 256 with hindsight, priorities updated": "ms",
        "priority, adding 1,000 transitions of 16 environments": "ms",
    }


def test_steps_stand_beside_their_physics_and_randomization_beside_none(capfd):
    rows = rows_of(capfd, "environment", "--seconds", "0.1")
    ends = ("", " reset", " randomized episode")
    assert [row["case"] for row in rows] == [
        f"panda reach {mode}{end}" for mode in ("joint", "cartesian") for end in ends
    ]
    for row in rows[::3]:
        assert row["peer"] == "bare physics loop"
        assert 0.1 < row["ratio_min"] <= row["ratio"] <= row["ratio_max"] < 1, "physics is a part of a step"


def test_resets_steps_and_waiting_environments_are_measured(capfd):
    toy = "--resets 10 --more-resets 20 --repeats 1 --seconds 0.02 --threads 1 --environments 1"
    rows = rows_of(capfd, "orchestrator", *toy.split())
    assert {row["unit"] for row in rows} == {"s", "steps/s", "us/step"}
    assert {row["peer"] for row in rows} >= {"gymnasium AsyncVectorEnv", "gymnasium SyncVectorEnv", "1 thread"}
    for word in ("10 resets", "20 resets", "lockstep", "asynchronous", "waiting environment", "parent's CPU time"):
        assert any(word in row["case"] for row in rows), word


@pytest.fixture
def forked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes fork from the server of workers, which has imported what they need."""
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload([])
    monkeypatch.setattr(multiprocessing, "get_context", lambda _: server)


@pytest.mark.usefixtures("forked")
def test_the_store_is_rebuilt_asked_and_written_to(capfd, monkeypatch):
    monkeypatch.delenv("KAROLOS_DATABASE", raising=False)
    sizes = ["--runs", "20", "--tests", "2", "--episodes", "5", "--writers", "2", "--repeats", "1"]
    rows = rows_of(capfd, "store", *sizes)
    assert [row["unit"] for row in rows] == ["s", "s", "s", "s", "transactions/s"]
    assert rows[2]["case"] == "query with a filter: 10 of 20 runs match"


EPISODES = 24
"""In four of these episodes the Panda's expert misses with 50 steps."""


@pytest.mark.usefixtures("forked")
def test_experts_are_counted_as_episodes_played_by_hand_with_any_number_of_processes():
    row = next(experts.measure(pair=["panda/push", "ur5/reach"], episodes=EPISODES, steps=50, jobs=2)).dump()
    by_expert: list[list[bool]] = []
    """Success at every step of the test episodes, played here step by step."""
    with closing(pair("panda", "push")) as environment:
        for seed in episode_seeds(0, EPISODES):
            step, flags = environment.reset(seed), list[bool]()
            expert = environment.expert()
            expert.reset()
            while not (step.terminated or step.truncated):
                step = environment.step(np.asarray(expert.act(), np.float32))
                flags.append(bool(step.success))
            by_expert.append(flags)
    assert row["case"] == "panda push"
    assert row["value"] == np.mean([flags[-1] for flags in by_expert])
    assert row["any"] == np.mean([any(flags) for flags in by_expert])
    assert row["steps"] == pytest.approx(np.mean([flags.index(True) + 1 for flags in by_expert if any(flags)]))
    assert 0 < row["low"] < row["value"] < 1, "a figure that could not be anything else shows nothing"
    assert row["peer_low"] <= row["peer_value"] <= row["peer_high"] < row["value"], "by chance"
    assert row["episodes"] == EPISODES


@pytest.mark.usefixtures("forked")
def test_every_pair_that_goes_together_is_measured(monkeypatch):
    monkeypatch.setattr(experts, "names", {"robots": ["iiwa", "panda"], "tasks": ["push", "reach"]}.get)
    cases = [row.case for row in experts.measure(episodes=1, jobs=1)]
    assert cases == ["iiwa push", "iiwa reach", "panda push", "panda reach"]


@pytest.mark.parametrize(
    ("arguments", "error"),
    [
        (["updates", "--only", "sca"], UsageError),
        (["updates", "--threads", "10000"], MachineError),
        (["experts", "--pair", "panda"], UsageError),
        (["experts", "--pair", "panda/raech"], UsageError),
        (["peer", "specs/toy.yaml"], MachineError),
        (["updates", "--peers"], MachineError),
    ],
)
def test_what_cannot_be_measured_is_refused(arguments, error, monkeypatch):
    monkeypatch.setattr("bench.side_by_side.find_spec", lambda _: None)
    with pytest.raises(error):
        main(arguments)


@pytest.mark.parametrize("path", sorted((ROOT / "bench/agents").glob("*.yaml")), ids=lambda path: path.stem)
def test_every_spec_of_an_agent_has_parts_that_go_together_and_a_peer(path):
    spec = load_spec(path)
    assert spec.name == path.stem
    check_parts(spec)
    if spec.buffer.name != "on_policy":
        check_parts(load_spec(path, ["buffer.name=priority"]))
    recipe = yaml.safe_load(PEERS.read_text())[path.stem]
    assert recipe["source"]
    assert recipe["algorithm"].lower() == spec.agent.name
