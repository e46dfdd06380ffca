"""Recordings in: other people's files, what is computed again, and what is refused in one line."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from support.datasets import COLUMNS, REACH, facts, foreign, lerobot, record

from karolos.errors import UsageError
from karolos.experiment.check import check_parts
from karolos.launchers.experiment import Experiment
from karolos.recordings.reading import read_recordings
from karolos.records import RunFolder
from karolos.specification import spec_from_dict

pytestmark = pytest.mark.xdist_group(__name__)

DATA, EPISODES, INFO = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet", "meta/info.json"
Damage = Callable[[Path], object]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a recording of our own, and what somebody else would write of the same episodes."""
    folder = tmp_path_factory.mktemp("recorded")
    foreign(folder / "foreign", record(folder / "own"))
    return folder


def test_what_somebody_else_wrote_is_the_same_but_for_the_last_step(recorded):
    expected = read_recordings(recorded / "own", facts(), {}, 100)
    found = read_recordings(recorded / "foreign", facts(), COLUMNS, 100)
    assert found.successes == expected.successes > 0
    for one, whole in zip(found.episodes, expected.episodes, strict=True):
        assert len(one.reward) == len(whole.reward) - 1
        np.testing.assert_allclose(one.observation, whole.observation[:-1], atol=1e-6)
        np.testing.assert_allclose(one.next_achieved_goal, whole.next_achieved_goal[:-1], atol=1e-6)
        np.testing.assert_array_equal(one.reward, whole.reward[:-1])
        assert one.truncated.tolist() == [False] * (len(one.reward) - 1) + [True]


def test_a_run_learns_from_a_recording_which_is_part_of_what_it_is(tmp_path):
    path = lerobot(tmp_path)
    given = {**REACH, "demonstrations": {"file": str(path), "episodes": 2}}
    outcome = Experiment(given).run(tmp_path / "runs")
    (event,) = [one for one in RunFolder.open(outcome.runs[0].folder).events() if one["event"] == "demonstrated"]
    assert (event["episodes"], event["steps"]) == (2, 24)
    before = spec_from_dict(given).hash()
    assert before != spec_from_dict({**REACH, "demonstrations": {"episodes": 2}}).hash()
    path.rename(tmp_path / "elsewhere")
    given["demonstrations"]["file"] = str(tmp_path / "elsewhere")
    assert spec_from_dict(given).hash() == before
    (tmp_path / "elsewhere/meta/stats.json").write_text("{}")
    assert spec_from_dict(given).hash() != before


def _table(change: Callable[[pa.Table], pa.Table]) -> Damage:
    return lambda path: pq.write_table(change(pq.read_table(path / DATA)), path / DATA)


def _column(name: str, change: Callable[[np.ndarray], Any]) -> Damage:
    def changed(table: pa.Table) -> pa.Table:
        column = change(np.array(table[name].to_pylist(), np.float32))
        return table.set_column(table.column_names.index(name), name, [column.tolist()])

    return _table(changed)


def _info(**changed: Any) -> Damage:
    def damage(path: Path) -> None:
        info = json.loads((path / INFO).read_text())
        (path / INFO).write_text(json.dumps(info | changed))

    return damage


def _nan(column: np.ndarray) -> np.ndarray:
    column[5, 1] = np.nan
    return column


def _million(path: Path) -> None:
    rows = pq.read_table(path / EPISODES).to_pylist()
    pq.write_table(pa.Table.from_pylist([{**rows[0], "length": 1_000_000_000}]), path / EPISODES)


def _hostile(path: Path) -> None:
    info = json.loads((path / INFO).read_text())
    info["features"]["\x1b[2J\nkarolos: all is well"] = {"dtype": "float32", "shape": [1]}
    (path / INFO).write_text(json.dumps(info))


