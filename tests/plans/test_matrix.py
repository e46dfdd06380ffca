"""A matrix of transfers: what is run, what is refused, and that nothing is run twice."""

import os
import shutil
import signal
from pathlib import Path

import pytest
from support.fake_launcher import FakeLauncher
from support.transfer_samples import LINE, line, run_matrix

from karolos.errors import RunError, SpecError, UsageError
from karolos.plans.matrix import Matrix
from karolos.plans.matrix_report import transfer_report
from karolos.records import RunFolder
from karolos.records.run_folder import STOP, TRANSFERS
from karolos.specification import load_spec, spec_from_dict
from karolos.store import Store, check

pytestmark = pytest.mark.xdist_group("transfer")

TIMES = ("seconds", "source_runs", "fine_tuned_runs", "runs")


def numbers(found: Matrix) -> list[object]:
    """The rows of the report without times and ids of runs."""

    def plain(value: object) -> object:
        if isinstance(value, dict):
            return {key: plain(one) for key, one in value.items() if key not in TIMES}
        return value

    return [plain(row) for row in transfer_report(found).rows()]


def test_every_source_is_an_ordinary_run_and_fine_tuning_starts_from_its_best_policy(undisturbed):
    sources, tuned = undisturbed.sources, undisturbed.fine_tuned
    assert {label: list(runs) for label, runs in sources.items()} == {"fast": [0, 1], "slow": [0, 1]}
    assert {pair: list(runs) for pair, runs in tuned.items()} == {("fast", "slow"): [0, 1], ("slow", "fast"): [0, 1]}
    for (source, target), runs in tuned.items():
        for seed, folder in runs.items():
            (event,) = [one for one in folder.events() if one["event"] == "started_from"]
            assert (event["run"], event["checkpoint"]) == (sources[source][seed].id, "best")
            assert folder.spec()["environment"] == sources[target][seed].spec()["environment"]
            assert (folder.description()["name"], folder.summary().steps) == (f"line-{source}-to-{target}", 80)
            assert folder.description()["seed"] == seed
    assert [test.steps for test in tuned["fast", "slow"][0].tests()] == [20, 40, 60, 80]
    runs_folder = undisturbed.folder.parents[1]
    with Store(Store.default_url(runs_folder)) as store:
        assert len(store.runs()) == 8
        assert list(check(store, runs_folder)) == []


def test_zero_shot_tests_are_those_of_karolos_test(undisturbed):
    folder, found = undisturbed.sources["fast"][1], undisturbed.zero_shot["fast", "slow"][1]
    assert folder.transfers().rows == (found,)
    assert (found.overrides, found.checkpoint, found.seed) == (("environment.speed=0.15",), "best", 1_000_000)


def test_a_finished_matrix_is_reported_again_without_a_run_or_a_test(undisturbed):
    runs = undisturbed.folder.parents[1]
    with pytest.raises(UsageError, match=r"matrix line exists: 4 of 4 sources are finished; --resume continues"):
        run_matrix(runs)
    again, _, started = run_matrix(runs, resume=True)
    assert started == []
    assert len(again.sources["fast"][0].transfers().rows) == 1
    assert len((again.folder / "baselines.jsonl").read_text().splitlines()) == 2
    assert numbers(again) == numbers(undisturbed)


def test_a_finished_run_of_another_name_with_the_settings_of_a_source_is_not_trained_again(undisturbed, runs):
    source = RunFolder.open(runs / undisturbed.sources["fast"][0].id)
    other = source.path.rename(source.path.with_name(source.path.name.replace("line-fast", "other")))
    (other / "run.json").write_text((other / "run.json").read_text().replace('"line-fast', '"other'))
    found, outcome, started = run_matrix(runs, resume=True)
    assert found.sources["fast"][0].id == other.name
    assert found.sources["fast"][1].id == undisturbed.sources["fast"][1].id
    assert (outcome.exit_code, started) == (0, [])


@pytest.fixture
def runs(undisturbed: Matrix, tmp_path: Path) -> Path:
    """The runs folder of that matrix, once more."""
    return shutil.copytree(undisturbed.folder.parents[1], tmp_path / "runs")


