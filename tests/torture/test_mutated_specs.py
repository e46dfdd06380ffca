"""Mutate the shipped specs and see that `karolos check` prints lines and never a traceback.

A mutant has one to four mutations: keys deleted, duplicated, renamed or moved, values of other types and sizes, deep
nesting, anchors and aliases, names of missing plugins, files to extend, broken text, overrides of any kind. In a long
test one in a hundred that `check` accepts is run with a small budget, in a process of its own. A run ends well if it is
finished, or if the command ends with an error of one line.
"""

import copy
import json
import random
import re
import shutil
import subprocess
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Iterable
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from karolos_cli.check import check
from support.torture import SEED, TIMES
from typer import Typer
from typer.testing import CliRunner

from karolos.errors import KarolosError, RunError
from karolos.records import scan
from karolos.registry import KINDS, names
from karolos.specification import load_spec
from karolos.specification.suite import is_suite

SPECS = Path(__file__).parents[2] / "specs"
BUDGET = ["seeds=[0]", "training.steps=200", "testing.interval=100", "testing.episodes=2", "testing.final_episodes=2"]
"""Overrides of a run that is to be quick."""
LONGEST_CHECK = 10.0
"""Seconds on the processor, which a busy machine does not change."""
LONGEST_LINE = 4000
EXTENDED = (
    *(
        "karolos:panda_reach.yaml",
        "karolos:bases/sac_grasp.yaml",
        "karolos:",
        "karolos:../x",
        "/etc/passwd",
        "loop.yaml",
    ),
    *("mutant.yaml", "bases", "", "/dev/zero", "\ud800.yaml", "\0", "x" * 70_000, 5, None, {"a": 1}),
    *(["karolos:panda_pick.yaml", "karolos:bases/ppo.yaml"], ["bases/pick.yaml", "mutant.yaml"], [[]], ["nothing"]),
)
"""What a mutant may extend."""
PATIENCE = 90.0
"""Seconds that such a run may take, start-up included."""
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 0.5, -0.5, 1e-300, 1e300, -1e300, 10**18, 10**30, -(10**30), 2**63, 2**31),
    *(float("inf"), float("nan"), "", " ", "x", "null", "1e5", "0x10", "sac", "panda", "../../etc/passwd", "a:b:c"),
    *("\N{SNOWMAN}" * 3, "\N{RIGHT-TO-LEFT OVERRIDE}x", "\x1b[31m", "x" * 70_000, "\N{GREEK SMALL LETTER ALPHA}\u0301"),
    *([], {}, [[]], [{}], {"": 1}, {"name": None}, {"name": []}, {"name": "sac"}, [1, 2, 3], [0] * 300, ["a"] * 5),
    *({"x": {"y": {"z": [1, {"w": 2}]}}}, [1, [2, [3, [4]]]], {"1": 1}, 1.5, 3, 10, 100, 1000, 65536, 1024, 1e6),
)
KEYS = ("", "\N{SNOWMAN}", "seeds ", *"name robot steps x extends sweep a.b Agent << null 1".split())  # noqa: SIM905
OVERRIDES = (
    *("", "\x00=1", "name=" + "n" * 300, "a" * 4000 + "=1"),
    *re.split(
        r"  |\n",
        """=  x  =1  a=b=c  .=1  agent  agent=  agent=null  agent.=1  agent..x=1  agent.name=  #=1  robot.name=[1]
seeds=[  seeds={0}  seeds=[0,0]  seeds=1  training={}  training=null  extends=x.yaml  buffer.name=priority
buffer.name=on_policy  agent.name=ppo  agent=dqn  environment=toy  task=throw
environment={name: gymnasium, id: CartPole-v1}  environment={name: gymnasium, id: 'x:Y-v0'}  robot=null
environment={name: gymnasium, id: CartPole-v1, kwargs: {x: 1}}  randomization.task.gravity=-5  task.gravity=-5
randomization.task.gravity={name: uniform, low: 1, high: 2}  randomization=5  sweep={space: {}}
sweep={space: {agent.learning_rate: {float: [0, 1], log: true}}}  training.mode=async
sweep={space: {training.batch_size: {int: [1, 1e18]}}, sampler: grid}  agent.hidden=[1,2,3]
training.device=cuda  orchestrator.processes=0  buffer.hindsight=null  demonstrations={}""",
    ),
)

Tree = Any
Place = tuple[Any, Any]
"""A container and a key or index in it."""


