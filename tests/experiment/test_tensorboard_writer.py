"""What a run writes into TensorBoard; what its agents say is tested with them."""

import re
from pathlib import Path

import pytest
from support.listeners import stopping_at
from support.toy_runs import run_of, toy
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData

from karolos.records import RunFolder

pytestmark = pytest.mark.xdist_group(__name__)

TOY = toy(buffer={"name": "priority"}, training={"steps": 240}, testing={"interval": 100, "episodes": 6})


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> RunFolder:
    """Of a finished run."""
    return run_of(TOY, tmp_path_factory.mktemp("runs"))


def series(folder: RunFolder) -> EventAccumulator:
    found = EventAccumulator(str(folder.tensorboard))
    found.Reload()
    return found


def points(folder: RunFolder, name: str) -> list[tuple[int, float]]:
    return [(event.step, event.value) for event in series(folder).Scalars(name)]


def test_every_series_is_listed_in_the_docs_and_every_one_that_is_listed_is_there(folder):
    page = (Path(__file__).parents[2] / "docs" / "tensorboard.md").read_text()
    listed = set(re.findall(r"^\| `(\w+/\w+)`", page, re.MULTILINE))
    tags = set(series(folder).Tags()["scalars"])
    assert tags <= listed
    assert all(tag.startswith("agent/") for tag in listed - tags), "those of other agents"


def test_a_test_stands_at_the_step_at_which_it_was_made_and_says_what_the_folder_says(folder):
    found = [(test.steps, pytest.approx(test.success_any)) for test in folder.tests()]
    assert points(folder, "test/success_any") == found
    assert [step for step, _ in found] == [100, 200, 240]


def test_a_run_that_was_resumed_has_the_points_of_one_that_was_not(folder, tmp_path):
    run_of(TOY, tmp_path, listener=stopping_at(200))
    resumed = run_of(TOY, tmp_path, existing="resume")
    for name in ("test/success_any", "buffer/transitions"):
        assert points(resumed, name) == points(folder, name)


def test_between_two_tests_there_are_ten_points(folder):
    steps = [step for step, _ in points(folder, "buffer/transitions")]
    assert sum(100 < step <= 200 for step in steps) == 10
    assert points(folder, "buffer/transitions")[-1] == (240, 240)


def test_settings_are_written_once_for_hparams(folder):
    content = series(folder).SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    settings = HParamsPluginData.FromString(content).session_start_info.hparams
    assert settings["agent.name"].string_value == "sac"
    assert settings["training.steps"].number_value == 240
