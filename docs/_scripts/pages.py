"""The pages of the site that are generated: from the command line, plugins, database tables and reference runs.

`make -C docs html` calls `write`. The pages are not kept in git, so that they cannot differ from what they show.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import shutil
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import references
import typer
import yaml
from films import FILMS, played_in
from karolos_cli.main import app
from karolos_cli.plugins import _settings
from typer.testing import CliRunner

from karolos.comparison import Contender, compare
from karolos.plugins.inspection import inspect_robot, inspect_task
from karolos.records import RunFolder, paths, run_records, shipped
from karolos.registry import KINDS, entries, load, singular
from karolos.report.comparison_figures import learning
from karolos.report.tables import setting
from karolos.specification.bind import models_in
from karolos.specification.model import Spec
from karolos.store import tables

ROOT = Path(__file__).parents[2]
TASKS = {
    "reach": ("reach",),
    "reach_pose": ("reach_pose",),
    "push": ("push",),
    "pick_place": ("pick", "pick_demos"),
    "throw": ("throw",),
    "insert": ("insert",),
    "stack": ("stack", "stack_demos"),
    "slide": ("slide", "slide_demos"),
    "reorient": ("reorient", "reorient_demos"),
    "open": ("open",),
}
"""Task -> its specs, without the robot."""
WALL = {
    "panda_reach": "reach",
    "ur5_push": "push",
    "panda_pick": "pick_place",
    "iiwa_throw": "throw",
    "ur5_insert": "insert",
    "panda_stack": "stack",
    "iiwa_slide_demos": "slide",
    "ur5_open": "open",
    "panda_reorient_demos": "reorient",
    "panda_reach_pose": "reach_pose",
    "desk_arm_pick": "an arm from its URDF",
    "ur5e_pick": "a UR5e, through karolos-deploy",
}
"""Films of the home page with their captions: ten tasks, three arms, two foreign arms."""
COPIED = {"ARCHITECTURE.md": "architecture.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
KIND_TEXTS = {
    "robots": "A robot with a task is an environment.",
    "grippers": "A gripper holds objects: `robot.gripper`.",
    "tasks": "A task goes with every robot.",
    "environments": "The agent acts in an environment. With `robot` and `task` it is `robot_task`.",
    "agents": "An agent is the algorithm.",
    "buffers": "The agent learns from a buffer.",
    "distributions": "Domain randomization samples from a distribution.",
    "orchestrators": "An orchestrator spreads environments over the machine.",
    "launchers": "A launcher starts runs.",
}


def write(folder: Path) -> None:
    """Write every generated page into `folder`. Files that did not change keep their time."""
    found: dict[str, str] = {
        "command_line.md": command_line(),
        "spec_keys.md": spec_keys(),
        "json_rows.md": json_rows(),
        "database.md": database(),
        **{f"parts/{kind}.md": parts(kind) for kind in KINDS},
        **{target: copied(source) for source, target in COPIED.items()},
    }
    folder.mkdir(exist_ok=True)
    (folder / "gallery").mkdir(exist_ok=True)
    found |= gallery(folder / "gallery")
    (folder / "wall.txt").write_text(wall(), encoding="utf-8")
    for name, text in found.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for path in folder.rglob("*.md"):
        if path.relative_to(folder).as_posix() not in found:
            path.unlink()


def table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown, with an empty line after it."""
    lines = [columns, ["---"] * len(columns), *([_cell(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n\n"


def _cell(value: object) -> str:
    return " ".join(str(value).split()).replace("|", "\\|").replace("<", "&lt;")


def _code(text: str) -> str:
    return f"`{text}`" if text else ""


def copied(name: str) -> str:
    """A page of the project's root, whose links lead to the pages of the site."""
    text = (ROOT / name).read_text(encoding="utf-8")
    for source, target in COPIED.items():
        text = text.replace(f"]({source})", f"]({target})")
    return text.replace("](docs/", "](../").replace("](runs/", "](../../runs/")


def command_line() -> str:
    """Every command with its arguments and options."""
    root = typer.main.get_command(app)
    about = "Options that all commands have: `--help`. The environment variable `NO_COLOR` turns colours off.\n\n"
    return f"# Command line\n\n{about}{''.join(_commands(root, 'karolos'))}"


def _commands(command: Any, name: str) -> Iterator[str]:
    if command.hidden:
        return
    context = typer.Context(command, info_name=name)
    depth = min(1 + len(name.split()), 4)
    yield f"{'#' * depth} {name}\n\n{inspect.cleandoc(command.help or '')}\n\n"
    usage = re.sub(r"\{([^{}]+)\}", r"\1", " ".join(command.collect_usage_pieces(context)))
    yield f"```text\n{name} {usage.replace('[[', '[').replace(']...]...', ']...')}\n```\n\n"
    records = filter(None, (one.get_help_record(context) for one in command.get_params(context)))
    rows = [(_code(re.sub(" <.*>", "", names)), about) for names, about in records if not names.startswith("--help")]
    if rows:
        yield table(["", ""], rows)
    for each in getattr(command, "commands", {}):
        yield from _commands(command.get_command(context, each), f"{name} {each}")


def _settings_table(model: Any) -> str:
    rows = [
        (
            _code(row["setting"]),
            row["type"],
            "required" if row["required"] else _code(setting(row["default"])),
            row["description"],
        )
        for row in _settings(model)
    ]
    return table(["setting", "type", "default", "what"], rows) if rows else "No settings.\n\n"


def parts(kind: str) -> str:
    """The plugins of a kind that come with karolos, with their settings."""
    text = (
        f"# {kind.title()}\n\n{KIND_TEXTS[kind]} `karolos plugins list {singular(kind)}` lists the installed ones.\n\n"
    )
    for entry in entries(kind):
        if entry.distribution == "karolos":
            plugin = load(kind, entry.name)
            text += f"## {entry.name}\n\n{_prose(inspect.getdoc(plugin) or '')}\n\n{_settings_table(plugin.Settings)}"
            text += _facts(kind, entry.name)
    return text


def _facts(kind: str, name: str) -> str:
    """Tables of `karolos inspect`: joints and gripper of a robot, goals of a task, parameters for randomization."""
    if kind not in ("robots", "tasks") or name in ("urdf", "random_arm"):  # which have none without a file or a number
        return ""
    found = inspect_robot(name, size=None) if kind == "robots" else inspect_task(name, size=None)
    text = ""
    for heading, rows in found.tables.items():
        if rows and heading != "settings":
            shown = [
                [f"{round(cell, 4):g}" if isinstance(cell, float) else cell for cell in row.values()] for row in rows
            ]
            text += f"### {name}: {heading}\n\n{table(list(rows[0]), shown)}"
    return text


def _prose(doc: str) -> str:
    """A docstring as Markdown: sections become lists, fixed headings begin a line, and nothing in it is HTML."""
    lines: list[str] = []
    for line in doc.replace("<", "&lt;").splitlines():
        if line in ("Args:", "Raises:", "Returns:"):
            lines += ["", f"**{line[:-1]}**", ""]
        elif line.startswith("    ") and not line.startswith("     "):
            lines.append(f"* {line.strip()}")
        elif re.match(r"[A-Z][a-z ]+: ", line) and lines and lines[-1]:
            lines += ["", line]
        else:
            lines.append(line)
    return "\n".join(lines)


def spec_keys() -> str:
    """The keys of a spec that do not belong to a plugin."""
    text = "# Keys of a spec\n\nA part is a name or a mapping with `name` and the plugin's settings.\n\n"
    top = [(_code(name), field.description or "") for name, field in Spec.model_fields.items()]
    text += table(["key", "what"], [("`extends`", "specs that this one changes, relative to it"), *top])
    for name in ("training", "testing", "demonstrations", "sweep", "transfer"):
        (model,) = models_in(Spec.model_fields[name].annotation)
        text += f"## {name}\n\n{inspect.getdoc(model) or ''}\n\n{_settings_table(model)}"
    return text


def database() -> str:
    """The tables of the results database, with the comments that stand in the code."""
    comments = _comments(inspect.getsource(tables))
    text = (
        "# Database\n\nThe database is an index of the run folders: `karolos db reindex` builds it from them. It is "
        f"SQLite or PostgreSQL. The version of the tables is {tables.SCHEMA}.\n\n"
    )
    for name, one in vars(tables).items():
        if isinstance(one, tables.Table):
            rows = []
            for column in one.columns:
                key = next((f"of `{key.column}`" for key in column.foreign_keys), "")
                marks = ", ".join(filter(None, ["key" if column.primary_key else "", key]))
                rows.append((_code(column.name), str(column.type), "yes" if column.nullable else "", marks))
            text += f"## {one.name}\n\n{comments.get(name, '')}\n\n{table(['column', 'type', 'null', 'key'], rows)}"
    return text


def _comments(source: str) -> dict[str, str]:
    """The strings that stand after assignments of a module or a class, by the names that they explain."""
    found = {}
    for body in [ast.parse(source).body, *(node.body for node in ast.parse(source).body if hasattr(node, "body"))]:
        for before, after in pairwise(body):
            target = before.targets[0] if isinstance(before, ast.Assign) else getattr(before, "target", None)
            if isinstance(target, ast.Name) and isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
                found[target.id] = str(after.value.value)
    return found


EXAMPLES = (
    ("runs list", "One row per run, the newest first. The table above explains the fields."),
    ("runs show panda_reach-s0", "One row: the run with its tests, settings and versions."),
    ("compare panda_reach ur5_reach", "One row per experiment."),
    ("diff panda_reach-s0 ur5_reach-s0", "One row per difference."),
    ("plugins list robot", "One row per plugin."),
    ("plugins show buffer priority", "One row per setting."),
    ("plugins check distribution uniform low=0 high=1", "One row per promise."),
    ("inspect robot panda --width 64 --height 48", "One row with all tables."),
    ("check specs/panda_reach.yaml", "One row per problem or note; without either one row that says so."),
)
"""Commands whose rows the page shows, and what a row is."""


def json_rows() -> str:
    """What `--json` prints: the fields of a run, and an example of each command that reads."""
    comments = _comments(inspect.getsource(run_records.RunSummary))
    types = {field.name: _json_type(str(field.type)) for field in fields(run_records.RunSummary)}
    text = (
        "# JSON rows\n\nWith `--json` a command prints one JSON object per row on stdout. Numbers that are not finite "
        "are null. The examples below are printed by the commands, from the reference runs; `...` stands for what is "
        "left out here.\n\n## A run\n\n`karolos run`, `karolos resume` and `karolos runs list` print these fields. "
        "`karolos.runs().rows()` has the same columns.\n\n"
    )
    text += table(
        ["field", "type", "what"], [(_code(name), kind, comments.get(name, "")) for name, kind in types.items()]
    )
    with TemporaryDirectory() as scratch:
        runs = Path(scratch) / "runs"
        shutil.copytree(references.REFERENCE, runs, ignore=shutil.ignore_patterns("karolos.sqlite*"))
        _printed("db reindex", runs)
        for command, about in EXAMPLES:
            lines = [line for line in _printed(command, runs, "--json").splitlines() if line.startswith("{")]
            row = json.dumps(_shortened(json.loads(lines[0])), indent=2).replace('"..."', "...")
            words = command.split()[: 2 if command.startswith(("runs", "plugins", "inspect")) else 1]
            text += f"## karolos {' '.join(words)}\n\n{about} `karolos {command} --json`:\n\n"
            text += f"```text\n{row.replace(f'{scratch}/', '').replace(f'{ROOT}/', '')}\n```\n\n"
    return text + _fields_of_a_transfer()


def _fields_of_a_transfer() -> str:
    """The names of the fields of `karolos test --json`; no reference run has been tested elsewhere."""
    row = RunFolder.open(paths(references.REFERENCE)[0]).final()["last"].changed_row()
    names = ", ".join(f"`{name}`" for name in ("run", *row))
    return f"## karolos test\n\nOne row with the fields {names}. `own` is the same test under the unchanged spec.\n"


def _json_type(annotation: str) -> str:
    """What a value of this annotation is in JSON."""
    words = {"str": "text", "int": "integer", "float": "number", "bool": "true, false", "None": "null"}
    return " or ".join(words.get(word, "list of texts") for word in annotation.split(" | "))


def _printed(command: str, runs: Path, *options: str) -> str:
    words = [str(ROOT / word) if word.startswith("specs/") else word for word in command.split()]
    places = ["--runs", str(runs)] if words[0] in ("runs", "compare", "diff", "db") else []
    places += ["--out", str(runs / "robot.png")] if words[0] == "inspect" else []
    ended = CliRunner().invoke(app, [*words, *places, *options], catch_exceptions=False)
    if ended.exit_code:
        raise RuntimeError(f"karolos {command} ends with {ended.exit_code}: {ended.output}")
    return ended.stdout


def _shortened(value: Any, longest: int = 3) -> Any:
    """A JSON value whose lists and mappings of many entries are cut."""
    if isinstance(value, dict):
        kept = list(value.items()) if len(value) <= 60 else list(value.items())[:longest]
        return {key: _shortened(one) for key, one in kept} | ({} if len(kept) == len(value) else {"...": "..."})
    if isinstance(value, list) and len(value) > longest:
        return [*(_shortened(one) for one in value[:2]), "..."]
    return [_shortened(one) for one in value] if isinstance(value, list) else value


def gallery(folder: Path) -> dict[str, str]:
    """An overview and a page for each pair of robot and task; figures are written into `folder`."""
    found = references.contenders()
    overview = (
        "# Gallery\n\nThree arms with nine of ten tasks. Films show shipped policies. The numbers are "
        "success at the end of 1,000 held-out episodes, mean over the seeds of the "
        "[reference runs](../../results.md).\n\n"
    )
    pages: dict[str, str] = {}
    for task, specs in TASKS.items():
        overview += f"## {task}\n\n::::{{grid}} 1 2 3 3\n:gutter: 2\n\n"
        for robot in references.ROBOTS:
            names = [f"{robot}_{one}" for one in specs]
            pages[f"gallery/{robot}_{task}.md"] = _pair(robot, task, names, found, folder)
            numbers = "<br>".join(_labelled(name, found.get(name)) for name in names)
            overview += (
                f":::{{grid-item-card}} {robot}\n:img-top: ../../films/{_film(names)}.gif\n"
                f":img-alt: {robot} {task}\n:link: {robot}_{task}\n:link-type: doc\n\n{numbers}\n:::\n"
            )
        overview += "::::\n\n"
    listed = "\n".join(Path(name).stem for name in pages)
    pages["gallery/index.md"] = f"{overview}\n```{{toctree}}\n:hidden:\n\n{listed}\n```\n"
    return pages


def wall() -> str:
    """The films of the home page, each with a link to its page."""
    text = "::::{grid} 2 3 4 4\n:gutter: 1\n:class-container: wall\n\n"
    for film, caption in WALL.items():
        robot, task = film.split("_")[0], caption.split(" ")[0]
        page = f"generated/gallery/{robot}_{task}" if task in TASKS else "your_robot"
        page = "deploy" if film == "ur5e_pick" else page
        arm = f"{robot}: " if task in TASKS else ""
        text += (
            f":::{{grid-item-card}}\n:img-top: films/{film}.gif\n:img-alt: {film}\n:link: {page}\n:link-type: doc\n\n"
            f"{arm}{caption}\n:::\n"
        )
    return f"{text}::::\n"


def _labelled(name: str, one: Contender | None) -> str:
    """A line about a spec: its success with what the number is."""
    if one is None:
        return f"`{name}`: no reference run"
    seeds = len(one.runs)
    end = float(compare([one]).scores[0].end.value)
    return f"`{name}`: **{end:.3f}** success, {seeds} seed{'s' * (seeds != 1)}"


def _film(names: Sequence[str]) -> str:
    """The name of the film that is shown for these specs: of the first whose policy ships."""
    return next(name for name in names if name in shipped.shipped_names())


def _pair(robot: str, task: str, names: Sequence[str], found: dict[str, Contender], folder: Path) -> str:
    film = _film(names)
    policy = f"../../../karolos/records/shipped_runs/{film}"
    text = (
        f"# {robot}: {task}\n\n![{robot} {task}](../../films/{film}.gif)\n\n"
        f"The film shows the shipped policy `{film}` in test episodes of its run. `karolos play "
        f"{film}` plays it. Files: [policy.npz]({policy}/policy.npz), [policy.json]({policy}/policy.json); sha256 "
        f"`{played_in(FILMS / f'{film}.gif')[:16]}`.\n\n"
    )
    return text + "".join(_of_spec(name, found.get(name), folder) for name in names)


def _of_spec(name: str, one: Contender | None, folder: Path) -> str:
    text = f"## {name}\n\n"
    seeds = "0" if one is None else ",".join(sorted(str(run.summary.seed) for run in one.runs))
    if one is None:
        text += "There is no reference run of this spec yet. This command makes one:\n\n"
    else:
        drawing = learning(compare([one]), "steps")
        drawing.save(folder / f"{name}.svg")
        text += f"![{drawing.title} of {name}]({name}.svg)\n\n{drawing.caption}\n\n"
        text += f"{references._results({name: one}, [name])}\n\n"
        text += "[How to read the table](../../results.md#each-seed). This command repeats the runs:\n\n"
    text += f"```sh\nkarolos run specs/{name}.yaml seeds=[{seeds}]\n```\n\n"
    for path in _files(ROOT / "specs" / f"{name}.yaml"):
        lines = path.read_text(encoding="utf-8").strip()
        text += f"`{path.relative_to(ROOT).as_posix()}`:\n\n```yaml\n{lines}\n```\n\n"
    return text + ("" if one is None else _software(one))


def _files(path: Path) -> Iterator[Path]:
    """A spec file, and those that it extends."""
    yield path
    extended = yaml.safe_load(path.read_text(encoding="utf-8")).get("extends", [])
    for each in [extended] if isinstance(extended, str) else extended:
        yield from _files((path.parent / each).resolve())


def _software(one: Contender) -> str:
    """Machine, commit and versions of each run."""
    rows = []
    for run in one.runs:
        about = RunFolder.open(run.summary.folder).description()
        versions = about.get("versions") or {}
        chosen = ("python", "karolos", "torch", "numpy", "pybullet", "mujoco-core")
        software = ", ".join(f"{name} {versions[name]}" for name in chosen if name in versions)
        commit = (about.get("git") or {}).get("commit", "")[:12]
        rows.append((run.summary.seed, about.get("machine", ""), _code(commit), software, run.summary.created[:10]))
    return table(["seed", "machine", "commit", "versions", "made"], rows)
