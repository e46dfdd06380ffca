"""Parts that do not go together are refused before anything runs, at file:line:column; and layouts change no result."""

from __future__ import annotations

from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from support.states import assert_same_state

from karolos.core.seeding import SeedTree
from karolos.errors import KarolosError, SpecError
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
