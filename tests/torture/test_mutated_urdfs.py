"""The quick part of `mutate_urdfs`."""

from __future__ import annotations

from pathlib import Path

from mutate_urdfs import judged


def test_mutated_urdfs_work_or_are_refused_in_one_line(tmp_path: Path) -> None:
    found = {number: outcomes for number, outcomes, _ in judged(range(1, 8), 1, tmp_path)}
    assert len(found) == 7
    for number, outcomes in found.items():
        for way, what in outcomes.items():
            assert what.startswith(("works", "refused")), f"mutant {number}, {way}: {what}"
