"""The specs that ship, with the plugins that ship."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from karolos.specification import load_spec, spec_from_dict
from karolos.specification.files import read, shipped_text
from karolos.specification.schema import spec_schema
from karolos.training.assembly import check_parts

SPECS = Path(__file__).parents[2] / "specs"
SUITES = [SPECS / "all_tasks.yaml", SPECS / "smoke" / "toy_suite.yaml"]
RUNNABLE = sorted({*SPECS.glob("*.yaml"), *SPECS.glob("smoke/*.yaml")}.difference(SUITES))
ALL = sorted({*SPECS.rglob("*.yaml")}.difference(SUITES))


def test_there_are_specs_to_test():
    assert {"panda_reach.yaml", "toy.yaml"} <= {path.name for path in RUNNABLE}


@pytest.mark.parametrize("path", RUNNABLE, ids=lambda path: str(path.relative_to(SPECS)))
def test_shipped_spec_is_right_and_loads_again(path):
    spec = load_spec(path)
    assert spec_from_dict(spec.dump()) == spec
    assert set(spec.origins.values()) != {"default"}


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(SPECS)))
def test_shipped_spec_fits_the_schema(path):
    schema, broken = spec_schema()
    assert not broken
    node, problems = read(path.read_text("utf-8"), path.name)
    assert not problems
    assert node is not None
    wrong = sorted(error.json_path for error in Draft202012Validator(schema).iter_errors(node.plain()))
    needs_base = path.parent.name == "bases"  # a base may leave robot and task to the spec that extends it
    assert [place for place in wrong if not (needs_base and place == "$")] == []


GENERAL = {"ppo": "reach push pick_place throw", "sac_grasp": "push pick_place throw"}
"""The tasks of bases that set none."""
GENERAL["sac_hindsight"] = GENERAL["ppo"]


@pytest.mark.parametrize("base", sorted(path.stem for path in SPECS.glob("bases/*.yaml")))
def test_base_needs_nothing_but_a_robot_and_a_task(tmp_path, base):
    for task in GENERAL.get(base, "").split() or [None]:
        (tmp_path / "mine.yaml").write_text(
            f"extends: karolos:bases/{base}.yaml\nrobot: panda\n{f'task: {task}' if task else ''}\n"
        )
        check_parts(load_spec(tmp_path / "mine.yaml"))


def test_shipped_spec_is_found_by_name_and_a_file_comes_first(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shipped = load_spec("panda_reach")
    assert shipped == load_spec(SPECS / "panda_reach.yaml") == load_spec("karolos:panda_reach.yaml")
    assert shipped.text == (SPECS / "panda_reach.yaml").read_text("utf-8")
    assert shipped.origins["robot.name"].startswith("karolos:panda_reach.yaml:3:")
    Path("panda_reach").write_text("extends: karolos:panda_push.yaml\nseeds: [7]\n")
    assert (load_spec("panda_reach").seeds, load_spec("panda_reach").task.name) == ((7,), "push")
    assert load_spec("karolos:panda_reach") == shipped


@pytest.mark.parametrize("path", ALL, ids=lambda path: str(path.relative_to(SPECS)))
def test_copy_of_a_shipped_spec_is_the_same_spec(tmp_path, path):
    name = str(path.relative_to(SPECS).with_suffix(""))
    copied = tmp_path / path.name
    copied.write_text(shipped_text(name))
    if path in RUNNABLE:
        assert load_spec(copied) == load_spec(path)


def test_environments_are_described_without_torch_or_an_engine():
    code = (
        "import sys; from karolos.specification.parts import Part\n"
        "for kind, name in [('environments', 'toy'), ('robots', 'panda'), ('tasks', 'reach')]:\n"
        "    Part.of(kind, name, {})\n"
        "import karolos.specification\n"
        "assert not {'torch', 'pybullet', 'mujoco', 'sqlalchemy', 'typer'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_override_of_a_name_keeps_the_settings_that_both_plugins_have_and_origins_tell():
    path = SPECS / "panda_reach.yaml"
    before, after = load_spec(path), load_spec(path, ["buffer.name=priority"])
    assert after.buffer.name == "priority"
    assert after.buffer.settings.hindsight == before.buffer.settings.hindsight
    assert after.buffer.settings.hindsight is not None
    assert "bases/sac_hindsight.yaml" in after.origins["buffer.hindsight.ratio"]
    agent = load_spec(path, ["agent.noise.kind=gaussian", "agent.tau=0.1", "agent.name=td3"]).agent
    assert agent.settings.learning_rate == before.agent.settings.learning_rate
    assert agent.settings.tau == 0.1
    assert agent.settings.noise.std == 0.2  # td3's own: its noise has another type
