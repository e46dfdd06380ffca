"""`karolos plugins list` and `karolos plugins show`."""

import json
import sys

import pytest
from karolos_cli.plugins import app
from support.commands import call

pytestmark = pytest.mark.usefixtures("fake_plugins")


def test_list_names_every_plugin_and_its_distribution():
    code, out, _ = call(app, "list", "--json")
    found = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    assert {
        "kind": "robot",
        "name": "arm",
        "distribution": "fakes",
        "version": "1.0",
        "target": "support.fake_plugins:Arm",
    } in found
    assert {row["kind"] for row in found} == {
        "robot", "task", "environment", "agent", "buffer", "orchestrator", "distribution",
    }  # fmt: skip


def test_list_imports_no_plugin(fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    code, out, _ = call(app, "list")
    assert code == 0
    assert "broken" in out
    assert "no_such_module_anywhere" not in sys.modules


@pytest.mark.parametrize("kind", ["robot", "robots"])
def test_kind_is_named_in_singular_or_plural(kind):
    _, out, _ = call(app, "list", kind, "--json")
    assert [json.loads(line)["name"] for line in out.splitlines()] == ["arm", "other_arm"]
    assert call(app, "show", kind, "arm")[0] == 0


def test_show_tells_docstring_and_settings():
    _, out, _ = call(app, "show", "robot", "arm")
    assert "An arm." in out
    line = next(line for line in out.splitlines() if line.startswith("step"))
    assert line.split() == ["step", "number", ">", "0", "0.05", "m", "per", "control", "step"]


def test_show_tells_nested_settings_and_required_ones():
    _, out, _ = call(app, "show", "buffer", "uniform", "--json")
    found = {row["setting"]: row for row in map(json.loads, out.splitlines())}
    assert found["hindsight"]["type"] == "mapping or null"
    assert found["hindsight.ratio"] == {
        "setting": "hindsight.ratio", "type": "number >= 0, <= 1", "required": False, "default": 0.8,
        "description": "share of relabelled transitions",
    }  # fmt: skip
    _, out, _ = call(app, "show", "distribution", "normal")
    assert "required" in out


def test_plugin_without_settings_says_so():
    assert "no settings" in call(app, "show", "buffer", "rollout")[1]
