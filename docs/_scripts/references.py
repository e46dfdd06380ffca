"""Reference runs: the runs that the tables of learning in README.md and docs/results.md are generated from.

python docs/_scripts/references.py add RUN...   copy finished run folders into runs/reference
python docs/_scripts/references.py ship RUN...  let their policies ship: of each spec the run of seed 0
python docs/_scripts/references.py tables       write the tables
python docs/_scripts/references.py check        exit 1 if tables, reference runs and shipped specs do not agree
"""

from __future__ import annotations

import json
import math
import runpy
import shutil
import sys
from collections.abc import Iterator
from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from karolos.comparison import Contender, Estimate, compare, gather
from karolos.comparison.reaching import median_reaching
from karolos.errors import KarolosError
from karolos.export.export import export_policy
from karolos.plans.matrix import Matrix
from karolos.records import RunFolder, paths, shipped
from karolos.records.decode import from_json
from karolos.report.tables import count, duration, estimate
from karolos.specification import Spec, load_spec, spec_from_dict
from karolos.store import Store, reindex
from karolos.system.files import write_json

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT / "runs" / "reference"
TRANSFERS = REFERENCE / "transfers"
"""A folder per matrix, called as its spec: rows.jsonl, which --json printed, and the resolved spec of each variant."""
FILES = ("spec.yaml", "resolved.json", "run.json", "state.json", "tests.jsonl", "final.jsonl", "labels.json")
"""What is kept of a run: no weights, no training episodes."""
RETURN_PLACES, MEASURE_DIGITS = 2, 3
"""Decimal places that are kept of the return of an episode, and significant digits of a measure."""
SHARED = "shared-machine"
"""Tag of runs that shared their machine with other work: their times are upper limits."""
SHORTER = ("training.steps=", "testing.final_episodes=")
"""Settings of variants that train for less than the shipped spec or are not tested at the end."""
ROBOTS = ("panda", "ur5", "iiwa")
TARGETS = {
    "reach": (0.99, 8),
    "reach_pose": (0.99, 30),
    "push": (0.97, 25),
    "pick": (0.97, 30),
    "pick_demos": (0.97, 12),
    "throw": (0.95, 120),
    "insert": (0.99, 60),
    "insert_demos": (0.99, 120),
    "stack": (0.97, 150),
    "stack_demos": (0.95, 180),
    "slide": (0.93, 600),
    "slide_demos": (0.95, 600),
    "reorient": (0.95, 900),
    "reorient_demos": (0.95, 900),
    "open": (0.95, 300),
}
"""Task, as in the name of a spec -> the least `end` of every seed, and the most seconds to .95 (median)."""


def command(folder: RunFolder) -> tuple[str, tuple[str, ...]]:
    """The spec file and the settings that a run's command changes, its name and seeds left out."""
    words = folder.description().get("command") or []
    if words[1:2] != ["run"] or len(words) < 3 or not (ROOT / words[2]).is_relative_to(ROOT / "specs"):
        raise KarolosError(f"its command is not `karolos run specs/...`, but {' '.join(words)}")
    return words[2], tuple(word for word in words[3:] if "=" in word and not word.startswith(("-", "name=", "seeds=")))


@cache
def shipped_spec(path: str, changed: tuple[str, ...]) -> Spec:
    """A spec as it ships, with some settings changed."""
    return load_spec(ROOT / path, changed)


def _steps(path: str, changed: tuple[str, ...]) -> int | None:
    """The steps of a variant that is compared in tests, not in final ones: it trains for less or has no final test."""
    return shipped_spec(path, changed).training.steps if any(word.startswith(SHORTER) for word in changed) else None


@cache
def shipped_hash(path: str, changed: tuple[str, ...]) -> str:
    """The hash of a spec as it ships, with some settings changed."""
    return shipped_spec(path, changed).hash()


