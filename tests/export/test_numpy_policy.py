"""The reader of exported policies: by itself, without karolos; and what the documentation says of the format."""

import re
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from karolos_deploy import policy as numpy_policy
from support.exported_policies import exported

from karolos.export import NumpyPolicy

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


def test_its_file_alone_with_numpy_is_enough(tmp_path):
    (tmp_path / "numpy_policy.py").write_text(Path(numpy_policy.__file__).read_text())
    folder = exported("dqn_dueling").folder
    subprocess.run([sys.executable, "-I", "-c", ALONE, str(tmp_path)], cwd=folder, check=True)


@pytest.mark.parametrize(("case", "block"), [*product(("sac", "ppo", "dqn_dueling"), (0, 1)), ("sac", 2)])
def test_the_code_in_the_documentation_acts_as_the_agent_does(case, block, monkeypatch):
    if block == 2:
        pytest.importorskip("onnx")
        pytest.importorskip("onnxruntime")
    blocks = re.findall(r"```python\n(.*?)```", DOCS.read_text(), re.DOTALL)
    assert len(blocks) == 3
    monkeypatch.chdir(exported(case).folder)
    names: dict[str, object] = {}
    exec(blocks[block], names)
    action = np.load("golden.npz")["action"]
    np.testing.assert_allclose(names["action"], action if block else action[0], atol=1e-5)


def test_inputs_of_another_size_are_refused():
    policy = NumpyPolicy(exported("sac").folder / "policy.npz")
    with pytest.raises(ValueError, match="have 3 numbers, the policy takes 4"):
        policy(np.zeros(3), np.zeros(0))
    for observation, goal, sizes in ((4, 0, "4 and 0"), (0, 4, "0 and 4")):
        with pytest.raises(ValueError, match=f"have {sizes} numbers, the policy takes at least 2 and 2"):
            policy(np.zeros(observation), np.zeros(goal))
    for rows, others in (((3, 2), (2,)), ((2,), (3, 2)), ((2, 2), (3, 2)), ((), (2,))):
        with pytest.raises(ValueError, match=r"have the shapes .* and .*; both are one row, or as many rows"):
            policy(np.zeros(rows), np.zeros(others))


def test_a_file_of_another_format_is_refused(tmp_path):
    np.savez(tmp_path / "newer.npz", format=np.int64(4))
    np.savez(tmp_path / "other.npz", weights=np.zeros(3))
    for name, told in (("newer", "format 4"), ("other", "format None")):
        with pytest.raises(ValueError, match=told):
            NumpyPolicy(tmp_path / f"{name}.npz")
