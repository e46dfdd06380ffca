"""Watching policies: the same episodes as in tests, moment by moment; what cannot be played is refused."""

from __future__ import annotations

import numpy as np
import pytest

from karolos.environments.toy import Toy
from karolos.errors import MachineError, RunError, UsageError
from karolos.evaluation.playing import Policy, expert_policy, load_expert, load_player, play
from karolos.evaluation.testing import test_seeds
from karolos.experiment.experiment import Experiment
from karolos.records import RunFolder
from karolos.spec import Spec

TOY = {
    "name": "toy",
    "environment": {"name": "toy", "max_steps": 7},
    "agent": {"name": "sac", "hidden": [8]},
    "orchestrator": {"processes": 0, "environments": 2},
    "training": {"steps": 60, "batch_size": 8, "replay_ratio": 2, "warmup_episodes": 2},
    "testing": {"interval": 30, "episodes": 4},
}
REACH = {"name": "reach", "robot": "panda", "task": "reach", "agent": "sac"}


def spec(**changes) -> Spec:
    return Spec.from_dict({**REACH, **changes})


def test_moments_follow_an_episode_from_its_reset_to_its_end_on_the_seeds_of_the_tests():
    environment = Toy(Toy.Settings(max_steps=5))
    begun = []
    policy = Policy(lambda step: np.zeros(2, np.float32), lambda: begun.append(environment._goal.copy()))
    moments = [(m.episode, m.step, m.over) for m in play(environment, policy, episodes=3, seed=8)]
    assert moments == [(episode, step, step == 5) for episode in range(3) for step in range(6)]
    other = Toy(Toy.Settings(max_steps=5))
    np.testing.assert_array_equal(begun, [other.reset(seed).desired_goal for seed in test_seeds(8, 3)])


def test_the_expert_of_a_spec_solves_its_task_and_is_played_without_randomization():
    drawn = {"task.gravity": {"name": "normal", "mean": -9.81, "std": 1.0}}
    environment, policy = load_expert(spec(randomization=drawn))
    assert environment.signature.parameters.size == 0
    ends = [moment.success for moment in play(environment, policy, episodes=3, seed=0) if moment.over]
    environment.close()
    assert ends == [True, True, True]


def test_an_environment_without_a_task_has_no_expert():
    with pytest.raises(UsageError, match="there is no expert for this environment"):
        load_expert(Spec.from_dict(TOY))
    with pytest.raises(UsageError, match="tasks have experts"):
        expert_policy(Toy(Toy.Settings()))


def test_a_window_needs_an_environment_that_has_one_and_a_display(monkeypatch):
    with pytest.raises(MachineError, match="environment toy has no window"):
        load_expert(Spec.from_dict(TOY), window=True)
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(MachineError, match="no display"):
        load_expert(spec(), window=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> RunFolder:
    outcome = Experiment(TOY).run(tmp_path_factory.mktemp("runs"))
    return RunFolder.open(outcome.runs[0].folder)


def test_a_saved_policy_plays_without_exploration_and_the_same_each_time(folder):
    def films() -> list[bytes]:
        found, environment, policy = load_player(folder, "last")
        assert found.name == "toy"
        seen = []
        for moment in play(environment, policy, episodes=2, seed=found.testing.seed):
            seen.append(moment.environment._position.tobytes())
        return seen

    assert films() == films()
    assert len(set(films())) > 8, "the point moves"


def test_a_checkpoint_that_is_not_there_is_refused(folder):
    with pytest.raises(RunError, match="never"):
        load_player(folder, "never")
