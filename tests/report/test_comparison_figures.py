from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.collections import QuadMesh
from support.compared_runs import CURVES, contender, run

from karolos.comparison import Comparison, Contender, compare
from karolos.errors import MachineError, UsageError
from karolos.report import comparison_figures as figures
from karolos.report.figures import COLOURS, Drawing, look, short, write_figures
from karolos.report.tables import verdict

NAMES = ["success_over_steps", "success_over_seconds", "final_success", "performance_profiles", "density__x_1_b_"]


def comparison() -> Comparison:
    return compare([contender("$x_1 <b>&$", CURVES), contender("two", CURVES[:1])], "any")


def drawn(compared: Comparison, *chosen: str) -> list[Drawing]:
    return [one for drawings in figures.comparison_figures(compared, chosen).values() for one in drawings]


def artists(drawing: Drawing, classes: str) -> list[Any]:
    """The artists that have exactly these class names."""
    gids = {gid for gid, (found, _) in drawing.parts.items() if found == classes}
    return [artist for artist in drawing.axes.get_children() if artist.get_gid() in gids]


def test_of_thousands_of_seeds_some_lines_are_drawn_and_the_caption_says_so():
    found = compare([contender("many", [[k % 90, 90] for k in range(1000)])])
    curves, dots = figures.learning(found, "steps"), figures.final(found)
    assert sum("seed series" in classes for classes, _ in curves.parts.values()) == figures.MOST_APART
    assert "One line for 5 of the 1,000 seeds" in curves.caption
    assert len(dots.parts) < 10
    assert sum(len(line.get_xdata()) for line in dots.axes.lines) > 1000


@pytest.mark.parametrize("axis", ["steps", "seconds"])
def test_every_seed_and_one_statistic_of_all_contenders_is_drawn(axis):
    assert "inter-quartile" in figures.learning(compare([contender("a", CURVES)], "any"), axis).caption
    mixed = figures.learning(compare([contender("a", CURVES), contender("b", CURVES[:2])], "any"), axis)
    assert "inter-quartile" not in mixed.caption
    for series, seeds in ((0, 5), (1, 2)):
        for kind, drawn in (("seed", seeds), ("main", 1), ("band", 1)):
            assert len(artists(mixed, f"{kind} series-{series}")) == drawn
    [mean] = artists(mixed, "main series-0")
    assert mean.get_ydata()[-1] == pytest.approx(0.74)


def test_density_has_a_column_for_each_test_and_one_scale_for_all():
    compared = compare([contender("a", CURVES), contender("b", [[100] * 3] * 5), contender("c", [[5, 5, 5]])], "any")
    drawings = list(figures.density_figures(compared))
    assert [(drawing.title, drawing.series) for drawing in drawings] == [("a", 0), ("b", 1)]  # one seed has no density
    meshes = [child for drawing in drawings for child in drawing.axes.get_children() if isinstance(child, QuadMesh)]
    shades = [mesh.get_array().reshape(101, 3) for mesh in meshes]
    for mesh in meshes:
        assert mesh.get_coordinates()[0, :, 0].tolist() == [500, 1500, 2500, 3000]
    assert shades[1].max() == 1.0
    assert shades[0][:, -1].max() < 0.5


def test_profile_is_a_step_function_down_from_all_seeds():
    [line] = artists(figures.profiles(compare([contender("a", [[20], [50], [100], [100]])], "any")), "main series-0")
    assert line.get_drawstyle() == "steps-pre"
    assert line.get_xdata().tolist() == [0.2, 0.5, 1]
    assert line.get_ydata().tolist() == [1, 0.75, 0.5]


def test_final_success_shows_each_seed_by_its_run():
    drawing = figures.final(compare([contender("a", CURVES)], "any"))
    dots = artists(drawing, "dot series-0")
    assert [dot.get_xdata()[0] for dot in dots] == [0.9, 1.0, 0.95, 0.0, 0.85]
    assert drawing.parts[dots[3].get_gid()][1] == "a, seed 3: a-s3 (finished), 0"


@pytest.mark.parametrize(
    ("successes", "low", "high"), [((994, 999), 0.98, 1), ((998, 1000), 0.98, 1), ((0, 90), 0, 0.12), ((0, 990), 0, 1)]
)
def test_axes_of_ratios_show_what_is_there_and_say_so(successes, low, high):
    compared = compare(
        [contender(name, [[one]], episodes=1000) for name, one in zip("ab", successes, strict=True)], "any"
    )
    for drawing, axis in ((figures.final(compared), "x"), (figures.learning(compared, "steps"), "y")):
        ends = getattr(drawing.axes, f"get_{axis}lim")()
        assert low <= ends[0] <= min(successes) / 1000 < max(successes) / 1000 <= ends[1] <= high
        assert ("only" in drawing.caption) == (high - low < 0.6)


def test_verdict_names_the_best_and_who_differs_from_the_first():
    curves = {"a": range(40, 60, 2), "b": range(80, 100, 2), "c": range(41, 61, 2), "d": [90]}
    assert verdict(compare([contender("d", [[90]])], "any")).endswith("0.900 [0.826, 0.945] over 1 seed.")
    compared = compare([contender(name, [[one] for one in ends]) for name, ends in curves.items()], "any")
    assert verdict(compared) == (
        "Highest mean of success at any step: d, 0.900 [0.826, 0.945]. Better than a: b. "
        "No difference from a is shown: c. Too few seeds to tell from a (5 of each are needed): d."
    )


