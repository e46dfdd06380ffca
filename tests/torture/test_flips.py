"""The short version of flip_bits.py."""

from pathlib import Path

from flip_bits import flip, make_archive


def test_a_flipped_bit_of_an_archive_loses_and_changes_nothing_in_silence(tmp_path: Path) -> None:
    counts = flip(make_archive(tmp_path / "runs", tmp_path / "x.tar.gz"), tmp_path / "place", count=40, seed=1)
    assert counts["silent"] == 0
    assert counts["refused"] > 25
