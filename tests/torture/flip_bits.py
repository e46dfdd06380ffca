"""Flips bits of an archive of runs: an import refuses it with one line, or brings exactly what was exported.

python tests/torture/flip_bits.py --count 2000 --seed 0
"""

from __future__ import annotations

import argparse
import random
import shutil
import tempfile
from collections import Counter
from pathlib import Path

from karolos.errors import UsageError
from karolos.launchers.experiment import Experiment
from karolos.records import RunFolder, scan
from karolos.records.archive import export_runs, import_runs
from karolos.specification import spec_from_dict

TOY = {
    "name": "toy",
    "seeds": [0],
    "environment": {"name": "toy"},
    "agent": {"name": "sac", "hidden": [4], "precision": "float32"},
    "buffer": {"capacity": 60},
    "orchestrator": {"environments": 1},
    "training": {"steps": 40, "batch_size": 4},
    "testing": {"interval": 10, "episodes": 5},
}


def make_archive(runs: Path, archive: Path) -> Path:
    """An archive of a small run with its checkpoints."""
    Experiment(spec_from_dict(TOY)).run(runs=runs)
    export_runs([folder for folder in scan(runs) if isinstance(folder, RunFolder)], archive)
    return archive


def contents(folder: Path) -> dict[str, bytes]:
    """The files below a folder, without those of locks and the database."""
    paths = (path for path in folder.rglob("*") if path.is_file() and path.name != "lock")
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def flip(archive: Path, place: Path, count: int, seed: int) -> Counter[str]:
    """Import the archive with one bit flipped, `count` times; the number of imports by their outcome.

    refused: by one line, and nothing is left behind. same: every file as it was. silent: anything else.
    """
    draw, whole, counts = random.Random(seed), archive.read_bytes(), Counter[str]()
    import_runs(archive, place / "good")
    good, flipped, runs = contents(place / "good"), place / "flipped.tar.gz", place / "runs"
    for number in range(count):
        # Every second flip is in the first or last 64 bytes, where the headers and the checksum are.
        ends = [*range(64), *range(len(whole) - 64, len(whole))]
        data, where = bytearray(whole), draw.choice(ends) if number % 2 else draw.randrange(len(whole))
        data[where] ^= 1 << draw.randrange(8)
        flipped.write_bytes(data)
        try:
            import_runs(flipped, runs)
        except UsageError as error:
            left = list(runs.iterdir())
            counts["refused" if not left and len(str(error).splitlines()) == 1 else "silent"] += 1
        else:
            counts["same" if contents(runs) == good else "silent"] += 1
        shutil.rmtree(runs, ignore_errors=True)
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        archive = make_archive(Path(place) / "made", Path(place) / "x.tar.gz")
        print(
            f"{archive.stat().st_size:,} bytes: {dict(flip(archive, Path(place) / 'place', given.count, given.seed))}"
        )


if __name__ == "__main__":
    main()