def faults(folder: RunFolder) -> Iterator[str]:
    """Why a run cannot be a reference, one line each."""
    record, git = folder.record(), folder.description().get("git")
    yield from record.problems
    if record.summary.state != "finished":
        yield f"the run is {record.summary.state}, not finished"
    if not git or git["dirty"]:
        yield "its code is not that of a commit"
    try:
        path, changed = command(folder)
        final = folder.final()
        if _steps(path, changed) is None and (len(final) < 2 or final["last"].episodes < 1000):
            yield "it has no final test of last and best with 1,000 episodes"
        if spec_from_dict(record.spec).hash() != shipped_hash(path, changed):
            yield "its spec is not the shipped one"
        if _is_shipped(record.summary.name) and shipped_hash(path, changed) != shipped_hash(path, ()):
            yield f"its settings are changed, but it is called {record.summary.name}"
    except KarolosError as error:
        yield f"its spec is not the shipped one: {error}"


def add(path: Path) -> Path:
    """Copy a run folder into runs/reference; returns the copy. Raises KarolosError if it cannot be a reference."""
    folder = RunFolder.open(path)
    wrong = list(faults(folder))
    if wrong:
        raise KarolosError("; ".join(wrong), where=str(path))
    about = folder.description()
    target = REFERENCE / f"{about['name']}-s{about['seed']}"
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    for name in FILES:
        if (path / name).exists():
            shutil.copy(path / name, target)
    _leave_out(target / "tests.jsonl", "measures", "distances", "reset")
    if (target / "final.jsonl").exists():
        _leave_out(target / "final.jsonl", "distances")  # the measure final_distance has them, too
        _leave_out(target / "final.jsonl", "measures", after=1)  # of the best policy, behind that of the last one
    write_json(target / "run.json", {**about, "command": portable(about["command"])})
    return target


def _leave_out(tests: Path, *keys: str, after: int = 0) -> None:
    """Leave out what is most of the bytes of a record of tests and what comparisons do not take from it.

    Returns and values of measures are rounded. The first `after` lines keep all keys.
    """
    rows = [json.loads(line) for line in tests.read_text(encoding="utf-8").splitlines()]
    kept = rows[:after] + [{key: value for key, value in row.items() if key not in keys} for row in rows[after:]]
    for row in kept:
        if "returns" in row:  # else it says which policies the others are of
            row["returns"] = [round(value, RETURN_PLACES) for value in row["returns"]]
        for measure in row.get("measures", {}).values():
            measure["values"] = [one and float(f"{one:.{MEASURE_DIGITS}g}") for one in measure["values"]]
    tests.write_text("".join(json.dumps(row, separators=(",", ":")) + "\n" for row in kept), encoding="utf-8")


def ship(path: Path) -> Path:
    """Export a run's policy to where those that ship are; returns the folder. Raises KarolosError as `add`, too."""
    folder = RunFolder.open(path)
    about = folder.description()
    wrong = [*faults(folder), *(["it is not of seed 0"] if about["seed"] else [])]
    if wrong:
        raise KarolosError("; ".join(wrong), where=str(path))
    target = shipped.FOLDER / about["name"]
    shutil.rmtree(target, ignore_errors=True)
    export_policy(folder, target, checkpoint="last", onnx=False)
    for name in ("resolved.json", "run.json", "state.json", "tests.jsonl", "final.jsonl"):
        shutil.copy(path / name, target)
    write_json(target / "run.json", {**about, "command": portable(about["command"])})
    return target


def portable(words: list[str]) -> list[str]:
    """A command without the folder and the database that its run went to: places on one machine."""
    kept, left_out = [], ("--runs", "--database")
    for before, word in zip(["", *words], words, strict=False):
        if before not in left_out and word.partition("=")[0] not in left_out:
            kept.append(word)
    return kept


def identify() -> None:
    """Write the hash that today's code gives the spec of each run: a setting that is added later changes all hashes."""
    for path in paths(REFERENCE):
        folder = RunFolder.open(path)
        about, current = folder.description(), spec_from_dict(folder.spec()).hash()
        if about["experiment"] != current:
            write_json(path / "run.json", {**about, "experiment": current})


