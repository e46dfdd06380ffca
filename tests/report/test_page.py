"""The page as text; in a browser it is looked at by test_page_in_browser."""

from __future__ import annotations

import re

import pytest
from support.compared_runs import CURVES, EVIL, SPEC, comparison, contender, evil

from karolos.comparison import Comparison, compare
from karolos.report.comparison_figures import comparison_figures
from karolos.report.page import Section, comparison_page, document
from karolos.report.tables import Table


def text_of(compared: Comparison) -> str:
    return comparison_page(compared, comparison_figures(compared))


def test_page_shows_figures_numbers_warnings_settings_and_runs() -> None:
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


def test_page_of_returns_shows_no_success() -> None:
    text = text_of(compare([contender("one", CURVES, has_success=False)]))
    assert text.count("<figure") == 4
    assert "-126.000 ~[" in text
    assert "success" not in re.sub(r"<title>.*?</title>|<h2>.*?</h2>|thresholds?.*?success only", "", text)


def test_single_runs_of_the_same_spec_have_no_densities_and_no_settings() -> None:
    text = text_of(compare([contender("one", [[10]]), contender("two", [[20]])]))
    assert "Density of" not in text
    assert "The specs are the same." in text


def test_every_text_is_escaped_and_cleaned() -> None:
    text = text_of(evil())
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 10
    signs = "a\x1b[2J\u202eb\nc"
    table = Table([EVIL, signs], [(EVIL, signs)])
    text += document(EVIL, signs, [Section(EVIL, signs, table=table, notes=[EVIL])], [EVIL], [signs])
    assert text.count("a\ufffd[2J\ufffdb\nc") == 6
    assert not re.search("<script|<img|\x1b|\u202e", text)


def test_page_asks_for_nothing_from_elsewhere_and_no_id_stands_twice() -> None:
    text = text_of(comparison())
    assert not re.search(r"https?:|@import|src=|href=\"(?!#|data:image/png;base64,)|url\((?!#)", text)
    [policy] = re.findall(r'Content-Security-Policy" content="(.*?)"', text.partition("<style>")[0])
    assert policy == (
        "default-src 'none'; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'"
    )
    ids = re.findall(r' id="(.*?)"', text)
    assert len(set(ids)) == len(ids)
    assert {one or other for one, other in re.findall(r'href="#(.*?)"|url\(#(.*?)\)', text)} <= set(ids)


@pytest.mark.parametrize("box", ["show-0", "show-1", "seeds"])
def test_each_box_of_the_legend_hides_something_without_a_script(box: str) -> None:
    text = text_of(comparison())
    assert f'id="{box}"' in text
    [hidden] = re.findall(rf"body:has\(#{box}:not\(:checked\)\) \.(\S+){{display:none}}", text)
    assert re.search(rf'class="[^"]*\b{hidden}\b', text)


def test_same_comparison_gives_the_same_page() -> None:
    assert text_of(comparison()) == text_of(comparison())


def test_seventh_contender_is_dashed() -> None:
    text = text_of(compare([contender(f"e{place}", [[10, 20]]) for place in range(7)]))
    assert text.count('stroke-dasharray="10 4 "') == 3  # in the legend and in two tables
    assert 'class="main series-6"' in text
