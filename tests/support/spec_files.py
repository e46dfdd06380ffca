"""Specs written to files, and the errors of loading them."""

from pathlib import Path

import pytest
import yaml

from karolos.errors import SpecError
from karolos.specification import load_spec

GOOD = "robot: arm\ntask: reach\nagent: learner\n"
REFUSED = yaml.safe_load(Path(__file__).with_name("refused.yaml").read_text("utf-8"))
"""The expected messages for bad specs, by kind of mistake."""


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, "utf-8")
    return path


def problems_of(path: Path, *overrides: str) -> list[str]:
    """The lines that loading the spec complains with, without the folder in front."""
    with pytest.raises(SpecError) as caught:
        load_spec(path, overrides)
    assert str(caught.value).splitlines() == [str(problem) for problem in caught.value.problems]
    return [str(problem).removeprefix(f"{path.parent}/") for problem in caught.value.problems]