def test_returns_are_drawn_on_their_own_axis():
    compared = compare([contender("a", CURVES), contender("b", CURVES[:1])], "return")
    drawings = drawn(compared)
    assert [drawing.name for drawing in drawings] == [name.replace("success", "return") for name in NAMES[:4]]
    assert drawings[0].axes.get_ylabel() == "mean return of an episode"
    assert drawings[0].axes.get_ylim()[0] < -150
    [line] = artists(drawings[3], "main series-0")
    assert line.get_xdata().tolist() == [-200, -115, -110, -105, -100]


def test_a_return_that_is_not_finite_is_not_drawn():
    diverged = Contender("a", (run(0, [50], final=True, mean_return=None), run(1, [60])))
    for runs in (diverged, Contender("a", diverged.runs[:1])):
        drawing = figures.final(compare([runs], "return"))
        assert len(artists(drawing, "dot series-0")) == len(runs.runs)
        assert "<svg" in drawing.svg()
        assert len(drawn(compare([runs], "return"))) == 2 * len(runs.runs)  # no empty axes


def test_figures_are_chosen_by_kind_or_name_and_named_by_experiment():
    compared = compare([contender(name, CURVES) for name in ("a b", "a/b", "c")], "any")
    names = [one.name for one in drawn(compared, "densities", "final_success")]
    assert names == ["final_success", "density_a_b_1", "density_a_b_2", "density_c"]
    with pytest.raises(UsageError, match="there is no figure 'final_sucess'; did you mean 'final_success'"):
        drawn(compared, "final_sucess")


def test_single_test_at_step_zero_can_be_drawn():
    runs = (run(0, [50], interval=0), run(1, [60], interval=0))
    for drawing in drawn(compare([Contender("a", runs)], "any")):
        low, high = drawing.axes.get_xlim()
        assert low < high
        assert "<svg" in drawing.svg()


def test_figures_are_written_in_every_format_and_are_the_same_each_time(tmp_path):
    assert [one.name for one in drawn(comparison())] == NAMES
    written, again = (
        write_figures(drawn(comparison(), "steps", "densities"), tmp_path / "new" / str(count)) for count in (1, 2)
    )
    chosen = (NAMES[0], NAMES[-1])
    assert [path.name for path in written] == [f"{name}.{end}" for name in chosen for end in ("svg", "pdf", "png")]
    for path, second in zip(written, again, strict=True):
        start = {".pdf": b"%PDF-", ".png": b"\x89PNG", ".svg": b"<?xml"}
        assert path.read_bytes().startswith(start[path.suffix])
        assert path.read_bytes() == second.read_bytes()
    assert "$x_1 &lt;b&gt;&amp;$" in written[0].read_text()  # text, and no formula
    with pytest.raises(MachineError):
        write_figures([], written[0] / "figures")


@pytest.mark.parametrize(
    ("width", "font", "name"), [(4.8, 9, "a_name_that_is_longer_than_what_a_figure_shows_of_it"), (3.4, 8, "a")]
)
def test_names_of_many_contenders_have_room_of_their_own(tmp_path, width, font, name):
    compared = compare([contender(f"{name}{place}", [[place, 90]]) for place in range(40)])
    curves, final = figures.learning(compared, "steps"), figures.final(compared)
    write_figures([curves, final], tmp_path, width=width, font=font)
    with look():
        for drawing in (curves, final):
            drawing.figure.set_dpi(200)  # as in the files: texts of few pixels are higher
            drawing.figure.canvas.draw()
    [legend], edge = curves.figure.legends, curves.figure.bbox
    box, axes = legend.get_window_extent(), curves.axes.get_window_extent()
    assert edge.x0 <= box.x0 < box.x1 <= edge.x1
    assert edge.y0 <= box.y0 < box.y1 < axes.y0 < axes.y1 - 100
    assert final.axes.get_window_extent().height / 200 * 72 / 40 > 1.2 * font  # a row is higher than its text


def test_figure_of_a_page_has_classes_and_tooltips():
    svg = figures.learning(comparison(), "steps").svg()
    root = ElementTree.fromstring(svg)
    seeds = [element for element in root.iter("g") if element.get("class") == "seed series-0"]
    assert [seed.findtext("title") for seed in seeds][3] == "$x_1 <b>&$, seed 3: $x_1 <b>&$-s3 (finished)"
    assert "http" not in svg


def test_long_names_keep_both_ends():
    assert short("panda_pick_place_sac_slow", 16) == "panda_p…sac_slow"
    assert short("x" * 16, 16) == "x" * 16
    assert short("a\x1bb") == "a\ufffdb"


@pytest.mark.parametrize("colour", COLOURS)
def test_colours_stand_out_from_white(colour):
    """WCAG 2.2, 1.4.3: text needs a contrast of 4.5 to 1."""
    channels = [int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    assert 1.05 / (np.dot([0.2126, 0.7152, 0.0722], linear) + 0.05) >= 4.5
