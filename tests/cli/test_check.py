"""`karolos check`."""

import json

import pytest
import typer
from karolos_cli.check import check
from support.commands import call

GOOD = "robot: arm\ntask: reach\nagent: learner\norchestrator: {processes: 0}\n"
app = typer.Typer()
app.command()(check)


@pytest.fixture
def specs(tmp_path, fake_plugins):
    (tmp_path / "good.yaml").write_text(GOOD)
    (tmp_path / "bad.yaml").write_text(
        "robot: amr\ntask: {name: reach, treshold: 1}\nagent: {name: learner, discount: 2}\n"
    )
    return tmp_path


def test_good_specs_are_named_and_the_exit_code_is_0(specs):
    code, out, err = call(app, str(specs / "good.yaml"))
    assert (code, out, err) == (0, f"{specs}/good.yaml: ok\n", "")


def test_overrides_hold_for_every_spec_and_may_be_wrong(specs):
    (specs / "other.yaml").write_text(GOOD)
    paths = [str(specs / "good.yaml"), str(specs / "other.yaml")]
    assert call(app, *paths, "agent.discount=0.5")[0] == 0
    code, out, _ = call(app, *paths, "agent.discount=2")
    assert code == 2
    assert len(out.splitlines()) == 2
    assert all("agent.discount" in line for line in out.splitlines())


def test_every_problem_of_every_bad_spec_is_printed_and_the_exit_code_is_2(specs):
    code, out, _ = call(app, str(specs / "bad.yaml"), str(specs / "good.yaml"), str(specs / "none.yaml"))
    assert code == 2
    lines = out.splitlines()
    assert [line.removeprefix(f"{specs}/").split(" ")[0] for line in lines] == [
        "bad.yaml:1:8:", "bad.yaml:2:21:", "bad.yaml:3:34:", "good.yaml:", "none.yaml:",
    ]  # fmt: skip


def test_json_gives_one_object_per_row(specs):
    code, out, _ = call(app, "--json", str(specs / "good.yaml"), str(specs / "bad.yaml"))
    found = [json.loads(line) for line in out.splitlines()]
    assert code == 2
    assert [row["ok"] for row in found] == [True, False, False, False]
    assert found[1]["where"] == f"{specs}/bad.yaml:1:8"
    assert found[1]["key"] == "robot.name"
    assert "did you mean 'arm'?" in found[1]["hint"]


def test_broken_plugin_ends_with_3_and_the_rest_is_checked(specs, fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot", distribution="shaky")
    (specs / "broken.yaml").write_text(GOOD.replace("arm", "broken"))
    code, out, _ = call(app, str(specs / "broken.yaml"), str(specs / "good.yaml"))
    assert code == 3
    assert "shaky" in out.splitlines()[0]
    assert out.splitlines()[1].endswith("good.yaml: ok")


def test_file_names_cannot_write_control_characters(tmp_path, fake_plugins):
    path = tmp_path / "\x1b[31mred.yaml"
    path.write_text(GOOD + "name: red\n")
    _, out, _ = call(app, str(path))
    assert "\x1b" not in out


def test_a_device_that_is_missing_is_told_with_its_place(monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    code, out, _ = call(app, "karolos:panda_reach", "training.device=cuda")
    assert (code, out.partition(": ")[0]) == (3, "override training.device=cuda")


def test_overrides_of_any_length_are_overrides_and_a_long_value_is_not_repeated_whole(specs):
    code, _, err = call(app, "agent.discount=2")
    assert (code, "is not a spec" in err) == (2, True)
    for overrides in (["name=" + "x" * 5000], ["agent.name=" + "x" * 70_000, f"name={'y' * 70_000}"]):
        code, out, _ = call(app, str(specs / "good.yaml"), *overrides)
        assert (code, "name" in out) == (2, True)
        assert max(map(len, out.splitlines())) < 2000


@pytest.mark.parametrize(
    ("spec", "override", "said"),
    [
        ("reach", "environment.actions=discrete", "with override {}: agent: sac gives continuous actions"),
        ("insert", "environment.engine=bullet", "with override {}: robot.control: the engine bullet has no impedance"),
        ("reach", "environment.window=true", "the engine mujoco has no window; set environment.engine=bullet"),
        ("reach", "agent.start_from=nothing", "override {}: agent.start_from: 'nothing': "),
    ],
)
def test_what_an_override_made_impossible_is_told_with_it(tmp_path, spec, override, said):
    code, out, _ = call(app, f"karolos:panda_{spec}", "training.steps=100000", override, "--runs", str(tmp_path))
    assert (code, said.format(override) in out) == (2, True)
