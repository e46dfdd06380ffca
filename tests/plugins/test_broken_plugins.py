"""The checks can fail: plugins that break a promise are told which, in one line."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.commands import karolos, refused, rows
from support.toy_runs import TOY, run_of, toy

from karolos import registry
from karolos.errors import UsageError
from karolos.plugins.contracts import Candidate, candidate, cases, check, results, robots
from karolos.registry import PluginEntry, blaming, load


def broken(one: Candidate, *promises: Callable[..., None]) -> dict[str, str]:
    """Promise -> what is wrong; of these promises, or of all."""
    found = [case for case in cases(one, alone=True) if not promises or case.promise in promises]
    return {case.promise.__name__: problem for case, problem in results(found) if problem}


def made(kind: str, name: str, methods: dict[str, Any], **settings: Any) -> Candidate:
    """An installed plugin with some methods replaced."""
    return Candidate(kind, "mine", type("Mine", (load(kind, name),), methods), settings)


def test_an_agent_that_acts_with_a_generator_of_its_own_breaks_two_promises():
    parent = load("agents", "dqn")

    def act(self: Any, observation: Any, desired_goal: Any, **how: Any) -> Any:
        found = parent.act(self, observation, desired_goal, **how)
        return found + np.random.default_rng().integers(0, 5, found.shape).astype(np.float32)

    found = broken(made("agents", "dqn", {"act": act}))
    assert "are not among [0, 1, 2]" in found["actions_have_their_shape_and_range"]
    assert found["without_exploration_acting_is_deterministic_and_draws_nothing"].startswith(
        "actions for the same observations differ: "
    )
    assert len(found) == 2


def test_an_agent_whose_state_is_not_a_copy_breaks_a_promise():
    parent = load("agents", "dqn")

    def learn(self: Any, batch: Any) -> Any:
        self.__dict__.setdefault("updates_so_far", np.zeros(1))[0] += 1
        return parent.learn(self, batch)

    def state(self: Any) -> Any:
        return parent.state(self) | {"mine": self.__dict__.setdefault("updates_so_far", np.zeros(1))}

    found = broken(made("agents", "dqn", {"learn": learn, "state": state}))
    assert "return copies" in found["a_saved_state_does_not_change_with_the_agent"]


def test_a_buffer_with_a_generator_of_its_own_breaks_a_promise():
    parent = load("buffers", "uniform")

    def sample(self: Any, size: int) -> Any:
        self._generator = np.random.default_rng()
        return parent.sample(self, size)

    found = broken(made("buffers", "uniform", {"sample": sample}))
    assert found["the_same_seed_samples_the_same_and_another_does_not"].startswith("slots sampled with the same seed")


def test_an_environment_of_float64_that_ignores_its_seed_breaks_promises():
    parent = load("environments", "toy")

    def reset(self: Any, seed: int) -> Any:
        step = parent.reset(self, np.random.SeedSequence().entropy % 2**32)
        return step._replace(observation=step.observation.astype(np.float64))

    found = broken(made("environments", "toy", {"reset": reset}))
    assert found["steps_are_as_the_signature_says"] == "observation is float64 instead of float32"
    used = "the_same_seed_gives_the_same_trajectory_in_a_fresh_and_in_a_used_environment"
    assert "in a used environment" in found[used] or "an episode of the same seed" in found[used]


def test_a_distribution_with_a_generator_of_its_own_breaks_a_promise():
    draw = {"draw": lambda self, generator: np.random.default_rng().uniform()}
    found = broken(made("distributions", "uniform", draw, low=0, high=1))
    assert set(found) == {"the_generator_alone_determines_the_values"}


def test_a_robot_whose_tool_moves_too_little_breaks_a_promise():
    parent = load("robots", "panda")
    slow = {"towards": lambda self, *target: 0.1 * parent.towards(self, *target)}
    found = broken(made("robots", "panda", slow), robots.the_tool_reaches_every_corner_of_the_workspace)
    assert "mm away from" in found["the_tool_reaches_every_corner_of_the_workspace"]


def test_a_task_without_the_headings_of_its_docstring_breaks_a_promise():
    found = broken(made("tasks", "reach", {"__doc__": "Reach."}))
    assert found == {
        "the_docstring_says_what_to_do_what_is_randomised_and_what_counts": 'the docstring lacks "What to do:"'
    }


def test_settings_and_kinds_that_cannot_be_checked_are_refused():
    with pytest.raises(UsageError, match="mine: low: Field required; `karolos plugins show distribution mine` lists"):
        broken(made("distributions", "uniform", {}))
    with pytest.raises(UsageError, match="no contracts for orchestrator local"):
        cases(candidate("orchestrators", "local"))
    with pytest.raises(UsageError, match="did you mean 'sac'"):
        check("agents", "sacc")


def test_the_command_line_names_broken_promises_and_ends_with_3(monkeypatch):
    def draw(self: Any, generator: Any) -> float:
        raise ZeroDivisionError("of my own\nmaking")

    bad = made("distributions", "uniform", {"draw": draw}, low=0, high=1)
    monkeypatch.setattr("karolos.plugins.contracts.candidate", lambda *_, **__: bad)
    told = karolos("plugins", "check", "distribution", "mine", code=3)
    assert "BROKEN mine-0-1-values_are_finite_floats" in told.out
    assert "`draw` returns a finite Python float." in told.out
    assert "ZeroDivisionError: of my own making" in told.out
    assert "Traceback" in told.err
    assert "0 of 2 promises are kept" in told.err
    assert [row["kept"] for row in rows("plugins", "check", "distribution", "x", code=3)] == [False, False]


BROKEN_TASK = """\
from types import SimpleNamespace
from karolos.tasks.reach import Reach

