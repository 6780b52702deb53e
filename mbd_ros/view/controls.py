"""The panel of the page; texts of others are values of fields, which are never read as HTML."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import printable
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.curves import ALL, QUANTITIES, Curves, MotionCurves, cursor
from mbd_ros.view.motion import ViewedMotion
from mbd_ros.view.pictures import film, picture
from mbd_ros.view.rerun import Rerun
from mbd_ros.view.stage import Stage

_COLOURS = ("#c0392b", "#2471a3", "#1e8449", "#b9770e", "#6c3483", "#117a65", "#839192", "#d35400")
_CURVES = 12  # at once: more are not told apart
_STEPS = 1000  # of a slider
_NOBODY = "nobody"


class Controls:
    """Slider and buttons, what is shown, curves, values of a joint, and the start of a run.

    Args:
        server: The `viser` server.
        scene: The scene.
        rerun: What may be changed of it.

    Attributes:
        reached: Time of the slider that is drawn [s].
    """

    def __init__(self, server: Any, scene: Scene, rerun: Rerun) -> None:
        self._server, self._gui, self.rerun = server, server.gui, rerun
        joints, model = scene.robot.joints, scene.robot.model
        at_v = {int(j.idx_v): i for i, j in enumerate(model.joints) if i and j.nv == 1}
        self._indices = {joint.name: at_v[joint.v] for joint in joints}
        self._indices |= {base.name: base.joint for base in scene.robot.bases}
        self._names = {index: name for name, index in self._indices.items()}
        self._asks, self.reached = False, 0.0
        self._seen: tuple[Any, ...] = ()
        self._plot: Any = None
        self._drawn: tuple[str, str] | None = None
        self._time_of(scene.name)
        self._view_of()
        self._plot_of()
        self._run_of()

    def _time_of(self, name: str) -> None:
        gui = self._gui
        gui.add_text("scene", printable(Path(name).name), disabled=True)
        self._slider = gui.add_slider("time", 0.0, 1.0, 1.0 / _STEPS, 0.0)
        self._play = gui.add_checkbox("play", False)
        self._speed = gui.add_slider("speed", 0.05, 4.0, 0.05, 1.0)
        self._loop = gui.add_checkbox("loop", True)
        self._said = gui.add_text("remarks", "", multiline=True, disabled=True)

    def _view_of(self) -> None:
        gui = self._gui
        with gui.add_folder("view"):
            self._shown = {
                name: gui.add_checkbox(name, value)
                for name, value in (
                    ("forces", True),
                    ("cones", True),
                    ("paths", True),
                    ("frames", False),
                )
            }
            self._scale = gui.add_slider("scale of forces", 0.1, 10.0, 0.1, 1.0)
            followed = [_NOBODY, *self._indices]
            self._followed = gui.add_dropdown("follow", followed, initial_value=_NOBODY)
            gui.add_button("picture").on_click(self._on_picture)
            gui.add_button("film").on_click(self._on_film)

    def _plot_of(self) -> None:
        gui = self._gui
        with gui.add_folder("curves"):
            self._joint = gui.add_dropdown("joint", [ALL, *self._indices], initial_value=ALL)
            self._quantity = gui.add_dropdown("quantity", QUANTITIES, initial_value="position")
            self._values = gui.add_text("values", "", multiline=True, disabled=True)
            self._folder = gui.add_folder("plot")

    def _run_of(self) -> None:
        gui, given = self._gui, {**self.rerun.starts, **self.rerun.numbers}
        self._wishes = dict[str, Any]()
        with gui.add_folder("run again", expand_by_default=False):
            for name, (value, low, high) in given.items():
                step = (high - low) / _STEPS or 1.0
                slider = gui.add_slider(name, low, max(high, low + step), step, value)
                self._wishes[name] = slider
            gui.add_button("run").on_click(self._ask)

    def _ask(self, _: Any) -> None:
        self._asks = True

    def chooser(self, joint: int) -> Callable[[Any], None]:
        """What a click on a solid does: choose its joint or free body."""

        def choose(_: Any) -> None:
            if joint in self._names:
                self._joint.value = self._names[joint]

        return choose

    def wishes(self) -> dict[str, float]:
        """Values of sliders that were moved."""
        given = {**self.rerun.starts, **self.rerun.numbers}
        values = {name: float(slider.value) for name, slider in self._wishes.items()}
        return {
            name: value
            for name, value in values.items()
            if abs(value - given[name][0]) > 0.6 * (given[name][2] - given[name][1]) / _STEPS
        }

    def take_run(self) -> bool:
        """Whether a run was asked for since the last call."""
        asked, self._asks = self._asks, False
        return asked

    @property
    def now(self) -> float:
        """Time of the slider [s]."""
        return float(self._slider.value)

    @now.setter
    def now(self, value: float) -> None:
        self._slider.value = value

    @property
    def end(self) -> float:
        """Largest time of the slider [s]."""
        return float(self._slider.max)

    @property
    def plays(self) -> bool:
        """Whether time goes on."""
        return bool(self._play.value)

    @plays.setter
    def plays(self, value: bool) -> None:
        self._play.value = value

    @property
    def speed(self) -> float:
        """Seconds of the motion a second."""
        return float(self._speed.value)

    @property
    def loops(self) -> bool:
        """Whether it begins again at the end."""
        return bool(self._loop.value)

    @property
    def scale(self) -> float:
        """Factor of the length of arrows."""
        return float(self._scale.value)

    @property
    def followed(self) -> int | None:
        """Index in the model of the joint that cameras follow; None without one."""
        return self._indices.get(self._followed.value)

    def changed(self) -> bool:
        """Whether something is to be shown in another way than at the last call."""
        shown = [one.value for one in self._shown.values()]
        seen = (*shown, self.scale, self._followed.value, self._joint.value, self._quantity.value)
        before, self._seen = self._seen, seen
        return seen != before

    def apply_to(self, stage: Stage) -> None:
        """Let a stage show what is chosen."""
        shown = {name: bool(one.value) for name, one in self._shown.items()}
        stage.shows_arrows, stage.shows_cones = shown["forces"], shown["cones"]
        stage.shows_paths = shown["paths"]
        stage.show_axes(shown["frames"])

    def say(self, lines: Sequence[str]) -> None:
        """Show lines for people."""
        self._said.value = printable("\n".join(lines))
        self._said.visible = bool(lines)

    def show_motion(self, motion: ViewedMotion, curves: MotionCurves) -> None:
        """Begin with a motion."""
        end = float(motion.times[-1])
        self._curves, self._drawn = curves, None
        self._slider.max = end or 1.0
        self._slider.step = (end or 1.0) / _STEPS
        self._slider.value, self._slider.disabled = 0.0, end == 0.0

    def show_sample(self, now: float, row: int) -> None:
        """Move the cursor of curves, and show the values of the chosen joint."""
        joint, quantity = self._joint.value, self._quantity.value
        lines = self._curves.values(joint, row)
        self._values.value = "\n".join(lines or ["click on a link, or choose a joint"])
        curves = self._curves.of(joint, quantity)
        curves = Curves(curves.times, curves.names[:_CURVES], curves.values[:, :_CURVES])
        if len(curves.times) < 2 or not curves.names:
            self._clear_plot()
            return
        columns = [*curves.values.T, cursor(curves, now)]
        data = tuple(np.ascontiguousarray(one) for one in (curves.times, *columns))
        if self._drawn == (joint, quantity) and self._plot is not None:
            self._plot.data = data
            return
        self._drawn = joint, quantity
        self._draw_plot(curves, data)

    def _clear_plot(self) -> None:
        if self._plot is not None:
            self._plot.remove()
            self._plot = None

    def _draw_plot(self, curves: Curves, data: tuple[Array, ...]) -> None:
        self._clear_plot()
        series = [
            {"label": name, "stroke": _COLOURS[i % len(_COLOURS)], "width": 1.5}
            for i, name in enumerate(curves.names)
        ]
        ends = {"label": "now", "stroke": "#888888", "width": 1}
        with self._folder:
            self._plot = self._gui.add_uplot(
                data,
                ({"label": "s"}, *series, ends),
                scales={"x": {"time": False, "auto": True}, "y": {"auto": True}},
                height=220,
            )

    def _on_picture(self, event: Any) -> None:
        picture(event.client)

    def _on_film(self, event: Any) -> None:
        film(event.client, self)
