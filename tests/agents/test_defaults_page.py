"""docs/defaults.md: the defaults that it explains are those of the code."""

import re
from pathlib import Path

import pytest
import yaml

from karolos.agents.ddpg import DDPG
from karolos.agents.dqn import DQN
from karolos.agents.ppo import PPO
from karolos.agents.sac import SAC
from karolos.agents.td3 import TD3
from karolos.buffers.hindsight import Hindsight
from karolos.buffers.priority import Priority
from karolos.buffers.uniform import Uniform
from karolos.specification.model import TrainingSettings

SETTINGS = {
    "sac": SAC.Settings,
    "td3": TD3.Settings,
    "ddpg": DDPG.Settings,
    "dqn": DQN.Settings,
    "ppo": PPO.Settings,
    "uniform": Uniform.Settings,
    "priority": Priority.Settings,
    "hindsight": Hindsight.Settings,
    "training": TrainingSettings,
}
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
    assert SETTINGS[part].model_fields[name].default == yaml.safe_load(value)
