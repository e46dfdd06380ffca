from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import pytest
from support.compared_runs import contender

from karolos.comparison import Comparison, compare
from karolos.errors import MachineError
from karolos.report.charts import charts
from karolos.report.figures import write_figures

CURVES = [[0, 50, 90], [0, 40, 100], [10, 60, 95], [0, 0, 0], [0, 20, 85]]
NAMES = ["success_over_steps", "success_over_seconds", "final_success", "performance_profiles", "density_1"]


def comparison() -> Comparison:
    return compare([contender("$x_1 <b>&", CURVES), contender("two", CURVES[:1])])


def test_every_figure_is_written_as_svg_and_pdf(tmp_path: Path) -> None:
    written = write_figures(charts(comparison()), tmp_path / "new" / "figures")
    assert [path.name for path in written] == [f"{name}.{ending}" for name in NAMES for ending in ("svg", "pdf")]
    for path in written:
        if path.suffix == ".svg":
            assert len(list(ElementTree.parse(path).iter())) > 50
        else:
            assert path.read_bytes().startswith(b"%PDF-")


def test_same_figures_are_the_same_files(tmp_path: Path) -> None:
    first, *_ = charts(comparison())
    one, other = (write_figures([first], tmp_path / name) for name in ("a", "b"))
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in other]


def test_folder_that_cannot_be_made_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MachineError):
        write_figures([], tmp_path / "file" / "figures")
