"""Policies: a saved agent, an expert and random actions; a policy that cannot be had is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.toy_runs import toy

from karolos import checkpoint
from karolos.core import Array
from karolos.core.seeding import SeedTree
from karolos.environments.toy import Toy
from karolos.errors import MachineError, RunError, UsageError
from karolos.evaluation.changed_spec import load_player
from karolos.evaluation.playing import play
from karolos.evaluation.policies import expert_policy, has_window, load_agent, load_expert, random_policy, signature_of
from karolos.export import NumpyPolicy
from karolos.export.export import export_policy
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder
from karolos.registry import load
from karolos.specification import Spec, spec_from_dict

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy(
    environment={"name": "toy", "max_steps": 7, "reward": "dense"},
    training={"steps": 60, "replay_ratio": 2},
    testing={"interval": 30, "episodes": 4},
)


def reach(**changes: Any) -> Spec:
    return spec_from_dict({"name": "reach", "robot": "panda", "task": "reach", "agent": "sac", **changes})


def test_the_expert_of_a_spec_solves_its_task_without_randomization() -> None:
    gravity = {"task.gravity": {"name": "normal", "mean": -9.81, "std": 1.0}}
    environment, policy = load_expert(reach(randomization=gravity))
    assert environment.signature.parameters.size == 0
    ends = [moment.success for moment in play(environment, policy, episodes=3, seed=0) if moment.over]
    environment.close()
    assert ends == [True, True, True]


def test_an_environment_without_a_task_has_no_expert() -> None:
    with pytest.raises(UsageError, match="there is no expert for this environment"):
        load_expert(spec_from_dict(TOY))
    with pytest.raises(UsageError, match="tasks have experts"):
        expert_policy(Toy(Toy.Settings()))


def test_a_window_needs_an_environment_that_has_one_and_a_display(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(MachineError, match="environment toy has no window"):
        load_expert(spec_from_dict(TOY), window=True)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(MachineError, match="no display"):
        load_expert(reach(environment={"name": "robot_task", "engine": "bullet"}), window=True)
    assert [has_window(one) for one in (spec_from_dict(TOY), reach())] == [False, False]


def test_a_random_policy_fills_the_action_range_and_is_determined_by_its_seed() -> None:
    environment = Toy(Toy.Settings())
    step = environment.reset(0)

    def actions(seed: int) -> Array:
        policy = random_policy(environment, seed)
        return np.array([policy.act(step) for _ in range(200)])

    np.testing.assert_array_equal(actions(1), actions(1))
    assert not np.array_equal(actions(1), actions(2))
    assert actions(1).shape == (200, 2)
    assert actions(1).min() < -0.9
    assert actions(1).max() > 0.9


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return RunFolder.open(Experiment(TOY).run(tmp_path_factory.mktemp("runs")).runs[0].folder)


def test_a_saved_policy_plays_without_exploration_and_the_same_each_time(folder: RunFolder) -> None:
    def totals() -> list[float]:
        player = load_player(folder, "last")
        assert (player.spec.name, player.note) == ("toy", None)
        seed = player.spec.testing.seed
        return [moment.total for moment in play(player.environment, player.policy, episodes=2, seed=seed)]

    assert totals() == totals()
    assert len(set(totals())) > 8, "the point moves"


def test_a_number_that_is_not_finite_is_refused_by_its_name(folder: RunFolder, tmp_path: Path) -> None:
    saved = load_agent(folder, "last")
    export_policy(folder, tmp_path, checkpoint="last", onnx=False)
    for values in (np.array([0, np.nan]), np.array([[0, 0], [0, -np.inf]])):
        with pytest.raises(UsageError, match=r"act: observation\[1\], which is position\[1\], is not finite"):
            saved.act(values, np.zeros_like(values))
        with pytest.raises(UsageError, match=r"goal\[1\]"):
            saved.act(np.zeros_like(values), values)
        with pytest.raises(ValueError, match=r"desired_goal\[1\] is not finite"):
            NumpyPolicy(tmp_path / "policy.npz")(np.zeros_like(values), values)


def test_a_missing_checkpoint_is_refused(folder: RunFolder) -> None:
    with pytest.raises(RunError, match="never"):
        load_player(folder, "never")


@pytest.mark.parametrize("lost", ["part", "key", "steps"])
def test_a_checkpoint_that_lacks_something_is_refused_in_one_line(tmp_path: Path, lost: str) -> None:
    spec = {"name": "t", "environment": "toy", "agent": {"name": "sac", "hidden": [8]}}
    folder = RunFolder.create(tmp_path, "t", 0)
    resolved = spec_from_dict(spec)
    folder.describe(resolved.dump(), experiment="x")
    agent = load("agents", "sac")(resolved.agent.settings, signature_of(resolved), SeedTree(0), "cpu")
    state = agent.state()
    if lost == "key":
        state.pop(next(iter(state)))
    meta = {"seconds": 1.0} if lost == "steps" else {"steps": 1, "seconds": 1.0}
    checkpoint.save(folder.checkpoints, "best", {"other" if lost == "part" else "agent": state}, meta)
    with pytest.raises(RunError, match="checkpoint") as caught:
        load_agent(folder)
    assert "\n" not in str(caught.value)