def places(tree: Tree) -> list[Place]:
    """Every entry of the nested mappings and lists."""
    found: list[Place] = []
    entries = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in entries:
        found += [(tree, key), *places(value)]
    return found


def put_value(tree: Tree, draw: random.Random) -> None:
    container, key = draw.choice(places(tree))
    container[key] = copy.deepcopy(draw.choice(VALUES))


def scale_number(tree: Tree, draw: random.Random) -> None:
    numbers = [(one, key) for one, key in places(tree) if isinstance(one[key], int | float)]
    if numbers:
        container, key = draw.choice(numbers)
        container[key] = container[key] * draw.choice((-1, 0, 0.1, 2, 10, 1e3, 1e9, 1e40))


def delete(tree: Tree, draw: random.Random) -> None:
    container, key = draw.choice(places(tree))
    del container[key]


def rename(tree: Tree, draw: random.Random) -> None:
    container, key = draw.choice([one for one in places(tree) if isinstance(one[0], dict)])
    letters = list(str(key))
    draw.shuffle(letters)
    container[draw.choice((*KEYS, "".join(letters), f"{key}x", str(key)[:-1], str(key).upper()))] = container.pop(key)


def add_key(tree: Tree, draw: random.Random) -> None:
    mappings = [tree, *(one[key] for one, key in places(tree) if isinstance(one[key], dict))]
    draw.choice(mappings)[draw.choice(KEYS)] = copy.deepcopy(draw.choice(VALUES))


def move(tree: Tree, draw: random.Random) -> None:
    (one, key), (other, place) = draw.choice(places(tree)), draw.choice(places(tree))
    other[place] = copy.deepcopy(one[key])


def nest(tree: Tree, draw: random.Random) -> None:
    container, key = draw.choice(places(tree))
    for _ in range(draw.choice((1, 2, 5, 31, 40, 60))):
        container[key] = [container[key]] if draw.random() < 0.5 else {"x": container[key]}


def name_plugin(tree: Tree, draw: random.Random) -> None:
    kind = draw.choice(KINDS)
    name = draw.choice((*names(kind), "sacc", "panda2", "uniforn", "karolos.robots.panda:Panda"))
    key = kind.removesuffix("s") if kind != "distributions" else "randomization"
    tree[key] = {"task.gravity": {"name": name}} if kind == "distributions" else draw.choice((name, {"name": name}))


def extend(tree: Tree, draw: random.Random) -> None:
    tree["extends"] = copy.deepcopy(draw.choice(EXTENDED))


TREE_MUTATIONS: tuple[Callable[[Tree, random.Random], None], ...] = (
    *(put_value, put_value, scale_number, scale_number, delete, rename, add_key, move, nest, name_plugin, extend),
)


def break_text(text: str, draw: random.Random) -> str:
    """Change the text of a spec below YAML's structure."""
    lines = text.splitlines() or [""]
    place = draw.randrange(len(lines))
    kind = draw.randrange(9)
    if kind == 0:
        lines.insert(place, lines[place])  # a duplicate key
    elif kind == 1:
        lines[place] = " " * draw.randrange(5) + lines[place].strip()
    elif kind == 2:
        lines.insert(place, "a0: &a [" + "x, " * 20 + "]")
        lines += [f"a{last}: &{last} [{f'*{one}, ' * 20}]" for one, last in pairwise("abcdef")]
    elif kind == 3:
        lines[place] = lines[place].replace(
            ": ", draw.choice((":", ": !!python/name:os.system ", ": &x *x ", ": - ")), 1
        )
    elif kind == 4:
        at = draw.randrange(len(lines[place]) + 1)
        lines[place] = lines[place][:at] + draw.choice("{}[]:,&*!|>'\"%@`#\t\x07\ufffe") + lines[place][at:]
    elif kind == 5:
        lines.insert(place, draw.choice(("---", "...", "<<: {agent: sac}", "? [1, 2]", "extends: s.yaml", "- x")))
    elif kind == 6:
        return text[: draw.randrange(len(text) + 1)]
    elif kind == 7:
        lines.append("x: " + "[" * draw.choice((10, 100, 10_000)))
    else:
        lines.append("y: " + "9" * draw.choice((30, 300, 3000)))
    return "\n".join(lines) + "\n"


@cache
def sources() -> list[Path]:
    """The shipped specs that are no suites."""
    return [path for path in sorted(SPECS.glob("*.yaml")) if not is_suite(path)]


@cache
def _dumped(source: Path) -> str:
    return json.dumps(load_spec(source).dump())


def resolved(source: Path) -> Tree:
    """The spec with every setting."""
    return json.loads(_dumped(source))


