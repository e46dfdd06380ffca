"""What every layout of the local orchestrator keeps, and what Ray's actors keep, with the toy environment."""

from functools import partial

import numpy as np
import pytest
from support.layouts import make
from support.rig import part

from karolos.core import Received, Step
from karolos.environments.build import build_environment
from karolos.environments.toy import Toy
from karolos.errors import RunError, WorkerError
from karolos.orchestrator.ray import Ray
from karolos.specification.parts import Recipe

SIZE = 6
TOY = Toy.Settings(dimensions=3, max_steps=5, reward="dense", threshold=0.3)
LAYOUTS = {
    "in_process": (0, 1, SIZE),
    "one_process": (1, 1, SIZE),
    "two_processes": (2, 1, SIZE // 2),
    "two_threads": (1, 2, SIZE // 2),
    "everything": (3, 2, 1),
}


@pytest.fixture(params=[*LAYOUTS, "ray"])
def orchestrator(request):
    if request.param == "ray":
        pytest.importorskip("ray")
        settings = Ray.Settings(workers=2, environments=SIZE // 2, failures=0, address="local")
        with Ray(settings, partial(Toy, TOY)) as made:
            yield made
        return
    with make(LAYOUTS[request.param], TOY, Toy) as made:
        yield made


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
    bare = {index: Toy(TOY) for index in (1, 2, 5)}
    orchestrator.reset([5, 1, 2], [50, 10, 20])
    received = orchestrator.receive()
    assert received.environment.tolist() == [1, 2, 5]
    assert_equal(received.step, [bare[index].reset(10 * index) for index in (1, 2, 5)])
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


def test_nothing_under_way_gives_nothing(orchestrator):
    orchestrator.step([], np.zeros((0, 3), np.float32))
    received = orchestrator.receive()
    assert isinstance(received, Received)
    assert received.environment.size == 0
    assert received.step.observation.shape == (0, 3)


def test_actions_of_a_wrong_shape_are_refused(orchestrator):
    with pytest.raises(ValueError, match=r"take actions of shape \(2, 3\), not \(2, 2\)"):
        orchestrator.step([0, 1], np.zeros((2, 2), np.float32))
    with pytest.raises(ValueError, match="shape"):
        orchestrator.step([0], np.zeros(3, np.float32))
    assert orchestrator.receive().environment.size == 0


def test_an_action_that_is_not_finite_is_refused_by_name(orchestrator):
    actions = np.zeros((2, 3), np.float32)
    actions[1, 2] = np.nan
    with pytest.raises(RunError, match="environment 4: the agent gave an action that is not a finite number"):
        orchestrator.step([1, 4], actions)


def test_large_seeds_arrive_whole(orchestrator):
    seed = 2**63 - 25
    orchestrator.reset([0], [seed])
    assert_equal(orchestrator.receive().step, [Toy(TOY).reset(seed)])


def test_close_is_final_and_safe_to_repeat(orchestrator):
    orchestrator.reset([0], [0])
    orchestrator.close()
    orchestrator.close()
    for use in (orchestrator.receive, lambda: orchestrator.reset([0], [0]), lambda: orchestrator.parameters([0])):
        with pytest.raises(ValueError, match="closed"):
            use()


def test_signature_is_the_environments(orchestrator):
    signature = Toy(TOY).signature
    assert orchestrator.size == SIZE
    assert orchestrator.signature.observation == signature.observation
    assert orchestrator.signature.max_steps == signature.max_steps
    reward = orchestrator.signature.goal_rule.reward(np.zeros(3), np.ones(3))
    np.testing.assert_array_equal(reward, signature.goal_rule.reward(np.zeros(3), np.ones(3)))


@pytest.mark.parametrize("name", ["toy", "robot_task"])
def test_a_recipe_is_built_in_the_workers_and_plays_the_same_everywhere(name):
    """By the road that a spec takes; with physics, which must not notice who runs it."""
    environment = part("environments", name)
    recipe = Recipe(environment, part("robots", "panda"), part("tasks", "reach")) if name == "robot_task" else None
    seen = []
    for processes, threads in ((0, 1), (2, 1), (1, 2)):
        layout = processes, threads, 2 // max(processes, threads)
        with make(layout, recipe or Recipe(environment), build_environment) as orchestrator:
            generator = np.random.default_rng(0)
            orchestrator.reset(range(2), range(2))
            steps = [orchestrator.receive().step]
            for _ in range(8):
                actions = generator.uniform(-1, 1, (2, orchestrator.signature.action.size)).astype(np.float32)
                orchestrator.step(range(2), actions)
                steps.append(orchestrator.receive().step)
            seen.append(steps)
    assert seen[0][0].observation.std() > 0
    for other in seen[1:]:
        for ours, theirs in zip(other, seen[0], strict=True):
            for field, expected in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(field, expected)
