"""A few of the mutated specs of mutate_specs.py."""

from pathlib import Path

from mutate_specs import check_mutants


def test_no_mutated_spec_gives_a_traceback(tmp_path: Path) -> None:
    counts, wrong, _ = check_mutants(range(20), 7, tmp_path)
    assert not wrong, (counts, *wrong)