class Broken(Reach):
    def expert(self):
        return SimpleNamespace(reset=int, act=lambda: self.act())

    def {method}(self, *_):
        return self.gaol
"""
Installer = Callable[[str], Path]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Installer:
    """Installs a third party's task `broken_<method>` which fails in that method; returns a spec with it."""
    before = registry._installed()
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.chdir(tmp_path)

    def install(method: str) -> Path:
        name = f"broken_{method}"
        (tmp_path / f"{name}.py").write_text(BROKEN_TASK.format(method=method))
        others = [PluginEntry("tasks", other, f"{name}:{other}", "shaky", "1.0") for other in ("Other", "BrokenOther")]
        mine = PluginEntry("tasks", name, f"{name}:Broken", "shaky", "1.0")
        monkeypatch.setattr(registry, "_installed", lambda: (*before, others[0], mine, others[1]))
        spec = tmp_path / "s.yaml"
        spec.write_text(f"robot: panda\ntask: {name}\nagent: sac\n")
        return spec

    return install


@pytest.mark.parametrize("method", ["fit", "build", "reset", "expert", "act"])
def test_a_third_partys_task_that_fails_is_told_at_its_line_in_one_line(installed, method):
    spec = installed(method)
    told = f"/broken_{method}.py:9: task 'broken_{method}' of shaky 1.0: AttributeError: 'Broken' object has no"
    small = ("--width", "32", "--height", "24")
    commands = [("play", spec, "--expert", "--out", "film.gif", *small)]
    if method not in ("expert", "act"):
        commands.append(("inspect", "task", f"broken_{method}", *small))
    if method == "fit":
        commands.append(("plugins", "check", "task", "broken_fit"))
    for words in commands:
        err = refused(*words, code=3)
        assert told in err
        assert err.count("\n") == 1


@pytest.mark.parametrize("method", ["fit", "build", "reset", "observe"])
def test_check_tells_a_task_that_fails_at_its_line_in_the_spec(installed, method):
    spec = installed(method)
    out = karolos("check", spec, "orchestrator.processes=0", code=3).out
    assert out.count("\n") == 1
    assert out.startswith(f"{spec}:2:7: task.name: /")
    assert f"/broken_{method}.py:9: task 'broken_{method}' of shaky 1.0: AttributeError: 'Broken' object" in out


def test_a_function_that_several_plugins_share_is_blamed_on_the_one_in_use(installed):
    spec = installed("achieved")
    module = spec.with_name("broken_achieved.py")
    module.write_text(module.read_text().replace("self.gaol", "shared(self)") + "def shared(task): return task.gaol\n")
    out = karolos("check", spec, "orchestrator.processes=0", code=3).out
    assert out.startswith(f"{spec}:2:7: task.name: {module}:10: task 'broken_achieved' of shaky 1.0: AttributeError")


@pytest.mark.parametrize(
    ("kind", "parent", "method"),
    [("agents", "SAC", "act"), ("agents", "SAC", "learn"), ("buffers", "Uniform", "sample")],
)
def test_a_run_names_the_third_partys_agent_or_buffer_that_fails(kind, parent, method, tmp_path, monkeypatch):
    module = f"failing_{method}"
    source = f"from karolos.{kind}.{parent.lower()} import {parent}\n\nclass Mine({parent}):\n"
    (tmp_path / f"{module}.py").write_text(f"{source}    def {method}(self, *_, **__):\n        return self.gaol\n")
    before, mine = registry._installed(), PluginEntry(kind, "mine", f"{module}:Mine", "shaky", "1.0")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(registry, "_installed", lambda: (*before, mine))
    part = kind.removesuffix("s")
    state = run_of(toy(**{part: {**TOY[part], "name": "mine"}}), tmp_path).state()
    place = f"{tmp_path / module}.py:5: {part} 'mine' of shaky 1.0"
    assert state.error == f"{place}: AttributeError: 'Mine' object has no attribute 'gaol'"


def test_an_error_of_karolos_itself_is_blamed_on_no_plugin(installed):
    installed("fit")
    with pytest.raises(ZeroDivisionError), blaming():
        _ = 1 / 0
