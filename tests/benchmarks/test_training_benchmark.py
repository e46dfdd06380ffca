import json
from pathlib import Path

import numpy as np
import pytest
from karolos_cli.bench import COLUMNS, app
from support.states import assert_same_state
from typer.testing import CliRunner

from karolos.benchmarks import end_to_end, side_by_side
from karolos.benchmarks.training import WithoutOverlap
from karolos.core.seeding import SeedTree
from karolos.errors import MachineError
from karolos.spec import load_spec, spec_from_dict
from karolos.training.assembly import make_agent, make_buffer, make_orchestrator
from karolos.training.training import Training

SPECS = Path(__file__).parents[2] / "specs"


def test_a_quick_run_prints_overlap_and_async_beside_training_without_overlap():
    result = CliRunner().invoke(app, ["training", "--quick", "--json"])
    assert result.exit_code == 0, result.output
    rows = [json.loads(line) for line in result.stdout.splitlines()]
    assert all(tuple(row) == COLUMNS for row in rows)
    assert [row["case"].rsplit(", ", 1)[1] for row in rows] == ["lockstep", "async"]
    assert all(row["value"] > 0 and row["peer"] == "lockstep without overlap" for row in rows)
    assert "an update" in result.stderr


def test_what_is_run_to_success_is_the_shipped_spec():
    own = ["training.steps=6000", "testing.final_episodes=0"]
    assert end_to_end.reach().hash() == load_spec(SPECS / "panda_reach.yaml", own).hash()


def test_a_missing_peer_is_told_before_anything_is_measured(monkeypatch):
    monkeypatch.setattr(side_by_side, "find_spec", lambda _: None)
    result = CliRunner().invoke(app, ["training", "--peers"])
    assert isinstance(result.exception, MachineError)
    assert "stable_baselines3, panda_gym not installed" in str(result.exception)
    assert not result.stdout


def learned(*, overlap: bool) -> dict[str, dict]:
    spec = spec_from_dict(
        {
            "environment": "toy",
            "agent": {"name": "sac", "hidden": [16], "precision": "float32"},
            "buffer": {"capacity": 1000, "hindsight": {"strategy": "future"}},
            "orchestrator": {"processes": 1, "environments": 4},
            "training": {"steps": 240, "batch_size": 16, "replay_ratio": 8, "warmup_episodes": 4},
        }
    )
    seeds = SeedTree(0)
    with make_orchestrator(spec, randomize=True) as made:
        environments = made if overlap else WithoutOverlap(made)
        agent = make_agent(spec, environments.signature, seeds)
        buffer = make_buffer(spec, environments.signature, seeds, environments=4, discount=agent.discount)
        training = Training(environments, agent, buffer, spec.training, seeds)
        assert list(training.rounds())[-1].updates > 40
        return {"agent": agent.state(), "buffer": buffer.state(), "training": training.state()}


def test_overlap_changes_nothing_that_is_learned():
    assert_same_state(learned(overlap=True), learned(overlap=False))


@pytest.mark.parametrize("answers", [None, 1])
def test_without_overlap_a_command_has_been_carried_out_when_it_returns(answers):
    calls = []

    class Told:
        signature, size = None, 2

        def step(self, environments, actions, *, updates):
            calls.append(("step", updates))

        def receive(self, at_least=None):
            calls.append(("receive", at_least))
            return "received"

    environments = WithoutOverlap(Told())
    environments.step([0], np.zeros((1, 1)), updates=3)
    assert calls == [("step", 3), ("receive", None)]
    assert environments.receive(answers) == "received"
    assert len(calls) == 2
