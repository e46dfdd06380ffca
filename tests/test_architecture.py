"""What ARCHITECTURE.md says of the code is true."""

import ast
import re
import runpy
from itertools import groupby
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
LAYERS = runpy.run_path(str(ROOT / "docs" / "_scripts" / "layers.py"))
MOST_ENTRIES = 30


def test_the_table_of_layers_is_the_generated_one():
    assert LAYERS["replaced"](PAGE) == PAGE, "run: python docs/_scripts/layers.py"


def test_every_package_says_in_one_line_what_it_is():
    rows = LAYERS["table"]().splitlines()[2:]
    assert len(rows) > 20
    assert not [row for row in rows if not re.fullmatch(r"\| `[^`]+` \| \S.*\. \|", row)]


def test_the_top_of_the_package_stays_small():
    entries = [
        path.name for path in (ROOT / "karolos").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    ]
    assert len([name for name in entries if name != "__init__.py"]) <= MOST_ENTRIES


def ways() -> dict[str, list[tuple[str, str]]]:
    """The ways that the page describes: heading -> (file, name in it) in order."""
    found = {}
    for heading, body in re.findall(r"^### (The way of .+?)\n(.*?)(?=^#|\Z)", PAGE, re.M | re.S):
        found[heading] = re.findall(r"^\d+\. `([\w/]+\.py)` `([\w.]+)`", body, re.M)
    return found


def test_the_described_ways_are_short_and_every_stop_exists():
    headings = "one transition", "one SAC update", "one test result", "a spec's line to its object", "one job on Ray"
    assert set(ways()) == {f"The way of {heading}" for heading in headings}
    for heading, stops in ways().items():
        assert 3 <= len({file for file, _ in stops}) <= 8, heading
        for file, name in stops:
            assert name in _definitions(ROOT / file), f"{heading}: {file} has no {name}"


def test_the_way_of_a_specs_line_takes_five_files_and_never_returns_to_one():
    files = [file for file, _ in groupby(file for file, _ in ways()["The way of a spec's line to its object"])]
    assert len(files) == len(set(files)) == 5


def _definitions(path: Path) -> set[str]:
    """Names of functions, classes and methods (as Class.method) of a module."""
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{item.name}" for item in node.body if isinstance(item, ast.FunctionDef)}
    return names


def test_every_file_that_the_page_names_exists():
    for name in re.findall(r"`((?:karolos|cli|docs|specs|tests|examples)/[\w./-]*\w)/?`", PAGE):
        assert (ROOT / name).exists(), name


def test_a_class_name_stands_for_one_thing():
    places: dict[str, list[str]] = {}
    for path in (*(ROOT / "karolos").rglob("*.py"), *(ROOT / "cli").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name.lstrip("_"), []).append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert len(places.pop("Settings")) > 20  # those of each plugin are nested in its class
    assert not {name: found for name, found in places.items() if len(found) > 1}
