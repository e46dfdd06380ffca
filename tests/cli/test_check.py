"""`karolos check`."""

import pytest
from support.commands import karolos, refused, rows

GOOD = "robot: arm\ntask: reach\nagent: learner\norchestrator: {processes: 0}\n"
BAD = "robot: amr\ntask: {name: reach, treshold: 1}\nagent: {name: learner, discount: 2}\n"


@pytest.fixture
def specs(tmp_path, monkeypatch, fake_plugins):
    monkeypatch.chdir(tmp_path)
    for name, text in (("good", GOOD), ("other", GOOD), ("bad", BAD)):
        (tmp_path / f"{name}.yaml").write_text(text)
    return tmp_path


@pytest.mark.usefixtures("specs")
def test_good_specs_are_named_and_overrides_hold_for_every_spec():
    both = ("check", "good.yaml", "other.yaml")
    assert karolos(*both, "agent.discount=0.5") == (0, "good.yaml: ok\nother.yaml: ok\n", "")
    lines = karolos(*both, "agent.discount=2", code=2).out.splitlines()
    assert len(lines) == 2
    assert all("agent.discount" in line for line in lines)


@pytest.mark.usefixtures("specs")
def test_every_problem_of_every_bad_spec_is_printed_and_the_exit_code_is_2():
    specs = ("bad.yaml", "good.yaml", "none.yaml")
    lines = karolos("check", *specs, code=2).out.splitlines()
    assert [line.split(" ")[0] for line in lines] == [
        "bad.yaml:1:8:", "bad.yaml:2:21:", "bad.yaml:3:34:", "good.yaml:", "none.yaml:",
    ]  # fmt: skip
    found = rows("check", *specs, code=2)
    assert [row["ok"] for row in found] == [False, False, False, True, False]
    assert (found[0]["where"], found[0]["key"]) == ("bad.yaml:1:8", "robot.name")
    assert "did you mean 'arm'?" in found[0]["hint"]


def test_broken_plugin_ends_with_3_and_the_rest_is_checked(specs, fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot", distribution="shaky")
    (specs / "broken.yaml").write_text(GOOD.replace("arm", "broken"))
    broken, good = karolos("check", "broken.yaml", "good.yaml", code=3).out.splitlines()
    assert "shaky" in broken
    assert good.endswith("good.yaml: ok")


def test_a_library_that_is_not_installed_is_told_before_a_run(monkeypatch):
    monkeypatch.setattr("karolos.experiment.check.find_spec", lambda _: None)
    for key in ("launcher", "orchestrator"):
        told = karolos("check", "bit_flip", f"{key}.name=ray", code=3).out
        assert f"{key}.name: ray is not installed; pip install 'karolos[ray]'" in told


def test_file_names_cannot_write_control_characters(specs):
    (specs / "\x1b[31mred.yaml").write_text(GOOD + "name: red\n")
    assert "\x1b" not in karolos("check", "\x1b[31mred.yaml").out


@pytest.mark.usefixtures("specs")
def test_overrides_of_any_length_are_overrides_and_a_long_value_is_not_repeated_whole():
    assert "is not a spec" in refused("check", "agent.discount=2")
    for overrides in (["name=" + "x" * 5000], ["agent.name=" + "x" * 70_000, f"name={'y' * 70_000}"]):
        told = karolos("check", "good.yaml", *overrides, code=2).out
        assert "name" in told
        assert max(map(len, told.splitlines())) < 2000


@pytest.mark.parametrize(
    ("spec", "override", "code", "said"),
    [
        ("reach", "environment.actions=discrete", 2, "with override {}: agent: sac gives continuous actions"),
        ("insert", "environment.engine=bullet", 2, "with override {}: robot.control: the engine bullet has no impeda"),
        ("reach", "environment.window=true", 2, "the engine mujoco has no window; set environment.engine=bullet"),
        ("reach", "agent.start_from=nothing", 2, "override {}: agent.start_from: 'nothing': "),
        ("reach", "training.device=cuda", 3, "override {}: "),
    ],
)
def test_what_an_override_made_impossible_is_told_with_it(tmp_path, monkeypatch, spec, override, code, said):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    command = ("check", f"karolos:panda_{spec}", "training.steps=100000", override, "--runs", tmp_path)
    assert said.format(override) in karolos(*command, code=code).out
