"""Parts that do not go together are refused before anything runs, at file:line:column."""

import re
from typing import Any

import numpy as np
import pytest
from support.faulty_environments import FAULTS
from support.spec_files import REFUSED, problems_of, write

from karolos.agents.sac import SAC
from karolos.environments.toy import NearPoint
from karolos.errors import KarolosError, PluginError, UsageError
from karolos.experiment.check import check_parts
from karolos.specification import load_spec, spec_from_dict
from karolos.system import memory


@pytest.mark.parametrize("case", REFUSED["parts"])
def test_parts_that_do_not_fit_are_refused_with_the_place_and_the_reason(case, tmp_path):
    expected = REFUSED["parts"][case]
    layout = "orchestrator: {processes: 0, environments: 4}"
    path = write(tmp_path, "s.yaml", f"environment: toy\n{expected['spec'].rstrip()}\n{layout}\n")
    with pytest.raises(KarolosError) as refused:
        check_parts(load_spec(path))
    assert str(refused.value).startswith(f"{path}:{expected['problem']}")


SEEN_BY_CRITICS = {"robot": "panda", "task": "insert", "environment": {"critic_observes": ["hole_error"]}}
UNUSED: dict[str, tuple[dict[str, Any], str]] = {
    "ppo": (
        SEEN_BY_CRITICS | {"agent": "ppo", "buffer": "on_policy"},
        "environment.critic_observes: PPO has no critic",
    ),
    "dqn": (
        SEEN_BY_CRITICS | {"agent": "dqn", "environment": SEEN_BY_CRITICS["environment"] | {"actions": "discrete"}},
        "environment.critic_observes: DQN has no critic",
    ),
    "throw": (
        {"robot": "panda", "task": "throw", "agent": {"name": "sac", "fine_goal": 3}},
        "agent.fine_goal: what is achieved of the goal is not among the observations",
    ),
}


@pytest.mark.parametrize("case", UNUSED)
def test_a_setting_that_an_agent_cannot_use_is_refused(case):
    spec, expected = UNUSED[case]
    with pytest.raises(UsageError, match=rf"^dict: {expected}[^\n]*$"):
        check_parts(spec_from_dict(spec))


@pytest.mark.parametrize("agent", ["sac", "ppo"])
def test_a_resolved_spec_with_its_defaults_spelt_out_is_not_refused(agent):
    buffer = "on_policy" if agent == "ppo" else "uniform"
    spec = spec_from_dict({"environment": "toy", "agent": agent, "buffer": buffer})
    check_parts(spec_from_dict(spec.dump()))


@pytest.mark.parametrize("override", REFUSED["amounts"])
def test_an_amount_that_no_machine_has_is_refused_at_its_setting(override, tmp_path):
    (problem,) = problems_of(write(tmp_path, "s.yaml", "environment: toy\nagent: sac\n"), override)
    assert problem.startswith("override ")
    assert REFUSED["amounts"][override] in problem


NEEDS_MEMORY = {
    "capacity": (
        "buffer: {capacity: 1e9}\n",
        r"3:20: buffer\.capacity: a buffer of 1,000,000,000 transitions needs 64\.0 GB of memory, and this machine has"
        r" 10\.0 GB; lower buffer\.capacity",
    ),
    "a buffer that a checkpoint copies": (
        "buffer: {capacity: 1e8}\ntraining: {steps: 1e9}\n",
        r"3:20: buffer\.capacity: a buffer of 100,000,000 transitions needs 12\.8 GB",
    ),
    "networks": (
        "training: {steps: 1000}\n",
        r"2:28: agent\.hidden: an agent with networks of 30000 x 30000 units needs 57\.6 GB",
    ),
    "processes": (
        "orchestrator: {processes: 512}\n",
        r"3:27: orchestrator\.processes: training and testing with 512 worker processes each needs 32\.2 GB",
    ),
    "episodes": (
        "orchestrator: {processes: 0, environments: 65536}\nbuffer: {capacity: 3e7}\n",
        r"orchestrator\.environments: the actions of 65,536 running episodes of up to 100,000 steps needs",
    ),
}


@pytest.mark.parametrize("case", NEEDS_MEMORY)
def test_what_does_not_fit_into_memory_is_refused_with_what_it_needs(case, tmp_path, monkeypatch):
    text, expected = NEEDS_MEMORY[case]
    monkeypatch.setattr("karolos.experiment.check.memory", lambda: 10_000_000_000)
    agent = "{name: sac, hidden: [30000, 30000]}" if case == "networks" else "sac"
    steps = "{name: toy, max_steps: 1e5}" if case == "episodes" else "toy"
    path = tmp_path / "s.yaml"
    path.write_text(f"environment: {steps}\nagent: {agent}\n{text}")
    with pytest.raises(UsageError, match=expected):
        check_parts(load_spec(path))


def test_runs_at_the_same_time_share_the_memory(monkeypatch):
    monkeypatch.setattr("karolos.experiment.check.memory", lambda: 10_000_000_000)
    spec = spec_from_dict({"environment": "toy", "agent": "sac", "buffer": {"capacity": 1e8}})
    check_parts(spec)
    with pytest.raises(UsageError, match=r"needs 6\.4 GB of memory \(2 runs at the same time: 12\.9 GB\), and"):
        check_parts(spec, jobs=2)


