"""README and the pages of docs/: their commands and code work as written, one after the other, at toy size."""

import re
import shlex
import shutil
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
import typer
from gymnasium.envs import registration
from karolos_cli.main import app
from support.commands import call
from support.fake_launcher import FakeLauncher
from support.plugin_packages import install

from karolos import registry
from karolos.records import paths, provenance
from karolos.specification import load_spec

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
RUN = ("sh", "python", "yaml")
OTHER = ("text", "toml", "sql", "{eval-rst}", "{figure}", "{toctree}", "{csv-table}")
"""Languages of blocks: `text` is output."""
NOT_RUN = {"minutes", "hours", "server", "cluster", "pandas", "stable-baselines3", "part"}
"""The second word of a block that is not run: how long it takes, that it does not end, what it needs, `part`."""
BLOCK = re.compile(r"(^<!-- from [^\n]*-->\n)?^```(\S+)(?: ([^\n]+))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
STEPS = r"\btraining\.steps=\d+"
FEW = [
    *("training.steps=40", "training.replay_ratio=1", "training.warmup_episodes=1", "training.batch_size=8"),
    *("testing.interval=20", "testing.episodes=2", "testing.final_episodes=2"),
    *("orchestrator.processes=0", "orchestrator.environments=2"),
]
"""Overrides that make a run end within seconds."""
TINY = [*FEW, "--quiet", "--jobs", "1"]
SMALL_FILM = ["--width", "64", "--height", "48"]
SMALLER = {
    "sweep": [*TINY, "task.max_steps=10", "sweep.final=null", "sweep.seeds=[0]", "--trials", "1"],
    "test": ["--episodes", "2", "orchestrator.processes=0", "orchestrator.environments=2"],
    "play": ["--episodes", "1", *SMALL_FILM],
    "inspect": SMALL_FILM,
}
IGNORED = (
    "python3 -m venv",
    "source .venv",
    "URDF=",
    "pip install -c constraints.txt",
    "pytest -n auto",
    "make -C docs html",
)
"""Commands that CI runs elsewhere."""


def blocks(page: Path) -> Iterator[tuple[str, str, str]]:
    """Language, reason not to run it, and text of each block of code; without what is from a starter package."""
    for starter, language, reason, text in BLOCK.findall(page.read_text(encoding="utf-8")):
        if not starter:  # test_plugins_new compares it with the starter
            yield language, reason, text


def commands(text: str) -> Iterator[str]:
    """The commands of a block of shell lines, without comments."""
    for line in text.splitlines():
        yield from filter(None, (part.partition(" #")[0].strip() for part in line.split(" && ")))


def shrunk(words: list[str]) -> list[str]:
    """A karolos command at toy size."""
    if words[0] == "resume":
        return [re.sub(STEPS, "training.steps=80", word) for word in words]
    if words[0] == "compare" and "--out" in words and "--figure" not in words:
        return [*words, "--figure", "steps"]  # tests/report draws all of them
    if words[0] != "run":
        short = ["task.max_steps=5"] if words[0] == "play" and not words[1].startswith("@") else []
        return [*words, *SMALLER.get(words[0], []), *short]
    spec = load_spec(words[1], [word for word in words[2:] if "=" in word and not word.startswith("-")])
    more = [] if spec.task is None else ["task.max_steps=10"]
    if spec.demonstrations is not None:
        more += ["demonstrations.episodes=2", "demonstrations.updates=2"]
    if "hidden" in type(spec.agent.settings).model_fields:
        more.append("agent.hidden=[8]" if spec.agent.name != "my_agent" else "agent.hidden=8")
    if len(spec.seeds) > 1:
        more.append("seeds=[0]")
    return [*words, *TINY, *more]


COMMANDS = typer.main.get_command(app)
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, quick_proposals: None) -> Iterator[Path]:
    """A folder as a reader of the pages has it; plugins and environments that a page adds are forgotten at the end."""
    monkeypatch.setattr(registration, "registry", dict(registration.registry))
    monkeypatch.setattr("karolos.plans.plan.make_launcher", lambda *_: FakeLauncher())  # tests/plans starts processes
    monkeypatch.setattr("karolos.plans.study.Study.figures", lambda _: {})  # tests/plans draws them
    for name in ("specs", "examples"):
        shutil.copytree(ROOT / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    look_again()


def look_again() -> None:
    """Forget which plugins are installed, and their versions, which a run records and its worker compares."""
    for cached in (registry._scan, provenance.versions):
        cached.cache_clear()


@pytest.mark.parametrize(
    "page",
    [page for page in PAGES if any(language in RUN and not reason for language, reason, _ in blocks(page))],
    ids=lambda page: page.stem,
)
def test_code_works_as_written(page, folder, monkeypatch):
    names: dict[str, object] = {}
    for language, reason, text in blocks(page):
        if reason or language not in RUN:
            continue
        file = re.match(r"# ([\w/-]+\.(?:yaml|py))\n", text)
        if file:
            Path(file[1]).write_text(text)
        if language == "yaml":
            assert file, f"a spec begins with the name of its file: {text}"
            load_spec(file[1])
        elif language == "python":
            if not file:
                exec(re.sub(f'"{STEPS}"', str(FEW)[1:-1], text), names)
        else:
            for command in commands(text):
                run(command, folder, monkeypatch)
    if runs := paths(folder / "runs"):
        documented = re.findall(r"`([\w.]+)`", (DOCS / "run_folder.md").read_text())
        assert {path.name for path in runs[0].iterdir()} <= set(documented)


def run(command: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = shlex.split(command)
    if "$URDF" in words:  # what the page gives it: a robot that comes with PyBullet
        spec = find_spec("pybullet_data")
        assert spec is not None
        assert spec.submodule_search_locations is not None
        words[words.index("$URDF")] = f"{spec.submodule_search_locations[0]}/kuka_iiwa/model.urdf"
    if command == "export PYTHONPATH=." or command.startswith(("pip install -e karolos-", "pip install -e examples/")):
        place = folder if words[0] == "export" else install(folder / words[-1])
        monkeypatch.syspath_prepend(place)
        monkeypatch.setenv("PYTHONPATH", str(place))
        look_again()
    elif words[0] == "cd":
        monkeypatch.chdir(words[1])
    elif words[0] == "karolos":
        code, out, err = call(app, *shrunk(words[1:]))
        assert code == 0, f"{command}\n{out}{err}"
    else:
        assert command.startswith(IGNORED), f"a command that nothing runs: {command}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_is_marked(page):
    """Each block says its language. What is not run says why. Indented blocks say neither."""
    text = page.read_text(encoding="utf-8")
    assert len(BLOCK.findall(text)) * 2 == text.count("```"), "a block without a language"
    assert {language for language, _, _ in blocks(page)} <= {*RUN, *OTHER}
    assert {reason for language, reason, _ in blocks(page) if language in RUN} <= {"", *NOT_RUN}
    assert not re.search(r"(?:^|\n\n|^#.*\n)    (?:karolos|pip|ray|python) ", BLOCK.sub("", text), re.MULTILINE)


def test_a_newcomer_needs_at_most_three_commands_to_a_trained_arm():
    first = next(text for language, _, text in blocks(ROOT / "README.md") if language == "sh")
    found = list(commands(first))
    assert found[1].startswith("karolos run ")
    assert len(found) <= 3


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_commands_in_sentences_exist_with_their_options(page):
    for inline in re.findall(r"`karolos ([^`]+)`", BLOCK.sub("", page.read_text(encoding="utf-8"))):
        command, words = COMMANDS, inline.replace("|", " ").split()
        while words and words[0] in getattr(command, "commands", {}):
            command = command.commands[words.pop(0)]
        assert command.name != "karolos" or words[0].startswith("-") or words[0].isupper(), inline
        known = {option for one in command.params for option in (*one.opts, *one.secondary_opts)}
        assert {word.strip("[]") for word in words if word.startswith(("-", "[-"))} <= known | {"--help"}, inline


def test_links_of_the_readme_lead_somewhere():
    for link in re.findall(r"\]\(([^)#]+)", (ROOT / "README.md").read_text(encoding="utf-8")):
        assert (ROOT / link).exists(), link
