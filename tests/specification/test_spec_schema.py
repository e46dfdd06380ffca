"""The JSON Schema for editors."""

from __future__ import annotations

import pytest
from jsonschema import Draft202012Validator

from karolos.specification.files import read
from karolos.specification.schema import spec_schema


def valid(text: str) -> bool:
    schema, _ = spec_schema()
    node, _ = read(text, "s")
    assert node is not None
    return Draft202012Validator(schema).is_valid(node.plain())


def test_schema_is_a_schema(fake_plugins):
    schema, broken = spec_schema()
    Draft202012Validator.check_schema(schema)
    assert not broken


@pytest.mark.parametrize(
    "text",
    [
        "robot: arm\ntask: reach\nagent: learner",
        "environment: point\nagent: {name: learner, discount: 0.5, decay: {rate: 0.1}}\nseeds: [0, 1]",
        "extends: base.yaml\ntraining: {steps: 1e6}\nrobot: null",
        "extends: [a.yaml, b.yaml]\nagent: {discount: 0.5}",
        "robot: arm\ntask: reach\nagent: learner\nbuffer: {name: uniform, hindsight: {ratio: 0.5}}\n"
        "randomization: {task.gravity: {name: normal, mean: 1, std: 1}, robot.gain: 2}",
    ],
)
def test_good_specs_fit_the_schema(fake_plugins, text):
    assert valid(text)


@pytest.mark.parametrize(
    "text",
    [
        "robot: arm\ntask: reach",
        "agent: learner",
        "robot: arm\ntask: reach\nagent: lerner",
        "robot: arm\ntask: reach\nagent: {name: lerner}",
        "robot: arm\ntask: reach\nagent: {name: learner, discont: 1}",
        "robot: arm\ntask: reach\nagent: {name: latest, discount: 0.5}",
        "robot: {name: arm, control: jiont}\ntask: reach\nagent: learner",
        "robot: arm\ntask: reach\nagent: learner\ntraining: {steps: 0}",
        "robot: arm\ntask: reach\nagent: learner\nrandomization: {gravity: {name: normal, mean: 1, std: 1}}",
        "robot: arm\ntask: reach\nagent: learner\nname: ../x",
        "robot: arm\ntask: reach\nagent: learner\nsweep: {trails: 3}",
    ],
)
def test_bad_specs_do_not(fake_plugins, text):
    assert not valid(text)


def test_plugin_that_does_not_import_is_left_out_and_told(fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot")
    schema, broken = spec_schema()
    Draft202012Validator.check_schema(schema)
    assert "robots.arm" in schema["$defs"]
    assert "robots.broken" not in schema["$defs"]
    assert len(broken) == 1
    assert "'broken'" in str(broken[0])