def untested(runs: Path, sources: dict[int, RunFolder]) -> list[Path]:
    """Remove the zero-shot tests of some sources; returns their files."""
    paths = [RunFolder.open(runs / source.id).path / TRANSFERS for source in sources.values()]
    for path in paths:
        path.unlink()
    return paths


def test_a_matrix_killed_in_the_middle_and_resumed_reports_as_an_undisturbed_one(undisturbed, runs):
    """It was killed in the first run of the second pair. tests/torture kills runs at every other moment."""
    shutil.rmtree(runs / undisturbed.fine_tuned["slow", "fast"][1].id)
    RunFolder.open(runs / undisturbed.fine_tuned["slow", "fast"][0].id).set_state("running", steps=40)
    found, _, started = run_matrix(runs, resume=True)
    assert started == ["line-slow-to-fast"] * 2
    assert numbers(found) == numbers(undisturbed)
    assert len(list(runs.glob("*/run.json"))) == 8


@pytest.mark.parametrize("blind", [False, True])
def test_a_test_whose_process_died_is_played_again_once(undisturbed, runs, blind):
    untested(runs, undisturbed.sources["fast"])
    launcher = FakeLauncher(True, True, False, blind=blind)
    found, outcome, started = run_matrix(runs, resume=True, launcher=launcher)
    assert started == ["(line-fast-to-slow)"] * 3
    assert [folder.name for folder in launcher.started] == [f"line-fast-to-slow-s{seed}" for seed in (0, 0, 1)]
    assert found.problems == ["the test of fast to slow, seed 0: its process died, 2 times"]
    assert (list(found.zero_shot["fast", "slow"]), outcome.exit_code) == ([1], 1)
    assert not (found.folder / "tests").exists()
    found, outcome, started = run_matrix(runs, resume=True, launcher=FakeLauncher(blind=blind))
    assert (started, outcome.exit_code) == (["(line-fast-to-slow)"], 0)
    assert numbers(found) == numbers(undisturbed)


def test_a_stop_breaks_tests_off_and_nothing_is_written(undisturbed, runs):
    results = untested(runs, undisturbed.sources["fast"])

    class Stopping(FakeLauncher):
        def start(self, folder: Path) -> None:
            (folder / STOP).write_text("stopped")
            super().start(folder)
            os.kill(os.getpid(), signal.SIGTERM)

    found, outcome, started = run_matrix(runs, resume=True, launcher=Stopping())
    assert (started, outcome.exit_code, found.problems) == (["(line-fast-to-slow)"], 143, [])
    assert not any(path.exists() for path in results)
    found, _, _ = run_matrix(runs, resume=True)
    assert numbers(found) == numbers(undisturbed)


def test_a_source_without_its_checkpoint_is_named_before_anything_runs(undisturbed, runs):
    folder = RunFolder.open(runs / undisturbed.sources["slow"][1].path.name)
    shutil.rmtree(folder.checkpoints / "best")
    with pytest.raises(RunError, match=rf"^{folder.id}: the source has no checkpoint 'best'; .*karolos runs rm"):
        run_matrix(runs, resume=True)


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["transfer={robots: [panda, ur5, panda], variants: null}"], ["names the robot panda twice"]),
        (["transfer.variants.slow.environment.speed=0.3"], ["fast and slow have the same settings"]),
        (["transfer.variants.slow=null"], ["needs two variants or more"]),
        (["transfer.modes=[zero_shot]"], ["no mode uses fine_tune"]),
        (["transfer.modes=[scratch]", "transfer.fine_tune={}"], ["transfers nothing"]),
        (
            ["transfer.variants.slow.agent.discount=0.5"],
            ["variants.slow.agent.discount: a variant cannot change agent.discount, only robot, task"],
        ),
        (
            ["transfer.variants.a/b={environment.speed: 0.2}"],
            ["'a/b' is not allowed; a variant has at most 24 letters"],
        ),
        (["transfer.sources=[fats]"], ["fats is not a variant; variants are fast, slow"]),
        (["transfer.sources=[]"], ["needs a source"]),
        (["transfer.references=[slow]", "transfer.modes=[zero_shot, fine_tune]"], ["references that no mode uses"]),
        (["transfer.fine_tune.testing.episodes=5"], ["fine_tune cannot change testing.episodes"]),
    ],
)
def test_a_matrix_that_makes_no_sense_is_an_invalid_spec(overrides, words):
    with pytest.raises(SpecError) as caught:
        line(*overrides)
    assert len(caught.value.problems) == 1
    assert all(word in str(caught.value) for word in words), caught.value


