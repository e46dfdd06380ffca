"""The orchestrator that measures layouts and takes one; what it takes changes no result."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.training_parts import Counter

from karolos.environments.toy import Toy
from karolos.orchestrator import auto
from karolos.orchestrator.auto import Auto, Measured, choose, process_counts
from karolos.orchestrator.local import Local
from karolos.spec import spec_from_dict

TOY = Toy.Settings(dimensions=3, max_steps=5, reward="dense", threshold=0.3)
SETTINGS = Auto.Settings(environments=4, seconds=0.1)


def play(orchestrator) -> list[np.ndarray]:
    generator = np.random.default_rng(0)
    orchestrator.reset(range(4), range(4))
    steps = [orchestrator.receive().step]
    for _ in range(3):
        orchestrator.step(range(4), generator.uniform(-1, 1, (4, 3)).astype(np.float32), updates=3)
        received = orchestrator.receive(at_least=4)
        assert received.updates.tolist() == [3] * 4
        steps.append(received.step)
    return [field for step in steps for field in step] + [orchestrator.parameters(range(4))]


def test_every_choice_gives_the_same_episodes(monkeypatch):
    played = []
    for chosen in (Measured(0, 1, 1.0), Measured(1, 1, 1.0), Measured(2, 2, 1.0)):
        monkeypatch.setattr(auto, "_probed", {})
        monkeypatch.setattr(auto, "probe", lambda *_, chosen=chosen: [chosen])
        with Auto(SETTINGS, TOY, build=Toy) as orchestrator:
            described = orchestrator.describe()
            assert (described["processes"], described["environments"]) == (chosen.processes, 4)
            played.append(play(orchestrator))
    for other in played[1:]:
        for ours, theirs in zip(played[0], other, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_what_was_measured_and_chosen_is_told_and_measured_once(monkeypatch):
    monkeypatch.setattr(auto, "_probed", {})
    with Auto(SETTINGS, TOY, build=Toy) as orchestrator:
        described = json.loads(json.dumps(orchestrator.describe()))
    layouts = [(found["processes"], found["threads"]) for found in described["measured"]]
    assert layouts[0] == (1, 1)
    assert layouts[-1] == (0, 1)
    assert all(found["steps_per_second"] > 0 for found in described["measured"])
    assert described["processes"] in {processes for processes, _ in layouts}
    monkeypatch.setattr(auto, "probe", lambda *_: pytest.fail("measured twice"))
    with Auto(SETTINGS, TOY, build=Toy) as again:
        assert again.describe() == described


class Unsteady(Counter):
    """Fails at a reset with seed 7, is over at once after one with seed 5, and refuses to step before a reset."""

    def reset(self, seed):
        if seed == 7:
            raise ZeroDivisionError("it broke at a reset")
        step = super().reset(seed)
        self.over = seed == 5
        return step._replace(truncated=self.over, diverged=self.over)

    def step(self, action):
        assert not self.over
        step = super().step(action)
        self.over = step.terminated or step.truncated
        return step


def test_the_probe_survives_environments_that_fail_or_are_over_at_a_reset():
    settings = Local.Settings(processes=0, environments=3, failures=1)
    with Local(settings, None, build=lambda _: Unsteady()) as orchestrator:
        assert auto.steps_per_second(orchestrator, 0.02) > 0


@given(st.lists(st.tuples(st.integers(0, 8), st.integers(1, 4), st.floats(1, 1e5)), min_size=1))
def test_the_choice_is_close_to_the_fastest_and_no_smaller_layout_is(layouts):
    measured = [Measured(*layout) for layout in layouts]
    chosen = choose(measured)
    close = [found for found in measured if found.steps_per_second * auto.SPEEDUP >= chosen.steps_per_second]
    assert chosen.steps_per_second * auto.SPEEDUP >= max(found.steps_per_second for found in measured)
    assert chosen in close


def test_a_second_process_that_adds_little_is_not_taken():
    assert choose([Measured(1, 1, 1000.0), Measured(2, 1, 1050.0)]).processes == 1
    assert choose([Measured(1, 1, 1000.0), Measured(2, 1, 1800.0)]).processes == 2


def test_the_main_process_steps_only_where_that_is_clearly_faster():
    """It cannot step while the agent learns."""
    assert choose([Measured(1, 1, 1000.0), Measured(0, 1, 1050.0)]).processes == 1
    assert choose([Measured(1, 1, 1000.0), Measured(0, 1, 1500.0)]).processes == 0


@pytest.mark.parametrize(("most", "expected"), [(1, [1]), (2, [1, 2]), (6, [1, 2, 4, 6]), (8, [1, 2, 4, 8])])
def test_process_counts_double_up_to_the_most(most, expected):
    assert list(process_counts(most)) == expected


def test_auto_and_local_with_as_many_environments_are_one_experiment():
    spec = {"environment": {"name": "toy"}, "agent": {"name": "sac"}}
    hashes = {
        spec_from_dict({**spec, "orchestrator": orchestrator}).hash()
        for orchestrator in (
            {"name": "auto", "environments": 6},
            {"name": "auto", "environments": 6, "seconds": 1.0, "failures": 0},
            {"name": "local", "processes": 2, "environments": 3, "time_limit": 5.0},
        )
    }
    assert len(hashes) == 1
    assert spec_from_dict({**spec, "orchestrator": "auto"}).orchestrator.settings.size == Auto.Settings().environments


def test_the_layout_as_it_is_is_told():
    with Local(Local.Settings(processes=3, threads=4), TOY, size=5, build=Toy) as orchestrator:
        assert orchestrator.describe() == {"processes": 3, "threads": 2, "environments": 5}
