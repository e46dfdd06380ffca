"""What every layout of the local orchestrator keeps, and what actors of Ray keep."""

import sys
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support import rig, toy_runs
from support.fake_environments import DIE, END, FINE, HANG, RAISE, SLOW, Fake
from support.layouts import IN_PROCESS, THREADS, TWO, every_layout, make, reset, step

from karolos.core import Field, Layout, Received, Signature, Step
from karolos.environments.build import build_environment
from karolos.environments.toy import Toy
from karolos.errors import MachineError, PluginError, RunError, WorkerError
from karolos.launchers.experiment import Experiment
from karolos.orchestrator.executor import ALIGNMENT, EnvironmentArrays
from karolos.orchestrator.local import Local
from karolos.orchestrator.ray import Ray
from karolos.records import RunFolder
from karolos.specification import spec_from_dict
from karolos.system import SharedMemory

SIZE = 6
TOY = Toy.Settings(dimensions=3, max_steps=5, reward="dense", threshold=0.3)
LAYOUTS = {
    "in_process": (0, 1, SIZE),
    "one_process": (1, 1, SIZE),
    "two_processes": (2, 1, SIZE // 2),
    "two_threads": (1, 2, SIZE // 2),
    "everything": (3, 2, 1),
}
ON_RAY = toy_runs.TOY | {"orchestrator": {"name": "ray", "workers": 2, "environments": 1, "address": "local"}}
in_process_and_not = pytest.mark.parametrize("layout", [IN_PROCESS, TWO], ids=["0", "2"])


@pytest.fixture(scope="module")
def on_ray() -> Iterator[list[Ray]]:
    """Toys in actors, which start slowly: one test leaves them to the next, unless it has closed or broken them."""
    kept: list[Ray] = []
    yield kept
    for made in kept:
        made.close()


@pytest.fixture(params=[*LAYOUTS, "ray"])
def orchestrator(request: pytest.FixtureRequest, on_ray: list[Ray]) -> Iterator[Any]:
    """Toys."""
    if request.param != "ray":
        with make(LAYOUTS[request.param], TOY, Toy) as made:
            yield made
        return
    pytest.importorskip("ray")
    if not on_ray:
        settings = Ray.Settings(workers=2, environments=SIZE // 2, failures=0, address="local")
        on_ray.append(Ray(settings, partial(Toy, TOY)))
    yield on_ray[0]
    try:
        on_ray[0].reset(range(SIZE), range(SIZE))
        on_ray[0].receive()
    except (ValueError, WorkerError):
        on_ray.pop().close()


def assert_equal(received: Step, expected: list[Step]) -> None:
    for name, ours, theirs in zip(Step._fields, received, zip(*expected, strict=True), strict=True):
        np.testing.assert_array_equal(ours, np.array(theirs, ours.dtype), err_msg=name)


def test_seeds_and_actions_alone_determine_every_step(orchestrator):
    """Against bare environments; the ones that finish are reset, so that environments stand at different steps."""
    generator = np.random.default_rng(0)
    bare = [Toy(TOY) for _ in range(SIZE)]
    orchestrator.reset(range(SIZE), range(SIZE))
    expected = [environment.reset(seed) for seed, environment in enumerate(bare)]
    for turn in range(17):
        received = orchestrator.receive()
        assert received.environment.tolist() == list(range(SIZE))
        assert_equal(received.step, expected)
        over = [bool(step.truncated) or (turn == 2 and index % 2 == 0) for index, step in enumerate(expected)]
        fresh, going = np.flatnonzero(over), np.flatnonzero(~np.array(over))
        actions = generator.uniform(-1, 1, (going.size, 3)).astype(np.float32)
        orchestrator.reset(fresh, [100 * turn + index for index in fresh.tolist()])
        orchestrator.step(going, actions)
        for index in fresh.tolist():
            expected[index] = bare[index].reset(100 * turn + index)
        for index, action in zip(going.tolist(), actions, strict=True):
            expected[index] = bare[index].step(action)


def test_ids_in_any_order_keep_their_seeds_and_actions(orchestrator):
    large = 2**63 - 25
    bare = {index: Toy(TOY) for index in (1, 2, 5)}
    orchestrator.reset([5, 1, 2], [large, 10, 20])
    received = orchestrator.receive()
    assert received.environment.tolist() == [1, 2, 5]
    assert_equal(received.step, [bare[1].reset(10), bare[2].reset(20), bare[5].reset(large)])
    actions = np.array([[0.5, 0, 0], [0, 0.25, 0], [0, 0, -1]], np.float32)
    orchestrator.step([2, 5, 1], actions)
    received = orchestrator.receive()
    assert received.environment.tolist() == [1, 2, 5]
    assert_equal(received.step, [bare[1].step(actions[2]), bare[2].step(actions[0]), bare[5].step(actions[1])])


def test_an_episode_that_is_over_is_not_reset_by_itself(orchestrator):
    orchestrator.reset([3], [1])
    orchestrator.receive()
    for _ in range(TOY.max_steps):
        orchestrator.step([3], np.ones((1, 3), np.float32))
        last = orchestrator.receive().step
    assert last.truncated.tolist() == [True]
    orchestrator.step([3], np.ones((1, 3), np.float32))
    with pytest.raises(WorkerError, match="RuntimeError: the episode is over"):
        orchestrator.receive()


def test_what_is_received_belongs_to_the_caller(orchestrator):
    orchestrator.reset(range(SIZE), range(SIZE))
    first = orchestrator.receive().step
    kept = first.observation.copy()
    orchestrator.step(range(SIZE), np.full((SIZE, 3), 0.5, np.float32))
    second = orchestrator.receive().step
    np.testing.assert_array_equal(first.observation, kept)
    expected = second.observation.copy()
    second.observation[:] = 7
    orchestrator.step(range(SIZE), np.zeros((SIZE, 3), np.float32))
    np.testing.assert_array_equal(orchestrator.receive().step.observation, expected)


def test_nothing_under_way_gives_nothing_and_wrong_actions_are_refused(orchestrator):
    orchestrator.step([], np.zeros((0, 3), np.float32))
    with pytest.raises(ValueError, match=r"take actions of shape \(2, 3\), not \(2, 2\)"):
        orchestrator.step([0, 1], np.zeros((2, 2), np.float32))
    with pytest.raises(ValueError, match="shape"):
        orchestrator.step([0], np.zeros(3, np.float32))
    actions = np.zeros((2, 3), np.float32)
    actions[1, 2] = np.nan
    with pytest.raises(RunError, match="environment 4: the agent gave an action that is not a finite number"):
        orchestrator.step([1, 4], actions)
    received = orchestrator.receive()
    assert isinstance(received, Received)
    assert received.environment.size == 0
    assert received.step.observation.shape == (0, 3)


def test_close_is_final_and_safe_to_repeat(orchestrator):
    assert orchestrator.size == SIZE
    assert orchestrator.signature.observation == Toy(TOY).signature.observation
    orchestrator.reset([0], [0])
    orchestrator.close()
    orchestrator.close()
    for use in (orchestrator.receive, lambda: orchestrator.reset([0], [0]), lambda: orchestrator.parameters([0])):
        with pytest.raises(ValueError, match="closed"):
            use()


def test_physics_plays_the_same_in_threads_of_a_process():
    """In processes: test_vector."""
    seen = []
    for layout in ((0, 1, 2), (1, 2, 1)):
        with make(layout, rig.recipe("reach"), build_environment) as orchestrator:
            generator = np.random.default_rng(0)
            orchestrator.reset(range(2), range(2))
            steps = [orchestrator.receive().step]
            for _ in range(8):
                actions = generator.uniform(-1, 1, (2, orchestrator.signature.action.size)).astype(np.float32)
                orchestrator.step(range(2), actions)
                steps.append(orchestrator.receive().step)
            seen.append(steps)
    assert seen[0][0].observation.std() > 0
    for ours, theirs in zip(*seen, strict=True):
        for field, expected in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(field, expected)


# Parameters, measures and actions


@in_process_and_not
def test_parameters_are_of_the_running_episode_and_measures_of_the_one_that_ended_last(layout):
    with make(layout) as orchestrator:
        orchestrator.reset([0, 1, 2, 3], [10, 20, 30, 40])
        orchestrator.receive()
        np.testing.assert_array_equal(orchestrator.parameters([3, 0]), [[40, 20], [10, 5]])
        for actions in ([FINE, END], [END]):
            orchestrator.step([0, 3][: len(actions)], np.array(actions, np.float32)[:, None])
            orchestrator.receive()
        np.testing.assert_array_equal(orchestrator.measures([3, 0]), [[1, np.nan], [2, np.nan]])
        orchestrator.reset([0], [12])
        orchestrator.receive()
        np.testing.assert_array_equal(orchestrator.parameters([0, 3]), [[12, 6], [40, 20]])


@in_process_and_not
def test_an_environment_may_keep_its_actions_and_a_discrete_one_gets_an_index(layout):
    """An action delay keeps them; the memory they came in is overwritten by the next."""
    with make(layout) as orchestrator:
        reset(orchestrator)
        for action, total in ((0.25, 0.25), (0.5, 0.75), (-0.125, 0.625)):
            orchestrator.step([0], np.full((1, 1), action, np.float32))
            assert orchestrator.receive().step.reward.tolist() == [total]
    with make(layout, recipe="discrete") as orchestrator:
        reset(orchestrator)
        step(orchestrator, FINE, FINE)
        assert orchestrator.receive().step.observation[:, 1].tolist() == [1, 1]


# Waiting for some of the answers


@every_layout
def test_every_answer_arrives_once_and_the_least_number_is_kept(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, SLOW, FINE, FINE, FINE)
        seen: list[int] = []
        while len(seen) < 4:
            ids = orchestrator.receive(at_least=1).environment.tolist()
            assert ids == sorted(ids)
            assert ids
            seen += ids
        assert sorted(seen) == [0, 1, 2, 3]
        assert orchestrator.receive(at_least=1).environment.size == 0, "nothing pending gives nothing"


@pytest.mark.parametrize("layout", [TWO, THREADS], ids=["2", "threads"])
def test_who_is_ready_goes_on_while_others_are_busy(layout):
    with make(layout) as orchestrator:
        reset(orchestrator)
        step(orchestrator, SLOW, FINE, FINE, FINE)
        assert orchestrator.receive(at_least=2).environment.tolist() == [2, 3]
        orchestrator.step([2, 3], np.zeros((2, 1), np.float32))
        received = orchestrator.receive(at_least=9)
        assert received.environment.tolist() == [0, 1, 2, 3], "more than is pending is all that is pending"
        assert received.step.observation[:, 1].tolist() == [1, 1, 2, 2]
        step(orchestrator, SLOW, SLOW, SLOW, SLOW)
        assert orchestrator.receive(at_least=0).environment.size == 0, "for none it does not wait"
        assert orchestrator.receive().environment.size == 4


def test_a_failure_counts_as_an_answer():
    """The loop has to act on it; waiting for others instead could wait for ever."""
    with make(TWO, failures=1) as orchestrator:
        reset(orchestrator)
        step(orchestrator, SLOW, SLOW, RAISE)
        received = orchestrator.receive(at_least=1)
        assert (received.environment.tolist(), received.failed.tolist()) == ([], [2])
        assert orchestrator.receive().environment.tolist() == [0, 1]


@every_layout
def test_the_policy_behind_each_action_comes_back_with_its_step(layout):
    with make(layout) as orchestrator:
        orchestrator.reset(range(4), range(4))
        assert orchestrator.receive().updates.tolist() == [-1] * 4
        orchestrator.step([1, 3], np.zeros((2, 1), np.float32), updates=7)
        orchestrator.step([0], np.zeros((1, 1), np.float32), updates=9)
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.updates.tolist()) == ([0, 1, 3], [9, 7, 7])


# Settings and memory


@given(processes=st.integers(0, 8), threads=st.integers(1, 8), environments=st.integers(1, 8))
def test_only_the_number_of_environments_is_part_of_an_experiments_identity(processes, threads, environments):
    settings = Local.Settings(processes=processes, threads=threads, environments=environments)
    assert settings.identity() == {"environments": max(processes, 1) * threads * environments}
    assert settings.identity() == Local.Settings(processes=0, environments=settings.size).identity()


@pytest.mark.parametrize("wrong", [{"processes": -1}, {"threads": 0}, {"environments": 0}, {"process": 2}])
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(ValidationError):
        Local.Settings(**wrong)


def all_arrays(arrays: EnvironmentArrays) -> list[np.ndarray]:
    return [arrays.seed, arrays.action, arrays.parameters, arrays.commands, *arrays.step]


widths = st.integers(0, 5)


@given(n=st.integers(1, 9), observation=widths, goal=widths, action=st.integers(1, 5), parameters=widths)
def test_the_arrays_do_not_overlap(n, observation, goal, action, parameters):
    def wide(size: int) -> Layout:
        return Layout((Field("x", size),))

    signature = Signature(
        wide(observation),
        wide(action),
        1,
        achieved_goal=wide(goal),
        desired_goal=wide(goal),
        parameters=wide(parameters),
    )
    buffer = bytearray(EnvironmentArrays.size(signature, n))
    ours, theirs = EnvironmentArrays.over(buffer, signature, n), EnvironmentArrays.over(buffer, signature, n)
    for number, array in enumerate(all_arrays(ours)):
        assert len(array) == n
        assert array.__array_interface__["data"][0] % array.itemsize == 0
        array[...] = number % 2 if array.dtype == bool else number
    for number, array in enumerate(all_arrays(theirs)):
        assert (array == (number % 2 if array.dtype == bool else number)).all()
    assert len(buffer) % ALIGNMENT == 0


def test_shared_memory_has_no_name_and_outlives_its_handle():
    memory = SharedMemory(128)
    content = np.frombuffer(memory.buffer, np.uint8)
    content[:] = 3
    memory.close()
    memory.close()
    assert content.sum() == 3 * 128


# Actors of Ray


def make_on_ray(recipe: str = "", **settings: float) -> Ray:
    pytest.importorskip("ray")
    chosen = Ray.Settings(workers=2, environments=2, failures=5, address="local", **settings)
    return Ray(chosen, partial(Fake, recipe))


def test_without_ray_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MachineError, match=r"Ray is not installed; pip install 'karolos\[ray\]'"):
        Ray(Ray.Settings(), partial(Fake, ""))


def test_a_worker_on_ray_that_dies_or_hangs_is_replaced_and_an_environment_that_raises_is_built_again():
    with make_on_ray(time_limit=8.0) as orchestrator:
        pids = reset(orchestrator)
        step(orchestrator, FINE, RAISE, FINE, DIE)
        received = orchestrator.receive()
        while received.failed.size < 3:
            received = orchestrator.receive()
        # one worker's death may be told before the other's error
        raised, died = sorted(received.failures, key=lambda failure: failure.environment[0])
        assert (received.failed.tolist(), raised.lost, died.lost) == ([1, 2, 3], False, True)
        assert "ZeroDivisionError: the inertia is zero" in str(raised.error)
        assert "with environments 2 to 3" in str(died.error)
        orchestrator.step([2], np.zeros((1, 1), np.float32))
        assert orchestrator.receive().failed.tolist() == [2], "a step cannot continue a lost episode"
        replaced = reset(orchestrator)
        assert replaced[0] == pids[0]
        assert replaced[2] not in pids
        orchestrator.step([0, 1, 2], np.array([[FINE], [FINE], [HANG]], np.float32))
        received = orchestrator.receive()
        assert (received.environment.tolist(), received.failed.tolist()) == ([0, 1], [2, 3])
        assert "a reset or step took longer than 8 s" in str(received.failures[0].error)
        assert reset(orchestrator)[2] not in replaced
        assert orchestrator.parameters([3])[:, 0].tolist() == [3]


def test_an_environment_on_ray_that_cannot_be_built_is_an_error_that_names_it():
    with pytest.raises(PluginError, match="the mesh is missing"):
        make_on_ray("complain")


def test_a_run_with_environments_on_ray_equals_one_in_this_process(tmp_path):
    assert spec_from_dict(ON_RAY).hash() == spec_from_dict(toy_runs.TOY).hash()
    pytest.importorskip("ray")
    (one,) = Experiment(ON_RAY).run(tmp_path / "ray").runs
    (other,) = Experiment(toy_runs.TOY).run(tmp_path / "here").runs
    folder, same = (RunFolder.open(run.folder) for run in (one, other))
    assert [(test.steps, test.end, test.returns) for test in folder.tests()] == [
        (test.steps, test.end, test.returns) for test in same.tests()
    ]
    assert (folder.path / "episodes.jsonl").read_text() == (same.path / "episodes.jsonl").read_text()
