"""Bad specs: one clear line for each mistake, at its place."""

import os
from typing import Any

import pytest
from pydantic import JsonValue, SecretStr, model_validator
from support.fake_plugins import Point
from support.spec_files import GOOD, REFUSED, problems_of, write

from karolos.errors import PluginError, SpecError
from karolos.specification import bind, load_spec, spec_from_dict

pytestmark = pytest.mark.usefixtures("fake_plugins")


@pytest.mark.parametrize("case", REFUSED["specs"])
def test_each_mistake_is_one_printable_line_at_its_place_and_in_our_words(tmp_path, monkeypatch, case):
    said = bind._text
    monkeypatch.setattr(bind, "_text", lambda entry: said({**entry, "msg": "of pydantic"}))
    expected = REFUSED["specs"][case]
    text = GOOD + expected["after"] if "after" in expected else expected["spec"]
    (line,) = problems_of(write(tmp_path, "s.yaml", text and text.rstrip("\n") + "\n"))
    assert line.startswith(f"s.yaml:{expected['problem']}")
    assert "of pydantic" not in line
    assert line.isprintable()


@pytest.mark.parametrize("override", REFUSED["overrides"])
def test_bad_override_is_one_line_that_names_it(tmp_path, override):
    (line,) = problems_of(write(tmp_path, "s.yaml", GOOD), override)
    assert line.startswith(f"override {override}: {REFUSED['overrides'][override]}")


def test_every_bad_override_is_told_after_the_file(tmp_path):
    path = write(tmp_path, "s.yaml", GOOD + "seed: 1\n")
    found = problems_of(path, "training.steps=x", "agent.discount=x")
    places = ["s.yaml:4:1", "override training.steps=x", "override agent.discount=x"]
    assert [line.split(": ")[0] for line in found] == places


def test_all_mistakes_are_told_in_the_order_of_the_file(tmp_path):
    text = "robot: {name: arm, stp: 1}\ntask: reech\nagent: {name: learner, discount: 2}\n"
    text += "training: {steps: -1}\nseed: [1]\n"
    found = problems_of(write(tmp_path, "s.yaml", text))
    assert [line.split(": ")[1] for line in found] == [
        "robot.stp", "task.name", "agent.discount", "training.steps", "seed",
    ]  # fmt: skip


class Keyed(Point):
    class Settings(Point.Settings):
        given: JsonValue = None
        key: SecretStr | None = None


SECRETS = {
    "given": [{"db": [{"API_KEY": "geheim"}]}, "db://me:geheim@host", "x?password=geheim", "hf_geheimgeheimgeheim"],
    "key": ["geheim"],
}


@pytest.mark.parametrize(("key", "value"), [(key, value) for key, values in SECRETS.items() for value in values])
def test_a_secret_is_refused_and_not_shown_and_a_variable_is_taken(fake_plugins, monkeypatch, key, value):
    monkeypatch.setattr("support.fake_plugins.Keyed", Keyed, raising=False)
    fake_plugins("environments", "keyed", "support.fake_plugins:Keyed")
    with pytest.raises(SpecError, match=rf"environment\.{key}.*: looks like a secret.* environment variable") as caught:
        spec_from_dict({"environment": {"name": "keyed", key: value}, "agent": "learner"})
    assert "geheim" not in str(caught.value)
    named = {"db": [{"API_KEY": "${MY_KEY}", "tokens": 3, "password": ""}]}
    assert spec_from_dict({"environment": {"name": "keyed", "given": named}, "agent": "learner"})


def test_another_environment_takes_no_robot_task_or_randomization(tmp_path):
    text = GOOD + "environment: point\nrandomization: {task.gravity: {name: normal, mean: 1, std: 1}}\n"
    found = problems_of(write(tmp_path, "s.yaml", text))
    assert [line.split(": ")[1] for line in found] == ["robot", "task", "randomization"]
    assert "requires environment robot_task, not 'point'" in found[0]


