"""Exported policies act as their agents do; what cannot be exported is refused, and nothing wrong is left behind."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest
from support.exported_policies import CASES, asked, exported, trained

from karolos.core import Agent, Deployed, Layer
from karolos.errors import MachineError, RunError, UsageError
from karolos.export import NumpyPolicy
from karolos.export.export import export_policy
from karolos.export.onnx_file import run_onnx
from karolos.records import checkpoint
from karolos.registry import load, names

pytestmark = pytest.mark.xdist_group("exported policies")  # which a process trains once

TOLERANCE = 1e-5


def test_every_agent_that_ships_is_exported_in_some_case():
    ships = {name for name in names("agents") if load("agents", name).__module__.startswith("karolos.")}
    assert ships == {case["agent"]["name"] for case in CASES.values()}


@pytest.mark.parametrize("case", CASES)
def test_the_written_files_act_as_the_agent_does(case):
    done = exported(case)
    assert done.error < TOLERANCE
    policy = NumpyPolicy(done.folder / "policy.npz")
    saved, observation, goal, action = asked(trained(case))
    if saved.agent.deployed().output == "argmax":
        action = action[:, 0].astype(np.int64)
    found = policy(observation, goal)
    assert found.dtype == action.dtype
    np.testing.assert_allclose(found, action, atol=TOLERANCE)
    assert len(np.unique(found, axis=0)) > 1, "a policy that always does the same would prove nothing"
    np.testing.assert_allclose(policy(observation[3], goal[3]), action[3], atol=TOLERANCE)

    pytest.importorskip("onnx")
    model = done.folder / "policy.onnx"
    inputs = {"observation": observation} | ({"desired_goal": goal} if goal.shape[1] else {})
    found = run_onnx(model, inputs)
    assert found.dtype == action.dtype
    np.testing.assert_allclose(found, action, atol=TOLERANCE)
    runtime = pytest.importorskip("onnxruntime")
    session = runtime.InferenceSession(str(model), providers=["CPUExecutionProvider"])
    assert [entry.name for entry in session.get_inputs()] == list(inputs)
    (found,) = session.run(["action"], inputs)
    np.testing.assert_allclose(found, action, atol=TOLERANCE)
    told = json.loads(session.get_modelmeta().custom_metadata_map["karolos"])
    assert told == json.loads((done.folder / "policy.json").read_text())


def test_golden_samples_are_the_agents_own_actions_and_reach_beyond_the_clipping():
    golden = np.load(exported("sac").folder / "golden.npz")
    saved = asked(trained("sac"))[0]
    expected = saved.agent.act(golden["observation"], golden["desired_goal"], explore=False)
    np.testing.assert_array_equal(golden["action"], expected)
    policy = NumpyPolicy(exported("sac").folder / "policy.npz")
    rows = np.concatenate((golden["observation"], golden["desired_goal"]), 1)
    known = rows.shape[1]
    assert (np.abs((rows - policy.shift[:known]) * policy.scale[:known]) > policy.clip).any()


def test_inputs_and_outputs_are_described_with_names_and_units():
    told = json.loads((exported("sac").folder / "policy.json").read_text())
    assert told["observation"] == [{"name": "position", "size": 2, "unit": "1"}]
    assert told["action"] == [{"name": "displacement", "size": 2, "unit": "1"}]
    assert (told["run"], told["checkpoint"], told["steps"]) == (trained("sac").id, "last", 120)
    assert told["sha256"] == checkpoint.digest(trained("sac").checkpoints, "last", "agent")
    labels = json.loads((exported("dqn").folder / "policy.json").read_text())["action"]["labels"]
    assert len(labels) == 4, "one for each bit"


def test_without_onnx_the_numpy_files_are_written_alone_unless_onnx_is_asked_for(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    out = tmp_path / "out"
    with pytest.raises(MachineError, match="--no-onnx"):
        export_policy(trained("td3"), out, onnx=True)
    with pytest.raises(RunError, match="never"):
        export_policy(trained("td3"), out, checkpoint="never", onnx=False)
    assert not out.exists()
    out.mkdir()
    (out / "policy.onnx").write_bytes(b"of another policy")
    done = export_policy(trained("td3"), out)
    assert [path.name for path in sorted(out.iterdir())] == ["golden.npz", "policy.json", "policy.npz"]
    assert sorted(done.files) == sorted(out.iterdir())


def test_an_agent_that_does_not_say_how_it_acts_is_refused():
    saved = asked(trained("sac"), 1)[0]
    with pytest.raises(UsageError, match="SAC cannot be exported"):
        Agent.deployed(saved.agent)


def test_a_policy_that_would_act_otherwise_or_is_no_number_is_refused(tmp_path, monkeypatch):
    folder = trained("td3")
    agent = type(asked(folder, 1)[0].agent)
    right = agent.deployed

    def shifted(self: Agent) -> Deployed:
        found = right(self)
        return replace(found, shift=found.shift + 1)

    monkeypatch.setattr(agent, "deployed", shifted)
    with pytest.raises(RunError, match="does not act like the agent"):
        export_policy(folder, tmp_path, checkpoint="last", onnx=False)
    assert not (tmp_path / "policy.npz").exists()
    monkeypatch.setattr(agent, "deployed", lambda self: replace(right(self), scale=right(self).scale * np.nan))
    with pytest.raises(RunError, match="weights that are nan or infinite"):
        export_policy(folder, tmp_path, checkpoint="last", onnx=False)


def test_layers_that_do_not_fit_are_refused():
    layer = Layer(np.zeros((2, 3), np.float32), np.zeros(2, np.float32))
    inputs = np.zeros(4, np.float32)
    with pytest.raises(ValueError, match="do not fit layers"):
        Deployed(inputs, inputs, 5.0, (layer,), "tanh")
