"""Policies that ship are those of reference runs, and still work."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from karolos_cli.play import play
from support.commands import call
from typer import Typer

from karolos.evaluation.playing import score
from karolos.export.numpy_policy import NumpyPolicy
from karolos.export.shipped import FOLDER, load_shipped, shipped_names
from karolos.files import read_object
from karolos.records import RunFolder, paths
from karolos.records.final_test import FinalTest

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"
app = Typer()
app.command()(play)


def test_a_policy_ships_for_every_pair_of_robot_and_task() -> None:
    pairs = product(("panda", "ur5", "iiwa"), ("reach", "push", "pick", "throw"))
    assert {f"{robot}_{task}" for robot, task in pairs} == set(shipped_names())


def final_test(run: object) -> FinalTest:
    [final] = [folder.final() for folder in map(RunFolder.open, paths(REFERENCE)) if folder.id == run]
    assert final is not None
    return final


@pytest.mark.parametrize("name", shipped_names())
def test_a_policy_that_ships_is_that_of_a_reference_run_and_acts_as_its_agent_did(name: str) -> None:
    described = read_object(FOLDER / name / "policy.json")
    assert described is not None
    final = final_test(described["run"])
    assert described["sha256"] in (final.last_sha256, final.best_sha256)
    golden = np.load(FOLDER / name / "golden.npz")
    acted = NumpyPolicy(FOLDER / name / "policy.npz")(golden["observation"], golden["desired_goal"])
    assert np.abs(acted - golden["action"]).max() < 1e-4


@pytest.mark.parametrize("name", shipped_names())
def test_a_policy_that_ships_succeeds_where_it_did_in_its_final_test(name: str) -> None:
    described = read_object(FOLDER / name / "policy.json")
    assert described is not None
    # the same episodes; numpy rounds otherwise than torch, and a throw at the edge of its target may miss then
    expected = float(np.mean(final_test(described["run"]).last.end[:20]))
    assert expected >= 0.8
    spec, environment, policy = load_shipped(name)
    try:
        assert score(environment, policy, episodes=20, seed=spec.testing.final_seed).success_end >= expected - 0.11
    finally:
        environment.close()


def test_an_unknown_name_is_refused_with_the_policies_that_ship(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    code, _, err = call(app, "panda_pik")
    assert code == 2
    assert "'panda_pik' means no run" in err
    assert "did you mean 'panda_pick'?" in err
    assert all(name in err for name in shipped_names())
