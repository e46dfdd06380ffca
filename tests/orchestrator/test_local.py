"""Parts of the local orchestrator: settings, spreading, memory, what environments are handed."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError
from support.fake_environments import END, FINE
from support.layouts import make

from karolos.core import Field, Layout, Signature
from karolos.orchestrator.local import Local
from karolos.orchestrator.shared_memory import ALIGNMENT, EnvironmentArrays
from karolos.system import SharedMemory


@given(processes=st.integers(0, 8), threads=st.integers(1, 8), environments=st.integers(1, 8))
def test_only_the_number_of_environments_is_part_of_an_experiments_identity(processes, threads, environments):
    settings = Local.Settings(processes=processes, threads=threads, environments=environments)
    assert settings.identity() == {"environments": max(processes, 1) * threads * environments}
    assert settings.identity() == Local.Settings(processes=0, environments=settings.size).identity()


@pytest.mark.parametrize("wrong", [{"processes": -1}, {"threads": 0}, {"environments": 0}, {"process": 2}])
def test_settings_without_sense_are_refused(wrong):
    with pytest.raises(ValidationError):
        Local.Settings(**wrong)


def test_every_setting_is_described():
    assert all(field.description for field in Local.Settings.model_fields.values())


@pytest.mark.parametrize("layout", [(0, 1, 4), (2, 1, 2)])
def test_parameters_are_those_of_the_running_episode(layout):
    with make(layout) as orchestrator:
        orchestrator.reset([0, 1, 2, 3], [10, 20, 30, 40])
        orchestrator.receive()
        np.testing.assert_array_equal(orchestrator.parameters([3, 0]), [[40, 20], [10, 5]])
        orchestrator.reset([0], [12])
        orchestrator.receive()
        np.testing.assert_array_equal(orchestrator.parameters([0, 3]), [[12, 6], [40, 20]])


@pytest.mark.parametrize("layout", [(0, 1, 4), (2, 1, 2)])
def test_measures_are_those_of_the_episode_that_ended_last(layout):
    with make(layout) as orchestrator:
        orchestrator.reset([0, 3], [10, 40])
        orchestrator.receive()
        for actions in ([FINE, END], [END]):
            orchestrator.step([0, 3][: len(actions)], np.array(actions, np.float32)[:, None])
            orchestrator.receive()
        np.testing.assert_array_equal(orchestrator.measures([3, 0]), [[1, np.nan], [2, np.nan]])


@pytest.mark.parametrize("layout", [(0, 1, 1), (1, 1, 1)])
def test_an_environment_may_keep_the_actions_it_was_given(layout):
    """An action delay does; the memory they came in is overwritten by the next."""
    with make(layout) as orchestrator:
        orchestrator.reset([0], [0])
        orchestrator.receive()
        for action, total in ((0.25, 0.25), (0.5, 0.75), (-0.125, 0.625)):
            orchestrator.step([0], np.full((1, 1), action, np.float32))
            assert orchestrator.receive().step.reward.tolist() == [total]


@pytest.mark.parametrize("layout", [(0, 1, 2), (1, 1, 2)])
def test_a_discrete_action_arrives_as_an_index(layout):
    with make(layout, recipe="discrete") as orchestrator:
        orchestrator.reset([0, 1], [0, 0])
        orchestrator.receive()
        orchestrator.step([0, 1], np.full((2, 1), FINE, np.float32))
        assert orchestrator.receive().step.observation[:, 1].tolist() == [1, 1]


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


def test_settings_travel_to_workers():
    settings = Local.Settings(processes=2)
    assert pickle.loads(pickle.dumps(settings)) == settings
