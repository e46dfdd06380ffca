"""Resolved specs: defaults, dump, origins, hash, recipe, pickling."""

import json
import os
import pickle
from dataclasses import FrozenInstanceError
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from support.spec_files import GOOD, write

from karolos.specification import load_spec, spec_from_dict, to_yaml

pytestmark = pytest.mark.usefixtures("fake_plugins")

SMALL = {"robot": "arm", "task": "reach", "agent": "learner"}


def test_robot_task_and_agent_are_enough():
    spec = spec_from_dict(SMALL)
    assert (spec.name, spec.seeds) == ("arm_reach", (0,))
    assert (spec.environment.name, spec.buffer.name, spec.orchestrator.name) == ("robot_task", "uniform", "local")
    amounts = {"steps": 100_000, "batch_size": 256, "replay_ratio": 64.0, "warmup_episodes": 20}
    rest = {"device": "cpu", "threads": None, "diverging": 0.5, "mode": "lockstep", "minimum_batch": None}
    assert spec.training.model_dump() == {**amounts, **rest}
    assert spec.testing.model_dump() == {"interval": 5000, "episodes": 100, "seed": 0, "final_episodes": None}


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"environment": "point", "agent": "learner"}, {"name": "point", "robot": None, "task": None}),
        # a default part takes settings without a name
        (
            {**SMALL, "buffer": {"capacity": 1e5}},
            {"buffer": {"name": "uniform", "capacity": 100_000, "hindsight": None}},
        ),
        # tuples and numbers of numpy
        (
            {**SMALL, "seeds": (np.int64(3), 4), "robot": {"name": "arm", "step": np.float32(0.5)}},
            {"seeds": [3, 4], "robot": {"name": "arm", "control": "cartesian", "step": 0.5}},
        ),
    ],
)
def test_a_dictionary_is_completed(given, expected):
    found = spec_from_dict(given).dump()
    assert {key: found.get(key) for key in expected} == expected


def test_name_defaults_to_the_file(tmp_path):
    assert load_spec(write(tmp_path, "first_try.yaml", GOOD)).name == "first_try"


def test_specs_are_frozen():
    spec = spec_from_dict(SMALL)
    with pytest.raises(ValidationError):
        spec.name = "x"
    with pytest.raises(FrozenInstanceError):
        spec.agent.name = "x"
    with pytest.raises(ValidationError):
        spec.agent.settings.discount = 0


def test_pickled_specs_and_recipes_come_back_equal():
    spec = spec_from_dict({**SMALL, "randomization": {"task.gravity": {"name": "normal", "mean": 1, "std": 1}}})
    assert pickle.loads(pickle.dumps(spec)) == spec
    recipe = spec.recipe(randomize=True)
    assert pickle.loads(pickle.dumps(recipe)) == recipe


def test_recipe_holds_randomization_only_when_asked_and_in_one_order():
    draws = {"name": "normal", "mean": 1, "std": 1}
    one = spec_from_dict({**SMALL, "randomization": {"task.mass": draws, "robot.gain": draws}})
    other = spec_from_dict({**SMALL, "randomization": {"robot.gain": draws, "task.mass": draws}})
    assert one.recipe(randomize=False).randomization == ()
    assert [name for name, _ in one.recipe(randomize=True).randomization] == ["robot.gain", "task.mass"]
    assert one.recipe(randomize=True) == other.recipe(randomize=True)
    assert one.hash() == other.hash()


def test_origins_tell_where_each_value_comes_from(tmp_path):
    write(tmp_path, "specs/base.yaml", "agent: {name: learner, discount: 0.9}\n")
    path = write(tmp_path, "specs/s.yaml", "extends: base.yaml\nrobot: arm\ntask: reach\nseeds: [1]\n")
    spec = load_spec(path, ["training.steps=7"])
    origins = {key: origin.removeprefix(f"{tmp_path}/") for key, origin in spec.origins.items()}
    assert origins["agent.discount"] == "specs/base.yaml:1:34"
    assert origins["robot.name"] == "specs/s.yaml:2:8"
    assert origins["seeds"] == "specs/s.yaml:4:8"
    assert origins["training.steps"] == "override training.steps=7"
    for key in ("agent.learning_rate", "environment.name", "training.threads", "name", "randomization"):
        assert origins[key] == "default"
    assert spec_from_dict(SMALL).origins["robot.name"] == "dict"