def mutant(draw: random.Random, specs: list[Path]) -> tuple[str, list[str]]:
    """The text of a mutated spec, and overrides."""
    source = draw.choice(specs)
    whole = draw.random() < 0.7  # every setting is there, and can break
    tree = resolved(source) if whole else yaml.safe_load(source.read_text("utf-8"))
    for _ in range(draw.choice((0, 1, 1, 1, 2, 2, 4))):
        if places(tree):
            draw.choice(TREE_MUTATIONS)(tree, draw)
    text = yaml.dump(tree, sort_keys=False, allow_unicode=True)
    if draw.random() < 0.15:
        text = break_text(text, draw)
    overrides = [draw.choice(OVERRIDES) for _ in range(draw.choice((0, 0, 0, 0, 1, 2)))]
    return text, overrides


def checked(app: Typer, path: Path, overrides: list[str]) -> tuple[int, str, str | None]:
    """Exit code and output of `check`, and the traceback if it raised."""
    result = CliRunner().invoke(app, [str(path), *(text for text in overrides if not text.startswith("-"))])
    error = result.exception
    if isinstance(error, KarolosError):
        return error.exit_code, str(error), None
    if error is not None and not isinstance(error, SystemExit):
        return 1, result.output, "".join(traceback.format_exception(error))
    return result.exit_code, result.output, None


def ended(path: Path, overrides: list[str], runs: Path) -> str | None:
    """Why the run of an accepted mutant did not end well within its time limit; None if it did."""
    command = [sys.executable, "-m", "karolos_cli", "run", str(path), *overrides, *BUDGET]
    command += ["--runs", str(runs), "--time-limit", "30s"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    except subprocess.TimeoutExpired:
        return f"was not over after {PATIENCE:g} s"
    if "Traceback" in done.stderr:
        return done.stderr
    for folder in scan(runs):
        traces = [] if isinstance(folder, RunError) else [event.get("traceback") for event in folder.events()]
        if any(traces):  # a fault of karolos or a plugin, which the command prints as one line
            return "\n".join(filter(None, traces))
    if done.returncode in (0, 124):  # finished, or stopped by the time limit
        return None
    return None if done.stderr.strip() else f"ended with {done.returncode} without a word"


APP = Typer()
APP.command()(check)


def check_mutants(numbers: Iterable[int], seed: int, folder: Path) -> tuple[str, list[str], list[int]]:
    """Check mutants in a copy of the shipped specs.

    Returns:
        A line of counts; what went wrong, by mutant; and the numbers of the mutants that are valid specs.
    """
    codes: Counter[int] = Counter()
    accepted, wrong, slowest = [], [], 0.0
    for number in numbers:
        path, overrides = write_mutant(number, seed, folder)
        start = time.process_time()
        code, output, trace = checked(APP, path, overrides)
        seconds = time.process_time() - start
        codes[code] += 1
        slowest = max(slowest, seconds)
        if trace is not None:
            wrong.append(f"mutant {number}: {overrides}\n{trace}")
        if seconds > LONGEST_CHECK:
            wrong.append(f"mutant {number}: checked in {seconds:.1f} s")
        if longest := [len(line) for line in output.splitlines() if len(line) > LONGEST_LINE]:
            wrong.append(f"mutant {number}: lines of {longest} characters")
        if code == 0:
            accepted.append(number)
    counts = f"{sum(codes.values())} mutants, exit codes {dict(sorted(codes.items()))}, slowest {slowest:.1f} s"
    return counts, wrong, accepted


def write_mutant(number: int, seed: int, folder: Path) -> tuple[Path, list[str]]:
    """Write a mutant into a copy of the shipped specs; returns its file and its overrides."""
    specs = folder / "specs"
    if not specs.exists():
        shutil.copytree(SPECS, specs)
        (specs / "loop.yaml").symlink_to("loop.yaml")
    text, overrides = mutant(random.Random(f"{seed} {number}"), sources())
    path = specs / "mutant.yaml"
    path.write_text(text, "utf-8", errors="surrogatepass")
    return path, overrides


def test_no_mutated_spec_gives_a_traceback(tmp_path):
    counts, wrong, accepted = check_mutants(range(12 * TIMES), 6 + SEED, tmp_path)
    assert not wrong, (counts, *wrong)
    for number in accepted[99::100]:
        path, overrides = write_mutant(number, 6 + SEED, tmp_path)
        assert ended(path, overrides, tmp_path / f"runs-{number}") is None, f"mutant {number}"