def contenders() -> dict[str, Contender]:
    """The reference runs by the names of their experiments."""
    with TemporaryDirectory() as scratch, Store(f"sqlite:///{scratch}/index.sqlite") as store:
        reindex(store, REFERENCE)
        names = sorted({run.name for run in store.runs()})
        return {name: gather(store, store.runs(name=name), name) for name in names}


def tables() -> dict[str, str]:
    """The generated tables in Markdown, by the names of their markers."""
    found = contenders()
    pairs = [f"{robot}_{task}" for task, robot in product(TARGETS, ROBOTS)]
    results = [*pairs, *(name for name in sorted(set(found) - set(pairs)) if _is_shipped(name))]
    return {
        "pairs": _overview(found),
        "reference runs": _results(found, results),
        "transfers": "\n\n".join(_transfer(path) for path in sorted(TRANSFERS.glob("*"))) or "None yet.",
        "trials": _trials(found),
    }


def _trials(found: dict[str, Contender]) -> str:
    """The table of settings changed one at a time."""
    trials = runpy.run_path(str(Path(__file__).with_name("trials.py")))
    rows = trials["rows"](found)
    return markdown(["setting", *trials["STEPS"], "better than as it ships"], rows) if rows else "None yet."


def _variant(path: Path, label: str) -> dict[str, Any]:
    """The resolved spec that a matrix keeps of a variant."""
    resolved: dict[str, Any] = json.loads((path / f"{label}.json").read_text(encoding="utf-8"))
    return resolved


def _rows(path: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (path / "rows.jsonl").read_text(encoding="utf-8").splitlines()]


def _transfer(path: Path) -> str:
    """The table of one matrix: its pairs, under what its variants have without a policy."""
    rows = _rows(path)
    threshold = f"{rows[0]['threshold']:g}"
    pairs = [
        [
            f"{row['source']} to {row['target']}",
            *(_estimate(row[name]) for name in ("zero_shot", "retention")),
            _reached(row["scratch"]["steps_to_threshold"]),
        ]
        for row in rows
        if row["source"] != row["target"]
    ]
    columns = ["transfer", "zero-shot", "retention", f"steps to {threshold} from scratch"]
    levels = ", ".join(
        f"{row['target']} {row['floor']:.3f} and {row['ceiling']:.3f}" for row in rows if row["source"] == row["target"]
    )
    steps = count(rows[0]["source_cost"]["steps"])
    head = f"`{path.name}`, {len(rows[0]['source_runs'])} seeds, sources of {steps} steps; "
    head += f"random actions and the expert: {levels}."
    return f"{head}\n{markdown(columns, pairs)}"


def _estimate(row: dict[str, Any] | None) -> str:
    numbers = {} if row is None else {key: math.inf if value is None else value for key, value in row.items()}
    return estimate(from_json(Estimate, numbers))


def _reached(row: dict[str, Any] | None) -> str:
    return "-" if row is None else f"{count(row['median'])} ({row['reached']} of {row['of']})"


def transfer_faults(path: Path) -> Iterator[str]:
    """Why a matrix cannot be a reference, one line each."""
    spec = ROOT / "specs" / f"{path.name}.yaml"
    try:
        variants = Matrix(load_spec(spec)).variants
        for label in variants:
            if spec_from_dict(_variant(path, label)).hash() != variants[label].hash():
                yield f"the spec of {label} is not the shipped one"
    except (KarolosError, OSError) as error:
        yield str(error)
        return
    rows = _rows(path)
    if [(row["source"], row["target"]) for row in rows] != list(product(variants, repeat=2)):
        yield "it does not hold every pair"
    yield from (warning for row in rows for warning in row["warnings"])


def _is_shipped(name: str) -> bool:
    return (ROOT / "specs" / f"{name}.yaml").is_file()


