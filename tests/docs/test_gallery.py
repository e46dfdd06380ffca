"""The gallery's pages show what stands in the reference runs."""

import re
import runpy
import sys
from functools import cache
from pathlib import Path

from karolos.records import RunFolder, paths
from karolos.report.figures import Drawing

SCRIPTS = Path(__file__).parents[2] / "docs" / "_scripts"


def test_success_in_a_page_is_that_of_the_final_episodes_of_its_runs(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(SCRIPTS)
    pages = runpy.run_path(str(SCRIPTS / "pages.py"))
    drawn = cache(lambda: drawing(*first))
    first, drawing = [], pages["learning"]

    def draw_once(*what: object) -> Drawing:
        """The figure of one spec stands for all: `make -C docs html` draws each."""
        first[:] = first or what
        return drawn()

    monkeypatch.setitem(pages["gallery"].__globals__, "learning", draw_once)
    monkeypatch.setattr(Drawing, "save", lambda *_: None)  # tests/report writes figures
    written = pages["gallery"](tmp_path)
    assert len(written) == 1 + 3 * len(pages["TASKS"]), "an overview, and a page per task and robot"
    ends: dict[str, list[float]] = {}
    for run in paths(sys.modules["references"].REFERENCE):
        summary = RunFolder.open(run).summary()
        if summary.final:  # not of a variant that trains less, which is on no page
            ends.setdefault(summary.name, []).append(summary.success_end)
    for specs in pages["TASKS"].values():
        for robot in ("panda", "ur5", "iiwa"):
            names = [f"{robot}_{spec}" for spec in specs]
            [page] = [text for text in written.values() if f"\n## {names[0]}\n" in text]
            for section, name in zip(re.split(r"^## ", page, flags=re.MULTILINE)[1:], names, strict=True):
                found = ends.get(name)
                assert ("There is no reference run" in section) == (found is None)
                assert found is None or f"| {sum(found) / len(found):.3f} " in section
                assert all(f"{end:.3f}" in section for end in found or ()), "each seed"
