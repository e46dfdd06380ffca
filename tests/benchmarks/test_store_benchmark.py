from __future__ import annotations

import json
import os
import subprocess
import sys


def test_benchmark_of_the_store_gives_a_row_per_measurement() -> None:
    command = [sys.executable, "-m", "karolos_cli", "bench", "store", "--json"]
    sizes = ["--runs", "20", "--tests", "2", "--episodes", "5", "--writers", "2"]
    surroundings = {key: value for key, value in os.environ.items() if not key.startswith("KAROLOS")}
    done = subprocess.run([*command, *sizes], check=True, capture_output=True, text=True, env=surroundings)
    rows = [json.loads(line) for line in done.stdout.splitlines()]
    assert [row["unit"] for row in rows] == ["s", "s", "s", "s", "transactions/s"]
    assert all(row["benchmark"] == "store" and row["value"] > 0 for row in rows)
    assert rows[2]["case"] == "filter that 10 of 20 runs fit"
