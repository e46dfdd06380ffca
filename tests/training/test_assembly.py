"""Parts that do not go together are refused before anything runs, at file:line:column; and layouts change no result."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from support.states import assert_same_state

from karolos.core.seeding import SeedTree
from karolos.errors import KarolosError, SpecError, UsageError
from karolos.machine import memory
from karolos.spec import load_spec, spec_from_dict
from karolos.training.assembly import check_parts, make_agent, make_buffer, make_orchestrator
from karolos.training.training import Training

REFUSED = {
    "ppo with uniform": (
        "agent: ppo\nbuffer: uniform\n",
        "3:1: buffer: agent 'ppo' learns from its own latest actions only, buffer 'uniform' replays old ones",
    ),
    "ppo with the default buffer": ("agent: ppo\n", "2:1: buffer: agent 'ppo' learns from its own latest actions only"),
    "ppo with priority": ("agent: ppo\nbuffer: {name: priority}\n", "3:1: buffer: agent 'ppo' learns from"),
    "ppo with hindsight": (
        "agent: ppo\nbuffer: {name: on_policy, hindsight: {strategy: future}}\n",
        "3:27: buffer.hindsight: no such key",
    ),
    "sac with on_policy": (
        "agent: sac\nbuffer: on_policy\n",
        "3:1: buffer: agent 'sac' learns from replay, buffer 'on_policy' forgets all but the latest actions",
    ),
    "ppo with a replay ratio": (
        "agent: ppo\nbuffer: on_policy\ntraining: {steps: 100, replay_ratio: 4}\n",
        "4:38: training.replay_ratio: ppo does not use replay_ratio, which is 4",
    ),
    "ppo with a warm-up": (
        "agent: ppo\nbuffer: on_policy\ntraining: {warmup_episodes: 0}\n",
        "4:29: training.warmup_episodes: ppo does not use warmup_episodes, which is 0",
    ),
    "ppo with a batch size": (
        "agent: ppo\nbuffer: on_policy\ntraining: {batch_size: 64}\n",
        "4:24: training.batch_size: ppo does not use batch_size, which is 64",
    ),
    "ppo as it comes": (
        "agent: ppo\nbuffer: on_policy\ntraining: {mode: async}\n",
        "4:18: training.mode: ppo learns from whole rollouts of its latest policy",
    ),
    "a larger minimum than there is": (
        "agent: sac\ntraining: {mode: async, minimum_batch: 5}\n",
        "3:40: training.minimum_batch: a batch of 5 environments is never ready, because there are 4; lower it",
    ),
    "a minimum for lockstep": (
        "agent: sac\ntraining: {minimum_batch: 2}\n",
        "3:11: training: minimum_batch requires mode: async, not lockstep",
    ),
    "a minimum of nobody": (
        "agent: sac\ntraining: {mode: async, minimum_batch: 0}\n",
        "3:40: training.minimum_batch: should be greater than or equal to 1, not 0",
    ),
    "an unknown mode": (
        "agent: sac\ntraining: {mode: asynchronous}\n",
        "3:18: training.mode: should be 'lockstep' or 'async', not 'asynchronous'",
    ),
    "more minibatches than transitions": (
        "agent: {name: ppo, minibatches: 32}\nbuffer: {name: on_policy, rollout: 5}\n",
        "2:33: agent.minibatches: a rollout of 20 transitions cannot be split into 32 minibatches",
    ),
    "a batch larger than the buffer": (
        "agent: sac\nbuffer: {capacity: 200}\ntraining: {batch_size: 300}\n",
        "4:24: training.batch_size: a batch of 300 is larger than the buffer, which stores 200 transitions",
    ),
    "a buffer smaller than a batch": (
        "agent: sac\nbuffer: {capacity: 200}\n",
        "3:20: buffer.capacity: a batch of 256 is larger than the buffer, which stores 200 transitions",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_parts_that_cannot_work_together_are_refused_with_the_place_and_the_reason(case: str, tmp_path: Path) -> None:
    text, expected = REFUSED[case]
    path = tmp_path / "s.yaml"
    path.write_text(f"environment: toy\n{text}orchestrator: {{processes: 0, environments: 4}}\n")
    with pytest.raises(KarolosError) as refused:
        check_parts(load_spec(path))
    error = refused.value
    told = str(error.problems[0]) if isinstance(error, SpecError) else str(error)
    assert f"{path}:{expected}" in told


@pytest.mark.parametrize("agent", ["sac", "ppo"])
def test_a_resolved_spec_with_its_defaults_spelt_out_is_not_refused(agent: str) -> None:
    buffer = "on_policy" if agent == "ppo" else "uniform"
    spec = spec_from_dict({"environment": "toy", "agent": agent, "buffer": buffer})
    check_parts(spec_from_dict(spec.dump()))


LARGE = {
    "seeds=[1" + 239 * "0" + "]": "seeds[0]: should be less than or equal to 1" + 60 * "0" + ", not 1000",
    "training.threads=1e6": "training.threads: should be less than or equal to 1024, not 1000000",
    "training.steps=1e300": "training.steps: should be less than or equal to 1000000000000, not 1e+300",
    "orchestrator={processes: 100, threads: 100, environments: 100}": "orchestrator: processes x threads x environments"
    " are 1000000 environments; 65536 are allowed",
    "orchestrator.environments=1e30": "orchestrator.environments: should be less than or equal to 65536",
    "agent.hidden=[1e9]": "agent.hidden[0]: should be less than or equal to 65536",
    "agent.hidden=[0]": "agent.hidden[0]: should be greater than or equal to 1, not 0",
    "agent.policy_delay=1e20": "agent.policy_delay: should be an integer of at most 64 bits, not 1e+20",
    "testing.episodes=1e9": "testing.episodes: should be less than or equal to 1000000",
    "environment={name: gymnasium, id: 'a:b:X'}": "environment.id: 'a:b:X' must be \"Name-v0\" or",
}


@pytest.mark.parametrize("override", LARGE)
def test_an_amount_that_no_machine_has_is_refused_at_its_setting(override: str, tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text("environment: toy\nagent: sac\n")
    with pytest.raises(SpecError) as refused:
        load_spec(path, [override])
    (problem,) = refused.value.problems
    assert LARGE[override] in str(problem)
    assert "override" in str(problem.where)


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
def test_what_does_not_fit_into_memory_is_refused_with_what_it_needs(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text, expected = NEEDS_MEMORY[case]
    monkeypatch.setattr("karolos.training.memory.memory", lambda: 10_000_000_000)
    agent = "{name: sac, hidden: [30000, 30000]}" if case == "networks" else "sac"
    steps = "{name: toy, max_steps: 1e5}" if case == "episodes" else "toy"
    path = tmp_path / "s.yaml"
    path.write_text(f"environment: {steps}\nagent: {agent}\n{text}")
    with pytest.raises(UsageError, match=expected):
        check_parts(load_spec(path))


def test_runs_at_the_same_time_share_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("karolos.training.memory.memory", lambda: 10_000_000_000)
    spec = spec_from_dict({"environment": "toy", "agent": "sac", "buffer": {"capacity": 1e8}})
    check_parts(spec)
    with pytest.raises(UsageError, match=r"needs 6\.4 GB of memory \(2 runs at the same time: 12\.9 GB\), and"):
        check_parts(spec, jobs=2)


def test_the_machine_says_how_much_memory_it_has() -> None:
    assert 1e8 < memory() < 1e14


def test_an_error_of_a_plugins_constructor_is_one_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def refuse(*_: object) -> None:
        raise ZeroDivisionError("no mass\nand a second line")

    monkeypatch.setattr("karolos.environments.toy.Toy.__init__", refuse)
    path = tmp_path / "s.yaml"
    path.write_text("environment: toy\nagent: sac\n")
    with pytest.raises(UsageError) as refused:
        check_parts(load_spec(path))
    told = "environment.name: environment 'toy' cannot be made: ZeroDivisionError: no mass"
    assert str(refused.value) == f"{path}:1:14: {told}"


LEARNERS: dict[str, dict[str, Any]] = {
    "sac": {
        "agent": {"name": "sac", "hidden": [16], "precision": "float32"},
        "buffer": {"name": "uniform", "capacity": 1000, "hindsight": {"strategy": "future"}},
        "training": {"batch_size": 16, "replay_ratio": 8, "warmup_episodes": 4},
    },
    "ppo": {
        "agent": {"name": "ppo", "hidden": [16], "epochs": 2, "minibatches": 2},
        "buffer": {"name": "on_policy", "rollout": 8},
    },
}


def trained(learner: str, processes: int, *, saved_after: int = 0, rounds: int = 60) -> dict[str, Any]:
    """All states after some rounds of four environments; those after `saved_after` go to new parts meanwhile."""
    layout = {"processes": processes, "environments": 4 // max(processes, 1)}
    spec = spec_from_dict({"environment": "toy", "orchestrator": layout, **LEARNERS[learner]})
    seeds, states = SeedTree(3), {}
    for count in (saved_after, rounds - saved_after) if saved_after else (rounds,):
        with make_orchestrator(spec, randomize=True) as orchestrator:
            agent = make_agent(spec, orchestrator.signature, seeds)
            buffer = make_buffer(spec, orchestrator.signature, seeds, environments=4, discount=agent.discount)
            training = Training(orchestrator, agent, buffer, spec.training, seeds)
            parts = {"agent": agent, "buffer": buffer, "training": training}
            for name, state in states.items():
                parts[name].load_state(state)
            last = list(islice(training.rounds(), count))[-1]
            states = {name: part.state() for name, part in parts.items()}
    assert last.updates > 20
    return states


@pytest.mark.parametrize("learner", LEARNERS)
def test_what_is_learned_does_not_depend_on_the_number_of_processes(learner: str) -> None:
    alone = trained(learner, 0)
    for processes in (1, 2):
        assert_same_state(alone, trained(learner, processes))


@pytest.mark.parametrize("saved_after", [1, 37])
@pytest.mark.parametrize("learner", LEARNERS)
def test_new_parts_go_on_bit_for_bit_from_saved_states(learner: str, saved_after: int) -> None:
    assert_same_state(trained(learner, 0), trained(learner, 0, saved_after=saved_after))


def test_only_an_agent_with_an_imitation_term_imitates_relabelled_transitions() -> None:
    parts = {"environment": "toy", "buffer": {"name": "uniform", "hindsight": {"imitate": True}}}
    check_parts(spec_from_dict({**parts, "agent": {"name": "sac", "imitation": 1.0}}))
    with pytest.raises(KarolosError, match="no imitation term, so it cannot imitate relabelled"):
        check_parts(spec_from_dict({**parts, "agent": {"name": "sac"}}))


def test_a_sweep_for_success_where_none_is_defined_is_noted() -> None:
    spec = {"name": "sweep", "environment": {"name": "gymnasium", "id": "Pendulum-v1"}, "agent": "sac"}
    sweep = {"space": {"agent.learning_rate": {"float": [1e-4, 1e-3]}}, "trials": 1}
    note = check_parts(spec_from_dict(spec | {"sweep": sweep}))
    assert note == "the environment defines no success, so success_end may stay 0: set sweep.objective=return"
    assert check_parts(spec_from_dict(spec | {"sweep": sweep | {"objective": "return"}})) is None
    assert check_parts(spec_from_dict(spec)) is None
