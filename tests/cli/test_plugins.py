"""`karolos plugins list` and `karolos plugins show`."""

import sys

import pytest
from support.commands import karolos, rows

pytestmark = pytest.mark.usefixtures("fake_plugins")


def test_list_names_every_plugin_and_its_distribution():
    found = rows("plugins", "list")
    arm = {"kind": "robot", "name": "arm", "distribution": "fakes", "version": "1.0"}
    assert arm | {"target": "support.fake_plugins:Arm"} in found
    kinds = "robot task environment agent buffer orchestrator distribution"
    assert {row["kind"] for row in found} == set(kinds.split())


def test_list_imports_no_plugin(fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    assert "broken" in karolos("plugins", "list").out
    assert "no_such_module_anywhere" not in sys.modules


@pytest.mark.parametrize("kind", ["robot", "robots"])
def test_kind_is_named_in_singular_or_plural(kind):
    assert [row["name"] for row in rows("plugins", "list", kind)] == ["arm", "other_arm"]
    assert "An arm." in karolos("plugins", "show", kind, "arm").out


def test_show_tells_settings_with_nested_and_required_ones():
    lines = karolos("plugins", "show", "robot", "arm").out.splitlines()
    line = next(line for line in lines if line.startswith("step"))
    assert line.split() == ["step", "number", ">", "0", "0.05", "m", "per", "control", "step"]
    found = {row["setting"]: row for row in rows("plugins", "show", "buffer", "uniform")}
    assert found["hindsight"]["type"] == "mapping or null"
    assert found["hindsight.ratio"] == {
        "setting": "hindsight.ratio", "type": "number >= 0, <= 1", "required": False, "default": 0.8,
        "description": "share of relabelled transitions",
    }  # fmt: skip
    assert "required" in karolos("plugins", "show", "distribution", "normal").out
    assert "no settings" in karolos("plugins", "show", "buffer", "rollout").out