UNREADABLE = {
    "raech.yaml": "raech.yaml: there is no such file; did you mean reach.yaml?",
    "nothere.yaml": "nothere.yaml: there is no such file",  # h.yaml has only its suffix
    "none/x.yaml": "x.yaml: there is no such file",
    "specs": "specs: is a folder, not a spec file; it contains h.yaml",
    "pipe.yaml": "pipe.yaml: is not an ordinary file",  # and is not waited for
    "latin.yaml": "latin.yaml:4: is not UTF-8 text; save the file in UTF-8",
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_a_file_that_cannot_be_read_is_told_with_the_reason_and_a_similar_name(tmp_path, name):
    for good in ("reach.yaml", "h.yaml", "specs/h.yaml"):
        write(tmp_path, good, GOOD)
    (tmp_path / "latin.yaml").write_bytes(GOOD.encode() + "name: Gr\xfcn\n".encode("latin-1"))
    os.mkfifo(tmp_path / "pipe.yaml")
    assert problems_of(tmp_path / name) == [UNREADABLE[name]]


def test_byte_order_mark_is_no_part_of_the_first_key(tmp_path):
    path = tmp_path / "s.yaml"
    path.write_bytes(b"\xef\xbb\xbf" + GOOD.encode())
    assert load_spec(path).robot is not None


def test_file_name_that_is_no_name_asks_for_one(tmp_path):
    (line,) = problems_of(write(tmp_path, "my spec.yaml", GOOD))
    assert line.startswith("my spec.yaml:1:1: name: 'my spec' is not allowed; give `name`")


def test_broken_plugin_is_told_at_the_place_that_names_it(tmp_path, fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot", distribution="shaky")
    path = write(tmp_path, "s.yaml", GOOD.replace("arm", "broken"))
    with pytest.raises(PluginError, match=r"s\.yaml:1:8: robot\.name: robot 'broken' of shaky 1\.0") as caught:
        load_spec(path)
    assert caught.value.__cause__ is None, "its traceback would be printed"


def test_broken_distribution_is_not_taken_for_the_buffer_of_that_name(tmp_path, fake_plugins):
    fake_plugins("distributions", "uniform", "no_such_module_anywhere:Uniform")
    path = write(tmp_path, "s.yaml", GOOD + "buffer: uniform\nrandomization: {task.gravity: {name: uniform}}\n")
    with pytest.raises(PluginError, match=r"s\.yaml:5:38: randomization\.task\.gravity\.name: distribution 'uniform'"):
        load_spec(path)


@pytest.mark.parametrize(
    ("spec", "expected"),
    [
        ({"robot": "arm", "task": "reach", "agent": "learnr"}, "dict: agent.name: no agent is called 'learnr'"),
        ({"robot": "arm", "task": "reach", "agent": object()}, "dict: agent: a spec cannot contain a object"),
        ({"robot": "arm", "task": "reach", "agent": "learner", 3: 4}, "dict: the key 3 is not a string"),
        ({"extends": "x.yaml"}, "dict: extends: a dictionary has no file to extend from"),
        ({}, "dict: has no environment"),
    ],
)
def test_mistakes_in_a_dictionary_are_told(spec, expected):
    with pytest.raises(SpecError) as caught:
        spec_from_dict(spec)
    assert str(caught.value).startswith(expected)


def test_endless_dictionary_is_refused():
    loop: dict = {"robot": "arm"}
    loop["task"] = loop
    with pytest.raises(SpecError, match="nested deeper"):
        spec_from_dict(loop)


class Failing(Point):
    class Settings(Point.Settings):
        @model_validator(mode="after")
        def _fails(self) -> Any:
            raise ZeroDivisionError("of the plugin")


def test_settings_that_fail_themselves_are_told_at_the_plugins_line(fake_plugins):
    fake_plugins("environments", "failing", f"{__name__}:Failing", "shaky")
    with pytest.raises(PluginError, match=r"test_bad_specs\.py:\d+: environment 'failing' of shaky 1\.0: ZeroDivision"):
        spec_from_dict({"environment": "failing", "agent": "learner"})
