"""Error against run time as a picture: one line an integrator, a legend that fits."""

import numpy as np
from report_runs import RUNS, run_of

from mbd_ros.applications.report.precision.kind import FAMILIES
from mbd_ros.applications.report.precision.text import points_of
from mbd_ros.applications.report.precision.work_precision import Point, diagram


def test_a_plot_has_one_line_an_integrator_and_a_legend_that_fits():
    """Every integrator of a scene with rows, three orders of Adams, and a tolerance."""
    ladders = [ladder for ladders in FAMILIES.values() for ladder in ladders]
    kinds = list(dict.fromkeys(ladder.integrator["type"] for ladder in ladders))
    kinds.remove("filippov")  # for scenes that have no others than explicit ones
    entries = [{"type": kind} for kind in kinds if kind != "adams"]
    entries += [{"type": "adams", "order": order} for order in (4, 6, 8)]
    entries.append({"type": "dop853", "tolerance": 1e-8})
    runs = [run_of(entry, 1.0 + i, 0.1 / 3**i) for i, entry in enumerate(entries)]
    figure = diagram("arm", runs, points_of(runs, None))
    axes, (legend,) = figure.axes[0], figure.legends
    said = [text.get_text() for text in legend.get_texts()]
    assert said == [*kinds, "with tolerance", "other runs", "Pareto front"] and len(said) <= 12
    assert max(len(line.get_xdata()) for line in axes.lines[2:]) == 3  # adams; 0, 1: the front
    figure.canvas.draw()
    box, whole = legend.get_window_extent(), figure.bbox
    assert whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0
    assert axes.get_window_extent().width > 0.8 * whole.width


def test_switching_scenes_have_a_plot():
    runs = [run_of({"type": "filippov"}, 1.0, 1e-3), run_of({"type": "rk4"}, 2.0, 1e2)]
    axes = diagram("slider", runs, points_of(runs, None)).axes[0]
    assert axes.get_ylim()[0] < 1e-3 < axes.get_ylim()[1] <= 10.0  # garbage needs no room


def test_the_front_of_a_plot_is_that_of_all_runs():
    points = points_of(RUNS, None)
    axes = diagram("arm", RUNS, points, {"MuJoCo": [Point(0.1, 1e-12)]}).axes[0]
    marked = axes.lines[0].get_xydata()
    np.testing.assert_array_equal(marked, [points[0], points[1]])
    peer = [line.get_color() for line in axes.lines if [0.1, 1e-12] in line.get_xydata().tolist()]
    assert peer == ["#D55E00"]
