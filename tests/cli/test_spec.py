"""`karolos spec`."""

import json

import pytest
from jsonschema import Draft202012Validator
from support.commands import karolos, refused, rows

from karolos.specification import load_spec

pytestmark = pytest.mark.usefixtures("fake_plugins")


@pytest.fixture
def spec(tmp_path):
    path = tmp_path / "try.yaml"
    path.write_text("robot: arm\ntask: reach\nagent: {name: learner, discount: 0.5}\n")
    return path


def test_every_spec_that_ships_is_listed_and_copied(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {row["name"] for row in rows("spec", "list")}
    assert {"panda_reach", "bases/sac_grasp", "smoke/toy"} <= names
    assert karolos("spec", "copy", "smoke/transfer_pick").out == "transfer_pick.yaml\n"
    text = (tmp_path / "transfer_pick.yaml").read_text()
    assert "extends: [karolos:transfer_pick.yaml, karolos:smoke/panda_pick.yaml]" in text
    missing = "nowhere/x.yaml: there is no folder nowhere; make it, or name another file\n"
    for name, file, told in (
        ("panda_reach", "transfer_pick.yaml", "exists already"),
        ("panda_raech", "x.yaml", "did you mean panda_reach?"),
        ("panda_reach", "nowhere/x.yaml", missing),
    ):
        assert told in refused("spec", "copy", name, file)


def test_show_prints_a_spec_that_loads_as_the_same(spec):
    told = karolos("spec", "show", spec, "seeds=[3]")
    assert told.err == ""
    again = spec.with_name("again.yaml")
    again.write_text(told.out)
    assert load_spec(again) == load_spec(spec, ["seeds=[3]"])
    error = refused("spec", "show", spec, "agent.discount=2")
    assert error.startswith("override agent.discount=2: agent.discount: should be less than 1")


def test_show_tells_where_each_value_comes_from(spec):
    lines = [line.split() for line in karolos("spec", "show", spec, "seeds=[3]", "--origin").out.splitlines()]
    told = {line[0]: (line[2], " ".join(line[4:])) for line in lines}
    found = {row["path"]: row for row in rows("spec", "show", spec, "seeds=[3]")}
    for path, value, origin in (
        ("agent.discount", 0.5, f"{spec}:3:34"),
        ("seeds", [3], "override seeds=[3]"),
        ("buffer.name", "uniform", "default"),
    ):
        assert told[path] == (str(value), origin)
        assert found[path] == {"path": path, "value": value, "origin": origin}
    assert found["buffer.hindsight"]["value"] is None


def test_schema_is_printed_and_broken_plugins_are_warned_of(fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    told = karolos("spec", "schema")
    Draft202012Validator.check_schema(json.loads(told.out))
    assert told.err.startswith("warning: left out: robot 'broken'")
