"""Curves in the panel of a page."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.view.curves import Curves

_COLOURS = ("#c0392b", "#2471a3", "#1e8449", "#b9770e", "#6c3483", "#117a65", "#839192", "#d35400")
MOST = 12  # curves at once: more are not told apart
_HEIGHT = 220  # px


class Plot:
    """One plot in a folder of the panel; another choice of curves draws it anew.

    Args:
        gui: The `viser.GuiApi`.
        folder: Where it stands.
    """

    def __init__(self, gui: Any, folder: Any) -> None:
        self._gui, self._folder = gui, folder
        self._plot: Any = None
        self._drawn: object = None

    def show(
        self, choice: object, curves: Curves, beside: Sequence[tuple[str, Array]] = ()
    ) -> None:
        """Show curves, or nothing where there are none.

        Args:
            choice: What they are of.
            curves: Finite, of any number of samples, at most `MOST` of them.
            beside: Names and values of grey curves.
        """
        if len(curves.times) < 2 or not curves.names:
            self.clear()
            return
        columns = [*curves.values.T, *(values for _, values in beside)]
        data = tuple(np.ascontiguousarray(one) for one in (curves.times, *columns))
        chosen = choice, curves.names
        if self._drawn == chosen and self._plot is not None:
            self._plot.data = data
            return
        self.clear()
        self._drawn = chosen
        self._draw(curves.names, [name for name, _ in beside], data)

    def clear(self) -> None:
        """Take it away."""
        if self._plot is not None:
            self._plot.remove()
            self._plot = None

    def _draw(self, names: Sequence[str], grey: Sequence[str], data: tuple[Array, ...]) -> None:
        series = [
            {"label": name, "stroke": _COLOURS[i % len(_COLOURS)], "width": 1.5}
            for i, name in enumerate(names)
        ]
        series += [{"label": name, "stroke": "#888888", "width": 1} for name in grey]
        with self._folder:
            self._plot = self._gui.add_uplot(
                data,
                ({"label": "s"}, *series),
                scales={"x": {"time": False, "auto": True}, "y": {"auto": True}},
                height=_HEIGHT,
            )
