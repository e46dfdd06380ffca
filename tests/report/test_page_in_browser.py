"""The page in headless Chromium: what is drawn, at which width, and what the console says."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageColor
from support.compared_runs import comparison, evil

from karolos.comparison import Comparison
from karolos.report.comparison_figures import comparison_figures
from karolos.report.figures import COLOURS
from karolos.report.page import comparison_page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine"),
    pytest.mark.xdist_group(__name__),
]
FLAGS = (
    *(
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--no-first-run",
        "--hide-scrollbars",
        "--force-color-profile=srgb",
    ),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--host-resolver-rules=MAP * ~NOTFOUND",  # whatever the browser itself would like to fetch
    *("--enable-logging=stderr", "--v=0"),
)
PANEL = "#f6f6f4"
"""Ground of a figure, around its drawing."""
HEIGHT = 6000
"""More than the page has at any width."""

_Picture = NDArray[np.int16]


def text_of(compared: Comparison) -> str:
    return comparison_page(compared, comparison_figures(compared))


def opened(text: str, folder: Path, width: int) -> tuple[_Picture, list[str]]:
    """A picture of the page (height, width, 3), and what the console said."""
    (folder / "page.html").write_text(text, encoding="utf-8")
    picture = folder / "page.png"
    places = [f"--user-data-dir={folder / 'profile'}", f"--screenshot={picture}", f"--window-size={width},{HEIGHT}"]
    url = (folder / "page.html").as_uri()
    ended = subprocess.run(
        [str(CHROMIUM), *FLAGS, *places, url], capture_output=True, text=True, timeout=120, check=True
    )
    pixels = np.asarray(Image.open(picture).convert("RGB"), np.int16)
    return pixels, [line for line in ended.stderr.splitlines() if ":CONSOLE" in line]


def near(picture: _Picture, colour: str, off: int = 12) -> NDArray[np.bool_]:
    """Where the picture has a colour: (height, width)."""
    found: NDArray[np.bool_] = (abs(picture - np.array(ImageColor.getrgb(colour))) <= off).all(axis=2)
    return found


def panels(picture: _Picture) -> list[slice]:
    """Rows of the figures in a column of them: where the panel's colour goes down its left border."""
    column = near(picture, PANEL, 1).mean(axis=1) > 0.02
    edges = np.flatnonzero(np.diff(np.concatenate([[0], column.astype(int), [0]])))
    return [slice(top, bottom) for top, bottom in edges.reshape(-1, 2) if bottom - top > 150]


def check_figures(column: _Picture, figures: int) -> None:
    """Each figure of a column of them holds coloured ink, spread over its width; everything else is grey."""
    found = panels(column)
    assert len(found) == figures
    for rows in found:
        inked = np.flatnonzero((np.ptp(column[rows], axis=2) > 40).any(axis=0))
        assert inked.size > 20
        assert np.ptp(inked) > column.shape[1] / 3


@pytest.fixture(scope="module")
def wide(tmp_path_factory: pytest.TempPathFactory) -> tuple[_Picture, list[str]]:
    """The usual page."""
    return opened(text_of(comparison()), tmp_path_factory.mktemp("wide"), 1280)


@pytest.mark.parametrize("markup", [False, True], ids=["usual", "with markup in every text"])
def test_wide_page_draws_its_figures_side_by_side(
    tmp_path: Path, wide: tuple[_Picture, list[str]], markup: bool
) -> None:
    picture, console = opened(text_of(evil()), tmp_path, 1280) if markup else wide
    assert console == []
    check_figures(picture[:, :640], 3)
    check_figures(picture[:, 640:], 3)
    for colour in COLOURS[:2]:
        assert near(picture, colour).sum() > 500
    assert near(picture[-20:], "#ffffff", 0).all()  # that was all of it


def test_narrow_page_draws_its_figures_one_below_the_other_and_nothing_sticks_out(tmp_path: Path) -> None:
    picture, console = opened(text_of(comparison()), tmp_path, 400)
    assert console == []
    check_figures(picture, 6)
    assert near(picture[:, -8:], "#ffffff", 0).all()


def test_security_policy_stops_what_should_ever_get_into_the_page(tmp_path: Path) -> None:
    """And shows that the tests above would hear of it."""
    foreign = '<script>console.error("ran")</script><img src="http://127.0.0.1:9/x.png"></body>'
    _, console = opened(text_of(comparison()).replace("</body>", foreign), tmp_path, 400)
    told = "\n".join(console)
    for part in ("inline script violates", "Loading the image"):
        assert part in told
    assert '"ran"' not in told


def test_unchecked_box_hides_its_contender(tmp_path: Path, wide: tuple[_Picture, list[str]]) -> None:
    shown, _ = wide
    hidden, _ = opened(text_of(comparison()).replace(' checked id="show-1"', ' id="show-1"'), tmp_path, 1280)
    assert near(hidden, COLOURS[1]).sum() < near(shown, COLOURS[1]).sum() / 3  # its entry of the legend stays
    assert near(hidden, COLOURS[0]).sum() > near(shown, COLOURS[0]).sum() * 0.9
