"""Tables of learning are generated from reference runs, and these are of the specs that ship."""

import json
import runpy
import shutil
from itertools import product
from pathlib import Path

import pytest

from karolos.errors import KarolosError
from karolos.records import paths
from karolos.records.shipped import shipped_names

ROOT = Path(__file__).parents[1]
SCRIPT = runpy.run_path(str(ROOT / "docs" / "_scripts" / "references.py"))
REFERENCE: Path = SCRIPT["REFERENCE"]
MOST_BYTES = 20_000_000


def test_tables_reference_runs_and_shipped_specs_agree():
    assert paths(REFERENCE)
    assert SCRIPT["problems"]() == []


def test_the_tables_of_benchmarks_are_those_of_their_rows(monkeypatch, tmp_path):
    script = runpy.run_path(str(ROOT / "docs" / "_scripts" / "benchmarks.py"))
    script["main"]("check", [])
    page = tmp_path / "benchmarks.md"
    page.write_text(script["PAGE"].read_text(encoding="utf-8").replace("updates/s", "updates/h"))
    monkeypatch.setitem(script["main"].__globals__, "PAGE", page)
    with pytest.raises(SystemExit, match="has other tables"):
        script["main"]("check", [])


def test_every_pair_of_robot_and_task_has_a_spec():
    for robot, task in product(SCRIPT["ROBOTS"], SCRIPT["TARGETS"]):
        assert (ROOT / "specs" / f"{robot}_{task}.yaml").is_file()


def test_films_show_the_shipped_policies():
    films = runpy.run_path(str(ROOT / "docs" / "_scripts" / "films.py"))
    guests = {name: policy for name, (policy, _) in films["GUESTS"].items()}
    for name, policy in ({name: name for name in shipped_names()} | guests).items():
        shown = films["played_in"](films["FILMS"] / f"{name}.gif")
        assert shown == films["sha256"](policy), f"run: docs/_scripts/films.py {name}"


def test_reference_runs_are_small_and_hold_no_weights():
    files = [path for path in REFERENCE.rglob("*") if path.is_file() and path.suffix != ".sqlite"]
    of_runs = {path.name for path in files if not path.is_relative_to(SCRIPT["TRANSFERS"])}
    assert of_runs <= {*SCRIPT["FILES"], "README.md"}
    assert {path.suffix for path in files} <= {".yaml", ".json", ".jsonl", ".md"}
    assert sum(path.stat().st_size for path in files) < MOST_BYTES


def test_reference_runs_name_no_place_on_a_machine():
    for path in paths(REFERENCE):
        words = json.loads((path / "run.json").read_text(encoding="utf-8"))["command"]
        assert not [word for word in words if Path(word).is_absolute() or word.startswith(("~", "--runs"))], path.name


def test_an_infinite_end_that_rows_hold_as_null_is_shown():
    row = {"value": 0.5, "low": 0.25, "high": None, "kind": "range"}
    assert SCRIPT["_estimate"](row) == "0.500 (0.250 to \N{INFINITY})"
    assert SCRIPT["_estimate"](None) == "-"


def test_a_command_is_kept_without_its_folder_and_database():
    words = ["karolos", "run", "specs/a.yaml", "--runs", "/tmp/a", "seeds=[0]", "--database=sqlite:///b", "--quiet"]
    assert SCRIPT["portable"](words) == ["karolos", "run", "specs/a.yaml", "seeds=[0]", "--quiet"]


def test_a_run_of_another_spec_or_without_its_final_test_is_refused(tmp_path):
    run = shutil.copytree(paths(REFERENCE)[0], tmp_path / "run")
    resolved = json.loads((run / "resolved.json").read_text())
    resolved["training"]["steps"] += 1
    (run / "resolved.json").write_text(json.dumps(resolved))
    (run / "final.jsonl").unlink()
    with pytest.raises(KarolosError, match=r"no final test .* its spec is not the shipped one"):
        SCRIPT["add"](run)
