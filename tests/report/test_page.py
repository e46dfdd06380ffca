"""The page as text, and in headless Chromium: what is drawn, at which width, and what the console says."""

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageColor
from support.browser import chromium, in_browser
from support.compared_runs import CURVES, EVIL, SPEC, comparison, contender, evil

from karolos.comparison import Comparison, compare
from karolos.report.comparison_figures import comparison_figures
from karolos.report.figures import COLOURS
from karolos.report.page import Section, comparison_page, document
from karolos.report.tables import Table


def text_of(compared: Comparison) -> str:
    return comparison_page(compared, comparison_figures(compared))


@pytest.fixture(scope="module")
def usual() -> str:
    return text_of(comparison())


def test_page_shows_figures_numbers_warnings_settings_and_runs():
    other = SPEC | {"agent": {"name": "ppo"}}
    text = text_of(compare([contender("one", CURVES), contender("two", CURVES[:2], spec=other)]))
    assert text.count("<figure") == text.count("</svg><figcaption>") == 6
    for title in ("over environment steps", "over wall-clock time", "at the end of training", "Performance profiles"):
        assert f"{title}</text>" in text
    for part in (
        "0.740<small>~[",
        "0.950<small>(0.900 to 1.000)",
        "unequal numbers of seeds: one 5; two 2",
        "agent.name",
        "ppo",
    ):
        assert part in text
    assert text.count("two-s1") >= 2  # in the table and on its lines


def test_page_of_returns_shows_no_success():
    text = text_of(compare([contender("one", CURVES, has_success=False)]))
    assert text.count("<figure") == 4
    assert "-126.000 ~[" in text
    assert "success" not in re.sub(r"<title>.*?</title>|<h2>.*?</h2>|thresholds?.*?success only", "", text)


def test_single_runs_of_the_same_spec_have_no_densities_and_no_settings():
    text = text_of(compare([contender("one", [[10]]), contender("two", [[20]])]))
    assert "Density of" not in text
    assert "The specs are the same." in text


def test_every_text_is_escaped_and_cleaned():
    text = text_of(evil())
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 10
    signs = "a\x1b[2J\u202eb\nc"
    table = Table([EVIL, signs], [(EVIL, signs)])
    text += document(EVIL, signs, [Section(EVIL, signs, table=table, notes=[EVIL])], [EVIL], [signs])
    assert text.count("a\ufffd[2J\ufffdb\nc") == 6
    assert not re.search("<script|<img|\x1b|\u202e", text)


def test_page_asks_for_nothing_from_elsewhere_and_no_id_stands_twice(usual):
    text = usual
    assert not re.search(r"https?:|@import|src=|href=\"(?!#|data:image/png;base64,)|url\((?!#)", text)
    [policy] = re.findall(r'Content-Security-Policy" content="(.*?)"', text.partition("<style>")[0])
    assert policy == (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    ids = re.findall(r' id="(.*?)"', text)
    assert len(set(ids)) == len(ids)
    assert {one or other for one, other in re.findall(r'href="#(.*?)"|url\(#(.*?)\)', text)} <= set(ids)


@pytest.mark.parametrize("box", ["show-0", "show-1", "seeds"])
def test_each_box_of_the_legend_hides_something_without_a_script(box, usual):
    assert f'id="{box}"' in usual
    [hidden] = re.findall(rf"body:has\(#{box}:not\(:checked\)\) \.(\S+){{display:none}}", usual)
    assert re.search(rf'class="[^"]*\b{hidden}\b', usual)


def test_same_comparison_gives_the_same_page(usual):
    assert text_of(comparison()) == usual


def test_seventh_contender_is_dashed():
    text = comparison_page(compare([contender(f"e{place}", [[10, 20]]) for place in range(7)]), {})
    assert text.count('stroke-dasharray="10 4 "') == 3  # in the legend and in two tables


pytestmark = pytest.mark.xdist_group(__name__)
FLAGS = (
    *("--hide-scrollbars", "--force-color-profile=srgb", "--disable-component-update", "--disable-sync"),
    "--host-resolver-rules=MAP * ~NOTFOUND",  # whatever the browser itself would like to fetch
    *("--enable-logging=stderr", "--v=0"),
)
PANEL = "#f6f6f4"
"""Ground of a figure, around its drawing."""
HEIGHT = 6000
"""More than the page has at any width."""

_Picture = NDArray[np.int16]


def opened(text: str, folder: Path, width: int) -> tuple[_Picture, list[str]]:
    """A picture of the page (height, width, 3), and what the console said."""
    (folder / "page.html").write_text(text, encoding="utf-8")
    picture = folder / "page.png"
    places = [f"--user-data-dir={folder / 'profile'}", f"--screenshot={picture}", f"--window-size={width},{HEIGHT}"]
    command = chromium(*FLAGS, *places, (folder / "page.html").as_uri())
    ended = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
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
def wide(tmp_path_factory: pytest.TempPathFactory, usual: str) -> tuple[_Picture, list[str]]:
    """The usual page."""
    return opened(usual, tmp_path_factory.mktemp("wide"), 1280)


@in_browser
@pytest.mark.parametrize("page", ["usual", "narrow", "with markup in every text"])
def test_page_draws_its_figures_side_by_side_or_on_a_narrow_screen_one_below_the_other(tmp_path, wide, usual, page):
    width = 400 if page == "narrow" else 1280
    text = text_of(evil()) if "markup" in page else usual
    picture, console = wide if page == "usual" else opened(text, tmp_path, width)
    assert console == []
    if page == "narrow":
        check_figures(picture, 6)
        assert near(picture[:, -8:], "#ffffff", 0).all()  # nothing sticks out
        return
    check_figures(picture[:, :640], 3)
    check_figures(picture[:, 640:], 3)
    for colour in COLOURS[:2]:
        assert near(picture, colour).sum() > 500
    assert near(picture[-20:], "#ffffff", 0).all()  # that was all of it


@in_browser
def test_unchecked_box_hides_its_contender_and_the_security_policy_stops_what_should_ever_get_into_the_page(
    tmp_path, wide, usual
):
    """And shows that the tests above would hear of it."""
    foreign = '<script>console.error("ran")</script><img src="http://127.0.0.1:9/x.png"></body>'
    changed = usual.replace(' checked id="show-1"', ' id="show-1"').replace("</body>", foreign)
    hidden, console = opened(changed, tmp_path, 1280)
    told = "\n".join(console)
    for part in ("inline script violates", "Loading the image"):
        assert part in told
    assert '"ran"' not in told
    shown, _ = wide
    assert near(hidden, COLOURS[1]).sum() < near(shown, COLOURS[1]).sum() / 3  # its entry of the legend stays
    assert near(hidden, COLOURS[0]).sum() > near(shown, COLOURS[0]).sum() * 0.9
