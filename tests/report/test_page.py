"""The page as text; in a browser it is looked at by test_page_in_browser."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support.compared_runs import CURVES, SPEC, comparison, contender, evil

from karolos.comparison import Comparison, compare
from karolos.errors import MachineError
from karolos.report.comparison_figures import comparison_figures
from karolos.report.page import page, write_page


def text_of(compared: Comparison) -> str:
    return page(compared, comparison_figures(compared))


def test_page_has_a_figure_for_each_question() -> None:
    text = text_of(comparison())
    assert text.count("<figure") == text.count("</svg><figcaption>") == 6
    for title in ("over environment steps", "over wall-clock time", "at the end of training", "Performance profiles"):
        assert f"{title}</text>" in text


def test_page_shows_numbers_warnings_and_settings() -> None:
    other = SPEC | {"agent": {"name": "ppo"}}
    text = text_of(compare([contender("one", CURVES), contender("two", CURVES[:2], spec=other)]))
    for part in ("0.740 ~[", "0.950 (0.900 to 1.000)", "unequal numbers of seeds: one 5; two 2", "agent.name", "ppo"):
        assert part in text
    assert text.count("two-s1") >= 2  # in the table and on its lines


def test_same_specs_are_said_to_be_the_same() -> None:
    assert "The specs are the same." in text_of(comparison())


def test_page_of_returns_shows_no_success() -> None:
    text = text_of(compare([contender("one", CURVES, has_success=False)]))
    assert text.count("<figure") == 4
    assert "-126.000 ~[" in text
    assert "Returns have no density." in text
    assert "success" not in re.sub(r"<title>.*?</title>|<h2>.*?</h2>|thresholds?.*?success only", "", text)


def test_every_text_is_escaped() -> None:
    text = text_of(evil())
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt;") >= 10
    assert "<script" not in text
    assert "<img" not in text


def test_page_asks_for_nothing_from_elsewhere() -> None:
    text = text_of(comparison())
    assert not re.search(r"https?:|@import|src=|href=\"(?!#|data:image/png;base64,)|url\((?!#)", text)


def test_security_policy_allows_styles_and_pictures_inside_and_nothing_else() -> None:
    text = text_of(comparison())
    [policy] = re.findall(r'Content-Security-Policy" content="(.*?)"', text)
    assert policy == (
        "default-src &#x27;none&#x27;; style-src &#x27;unsafe-inline&#x27;; img-src data:; "
        "base-uri &#x27;none&#x27;; form-action &#x27;none&#x27;"
    )
    assert text.index("Content-Security-Policy") < text.index("<style>")


def test_no_id_stands_twice_and_none_is_missing() -> None:
    text = text_of(comparison())
    ids = re.findall(r' id="(.*?)"', text)
    named = re.findall(r'href="#(.*?)"|url\(#(.*?)\)', text)
    assert len(set(ids)) == len(ids)
    assert {one or other for one, other in named} <= set(ids)


def test_single_runs_are_compared_without_densities() -> None:
    text = text_of(compare([contender("one", [[10]]), contender("two", [[20]])]))
    assert "A single seed has no density." in text


def test_legend_hides_a_contender_or_the_seeds_without_a_script() -> None:
    text = text_of(comparison())
    for place in (0, 1):
        assert f'id="show-{place}"' in text
        assert f"body:has(#show-{place}:not(:checked)) .series-{place}{{display:none}}" in text
    assert 'id="seeds"' in text
    assert "body:has(#seeds:not(:checked)) .seed{display:none}" in text


def test_same_comparison_gives_the_same_page() -> None:
    assert text_of(comparison()) == text_of(comparison())


def test_seventh_contender_is_dashed() -> None:
    text = text_of(compare([contender(f"e{place}", [[10, 20]]) for place in range(7)]))
    assert text.count('stroke-dasharray="10 4"') == 3  # in the legend and in two tables
    assert 'class="main series-6"' in text


def test_page_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MachineError):
        write_page(comparison(), [], tmp_path / "file" / "page.html")
