"""docs/defaults.md: the defaults that it explains are those of the code."""

import re
from pathlib import Path

import pytest
import yaml

from karolos.buffers.hindsight import Hindsight
from karolos.registry import load
from karolos.specification.model import TrainingSettings

PAGE = Path(__file__).parents[2] / "docs" / "defaults.md"
ROWS = re.findall(r"^\| `(\w+)` \| `(\w+): ([^`]+)` \|", PAGE.read_text(), re.MULTILINE)


def test_the_page_lists_what_surprises_most():
    listed = {(part, name) for part, name, _ in ROWS}
    assert listed >= {
        ("sac", "entropy_in_target"),
        ("sac", "clip_targets"),
        ("sac", "random_actions"),
        ("dqn", "epsilon_steps"),
        ("hindsight", "min_displacement"),
    }


@pytest.mark.parametrize(("part", "name", "value"), ROWS)
def test_a_default_on_the_page_is_that_of_the_code(part, name, value):
    others = {"hindsight": Hindsight.Settings, "training": TrainingSettings}
    settings = others.get(part) or load("buffers" if part in ("uniform", "priority") else "agents", part).Settings
    assert settings.model_fields[name].default == yaml.safe_load(value)
