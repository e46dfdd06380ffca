"""The orchestrator as a vector environment of gymnasium: what SyncVectorEnv gives, from worker processes."""

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from support.processes import kill_worker

import karolos
from karolos.errors import RunError, UsageError, WorkerError

DRAWN = {"task.gravity": {"name": "normal", "mean": -9.8, "std": 0.1}}
FORCES = {"limit": 1, "weight": 2, "most": 3}


def envs(name: str = "PandaReach-v1", count: int = 3, **settings: Any) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return gymnasium.make_vec(f"karolos.gym:karolos/{name}", num_envs=count, **settings)


def assert_same(own: Any, peer: Any, where: str = "") -> None:
    if isinstance(peer, dict):
        assert set(own) == set(peer), where
        for key, value in peer.items():
            assert_same(own[key], value, f"{where} {key}")
    elif peer is None:
        assert own is None, where
    elif peer.dtype == object:
        for one, other in zip(own, peer, strict=True):
            assert_same(one, other, where)
    else:
        assert own.dtype == peer.dtype, where
        exact = own.dtype == np.float32  # rewards are computed as float64 there
        np.testing.assert_allclose(own, peer, rtol=0 if exact else 1e-7, atol=0 if exact else 1e-5, err_msg=where)


@pytest.mark.parametrize("mode", [mode.value for mode in AutoresetMode])
@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("PandaPush-v2", {"max_steps": 3, "force_penalty": FORCES, "randomization": DRAWN}),
        ("PandaPickPlace-v2", {"max_steps": 2, "actions": "discrete"}),
    ],
)
def test_every_answer_is_that_of_gymnasiums_own(mode, name, settings):
    processes = 2 if (mode, name) == ("SameStep", "PandaPush-v2") else 0  # which no mode knows of
    own = envs(name, processes=processes, autoreset_mode=mode, **settings)
    peer = envs(name, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **settings)
    assert (own.observation_space, own.action_space) == (peer.observation_space, peer.action_space)
    assert own.metadata["autoreset_mode"] is peer.metadata["autoreset_mode"]
    answers = [together.reset(seed=[7, 3, 5]) for together in (own, peer)]
    own.action_space.seed(0)
    for _ in range(7):
        for place, (one, other) in enumerate(zip(*answers, strict=True)):
            assert_same(one, other, str(place))
        over = answers[0][2] | answers[0][3] if len(answers[0]) == 5 else np.zeros(3, np.bool_)
        if mode == "Disabled" and over.any():
            answers = [together.reset(options={"reset_mask": over.copy()}) for together in (own, peer)]
        else:
            actions = own.action_space.sample()
            answers = [together.step(actions) for together in (own, peer)]
    own.close()
    peer.close()


def test_wrappers_and_policies_take_them():
    spec = karolos.make("panda_reach").spec
    assert spec is not None
    made: Any = gymnasium.make_vec(spec, num_envs=2, processes=0)
    together: Any = gymnasium.wrappers.vector.DictInfoToList(gymnasium.wrappers.vector.RecordEpisodeStatistics(made))
    observation, _ = together.reset(seed=0)
    assert karolos.load("panda_reach").act(observation).shape == (2, 3)
    infos = [together.step(together.action_space.sample())[4] for _ in range(30)]
    assert {"measures", "episode"} <= set(infos[-1][1])
    assert made.compute_reward(observation["achieved_goal"], observation["achieved_goal"], None).shape == (2,)
    together.close()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"render_mode": "rgb_array"}, "make no pictures"),
        ({"max_episode_steps": 5}, "max_episode_steps cannot be 5: episodes have 50; give max_steps=5"),
        ({"autoreset_mode": "Never"}, "no autoreset mode 'Never'; there are .*SameStep"),
        ({"count": 0}, "num_envs is at least 1"),
        ({"contrl": "joint"}, "did you mean 'control'"),
    ],
)
def test_what_makes_no_sense_is_refused(settings, told):
    with pytest.raises(UsageError, match=told):
        envs(**settings)


def test_a_reset_is_asked_for_and_wrong_masks_seeds_and_actions_are_refused():
    together = envs(processes=0, max_steps=2, autoreset_mode="Disabled")
    actions = np.zeros((3, 3), np.float32)
    for call in (lambda: together.step(actions), lambda: together.reset(options={"reset_mask": actions[0] == 1})):
        with pytest.raises((gymnasium.error.ResetNeeded, ValueError)):
            call()
    with pytest.raises(ValueError, match="2 seeds for 3"):
        together.reset(seed=[1, 2])
    together.reset(seed=0)
    with pytest.raises(RunError, match="not a finite number"):
        together.step(actions * np.nan)
    together.step(actions)
    together.step(actions)
    with pytest.raises(gymnasium.error.ResetNeeded, match=r"over: \[0, 1, 2\]"):
        together.step(actions)
    together.close()


def test_after_a_lost_worker_all_begin_again():
    together = envs(processes=2)
    actions = np.zeros((3, 3), np.float32)
    first = together.reset(seed=0)[0]
    kill_worker(1)
    with pytest.raises(WorkerError, match="killed"):
        together.step(actions)
    with pytest.raises(gymnasium.error.ResetNeeded):
        together.step(actions)
    again = together.reset(seed=0)[0]
    np.testing.assert_array_equal(again["observation"], first["observation"])
    together.close()
