"""`karolos spec`."""

import json

import pytest
from jsonschema import Draft202012Validator
from karolos_cli.spec import app
from support.commands import call

from karolos.specification import load_spec

pytestmark = pytest.mark.usefixtures("fake_plugins")


@pytest.fixture
def spec(tmp_path):
    path = tmp_path / "try.yaml"
    path.write_text("robot: arm\ntask: reach\nagent: {name: learner, discount: 0.5}\n")
    return path


def test_every_spec_that_ships_is_listed_and_copied(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = [json.loads(line) for line in call(app, "list", "--json")[1].splitlines()]
    assert {"panda_reach", "bases/sac_grasp", "smoke/toy"} <= {row["name"] for row in rows}
    assert call(app, "copy", "smoke/transfer_pick")[:2] == (0, "transfer_pick.yaml\n")
    text = (tmp_path / "transfer_pick.yaml").read_text()
    assert "extends: [karolos:transfer_pick.yaml, karolos:smoke/panda_pick.yaml]" in text
    code, _, err = call(app, "copy", "panda_reach", "transfer_pick.yaml")
    assert (code, "exists already" in err) == (2, True)
    code, _, err = call(app, "copy", "panda_raech", "x.yaml")
    assert (code, "did you mean panda_reach?" in err) == (2, True)
    code, _, err = call(app, "copy", "panda_reach", "nowhere/x.yaml")
    assert (code, err) == (2, "nowhere/x.yaml: there is no folder nowhere; make it, or name another file\n")


def test_show_prints_a_spec_that_loads_as_the_same(spec):
    code, out, err = call(app, "show", str(spec), "seeds=[3]")
    assert (code, err) == (0, "")
    again = spec.with_name("again.yaml")
    again.write_text(out)
    assert load_spec(again) == load_spec(spec, ["seeds=[3]"])


def test_origin_tells_where_each_value_comes_from(spec):
    _, out, _ = call(app, "show", str(spec), "seeds=[3]", "--origin")
    lines = [line.split() for line in out.splitlines()]
    found = {line[0]: (line[2], " ".join(line[4:])) for line in lines}
    assert found["agent.discount"] == ("0.5", f"{spec}:3:34")
    assert found["seeds"] == ("[3]", "override seeds=[3]")
    assert found["buffer.name"] == ("uniform", "default")


def test_json_gives_value_and_origin_per_row(spec):
    _, out, _ = call(app, "show", str(spec), "--json")
    found = {row["path"]: row for row in map(json.loads, out.splitlines())}
    assert found["agent.discount"] == {"path": "agent.discount", "value": 0.5, "origin": f"{spec}:3:34"}
    assert found["seeds"]["value"] == [0]
    assert found["buffer.hindsight"] == {"path": "buffer.hindsight", "value": None, "origin": "default"}


def test_bad_spec_prints_its_problems_and_nothing_else(spec):
    code, out, err = call(app, "show", str(spec), "agent.discount=2")
    assert (code, out) == (2, "")
    assert err.startswith("override agent.discount=2: agent.discount: should be less than 1")


def test_schema_is_printed_and_broken_plugins_are_warned_of(fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    code, out, err = call(app, "schema")
    assert code == 0
    Draft202012Validator.check_schema(json.loads(out))
    assert err.startswith("warning: left out: robot 'broken'")
