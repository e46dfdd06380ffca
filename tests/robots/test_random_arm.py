"""Arms that nobody built."""

from pathlib import Path

import numpy as np
import pytest
from support.rig import expert_episode

from karolos.environments.build import opened
from karolos.robots.random_arm import FAMILIES, GRIPPERS, _model
from karolos.specification import load_spec


@pytest.fixture(autouse=True)
def caches(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    _model.cache_clear()


def test_a_number_is_an_arm_and_its_files_are_made_once(tmp_path: Path) -> None:
    first = _model(3, "robotiq_2f85")
    text = first.urdf.read_text()
    assert _model(4, "robotiq_2f85").home != first.home
    _model.cache_clear()
    first.urdf.unlink()
    again = _model(3, "robotiq_2f85")
    assert again == first
    assert again.urdf.read_text() == text
    assert again.urdf.is_relative_to(tmp_path)


def test_arms_are_of_all_families_and_carry_either_gripper() -> None:
    models = [_model(number, None) for number in range(12)]
    made = {model.urdf.read_text().partition('name="')[2].partition('"')[0] for model in models}
    assert made == {family.replace(" ", "_") for family in FAMILIES}
    assert {model.gripper for model in models} == {*GRIPPERS}
    lengths = [np.linalg.norm(model.workspace.centre[:2]) for model in models]
    assert max(lengths) > 1.5 * min(lengths)


def test_an_expert_reaches_with_any_of_the_arms_that_training_draws() -> None:
    spec = load_spec("random_arm_reach", ["randomization.robot.arm={name: choice, values: [0, 2, 6]}"])
    with opened(spec.recipe(randomize=True)) as environment:
        drawn = set()
        for seed in range(8):
            assert expert_episode(environment, seed)[-1].success
            drawn.add(float(environment.parameters()[-1]))
    assert drawn == {0.0, 2.0, 6.0}
