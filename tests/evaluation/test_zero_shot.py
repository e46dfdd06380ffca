"""Tests of a saved policy under changed settings: what is played, what is written, and what is refused."""

import shutil
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from support import toy_runs as toys

from karolos.errors import MachineError, RunError, SpecError, UsageError
from karolos.evaluation.zero_shot import zero_shot_test
from karolos.records import RunFolder
from karolos.records.evaluation import LISTS, Evaluation
from karolos.records.run_folder import TRANSFERS
from karolos.system.files import FileLock

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toys.toy(testing={"episodes": 4, "seed": 5})
REACH = toys.REACH


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return toys.run_of(TOY, tmp_path_factory.mktemp("runs")).path


@pytest.fixture
def toy(finished: Path, tmp_path: Path) -> RunFolder:
    return RunFolder.open(shutil.copytree(finished, tmp_path / finished.name))


@pytest.fixture(scope="module")
def reach(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    return toys.run_of(REACH, tmp_path_factory.mktemp("runs"))


def episodes_of(test: Evaluation) -> tuple[Any, ...]:
    return (test.steps, *(getattr(test, name) for name in LISTS))


def test_by_default_it_plays_the_episodes_of_the_final_test_which_nothing_was_chosen_on(toy):
    for name, own in toy.final().items():
        transfer = zero_shot_test(toy, checkpoint=name)
        assert episodes_of(transfer) == episodes_of(own)
        assert (transfer.sha256, transfer.seed, transfer.checkpoint) == (own.sha256, 1_000_005, name)
        assert (transfer.randomized, transfer.overrides) == (False, ())
    again = zero_shot_test(toy, checkpoint="last", seed=5)
    assert episodes_of(again) == episodes_of(toy.tests()[-1])


@pytest.mark.parametrize(("seed", "episodes"), [(None, None), (None, 3), (None, 6), (8, 4)])
def test_the_same_policy_on_the_same_episodes_stands_beside_it(toy, seed, episodes):
    for name in ("best", "last"):
        changed = zero_shot_test(toy, ["environment.threshold=0.9"], checkpoint=name, seed=seed, episodes=episodes)
        unchanged = zero_shot_test(toy, checkpoint=name, seed=seed, episodes=episodes)
        assert replace(changed.own, seconds=0.0) == replace(unchanged.counts, seconds=0.0)
        assert changed.own.episodes == changed.episodes == (episodes or 4)


def test_results_are_appended_and_come_back_as_they_were(toy):
    first = zero_shot_test(toy, ["environment.threshold=0.9"], checkpoint="last", episodes=3, seed=8)
    second = zero_shot_test(toy, ["environment.max_steps=3"])
    assert toy.transfers() == ((first, second), ())
    assert (first.episodes, first.seed, first.steps) == (3, 8, 80)
    assert set(second.lengths) == {3}
    assert first.versions["karolos"]
    assert toy.record().problems == ()


def test_overrides_change_what_is_played_and_seeds_which_episodes(toy):
    def returns(overrides: Sequence[str] = (), **options: Any) -> tuple[float, ...]:
        return zero_shot_test(toy, overrides, **options).returns

    assert returns(["environment.reward=dense"]) == returns(["environment.reward=dense"])
    assert returns(["environment.reward=dense"], seed=1) != returns(["environment.reward=dense"], seed=2)
    assert len(returns(episodes=7)) == 7


def test_a_policy_is_tested_on_another_robot_and_with_randomization(reach):
    own = zero_shot_test(reach, checkpoint="last")
    other = zero_shot_test(reach, ["robot=ur5"], checkpoint="last")
    assert own.distances != other.distances
    gravity = "randomization.task.gravity={name: uniform, low: -12, high: -2}"
    assert zero_shot_test(reach, [gravity], checkpoint="last", randomize=True).randomized
    assert reach.transfers().rows[-2] == other
    with pytest.raises(UsageError, match="--randomize"):
        zero_shot_test(reach, [gravity], checkpoint="last")


def test_a_parameter_of_the_world_takes_a_plain_value(reach):
    own = zero_shot_test(reach, checkpoint="last")
    changed = zero_shot_test(reach, ["task.gravity=-5"], checkpoint="last")
    assert changed.distances != own.distances
    assert changed.overrides == ("task.gravity=-5",)
    assert not changed.randomized
    nominal = zero_shot_test(reach, ["task.gravity=-9.81"], checkpoint="last")
    assert nominal.distances == own.distances
    both = ["robot=ur5", "robot.joint_friction=0.4"]
    assert zero_shot_test(reach, both, checkpoint="last").overrides == tuple(both)
    with pytest.raises(UsageError, match=r"task\.gravity.*-50 m/s2 .*; allowed is -20 to 0 m/s2"):
        zero_shot_test(reach, ["task.gravity=-50"])
    with pytest.raises(UsageError, match=r"task\.gravty: no such key; did you mean task\.gravity\?"):
        zero_shot_test(reach, ["task.gravty=-5"])
    zero_shot_test(reach, ["robot.name=panda"])


def test_other_layouts_are_refused_and_both_are_shown(reach, toy):
    before = reach.transfers()
    with pytest.raises(UsageError, match="with other observations, actions or goals") as caught:
        zero_shot_test(reach, ["robot.control=joint"], checkpoint="last")
    text = str(caught.value)
    for told in ("override robot.control=joint", "joint_changes 7 1", "tool_position_change 3 1", "here", "there"):
        assert told in text
    assert reach.transfers() == before
    with pytest.raises(UsageError, match=r"position 3 1\] here and \[position 2 1\] there"):
        zero_shot_test(toy, ["environment.dimensions=3"])


@pytest.mark.parametrize(
    ("overrides", "options", "error", "message"),
    [
        (["agent.hidden=[3]"], {}, UsageError, "changes the training"),
        (["training.steps=3"], {}, UsageError, "changes the training"),
        (["testing.episodes=3"], {}, UsageError, "--episodes"),
        (["environment.treshold=0.1"], {}, SpecError, "did you mean 'threshold'"),
        ([], {"randomize": True}, UsageError, "nothing to randomize"),
        ([], {"checkpoint": "never"}, RunError, "never"),
    ],
)
def test_what_cannot_be_tested_is_refused_and_nothing_is_written(toy, overrides, options, error, message):
    with pytest.raises(error, match=message):
        zero_shot_test(toy, overrides, **options)
    assert not (toy.path / TRANSFERS).exists()


def test_a_run_without_its_spec_says_so(toy):
    (toy.path / "resolved.json").write_text("{")
    with pytest.raises(RunError, match=r"resolved.json is missing, damaged or changed"):
        zero_shot_test(toy)


def test_damaged_lines_are_left_out_and_named(toy):
    first = zero_shot_test(toy)
    path = toy.path / TRANSFERS
    path.write_text('{"time": 3}\nnot json\n' + path.read_text() + '{"torn')
    found, problems = toy.transfers()
    assert found == (first,)
    assert [problem.split(": ")[0] for problem in problems] == [
        f"{TRANSFERS}:1",
        f"{TRANSFERS}:2",
        f"{TRANSFERS}:4",
    ]
    toy.add_transfer(first)
    assert toy.transfers().rows == (first, first)


def test_many_that_add_at_once_lose_nothing(toy):
    first = zero_shot_test(toy)
    many = [replace(first, seed=seed) for seed in range(24)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(toy.add_transfer, many))
    assert sorted(transfer.seed for transfer in toy.transfers().rows[1:]) == list(range(24))


def test_a_lock_held_by_another_process_is_an_error(toy, monkeypatch):
    first = zero_shot_test(toy)
    monkeypatch.setattr("karolos.system.files.LOCK_SECONDS", 0.0)
    lock = FileLock(toy.path / "transfers.lock")
    assert lock.acquire()
    with pytest.raises(MachineError, match="locked"):
        toy.add_transfer(first)
    lock.release()
