"""Benchmarks: the rows that the tables of docs/benchmarks.md are generated from.

python docs/_scripts/benchmarks.py measure [NAME...]  run the page's commands, alone on the machine, and keep the rows
python docs/_scripts/benchmarks.py tables             write the tables into the page
python docs/_scripts/benchmarks.py check              exit 1 if the page has other tables
"""

from __future__ import annotations

import json
import os
import platform
import re
import shlex
import subprocess
import sys
from collections.abc import Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

from karolos.records.provenance import versions

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "benchmarks.md"
ROWS = ROOT / "runs" / "measured" / "benchmarks.jsonl"
"""A line for each row of a benchmark, with the command, the machine, the day and the version that it belongs to."""
TABLE = re.compile(
    r"(?P<head><!-- python -m bench (?P<command>.+?)(?:; rows: (?P<rows>.+?))? -->\n)(?P<table>(?:\|.*\n)*)"
)
"""A table with the command that measures it, and a pattern of the rows that it shows (all: none)."""
MACHINE = re.compile(r"(?<=<!-- machine -->\n)(?:.+\n)?")
FIGURES = 3
"""Significant figures of a number."""


def main(action: str, names: Sequence[str]) -> None:
    page = PAGE.read_text(encoding="utf-8")
    commands = [found["command"] for found in TABLE.finditer(page)]
    if action == "measure":
        kept = [row for row in stored() if row["command"] in commands]
        for command in commands:
            if names and shlex.split(command)[0] not in names:
                continue
            kept = [row for row in kept if row["command"] != command] + measured(command)
            ROWS.write_text("".join(f"{json.dumps(row)}\n" for row in kept), encoding="utf-8")
    rows = stored()
    written = TABLE.sub(lambda found: found["head"] + table(shown(found, rows)), page)
    where = sorted({f"{row['machine']}, on {row['day']}, by karolos {row['karolos']}" for row in rows})
    written = MACHINE.sub(f"Measured on {'; '.join(where)}.\n", written)
    if action == "check" and written != page:
        sys.exit(f"{PAGE.name} has other tables than {ROWS.name}: python docs/_scripts/benchmarks.py tables")
    PAGE.write_text(written, encoding="utf-8")


def stored() -> list[dict[str, Any]]:
    return [json.loads(line) for line in ROWS.read_text(encoding="utf-8").splitlines()] if ROWS.exists() else []


def shown(found: re.Match[str], rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of a table."""
    own = (row for row in rows if row["command"] == found["command"])
    return [row for row in own if found["rows"] is None or re.search(found["rows"], row["case"])]


def measured(command: str) -> list[dict[str, Any]]:
    """The rows of a benchmark, measured now."""
    print(f"python -m bench {command}", file=sys.stderr)
    words = [sys.executable, "-m", "bench", *shlex.split(command), "--json"]
    printed = subprocess.run(words, stdout=subprocess.PIPE, text=True, encoding="utf-8", check=True).stdout
    about = {"command": command, "machine": processor(), "day": f"{date.today()}", "karolos": versions()["karolos"]}
    return [{**about, **json.loads(line)} for line in printed.splitlines()]


def processor() -> str:
    """Name and number of this machine's processors, as Linux gives it; elsewhere what Python knows."""
    told = Path("/proc/cpuinfo")
    names = (
        re.findall(r"^model name\s*: (.*)$", told.read_text(encoding="utf-8"), re.MULTILINE) if told.exists() else []
    )
    return f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores"


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a row for each case, with its peers and the median ratio to each."""
    cases: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        cases.setdefault(row["case"], []).append(row)
    lines = [["measured", "karolos", "compared with"], ["---"] * 3]
    for case, found in cases.items():
        peers = [
            f"{number(one['ratio'])} x {one['peer']} ({number(one['peer_value'])})" for one in found if one["peer"]
        ]
        lines.append([case, f"{number(found[0]['value'])} {found[0]['unit']}", "; ".join(peers)])
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


def number(value: float) -> str:
    """Three figures, thousands in groups."""
    rounded = float(f"{value:.{FIGURES}g}")
    return f"{rounded:,.0f}" if abs(rounded) >= 10 ** (FIGURES - 1) else f"{rounded:.{FIGURES}g}"


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "check", sys.argv[2:])
