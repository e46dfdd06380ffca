"""Arms that nobody built."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from support.rig import expert_episode

from karolos.environments.build import opened
from karolos.robots.random_arm import FAMILIES, _draws, _model, _write
from karolos.specification import load_spec

pytestmark = pytest.mark.usefixtures("quick_proposals")


@pytest.fixture(scope="module", autouse=True)
def caches(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A cache folder for the tests of this file: an arm's workspace takes seconds."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(folder))
        _model.cache_clear()
        yield folder
    _model.cache_clear()


def test_a_number_is_an_arm_and_its_files_are_made_once(caches):
    first = _model(3, "robotiq_2f85")
    text = first.urdf.read_text()
    _model.cache_clear()
    first.urdf.unlink()
    again = _model(3, "robotiq_2f85")
    assert again == first
    assert again.urdf.read_text() == text
    assert again.urdf.is_relative_to(caches)


def test_arms_are_of_all_families_and_no_two_are_alike(tmp_path):
    for number in range(12):
        _write(tmp_path / f"{number}.urdf", next(_draws(number)))
    texts = [path.read_text() for path in tmp_path.iterdir()]
    names = {text.partition('name="')[2].partition('"')[0] for text in texts}
    assert names == {family.replace(" ", "_") for family in FAMILIES}
    assert len(set(texts)) == 12


def test_an_expert_reaches_with_any_of_the_arms_that_training_draws():
    spec = load_spec("random_arm_reach", ["robot.arm=3", "randomization.robot.arm={name: choice, values: [3, 6]}"])
    with opened(spec.recipe(randomize=True)) as environment:
        drawn = set()
        for seed in range(6):
            assert expert_episode(environment, seed)[-1].success
            drawn.add(float(environment.parameters()[-1]))
    assert drawn == {3.0, 6.0}
