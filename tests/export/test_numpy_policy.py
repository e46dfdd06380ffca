"""The reader of exported policies: by itself, without karolos; and what the documentation says of the format."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from karolos_deploy import policy as numpy_policy
from support.exported_policies import trained

from karolos.export import NumpyPolicy
from karolos.export.export import export_policy

pytestmark = pytest.mark.xdist_group("exported policies")  # which a process trains once

DOCS = Path(__file__).parents[2] / "docs" / "export.md"
ALONE = """
import sys
sys.path.insert(0, sys.argv[1])
import numpy as np
from numpy_policy import NumpyPolicy
golden = np.load("golden.npz")
found = NumpyPolicy("policy.npz")(golden["observation"], golden["desired_goal"])
assert np.abs(found - golden["action"]).max() < 1e-5
assert not {"karolos", "torch", "pydantic"} & set(sys.modules)
"""


def exported(case: str, folder: Path) -> Path:
    export_policy(trained(case), folder, checkpoint="last", onnx=False)
    return folder


def test_its_file_alone_with_numpy_is_enough(tmp_path):
    exported("dqn_dueling", tmp_path)
    alone = tmp_path / "alone"
    alone.mkdir()
    (alone / "numpy_policy.py").write_text(Path(numpy_policy.__file__).read_text())
    subprocess.run([sys.executable, "-I", "-c", ALONE, str(alone)], cwd=tmp_path, check=True)


@pytest.mark.parametrize("case", ["sac", "ppo", "dqn_dueling"])
def test_the_code_in_the_documentation_acts_as_the_agent_does(case, tmp_path, monkeypatch):
    blocks = re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.DOTALL)
    assert len(blocks) == 3
    monkeypatch.chdir(exported(case, tmp_path))
    golden = np.load("golden.npz")
    for block, expected in ((blocks[0], golden["action"][0]), (blocks[1], golden["action"])):
        names: dict[str, object] = {}
        exec(block, names)
        np.testing.assert_allclose(names["action"], expected, atol=1e-5)


def test_the_onnx_code_in_the_documentation_acts_as_the_agent_does(tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    export_policy(trained("sac"), tmp_path, checkpoint="last")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    exec(re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.DOTALL)[2], names)
    np.testing.assert_allclose(names["action"], np.load("golden.npz")["action"], atol=1e-5)


def test_inputs_of_another_size_are_refused(tmp_path):
    policy = NumpyPolicy(exported("sac", tmp_path) / "policy.npz")
    with pytest.raises(ValueError, match="have 3 numbers, the policy takes 4"):
        policy(np.zeros(3), np.zeros(0))
    for observation, goal, sizes in ((4, 0, "4 and 0"), (0, 4, "0 and 4")):
        with pytest.raises(ValueError, match=f"have {sizes} numbers, the policy takes at least 2 and 2"):
            policy(np.zeros(observation), np.zeros(goal))


def test_a_file_of_another_format_is_refused(tmp_path):
    np.savez(tmp_path / "newer.npz", format=np.int64(4))
    np.savez(tmp_path / "other.npz", weights=np.zeros(3))
    for name, told in (("newer", "format 4"), ("other", "format None")):
        with pytest.raises(ValueError, match=told):
            NumpyPolicy(tmp_path / f"{name}.npz")
