"""`karolos plugins new`: its package works, is tested, and is the one that docs/ and examples/ show."""

import re
from pathlib import Path

import pytest
from support.commands import karolos, refused
from support.fork_server import FORKS
from support.plugin_packages import STARTERS, install, python

from karolos.registry import PluginEntry

pytestmark = pytest.mark.xdist_group(__name__)

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A starter of each kind, installed."""
    folder = tmp_path_factory.mktemp("starters")
    found = {}
    for kind, name in STARTERS.items():
        found[kind] = folder / name
        karolos("plugins", "new", kind, name, "--out", found[kind])
        install(found[kind])
    return found


def test_starters_pass_their_tests_as_written_and_the_command_line_finds_them(packages, tmp_path):
    """Their tests, but those of a robot and an agent, which take longest and are run by .ci/run in examples/.

    The text of these is the same. Not a line is changed in karolos.
    """
    (tmp_path / "mine.yaml").write_text(
        "robot: desk_arm\ntask: my_task\nagent: my_agent\nbuffer: my_buffer\n"
        "randomization: {task.gravity: {name: my_distribution, low: -10.5, mode: -9.81, high: -9}}\n"
    )
    tested = [kind for kind in packages if kind not in ("robot", "agent")]
    commands = ["check", "mine.yaml"], ["plugins", "check", "environment", STARTERS["environment"]]
    folders = ["-p", "no:cacheprovider", "-v", *(str(packages[kind] / "tests") for kind in tested)]
    script = f"""{FORKS}
import pytest
from karolos.export import bundle
from karolos.plugins.contracts import pairs
from karolos_cli.main import app
bundle.EPISODES, bundle.write_film = 6, lambda path, *_: path.touch()  # tests/export looks at films
pairs.EPISODES, pairs.CHANCE_EPISODES = 4, 1  # as tests/plugins/test_contracts.py
assert pytest.main({folders}) == 0
for words in {commands}:
    assert not app(words, standalone_mode=False)
"""
    ran = python("-c", script, sources=[package / "src" for package in packages.values()], folder=tmp_path)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "skipped" not in ran.stdout
    for kind in tested:
        assert f"test_{STARTERS[kind]}.py::test_it_is_found_by_its_entry_point PASSED" in ran.stdout
    assert "BROKEN" not in ran.stdout
    assert "promises are kept" in ran.stderr


@pytest.mark.parametrize(("kind", "name"), [("robot", "desk_arm"), ("agent", "actor_critic")])
def test_a_package_in_examples_is_the_starter(tmp_path, kind, name):
    example = ROOT / "examples" / f"karolos-{name.replace('_', '-')}"
    for line in karolos("plugins", "new", kind, name, "--out", tmp_path).out.splitlines():
        path = Path(line).relative_to(tmp_path)
        if path.name != "README.md" and path.parts[0] != "specs":
            assert (example / path).read_text() == Path(line).read_text(), path


def test_the_code_in_the_guides_is_that_of_the_starters(packages):
    pages = [(ROOT / "docs" / f"{name}.md").read_text() for name in ("extending", "own_task", "own_agent", "deploy")]
    blocks = re.findall(r"<!-- from (\w+) (\w+): (\S+) -->\n```\w+\n(.*?)```", "".join(pages), re.DOTALL)
    assert len(re.findall(r"^```(?:python|toml)$", pages[0], re.MULTILINE)) == pages[0].count("<!-- from")
    assert {kind for kind, *_ in blocks} == set(STARTERS)
    for kind, name, path, code in blocks:
        assert name == STARTERS[kind]
        assert code in (packages[kind] / path).read_text(), code


def test_its_files_are_printed_and_the_folder_has_the_name_of_the_package(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    listed = karolos("plugins", "new", "distribution", "two_words").out.splitlines()
    assert "class TwoWords(Distribution)" in Path("karolos-two-words/src/karolos_two_words/two_words.py").read_text()
    assert sorted(listed) == sorted(str(path) for path in Path("karolos-two-words").rglob("*") if path.is_file())


@pytest.mark.parametrize(
    ("kind", "name", "what"),
    [
        ("robbot", "x", "did you mean 'robot'"),
        ("orchestrator", "x", "no starter for 'orchestrator'"),
        ("robot", "My-Arm", "cannot be the name"),
        ("robot", "class", "cannot be the name"),
        ("distribution", "null", "not a keyword of Python or YAML"),
        ("robot", "../x", "cannot be the name"),
        ("robot", "a__b", "cannot be the name"),
        ("robot", "a" * 61, "at most 60 lower-case letters"),
        ("task", "reach", "the package karolos has a task called 'reach' already"),
        ("gripper", "vacuum", "the package karolos has a gripper called 'vacuum' already"),
        ("distribution", "choice", "the package karolos has a distribution called 'choice' already"),
        ("driver", "ur", "has a driver called 'ur' already"),
    ],
)
def test_what_cannot_be_written_is_refused_and_leaves_nothing(tmp_path, kind, name, what):
    out = tmp_path / "new"
    assert what in refused("plugins", "new", kind, name, "--out", out)
    assert not out.exists()


@pytest.mark.parametrize(
    ("kind", "name", "class_name"),
    [("task", "box", "BoxTask"), ("robot", "arm", "ArmRobot"), ("task", "bin", "Bin")],
)
def test_a_class_is_not_called_like_one_that_it_uses(tmp_path, kind, name, class_name):
    karolos("plugins", "new", kind, name, "--out", tmp_path / "new")
    assert f'"karolos_{name}.{name}:{class_name}"' in (tmp_path / "new" / "pyproject.toml").read_text()
    assert f"\nclass {class_name}(" in (tmp_path / f"new/src/karolos_{name}/{name}.py").read_text()


def test_a_package_that_is_installed_can_be_written_again(tmp_path, monkeypatch):
    mine = PluginEntry("tasks", "my_part", "karolos_my_part.my_part:MyPart", "karolos-my-part", "0.1.0")
    monkeypatch.setattr("karolos.registry._installed", lambda: (mine,))
    assert karolos("plugins", "new", "task", "my_part", "--out", tmp_path / "new").out


def test_a_folder_that_holds_something_is_not_written_to(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    for out in (tmp_path, tmp_path / "mine.txt"):
        assert "already exists" in refused("plugins", "new", "robot", "x", "--out", out)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
