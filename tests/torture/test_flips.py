"""Flips bits of an archive of runs: an import refuses it with one line, or brings exactly what was exported."""

import random
import shutil
from collections import Counter
from pathlib import Path

from support.torture import SEED, TIMES
from support.toy_runs import run_of, toy

from karolos.errors import UsageError
from karolos.records.archive import export_runs, import_runs


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


def test_a_flipped_bit_of_an_archive_loses_and_changes_nothing_in_silence(tmp_path):
    archive = tmp_path / "x.tar.gz"
    export_runs([run_of(toy(buffer={"capacity": 60}, orchestrator={"environments": 1}), tmp_path / "runs")], archive)
    counts = flip(archive, tmp_path / "place", 40 * TIMES, SEED)
    assert counts["silent"] == 0
    assert counts["refused"] > 25 * TIMES