def test_the_machine_says_how_much_memory_it_has():
    assert 1e8 < memory() < 1e14


def test_an_error_of_a_plugins_constructor_is_one_line(monkeypatch, tmp_path):
    def refuse(*_: object) -> None:
        raise ZeroDivisionError("no mass\nand a second line")

    monkeypatch.setattr("karolos.environments.toy.Toy.__init__", refuse)
    path = tmp_path / "s.yaml"
    path.write_text("environment: toy\nagent: sac\n")
    with pytest.raises(PluginError) as refused:
        check_parts(load_spec(path))
    told = rf"{path}:1:14: environment.name: .*test_assembly\.py:\d+: ZeroDivisionError: no mass"
    assert re.fullmatch(told, str(refused.value))


@pytest.mark.parametrize("fault", FAULTS)
def test_a_foreign_environment_that_fails_in_its_first_steps_is_told_at_its_place(fault, tmp_path):
    name = "{name: gymnasium, id: support.faulty_environments:Faulty-v0, kwargs: {fault: " + fault + "}}"
    workers = int(fault.startswith("_exit"))  # without a worker nothing outlives it
    text = f"environment: {name}\nagent: sac\norchestrator: {{processes: {workers}}}\n"
    path = write(tmp_path, "s.yaml", text)
    with pytest.raises(KarolosError) as refused:
        check_parts(load_spec(path))
    assert re.fullmatch(rf"{path}:1:\d+: environment\S*: .*", str(refused.value))
    assert refused.value.exit_code == 3


@pytest.mark.parametrize("method", ["reset", "act"])
def test_what_a_robot_cannot_do_in_its_first_steps_is_told_at_the_task(method, monkeypatch, tmp_path):
    def refuse(*_: object) -> None:
        raise PluginError("the tool cannot reach (0, 0, 0) m", where="Panda", hint="its workspace is higher")

    monkeypatch.setattr(f"karolos.robots.arm.Arm.{method}", refuse)
    path = write(tmp_path, "s.yaml", "robot: panda\ntask: reach\nagent: sac\n")
    told = "task.name: Panda: the tool cannot reach (0, 0, 0) m; its workspace is higher"
    with pytest.raises(PluginError, match=f"^{re.escape(f'{path}:2:7: {told}')}$"):
        check_parts(load_spec(path))


def test_only_an_agent_with_an_imitation_term_imitates_relabelled_transitions():
    parts = {"environment": "toy", "buffer": {"name": "uniform", "hindsight": {"imitate": True}}}
    check_parts(spec_from_dict({**parts, "agent": {"name": "sac", "imitation": 1.0}}))
    with pytest.raises(KarolosError, match="no imitation term, so it cannot imitate relabelled"):
        check_parts(spec_from_dict({**parts, "agent": {"name": "sac"}}))


def test_a_sweep_for_success_where_none_is_defined_is_noted():
    spec = {"name": "sweep", "environment": {"name": "gymnasium", "id": "Pendulum-v1"}, "agent": "sac"}
    sweep = {"space": {"agent.learning_rate": {"float": [1e-4, 1e-3]}}, "trials": 1}
    note = check_parts(spec_from_dict(spec | {"sweep": sweep}))
    assert note == "the environment defines no success, so success_end may stay 0: set sweep.objective=return"
    assert check_parts(spec_from_dict(spec | {"sweep": sweep | {"objective": "return"}})) is None
    assert check_parts(spec_from_dict(spec)) is None


def _nearest(rule: NearPoint, achieved: Any, desired: Any) -> bool:
    return float(np.linalg.norm(np.subtract(achieved, desired))) < rule.threshold


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"success": _nearest}, r"the goal rule's success has the shape \(\) for 4 goals, not \(4,\); compute it"),
        ({"reward": lambda *_: np.float32(-1)}, r"the goal rule's reward has the shape \(\) for 4 goals"),
    ],
)
def test_a_goal_rule_that_does_not_judge_each_goal_is_refused(monkeypatch, changed, told):
    for name, method in changed.items():
        monkeypatch.setattr(NearPoint, name, method)
    with pytest.raises(PluginError, match=told):
        check_parts(spec_from_dict({"environment": "toy", "agent": "sac"}))


def test_a_reward_outside_the_range_of_the_signature_is_refused():
    environment = {"name": "gymnasium", "id": "Pendulum-v1", "reward_range": [-0.001, 0]}
    spec = {"environment": environment, "agent": "sac", "orchestrator": {"processes": 0}}
    told = r"the environment gave reward -\d\S*, outside its reward_range \[-0\.001, 0\]"
    with pytest.raises(PluginError, match=told):
        check_parts(spec_from_dict(spec))


def test_an_agent_whose_check_fails_is_told_by_name(monkeypatch):
    monkeypatch.setattr(SAC, "check", lambda *_: None)
    with pytest.raises(UsageError, match=r"agent 'sac' cannot be made: TypeError: .* argument 'demonstrations'"):
        check_parts(spec_from_dict({"environment": "toy", "agent": "sac"}))
