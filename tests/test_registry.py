"""The registry: names without imports, classes when asked for, and errors that name the culprit."""

import importlib.metadata
import sys

import pytest

from karolos import registry
from karolos.errors import MachineError, PluginError, UsageError


def test_plugins_are_listed_with_their_distribution_and_loaded_by_name(fake_plugins):
    assert registry.names("robots") == ["arm", "other_arm"]
    assert {entry.distribution for entry in registry.entries("robots")} == {"fakes"}
    plugin = registry.load("robots", "arm")
    assert plugin.__name__ == "Arm"
    assert plugin.Settings().step == 0.05
    with pytest.raises(UsageError, match="did you mean 'robots'"):
        registry.names("robot")


def test_unknown_name_tells_the_closest_and_what_is_installed(fake_plugins):
    with pytest.raises(UsageError) as caught:
        registry.load("robots", "amr")
    text = str(caught.value)
    assert "'amr'" in text
    assert "did you mean 'arm'?" in text
    assert "arm, other_arm" in text


def test_name_of_two_distributions_is_refused_naming_both(fake_plugins):
    fake_plugins("robots", "arm", "support.fake_plugins:OtherArm", distribution="another")
    assert registry.names("robots") == ["arm", "other_arm"]
    with pytest.raises(PluginError, match="'arm' is claimed by another and fakes"):
        registry.load("robots", "arm")
    assert registry.load("robots", "other_arm")


@pytest.mark.parametrize("target", ["no_such_module_anywhere:Robot", "support.fake_plugins:NoSuchClass"])
def test_plugin_that_does_not_import_fails_only_when_used(fake_plugins, target):
    fake_plugins("robots", "broken", target, distribution="shaky")
    assert "broken" in registry.names("robots")
    assert registry.load("robots", "arm")
    with pytest.raises(PluginError) as caught:
        registry.load("robots", "broken")
    assert "'broken'" in str(caught.value)
    assert "shaky 1.0" in str(caught.value)
    assert isinstance(caught.value.__context__, ImportError | AttributeError)
    assert caught.value.__cause__ is None, "its traceback would be printed"
    assert caught.value.exit_code == 3


def test_nobody_is_told_to_uninstall_karolos(fake_plugins):
    fake_plugins("robots", "broken", "no_such_module_anywhere:Robot", distribution="karolos")
    with pytest.raises(PluginError, match="; free memory if there is too little, or install karolos and its"):
        registry.load("robots", "broken")


HOSTILE = {
    "raise RuntimeError('no licence\\nsecond line')": "RuntimeError: no licence",
    "import sys; sys.exit(0)": "SystemExit: 0",
    "raise GeneratorExit": "GeneratorExit",
    "raise MemoryError": "not enough memory to import robot",
    "import sys; sys.modules[__name__] = None": "AttributeError",
    "class Dumb(Exception):\n  def __str__(self): raise self\nraise Dumb": "exception str",
    "import sys; sys.modules[__name__] = 5": "AttributeError",
    "class Odd(type):\n  def __getattribute__(self, key): raise OSError\nclass Robot(metaclass=Odd): 0": "OSError",
    "def f(): f()\nf()": "RecursionError",
    "class Robot: Settings = 1": "has no settings",
    "x = 1\ndef f(:\n  pass": r"hostile_plugin\.py:2: robot 'hostile' of fakes 1.0: does not import: SyntaxError: ",
    "x = 1\nimport nothing_here": r"hostile_plugin\.py:2: robot 'hostile' of fakes 1.0: does not import: ModuleNot",
}
"""Modules of a plugin, and what is said of each."""


@pytest.mark.parametrize(("module", "what"), HOSTILE.items())
def test_a_plugin_that_does_not_come_out_of_its_import_is_named_in_one_line(
    fake_plugins, tmp_path, monkeypatch, module, what
):
    (tmp_path / "hostile_plugin.py").write_text(module)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "hostile_plugin", raising=False)
    fake_plugins("robots", "hostile", "hostile_plugin:Robot")
    with pytest.raises((PluginError, MachineError), match=what) as caught:
        registry.load("robots", "hostile")
    assert "robot 'hostile' of fakes" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_a_plugin_prints_while_it_is_imported_does_not_mix_with_results(
    fake_plugins, tmp_path, monkeypatch, capsys
):
    (tmp_path / "loud_plugin.py").write_text("print('hello')\nfrom support.fake_plugins import Arm as Robot")
    monkeypatch.syspath_prepend(tmp_path)
    fake_plugins("robots", "loud", "loud_plugin:Robot")
    assert registry.load("robots", "loud")
    assert capsys.readouterr() == ("", "hello\n")


@pytest.mark.parametrize(
    ("kind", "target", "what"),
    [
        ("robots", "WithoutSettings", "has no settings"),
        ("robots", "not_a_class", "is not a class"),
        ("robots", "WithName", "a setting called 'name'"),
        ("distributions", "Abstract", "Abstract is no distribution: it lacks draw; distributions have draw"),
    ],
)
def test_plugin_without_usable_settings_or_with_an_abstract_method_is_refused(fake_plugins, kind, target, what):
    fake_plugins(kind, "odd", f"support.fake_plugins:{target}")
    with pytest.raises(PluginError, match=what):
        registry.load(kind, "odd")


@pytest.mark.parametrize("kind", registry.KINDS)
def test_plugin_of_a_wrong_interface_is_refused_when_used_naming_what_it_lacks(fake_plugins, kind):
    fake_plugins(kind, "unfinished", "support.fake_plugins:Unfinished", distribution="shaky")
    assert "unfinished" in registry.names(kind)
    with pytest.raises(PluginError, match=f"Unfinished is no {registry.singular(kind)}: it lacks") as caught:
        registry.load(kind, "unfinished")
    assert "shaky 1.0" in str(caught.value)
    for name in registry.NEEDED_ATTRIBUTES[kind]:
        assert name in str(caught.value)
    assert caught.value.exit_code == 3


DISORDER = {
    "not_utf8": b"\xff[karolos.robots]\na = b:C",
    "malformed": b"[karolos.robots]\na b\n[]\n=\n",
    "a_folder": None,
    "large": b"#" * 2_000_000,
}
"""What stands in entry_points.txt."""


@pytest.mark.parametrize("name", DISORDER)
def test_what_cannot_be_read_of_a_distribution_is_named_and_ends_nothing(tmp_path, monkeypatch, name):
    for each, content in ((name, DISORDER[name]), ("fine", b"[karolos.robots]\nfine_arm = fine:Arm")):
        file = tmp_path / f"{each}-2.0.dist-info" / "entry_points.txt"  # beside no METADATA
        file.parent.mkdir()
        file.mkdir() if content is None else file.write_bytes(content)
    monkeypatch.syspath_prepend(tmp_path)
    found, problems = registry._scan.__wrapped__()
    (entry,) = (one for one in found if one.name == "fine_arm")
    assert (entry.distribution, entry.version) == ("fine", "2.0")
    (problem,) = problems
    assert name in problem
    assert "cannot be read" in problem
    list(importlib.metadata.entry_points(group="pydantic"))  # as pydantic and numba ask


def test_every_installed_plugin_loads():
    for kind in registry.KINDS:
        for name in registry.names(kind):
            assert registry.load(kind, name).Settings