def test_settings_that_are_misspelt_or_that_transfers_do_not_change_are_shown_where_they_stand(tmp_path):
    path, begin = tmp_path / "line.yaml", "environment: toy\nagent: sac\ntransfer:\n  variants:\n"
    path.write_text(f"{begin}    a: {{environment.speed: 0.1}}\n    b: {{environment.sped: 2}}\n")
    with pytest.raises(SpecError, match=r"line\.yaml:6:\d+: environment.sped: no such key; did you mean 'speed'\?"):
        Matrix(load_spec(path))
    others = "  fine_tune:\n    training.steps: 80\n    robot.tool_step: 5\n"
    path.write_text(f"{begin}    a: {{environment.speed: 0.1}}\n    b: {{agent.tau: 0.1}}\n{others}")
    with pytest.raises(SpecError) as caught:
        load_spec(path)
    assert [str(one.where).removeprefix(f"{path}:") for one in caught.value.problems] == ["6:9", "9:5"]


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["transfer.variants.slow.environment.dimensions=2"], "a policy of fast cannot act on slow: observation is"),
        (["transfer.fine_tune.agent.hidden=[8]"], "transfer.fine_tune: the run's networks differ: agent.hidden is [8]"),
        (["name=" + 56 * "n"], "which is longer than 64 characters"),
        (["transfer.variants.slow={environment.max_steps: 9, environment.speed: 0.15}"], "give every variant the same"),
        (["transfer=null"], "has no transfer"),
    ],
)
def test_what_cannot_work_is_refused_before_anything_runs(tmp_path, overrides, words):
    with pytest.raises(UsageError) as caught:
        run_matrix(tmp_path / "runs", *overrides)
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "runs").exists()


def test_joint_control_is_refused_in_one_line_that_says_what_could_be_done():
    changes = {"robot": {"name": "panda", "control": "joint"}, "task": "reach", "environment": "robot_task"}
    spec = spec_from_dict({**LINE, **changes, "transfer": {"robots": ["panda", "ur5"]}})
    with pytest.raises(UsageError, match=r"policy of panda cannot act on ur5: .*set robot\.control=cartesian"):
        Matrix(spec).check()


def arms(file: str) -> Matrix:
    variants = {"ur5": {"robot.name": "ur5"}, "other": {"robot.name": "urdf", "robot.file": file}}
    variants["iiwa"] = {"robot.name": "iiwa"}
    part = {"robot": {"name": "ur5", "control": "cartesian"}, "task": "reach", "environment": "robot_task"}
    return Matrix(spec_from_dict({**LINE, **part, "transfer": {"variants": variants, "sources": ["ur5"]}}))


def test_a_target_that_cannot_be_used_is_named_and_the_others_go_on(tmp_path):
    matrix = arms(str(tmp_path / "none.urdf"))
    matrix.check()
    assert matrix.pairs == [("ur5", "iiwa")]
    assert matrix.refused == {
        "other": f"there is no file {tmp_path / 'none.urdf'}; name a URDF or an MJCF file; in a spec relative to it, "
        "in an override to the current folder"
    }


def test_a_matrix_without_a_usable_target_says_why():
    matrix = arms("installed:nothing/none.urdf")
    matrix.variants.pop("iiwa")
    matrix.pairs = [("ur5", "other")]
    with pytest.raises(UsageError, match=r"no target can be used: there is no file .*; pip install nothing"):
        matrix.check()
