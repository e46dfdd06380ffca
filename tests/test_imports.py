"""What a command or a module does not need is not imported, so that it starts fast and is small in a worker."""

import subprocess
import sys
from pathlib import Path

from support.run_samples import add_run

import karolos

DRAWN = "alembic gymnasium imageio matplotlib mujoco multiprocessing.connection onnx optuna pybullet ray scipy"
DRAWN += " sqlalchemy.dialects.postgresql tensorboard torch"
HEAVY = f"{DRAWN} numpy sqlalchemy.orm yaml"
COMMANDS = [
    ("runs list agent=sac --json --runs {0}", f"{HEAVY} rich"),
    ("runs list --csv --runs {0}", f"{HEAVY} rich"),
    ("sweeps list --runs {0}", f"{HEAVY} rich"),
    ("--help", HEAVY),
    ("run --help", HEAVY),
    ("plugins list", HEAVY),
    ("runs list --runs {0}", HEAVY),
    ("compare reach --runs {0}", DRAWN),
    ("runs show @last --runs {0}", DRAWN),
]
"""Commands in one process, and what none until then may have imported."""
CALL = """
import sys
from karolos_cli import main
folder = sys.argv[-1]
for words, heavy in {commands}:
    sys.argv = ["karolos", *words.format(folder).split()]
    try:
        main()
    except SystemExit as end:
        assert not end.code, end.code
    print("imported:", words, *[name for name in heavy.split() if name in sys.modules], file=sys.stderr)
"""
MODULES = [
    ("import karolos", "torch numpy sqlalchemy pydantic gymnasium importlib.metadata"),
    ("import karolos.export", "torch pydantic pybullet mujoco onnx"),
    (
        "from karolos.registry import KINDS, names; assert 'panda' in sum(map(names, KINDS), [])",
        "torch pybullet mujoco pydantic karolos.robots",
    ),
    ("import karolos.records.checkpoint", "torch"),
    ("import karolos.orchestrator.local", "torch pybullet mujoco sqlalchemy"),
    ("from karolos.specification.parts import Part", "torch pybullet mujoco sqlalchemy typer"),
    ("Part.of('environments', 'toy', {})", "torch pybullet mujoco sqlalchemy typer"),
    ("Part.of('robots', 'panda', {}); Part.of('tasks', 'reach', {})", "torch pybullet mujoco sqlalchemy typer"),
]


def process(code: str, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True, check=True)


def test_commands_import_only_what_they_need(tmp_path):
    add_run(tmp_path, 0)
    ended = process(CALL.format(commands=COMMANDS), str(tmp_path))
    told = [line for line in ended.stderr.splitlines() if line.startswith("imported:")]
    assert told == [f"imported: {words}" for words, _ in COMMANDS]


def test_a_module_imports_only_what_it_needs():
    lines = ["import sys"]
    for code, heavy in MODULES:
        lines += [code, f"print([name for name in {heavy.split()} if name in sys.modules])"]
    assert process("\n".join(lines)).stdout == "[]\n" * len(MODULES)


def test_ctrl_c_is_handled_before_anything_large_is_imported():
    code = "import sys; sys.path.append(sys.argv[1]); import karolos.experiment.interrupt; print(*sys.modules)"
    command = [sys.executable, "-I", "-S", "-c", code, str(Path(karolos.__file__).parents[1])]
    modules = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()
    assert not {"typing", "threading", "contextlib", "pathlib", "re"}.intersection(modules)