def _overview(found: dict[str, Contender]) -> str:
    names = {task: [*(f"{robot}_{task}" for robot in ROBOTS), f"panda_{task}_bullet"] for task in TARGETS}
    rows = [[f"`{task}`", *(_success(found.get(name), short=True) for name in row)] for task, row in names.items()]
    return markdown(["task", *ROBOTS, "panda by PyBullet"], rows)


def _results(found: dict[str, Contender], names: list[str]) -> str:
    columns = [
        "spec",
        "version",
        "`end`, mean",
        "each seed",
        "best policy",
        "steps to .95",
        "time to .95",
        "in all",
        "targets",
    ]
    table = markdown(columns, [_result(name, found[name]) for name in names if name in found])
    missing = ", ".join(f"`{name}`" for name in names if name not in found)
    return f"{table}\n\nWithout a reference run: {missing}." if missing else table


def _result(name: str, one: Contender) -> list[str]:
    runs, ends = [run.summary for run in one.runs], [run.reported("end") for run in one.runs]
    best = compare([one]).scores[0].best_end
    alone = [run for run in runs if SHARED not in run.tags]
    timed = alone or runs
    seconds = median_reaching([run.seconds_to_95 for run in timed])
    mark = " *" if not alone else "" if len(alone) == len(runs) else f" ({len(alone)})"
    targets = "-"
    if task := TARGETS.get(name.partition("_")[2]):
        least, most = task
        slow = "missed" if alone else "not shown"
        on_time = "met" if seconds is not None and seconds <= most else slow
        targets = f"{least:.2f} {'met' if min(ends) >= least else 'missed'}, {most} s {on_time}"
    versions = sorted(
        {RunFolder.open(REFERENCE / f"{name}-s{run.seed}").description()["versions"]["karolos"] for run in runs}
    )
    return [
        f"`{name}`",
        ", ".join(versions),
        _success(one),
        " ".join(f"{end:.3f}" for end in ends),
        "-" if best is None else f"{best.value:.3f}",
        count(median_reaching([run.steps_to_95 for run in runs])),
        duration(seconds) + mark,
        duration(median_reaching([run.total_seconds for run in timed])) + mark,
        targets,
    ]


def _success(one: Contender | None, *, short: bool = False) -> str:
    if one is None:
        return "-"
    found = compare([one]).scores[0].end
    return f"{found.value:.3f} ({len(one.runs)})" if short else estimate(found)


def markdown(columns: list[str], rows: list[list[str]]) -> str:
    lines = [columns, ["---"] * len(columns), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def pages() -> dict[Path, str]:
    """The texts of pages with the generated tables between their markers."""
    generated, found = tables(), {}
    for page in (ROOT / "README.md", *(ROOT / "docs" / f"{name}.md" for name in ("index", "results", "settings"))):
        text = page.read_text(encoding="utf-8")
        for name, table in generated.items():
            begin, end = f"<!-- {name}: written by docs/_scripts/references.py -->", f"<!-- end of {name} -->"
            if begin in text:
                before, _, rest = text.partition(begin)
                text = f"{before}{begin}\n{table}\n{end}{rest.partition(end)[2]}"
        found[page] = text
    return found


def problems() -> list[str]:
    """What does not agree, one line each."""
    found = [f"{path.name}: {fault}" for path in paths(REFERENCE) for fault in faults(RunFolder.open(path))]
    found += [f"{path.name}: {fault}" for path in TRANSFERS.glob("*") for fault in transfer_faults(path)]
    for page, text in pages().items():
        if page.read_text(encoding="utf-8") != text:
            found.append(f"{page.name} is not the generated one; run: python docs/_scripts/references.py tables")
    return found


def main() -> None:
    verb, *arguments = sys.argv[1:] or ["check"]
    if verb in {"add", "ship"}:
        for argument in arguments:
            try:
                print({"add": add, "ship": ship}[verb](Path(argument)).name)
            except KarolosError as error:
                sys.exit(str(error))
    elif verb == "tables":
        identify()
        for page, text in pages().items():
            page.write_text(text, encoding="utf-8")
    elif found := problems():
        sys.exit("\n".join(found))


if __name__ == "__main__":
    main()
