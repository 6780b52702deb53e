"""Pictures of ensembles: histograms, and free energy along a coordinate."""

from collections.abc import Mapping
from typing import Any

from matplotlib.backends.backend_agg import FigureCanvasAgg

from mbd_ros.errors import DataError
from mbd_ros.features.sampling.task import HISTOGRAM, PROFILE
from mbd_ros.files.plot import Picture
from mbd_ros.files.table import Result, Table

_WIDTH = 4.0  # in, of each panel
_HEIGHT = 3.2  # in
_MOST = 6  # panels


def picture_of(result: Result) -> Picture:
    """A picture of a result of `sample`.

    Raises:
        DataError: There is nothing to show.
    """
    if PROFILE in result:
        return _profile(result[PROFILE])
    shown = {n.removeprefix(HISTOGRAM): t for n, t in result.items() if n.startswith(HISTOGRAM)}
    if shown:
        return _histograms(dict(list(shown.items())[:_MOST]))
    raise DataError("--plot: no quantity is kept, so there is no histogram; see --observe")


def _profile(table: Table) -> Picture:
    picture, (left, right) = _panels(2)
    coordinate = table.columns[0]
    for axes, name in ((left, "mean_force"), (right, "free_energy")):
        x, y, error = table[coordinate.name], table[name], table[f"{name}.standard_error"]
        axes.errorbar(x, y, 2.0 * error, fmt="o-", lw=1.0, ms=3, capsize=2)
        axes.set_xlabel(coordinate.label)
        axes.set_ylabel(table.column(name).label)
    return picture


def _histograms(histograms: Mapping[str, Table]) -> Picture:
    picture, panels = _panels(len(histograms))
    for axes, (name, table) in zip(panels, histograms.items(), strict=True):
        low, high = table["low"], table["high"]
        density, error = (table[n] / (high - low) for n in ("share", "standard_error"))
        axes.bar(low, density, high - low, align="edge", alpha=0.5)
        axes.errorbar(0.5 * (low + high), density, 2.0 * error, fmt="none", lw=1.0, capsize=2)
        unit = table.column("low").unit
        axes.set_xlabel(f"{name} [{unit}]" if unit else name)
        axes.set_ylabel("density")
    return picture


def _panels(count: int) -> tuple[Picture, list[Any]]:
    picture = Picture(figsize=(_WIDTH * count, _HEIGHT), layout="constrained")
    FigureCanvasAgg(picture)
    panels: Any = picture.subplots(1, count, squeeze=False)
    for axes in panels[0]:
        axes.grid(visible=True, alpha=0.3)
        axes.tick_params(labelsize=7)
    return picture, list(panels[0])
