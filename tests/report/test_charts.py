from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.compared_runs import contender, run

from karolos.comparison import Contender, compare
from karolos.report import charts
from karolos.report.chart import DARK, LIGHT, Band, Dots, Line, Shades, seconds_axis, short, spread, steps_axis

CURVES = [[0, 50, 90], [0, 40, 100], [10, 60, 95], [0, 0, 0], [0, 20, 85]]


def test_every_seed_and_every_mean_is_drawn() -> None:
    comparison = compare([contender("a", CURVES), contender("b", CURVES[:2])])
    for chart in (charts.learning(comparison, "steps"), charts.learning(comparison, "seconds")):
        lines = [mark for mark in chart.marks if isinstance(mark, Line)]
        assert [sum(line.role == "seed" and line.series == series for line in lines) for series in (0, 1)] == [5, 2]
        assert [line.series for line in lines if line.role == "main"] == [0, 1]
        assert [mark.series for mark in chart.marks if isinstance(mark, Band)] == [0, 1]
        assert [label.text for label in chart.labels] == ["a", "b"]


def test_one_statistic_for_all_contenders_of_a_figure() -> None:
    assert "inter-quartile" in charts.learning(compare([contender("a", CURVES)]), "steps").caption
    mixed = charts.learning(compare([contender("a", CURVES), contender("b", CURVES[:2])]), "steps")
    assert "inter-quartile" not in mixed.caption
    bold = [mark for mark in mixed.marks if isinstance(mark, Line) and mark.role == "main"]
    assert bold[0].y.tolist() == pytest.approx([0.02, 0.34, 0.74])


def test_density_has_a_column_for_each_test_and_one_scale_for_all() -> None:
    comparison = compare([contender("a", CURVES), contender("b", [[100] * 3] * 5), contender("c", [[5, 5, 5]])])
    drawn = list(charts.density_charts(comparison))
    assert [chart.title for chart in drawn] == ["a", "b"]  # a single seed has none
    shades = [mark for chart in drawn for mark in chart.marks if isinstance(mark, Shades)]
    assert [one.edges.tolist() for one in shades] == [[500, 1500, 2500, 3000]] * 2
    assert [one.shades.shape for one in shades] == [(3, 101)] * 2
    assert shades[1].shades.max() == 1.0
    assert shades[0].shades[-1].max() < 0.5


def test_profile_is_a_step_function_down_from_all_seeds() -> None:
    chart = charts.profiles(compare([contender("a", [[20], [50], [100], [100]])]))
    [line] = [mark for mark in chart.marks if isinstance(mark, Line)]
    assert line.x.tolist() == [0, 0, 0.2, 0.2, 0.5, 0.5, 1]
    assert line.y.tolist() == [1, 1, 1, 0.75, 0.75, 0.5, 0.5]


def test_final_success_shows_each_seed_by_its_run() -> None:
    chart = charts.final(compare([contender("a", CURVES)]))
    [dots] = [mark for mark in chart.marks if isinstance(mark, Dots)]
    assert dots.x.tolist() == [0.9, 1.0, 0.95, 0.0, 0.85]
    assert dots.labels[3] == "a, seed 3: a-s3 (finished)"


def test_single_test_at_step_zero_can_be_drawn() -> None:
    runs = (run(0, [50], interval=0), run(1, [60], interval=0))
    for chart in charts.charts(compare([Contender("a", runs)])):
        assert chart.across.high > chart.across.low


@given(st.floats(1e-3, 1e9))
def test_axis_has_a_few_tidy_ticks_from_zero(high: float) -> None:
    for axis in (steps_axis(high), seconds_axis(high)):
        places = [place for place, _ in axis.ticks]
        assert 3 <= len(places) <= 7
        assert places[0] == 0
        assert places[-1] <= high * (1 + 1e-9)
        assert len({text for _, text in axis.ticks}) == len(places)


@given(st.lists(st.floats(0, 100), max_size=6))
def test_labels_are_moved_apart_and_stay_inside(heights: list[float]) -> None:
    moved = sorted(spread(heights, 10, 0, 100))
    assert all(gap >= 10 - 1e-9 for gap in np.diff(moved))
    assert all(0 <= height <= 100 + 1e-9 for height in moved)


def test_labels_that_are_apart_stay_where_they_are() -> None:
    assert spread([50, 10, 90], 10, 0, 100) == [50, 10, 90]


def test_long_names_keep_both_ends() -> None:
    assert short("panda_pick_place_sac_slow") == "panda_p…sac_slow"
    assert short("x" * 16) == "x" * 16


def _luminance(colour: str) -> float:
    channels = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


@pytest.mark.parametrize(("colours", "ground"), [(LIGHT, "#ffffff"), (LIGHT, "#f6f6f4"), (DARK, "#1f2226")])
def test_colours_stand_out_from_their_ground(colours: tuple[str, ...], ground: str) -> None:
    """WCAG 2.2, 1.4.3: text needs a contrast of 4.5 to 1."""
    for colour in colours:
        lower, higher = sorted([_luminance(colour), _luminance(ground)])
        assert (higher + 0.05) / (lower + 0.05) >= 4.5
