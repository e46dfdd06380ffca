"""Bundles: complete, readable by others, and enough to port a policy without a line of our code."""

import re
import subprocess
import sys

import numpy as np
import pytest
import yaml
from support.bundles import bundle_of
from support.exported_policies import trained

from karolos.errors import UsageError
from karolos.export.bundle import export_bundle
from karolos.records import RunFolder
from karolos.records.shipped import FOLDER

pytestmark = pytest.mark.xdist_group("bundle")


def test_the_yaml_has_the_keys_that_leapp_s_readers_need():
    insert = bundle_of("ur5_insert")
    assert (insert / "film.mp4").stat().st_size > 1000
    told = yaml.safe_load((insert / "policy.yaml").read_text())
    policy = told["models"]["policy"]
    assert [one["name"] for one in policy["inputs"]] == told["pipeline"]["inputs"]["policy"]
    assert [one["shape"] for one in policy["inputs"] + policy["outputs"]] == [[1, 36], [1, 6], [1, 6]]
    assert told["pipeline"]["configs"] == {"frequency": 12.0}
    assert told["system information"]["leapp config version"] == "1.3"
    assert [len(one["element_names"][1]) for one in policy["inputs"]] == [36, 6]
    subprocess.run(["sha256sum", "--quiet", "-c", "SHA256SUMS"], cwd=insert, check=True)


@pytest.mark.parametrize("name", ["ur5_insert", "ur5_pick"])
def test_from_the_page_alone_a_reading_becomes_the_observation_and_the_recorded_action(name):
    """Reads the tables of the page as a person would, and uses neither karolos nor karolos-deploy."""
    insert = bundle_of(name)
    page = (insert / "README.md").read_text()
    rows = [line.strip("| ").split(" | ") for line in page.splitlines() if line.startswith("| ")]
    base = [float(x) for x in re.search(r"base\s+stands at ([^i]+) in the world", page)[1].split()]
    links = [
        [float(x) for x in f"{row[1]} {row[2]}".split()] for row in rows if len(row) == 3 and len(row[2].split()) == 9
    ]
    inputs = [row for row in rows if len(row) == 6 and re.fullmatch(r"\d+( to \d+)?", row[0])]
    known = dict(np.load(insert / "episode.npz"))
    for step in (0, 10, 20):
        p, rotation, origins, axes = np.array(base), np.eye(3), [], []
        for place, link in enumerate(links):
            p, rotation = p + rotation @ link[:3], rotation @ np.reshape(link[3:], (3, 3))
            if place < len(links) - 1:
                origins.append(p)
                axes.append(rotation[:, 2])
                k, s = np.cos(known["positions"][step][place]), np.sin(known["positions"][step][place])
                rotation = rotation @ [[k, -s, 0], [s, k, 0], [0, 0, 1]]
        turning = np.cross(axes, p - origins).T @ known["velocities"][step]
        by_words = {
            "p of the kinematics": p,
            "J_v w": turning,
            "distance of the pads": known["opening"][step : step + 1],
            "way from the tool to the set point": known["set_point"][step],
            "the wrench, both parts turned by R": np.hstack(
                [rotation @ part for part in np.split(known["wrench"][step], 2)]
            ),
            "1 once": known["overloaded"][step : step + 1],
            **{f"from cameras {one}": known.get(f"measured_{one}", [[]] * 30)[step] for _, one, *_ in inputs},
        }
        found: dict[str, np.ndarray] = {}
        for _, field, _, _, _, how in inputs:
            told = f"from cameras {field}" if how.startswith("from cameras") else how
            simple = [value for words, value in by_words.items() if told.startswith(words)]
            terms = re.findall(r"\((\w+)\[(\d)\] \+ (\S+)\) / ([\d.]+)", how)
            if simple:
                found[field] = np.asarray(simple[0])
            elif terms:
                found[field] = np.tanh([(found[one][int(at)] + float(add)) / float(by) for one, at, add, by in terms])
            else:
                first, second = how.split(" - ")
                found[field] = found[first] - found[second]
        observation = np.concatenate([*found.values()])
        np.testing.assert_allclose(observation, known["observation"][step], atol=1e-4)
        runtime = pytest.importorskip("onnxruntime")
        session = runtime.InferenceSession(str(insert / "policy.onnx"), providers=["CPUExecutionProvider"])
        given = {"observation": observation[None].astype(np.float32), "desired_goal": known["desired_goal"][step][None]}
        (action,) = session.run(["action"], given)
        np.testing.assert_allclose(action[0], known["action"][step], atol=1e-4)


def test_what_is_no_arm_and_folders_of_others_are_refused(tmp_path):
    with pytest.raises(UsageError, match="moves an arm"):
        export_bundle(trained("sac"), tmp_path / "out", checkpoint="last")
    with pytest.raises(UsageError, match="a release within a control step"):
        export_bundle(RunFolder.open(FOLDER / "ur5_throw"), tmp_path / "out")
    for name in ("README.md", "thesis.tex"):
        (folder := tmp_path / name.lower()).mkdir()
        (folder / name).write_text("years of work")
        with pytest.raises(UsageError, match=rf"holds {name}"):
            export_bundle(RunFolder.open(FOLDER / "ur5_reach"), folder)
        assert (folder / name).read_text() == "years of work"


@pytest.mark.parametrize("change", ["robot.latency=0.02", "robot.jitter=0.01", "robot.observation_noise=0.001"])
def test_errors_of_a_cell_that_a_replay_cannot_repeat_are_refused(change, tmp_path):
    with pytest.raises(UsageError, match=f"a bundle cannot have {change.partition('=')[0]}; leave it out"):
        export_bundle(RunFolder.open(FOLDER / "ur5_reach"), tmp_path / "out", [change])
    assert not (tmp_path / "out").exists()


def test_the_executor_imports_neither_karolos_nor_anything_heavy():
    heavy = "{'karolos', 'torch', 'pydantic', 'scipy'}"
    code = f"import sys, karolos_deploy.command; print([*{heavy} & set(sys.modules)])"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).strip() == "[]"