ASYNC = {"training": {"mode": "async"}}
CHANGES = {
    "name": ({"name": "other"}, True),
    "seeds": ({"seeds": [5, 6]}, True),
    "device": ({"training": {"device": "cuda"}}, True),
    "threads": ({"training": {"threads": 3}}, True),
    "layout of environments": ({"orchestrator": {"name": "local", "processes": 2, "environments": 4}}, True),
    "written default": ({"training": {"steps": 1e5}}, True),
    "lockstep spelt out": ({"training": {"mode": "lockstep", "minimum_batch": None}}, True),
    "async": (ASYNC, False),
    "number of environments": ({"orchestrator": {"name": "local", "environments": 9}}, False),
    "steps": ({"training": {"steps": 1}}, False),
    "setting of a part": ({"agent": {"name": "learner", "discount": 0.5}}, False),
    "another part": ({"robot": "other_arm"}, False),
    "randomization": ({"randomization": {"task.gravity": {"name": "normal", "mean": 1, "std": 1}}}, False),
    "tests": ({"testing": {"seed": 1}}, False),
}


@pytest.mark.parametrize("change", CHANGES)
def test_hash_names_what_results_depend_on(change):
    changed, same = CHANGES[change]
    assert (spec_from_dict({**SMALL, **changed}).hash() == spec_from_dict(SMALL).hash()) is same


@pytest.mark.parametrize("batch", [1, 2])
def test_waiting_for_one_environment_is_what_async_does_unless_told_otherwise(batch):
    waiting = spec_from_dict({**SMALL, "training": {"mode": "async", "minimum_batch": batch}})
    assert (waiting.hash() == spec_from_dict({**SMALL, **ASYNC}).hash()) is (batch == 1)


def test_specs_that_resolve_alike_are_equal(tmp_path):
    from_file = load_spec(write(tmp_path, "arm_reach.yaml", GOOD))
    assert from_file == spec_from_dict(SMALL)
    assert hash(from_file) == hash(spec_from_dict(SMALL))
    assert from_file != spec_from_dict({**SMALL, "name": "x"})


numbers = st.floats(1e-9, 0.99, allow_nan=False)
parts = {
    "robot": st.fixed_dictionaries(
        {"name": st.just("arm")}, optional={"step": numbers, "control": st.sampled_from(["joint", "cartesian"])}
    ),
    "task": st.just("reach")
    | st.fixed_dictionaries({"name": st.just("reach"), "box": st.tuples(numbers, numbers, numbers)}),
    "agent": st.fixed_dictionaries(
        {"name": st.just("learner")},
        optional={
            "discount": numbers,
            "hidden": st.lists(st.integers(-(2**63), 2**63 - 1), max_size=3),
            "entropy": st.just("auto") | st.floats(allow_nan=False, allow_infinity=False),
            "decay": st.booleans() | st.fixed_dictionaries({"rate": numbers}),
        },
    ),
}
optional = {
    "name": st.from_regex(r"x[A-Za-z0-9._-]{0,62}[A-Za-z0-9_-]", fullmatch=True),
    "seeds": st.lists(st.integers(0, 2**63 - 1), min_size=1, max_size=4, unique=True),
    "randomization": st.dictionaries(
        st.sampled_from(["task.gravity", "robot.mass"]),
        st.fixed_dictionaries({"name": st.just("normal"), "mean": st.floats(-9, 9), "std": numbers}),
    ),
    "training": st.fixed_dictionaries({}, optional={"steps": st.integers(1, 10**9), "replay_ratio": st.floats(0, 1e6)}),
}


@given(st.fixed_dictionaries(parts, optional=optional))
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_dump_loads_as_an_equal_spec(tmp_path, given_spec):
    spec = spec_from_dict(given_spec)
    dump = spec.dump()
    assert spec_from_dict(json.loads(json.dumps(dump, allow_nan=False))) == spec
    assert spec_from_dict(dump).hash() == spec.hash()
    assert load_spec(write(tmp_path, "again.yaml", to_yaml(dump))) == spec
    assert set(spec.origins) == set(spec_from_dict(dump).origins)


def test_a_file_that_a_setting_names_counts_by_its_content(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    spec = spec_from_dict({"environment": {"name": "point", "label": "part.stl"}, "agent": "learner"})
    hashes = [spec.hash()]
    assert spec.files() == {}
    for text in ("a", "b"):
        Path("part.stl").write_text(text)
        hashes.append(spec.hash())
    assert list(spec.files()) == ["environment.label"]
    assert len(set(hashes)) == 3
    os.makedirs("elsewhere")
    Path("part.stl").rename("elsewhere/part.stl")
    moved = spec_from_dict({"environment": {"name": "point", "label": "elsewhere/part.stl"}, "agent": "learner"})
    assert moved.hash() == hashes[-1]