DAMAGES: dict[str, tuple[Damage, dict[str, str], str]] = {
    "missing column": (_table(lambda table: table.drop_columns(["goal"])), {}, "episode 0 has no column 'goal'"),
    "unmapped": (lambda _: None, {"tool_position": ""}, "episode 0 has no observation that is known"),
    "wrong shape": (_column("arm", lambda one: one[:, :5]), {}, "column 'arm' has 5 numbers a row, and"),
    "nan": (_column("arm", _nan), {}, "episode 0, column 'arm' is nan in row 5"),
    "cut parquet": (lambda path: (path / DATA).write_bytes((path / DATA).read_bytes()[:-200]), {}, "cannot be read"),
    "other fps": (_info(fps=50), {}, "it has 50 steps a second, and this environment 24"),
    "degrees": (lambda _: None, {"tool_position": "arm[0:3] deg"}, "deg cannot be converted to m"),
    "no unit": (lambda _: None, {"tool_position": "arm[0:3]"}, "the unit is missing; the environment uses m"),
    "goals missing": (lambda _: None, {"desired_goal": ""}, "episode 0 has no desired_goal"),
    "no success": (_column("goal", lambda one: one + 1), {}, "none of 3 episodes ends with success"),
    "too many rows": (_million, {}, "episodes of 1000000000 to 1000000000 steps are impossible"),
    "wrong index": (
        _column("episode_index", lambda one: one * 0),
        {},
        "episode 0 has 36 rows here and 12",
    ),
    "wrong frames": (_column("frame_index", lambda one: one * 2), {}, "'frame_index' does not count from 0 to 11"),
    "path outside": (_info(data_path="../../{chunk_index}"), {}, "leads outside of"),
    "hostile names": (_hostile, {}, r"has no column '\x1b[2J\nkarolos: all is well'"),
    "actions": (_column("action", lambda one: one * 50), {}, "row 0: action["),
    "unknown field": (lambda _: None, {"elbow": "arm[0:1]"}, "there is no field 'elbow' here"),
    "damaged info": (lambda path: (path / INFO).write_text("{"), {}, "holds no JSON object"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_recording_is_one_line_and_nothing_is_run(name, recorded, tmp_path):
    damage, columns, expected = DAMAGES[name]
    path = shutil.copytree(recorded / "foreign", tmp_path / "foreign")
    damage(path)
    mapped = {key: value for key, value in {**COLUMNS, **columns}.items() if value}
    with pytest.raises(UsageError) as caught:
        Experiment({**REACH, "demonstrations": {"file": str(path), "columns": mapped}}).run(tmp_path / "runs")
    assert expected in str(caught.value)
    assert str(caught.value).isprintable()
    assert name in ("degrees", "no unit", "unknown field") or str(path) in str(caught.value)
    assert not list((tmp_path / "runs").glob("*-s0-*"))


def _arrays(**changed: Callable[[np.ndarray], Any]) -> Damage:
    def damage(path: Path) -> None:
        with np.load(path) as file:
            arrays = dict(file)
        np.savez(path, **{name: changed.get(name, np.asarray)(array) for name, array in arrays.items()})

    return damage


@pytest.mark.parametrize(
    ("damage", "expected"),
    [
        (
            lambda path: path.write_bytes(path.read_bytes()[:100]),
            "cannot be read: File is not a zip file; copy",
        ),
        (lambda path: path.write_bytes(b""), "cannot be read: No data left in file; copy it again"),
        (_arrays(action=lambda one: one[:-1]), "action has the shape (11, 3), and the episode 12 steps; copy it again"),
        (_arrays(reward=lambda one: one[0]), "reward has the shape (), and the episode 12 steps; copy it again"),
        (_arrays(observation=lambda one: one[:5]), "observation has the shape (5, 6), and the episode 12 steps;"),
    ],
)
def test_a_damaged_episode_of_our_own_format_is_one_line_with_its_file(damage, expected, recorded, tmp_path):
    path = shutil.copytree(recorded / "own", tmp_path / "own")
    damage(path / "episodes/000001.npz")
    with pytest.raises(UsageError) as caught:
        read_recordings(path, facts(spec_from_dict(REACH).recipe(randomize=False)), {}, 3)
    assert f"000001.npz: {expected}" in str(caught.value)


def test_joints_in_degrees_are_noticed(recorded):
    joints = spec_from_dict(REACH, ["robot.control=joint"]).recipe(randomize=False)
    columns = {**COLUMNS, "joint_positions": "joints SI", "joint_velocities": "joints deg/s"}
    with pytest.raises(UsageError, match=r"joint_positions is 90 rad; .* degrees, .*joint_positions: joints deg"):
        read_recordings(recorded / "foreign", facts(joints), columns, 1)


def test_a_recording_of_another_environment_is_refused(recorded):
    slower = spec_from_dict(REACH, ["environment.substeps=20"]).recipe(randomize=False)
    with pytest.raises(UsageError, match="it has 24 steps a second, and this environment 12"):
        read_recordings(recorded / "own", facts(slower), {}, 1)
    other = spec_from_dict(REACH, ["robot.control=joint"]).recipe(randomize=False)
    with pytest.raises(UsageError, match="it was recorded in another environment: observation is"):
        read_recordings(recorded / "own", facts(other), {}, 1)


def test_behaviour_cloning_takes_no_environment_step(tmp_path):
    given = {**REACH, "demonstrations": {"file": str(lerobot(tmp_path)), "updates": 200}}
    cloned = ["training.steps=0", "agent.imitation=1", "agent.cloning=true"]
    outcome = Experiment(spec_from_dict(given, cloned)).run(tmp_path / "runs")
    folder = RunFolder.open(outcome.runs[0].folder)
    assert (folder.state().state, folder.state().steps, folder.state().updates) == ("finished", 0, 200)
    assert [test.steps for test in folder.tests()] == [0]
    assert folder.final()
    del given["demonstrations"]
    with pytest.raises(UsageError, match="nothing to learn from"):
        check_parts(spec_from_dict(given, cloned[:1]))


def test_a_folder_above_a_recording_is_told_with_the_recording_in_it(tmp_path):
    (tmp_path / "set/karolos/reach/expert-v0/data").mkdir(parents=True)
    (tmp_path / "set/karolos/reach/expert-v0/data/metadata.json").write_text("{}")
    told = "set: holds recordings, and is none itself; write .*set/karolos/reach/expert-v0$"
    with pytest.raises(UsageError, match=told):
        read_recordings(tmp_path / "set", facts(), {}, 1)
