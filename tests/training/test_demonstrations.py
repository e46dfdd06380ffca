"""Demonstrations: the collected episodes, their reproducibility, and where they are refused."""

from typing import Any

import numpy as np
import pytest
from support import datasets
from support.toy_runs import toy

from karolos.core.seeding import SeedTree
from karolos.errors import UsageError
from karolos.experiment.check import check_parts
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder
from karolos.specification import spec_from_dict
from karolos.specification.model import DemonstrationSettings
from karolos.training.demonstrations import collect_demonstrations

REACH = toy(datasets.REACH, task={"max_steps": 50}, training={"steps": 60}, testing={"interval": 60})


def collected(seed: int = 0, **settings: Any) -> Any:
    chosen = DemonstrationSettings.model_validate({"episodes": 3, **settings})
    return collect_demonstrations(spec_from_dict(REACH).recipe(randomize=True), chosen, SeedTree(seed))


def test_the_expert_solves_what_it_shows_and_actions_stay_in_range():
    found = collected(noise=0.1, random=0.0)
    assert found.success_end == 1
    assert found.steps == sum(len(episode.reward) for episode in found.episodes)
    for episode in found.episodes:
        assert (episode.terminated | episode.truncated)[-1]
        assert not (episode.terminated | episode.truncated)[:-1].any()
        np.testing.assert_array_equal(episode.observation[1:], episode.next_observation[:-1])
        assert np.abs(episode.action).max() <= 1


def test_the_same_seed_shows_the_same_and_another_does_not():
    one, same, other = (collected(seed).episodes for seed in (0, 0, 1))
    for first, second in zip(one, same, strict=True):
        for field, again in zip(first, second, strict=True):
            np.testing.assert_array_equal(field, again)
    assert not np.array_equal(one[0].action, other[0].action)
    assert not np.array_equal(one[0].desired_goal, one[1].desired_goal)


def test_noise_and_random_actions_are_what_was_asked():
    plain = collected(noise=0.0, random=0.0).episodes[0]
    noisy = collected(noise=0.0, random=1.0).episodes[0]
    assert plain.reward.mean() > noisy.reward.mean()
    np.testing.assert_array_equal(plain.observation[0], noisy.observation[0])
    assert noisy.action.mean() == pytest.approx(0, abs=0.2)


def test_demonstrations_count_as_time_but_neither_as_steps_nor_as_tests_and_are_noted(tmp_path):
    outcome = Experiment({**REACH, "demonstrations": {"episodes": 2}}).run(tmp_path)
    folder = RunFolder.open(outcome.runs[0].folder)
    (event,) = [event for event in folder.events() if event["event"] == "demonstrated"]
    assert event["episodes"] == 2
    assert event["steps"] > 0
    assert 0 <= event["success_end"] <= 1
    assert 0 < event["seconds"] < folder.state().seconds
    assert folder.state().steps == 60
    assert len(folder.tests()) == 1


def test_an_environment_without_an_expert_is_refused_where_it_was_asked_for():
    spec = spec_from_dict({"environment": "toy", "agent": "sac"}, ["demonstrations.episodes=5"])
    with pytest.raises(UsageError, match="no expert") as caught:
        check_parts(spec)
    assert "override demonstrations.episodes=5: demonstrations:" in str(caught.value)


def test_an_agent_that_learns_from_its_own_actions_only_is_refused_demonstrations():
    changed = {**REACH, "agent": "ppo", "buffer": "on_policy", "training": {}, "demonstrations": {}}
    with pytest.raises(UsageError, match="does not support demonstrations"):
        check_parts(spec_from_dict(changed))


def test_imitation_without_demonstrations_is_refused():
    spec = spec_from_dict({**REACH, "agent": {"name": "sac", "imitation": 0.5}})
    with pytest.raises(UsageError, match="no demonstrations to imitate"):
        check_parts(spec)


def test_demonstrations_are_part_of_what_an_experiment_is():
    hashes = {
        spec_from_dict({**REACH, **({"demonstrations": some} if some is not None else {})}).hash()
        for some in (None, {}, {"episodes": 5})
    }
    assert len(hashes) == 3
    spec = spec_from_dict({**REACH, "demonstrations": {"episodes": 5}})
    assert spec_from_dict(spec.dump()) == spec
