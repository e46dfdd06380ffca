"""Writes the table of layers in ARCHITECTURE.md from the import contract and from the packages' docstrings.

python docs/_scripts/layers.py          write the table
python docs/_scripts/layers.py --check  exit 1 if the table in the file is not the generated one
"""

from __future__ import annotations

import ast
import sys
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[2]
BEGIN = "<!-- layers: written by docs/_scripts/layers.py -->"
END = "<!-- end of layers -->"


def table() -> str:
    """The layers as a Markdown table, from the top layer down: package and first line of its docstring."""
    rows = ["| package | subject |", "|---|---|", _row("cli"), _row("bench")]
    for layer in _layers():
        rows += [_row(f"karolos/{name.strip()}") for name in layer.replace(":", "|").split("|")]
    return "\n".join(rows)


def _layers() -> list[str]:
    """The layers of the import contract, from the top down; packages of one layer are separated by `|` or `:`."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    return next(contract["layers"] for contract in contracts if contract["type"] == "layers")


def _row(path: str) -> str:
    place = ROOT / path
    is_package = place.is_dir()
    source = place / "__init__.py" if is_package else place.with_suffix(".py")
    docstring = ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or ""
    shown = f"{path}/" if is_package else f"{path}.py"
    return f"| `{shown}` | {docstring.splitlines()[0] if docstring else ''} |"


def replaced(text: str) -> str:
    """The text of ARCHITECTURE.md with the generated table between the two markers."""
    before, _, rest = text.partition(BEGIN)
    _, _, after = rest.partition(END)
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def main() -> None:
    page = ROOT / "ARCHITECTURE.md"
    text = page.read_text(encoding="utf-8")
    if "--check" in sys.argv[1:]:
        sys.exit(replaced(text) != text)
    page.write_text(replaced(text), encoding="utf-8")


if __name__ == "__main__":
    main()
