"""Policies that treat joints alike, outside karolos: their files, and a bundle for an arm that they never moved."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from karolos_deploy import Bundle, command
from karolos_deploy.drivers import simulation
from karolos_deploy.policy import NumpyPolicy
from support.exported_policies import trained
from support.parts import batch, jointed, make

from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.core import Deployed, Field
from karolos.errors import UsageError
from karolos.export import bundle
from karolos.export.export import arrays
from karolos.export.onnx_file import run_onnx, write_onnx
from karolos.export.simulated_robot import Server
from karolos.report.video import write_film

pytestmark = pytest.mark.xdist_group("exported policies")  # which a process trains once


@pytest.mark.parametrize("others", [(), (Field("grip", 1),)], ids=["joints alone", "a gripper first"])
@pytest.mark.parametrize("kind", [SAC, TD3])
def test_files_act_as_the_agent_does_with_and_without_absent_joints(kind, others, tmp_path):
    of = jointed(others)
    agent = make(kind, of, per_joint=True, hidden=(16, 24, 24))
    for update in range(4):
        agent.learn(batch(32, of, seed=update))
    asked = batch(200, of, seed=9)
    observation, goal = 3 * asked.observation, asked.desired_goal
    observation[100:, [8, 9, 12]] = 0.0  # no third joint
    action = agent.act(observation, goal, explore=False)
    policy = agent.deployed()
    np.savez(tmp_path / "policy.npz", **arrays(policy))
    numpy_policy = NumpyPolicy(tmp_path / "policy.npz")
    np.testing.assert_allclose(numpy_policy(observation, goal), action, atol=1e-5)
    np.testing.assert_allclose(numpy_policy(observation[-1], goal[-1]), action[-1], atol=1e-5)
    heir = make(kind, of, seed=2, per_joint=True, hidden=(16, 24, 24))
    heir.adopt(Deployed.read(tmp_path / "policy.npz"))
    np.testing.assert_allclose(heir.act(observation, goal, explore=False), action, atol=1e-5)
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    write_onnx(tmp_path / "policy.onnx", policy, (observation.shape[1], goal.shape[1]), {})
    inputs = {"observation": observation, "desired_goal": goal}
    np.testing.assert_allclose(run_onnx(tmp_path / "policy.onnx", inputs), action, atol=1e-5)
    session = runtime.InferenceSession(str(tmp_path / "policy.onnx"), providers=["CPUExecutionProvider"])
    np.testing.assert_allclose(session.run(["action"], inputs)[0], action, atol=1e-5)


@pytest.fixture(scope="module")
def for_panda(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The bundle for a Panda, with a small film, of a policy that learned on a UR5."""
    pytest.importorskip("onnx")
    out = tmp_path_factory.mktemp("joints") / "bundle"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bundle, "write_film", lambda *what: write_film(*what[:-1], (64, 48)))
        patch.setattr(bundle, "EPISODES", 2)
        bundle.export_bundle(trained("sac_joints"), out, ["robot.name=panda"], checkpoint="last")
    return out


def test_a_bundle_for_another_arm_computes_what_joints_do_from_its_readings(for_panda):
    whole = Bundle(for_panda)
    contract, episode = whole.contract, whole.episode()
    assert (contract["format"], contract["robot"]["name"], len(contract["joints"])) == (2, "panda", 7)
    assert (contract["run"]["changed"], contract["run"]["test"]) == (["robot.name=panda"], None)
    assert "measured" not in {one["formula"] for one in contract["observation"]}
    assert whole.replay_episode() == len(episode["time"]) > 1
    assert np.ptp(episode["observation"], 0).max() > 0.01, "an arm that rests would prove nothing"
    inputs = {name: episode[name] for name in ("observation", "desired_goal")}
    for found in (whole.policy(*inputs.values()), run_onnx(for_panda / "policy.onnx", inputs)):
        np.testing.assert_allclose(found, episode["action"], atol=1e-5)
    page = (for_panda / "README.md").read_text()
    assert "| joint_effects | m, rad |" in page
    assert "Trained without these changes: robot.name=panda." in page


def test_karolos_deploy_runs_it_on_a_simulated_arm(for_panda, monkeypatch, capsys):
    served = Server(for_panda)  # in this process, which need not start another one

    class Direct:
        def __init__(self, _address: str) -> None: ...

        def ask(self, **request: Any) -> dict[str, Any]:
            return served.answer(request)

        def close(self) -> None: ...

    monkeypatch.setattr(simulation, "Channel", Direct)
    settings = ["--set", "clock=simulated", "--set", "address=here"]
    code = command.main([str(for_panda), "--move", "--json", "--rate", "125", *settings])
    told = capsys.readouterr()
    assert code == 0, told.err
    assert json.loads(told.out)["episodes"] == 1
    assert served.robot is not None
    assert served.robot.time == pytest.approx(10 / 24, abs=0.02), "ten actions"


def test_an_arm_with_another_layout_is_refused(tmp_path):
    with pytest.raises(UsageError, match="other observations, actions or goals"):
        bundle.export_bundle(trained("sac_joints"), tmp_path, ["robot.control=pose", "robot.joint_slots=null"])
    assert not any(tmp_path.iterdir())
