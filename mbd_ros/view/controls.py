"""The panel of the page: fields, pictures and films.

Texts of others are values of fields, which are never read as HTML. Pictures and films are what a
browser shows, as files that it downloads.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.errors import DataError, SceneError, install_hint, printable
from mbd_ros.features.simulation.job import Interrupted, simulate
from mbd_ros.files.table import Result
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.variants import found_place, places_of, with_numbers, with_sections
from mbd_ros.view.curves import ALL, MOST, QUANTITIES, MotionCurves, Plot, cursor
from mbd_ros.view.drawing import Drawing
from mbd_ros.view.frames import joint_indices
from mbd_ros.view.motion import ViewedMotion

_TURN = 3.14  # rad: reach of a joint without limits
_MOST_SLIDERS = 12  # joints with a slider
_STEPS = 1000  # of a slider
_NOBODY = "nobody"
_HEIGHT, _WIDTH = 720, 1280
_RATE = 30  # images a second of a film
_FEWEST, _MOST = 30, 300  # images of a film: a longer motion is shown faster
_WAIT = 0.01  # s, until another look at what is drawn
_PATIENCE = 20.0  # s, for an image of a browser


class Controls:
    """Slider and buttons, what is shown, curves, values of a joint, and the start of a run.

    Args:
        server: The `viser` server.
        rerun: What may be changed of it.

    Attributes:
        reached: Time of the slider that is drawn [s].
    """

    def __init__(self, server: Any, scene: Scene, rerun: Rerun) -> None:
        self._server, self._gui, self.rerun = server, server.gui, rerun
        self._indices = joint_indices(scene.robot)
        self._names = {index: name for name, index in self._indices.items()}
        self._asks, self.reached = False, 0.0
        self._seen: tuple[Any, ...] = ()
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
        self._remarks = gui.add_text("remarks", "", multiline=True, disabled=True)

    def _view_of(self) -> None:
        gui = self._gui
        with gui.add_folder("view"):
            self._shown = {
                name: gui.add_checkbox(name, value)
                for name, value in (
                    ("forces", True),
                    ("moments", False),
                    ("reactions", False),
                    ("cones", True),
                    ("paths", True),
                    ("frames", False),
                )
            }
            self._scale = gui.add_slider("scale of arrows", 0.1, 10.0, 0.1, 1.0)
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
            self._plot = Plot(gui, gui.add_folder("plot"))

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
        """Return the reaction to a click on a solid: it chooses the joint or free body."""

        def choose(_: Any) -> None:
            if joint in self._names:
                self._joint.value = self._names[joint]

        return choose

    def wishes(self) -> dict[str, float]:
        """Values of sliders that were moved."""
        ranges = {**self.rerun.starts, **self.rerun.numbers}
        values = {name: float(slider.value) for name, slider in self._wishes.items()}
        return {
            name: value
            for name, value in values.items()
            if abs(value - ranges[name][0]) > 0.6 * (ranges[name][2] - ranges[name][1]) / _STEPS
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

    def apply_to(self, drawing: Drawing) -> None:
        """Let a drawing show what is chosen."""
        shown = {name for name, one in self._shown.items() if one.value}
        drawing.shown, drawing.scale = shown & {"forces", "moments", "reactions"}, self.scale
        if {"moments", "reactions"} <= shown:
            drawing.shown.add("reaction moments")
        stage = drawing.stage
        stage.shows_cones, stage.shows_paths = "cones" in shown, "paths" in shown
        stage.show_axes("frames" in shown)

    def say(self, lines: Sequence[str]) -> None:
        """Show lines for people."""
        self._remarks.value = printable("\n".join(lines))
        self._remarks.visible = bool(lines)

    def show_motion(self, motion: ViewedMotion, curves: MotionCurves) -> None:
        """Begin with a motion."""
        end = float(motion.times[-1])
        self._curves = curves
        self._slider.max = end or 1.0
        self._slider.step = (end or 1.0) / _STEPS
        self._slider.value, self._slider.disabled = 0.0, end == 0.0

    def show_sample(self, now: float, row: int) -> None:
        """Move the cursor of curves, and show the values of the chosen joint."""
        joint, quantity = self._joint.value, self._quantity.value
        lines = self._curves.values(joint, row)
        self._values.value = "\n".join(lines or ["click on a link, or choose a joint"])
        curves = self._curves.of(joint, quantity).first(MOST)
        beside = [("now", cursor(curves, now))] if len(curves.times) > 1 else []
        self._plot.show((joint, quantity, self._curves), curves, beside)

    def _on_picture(self, event: Any) -> None:
        picture(event.client, self)

    def _on_film(self, event: Any) -> None:
        film(event.client, self)


def picture(client: Any, controls: Controls) -> None:
    """Send a browser the picture that it shows, a .png."""
    _send(client, controls, "view.png", lambda: png(_image(client, "png")))


def _send(client: Any, controls: Controls, name: str, make: Any) -> None:
    """Make a file and send it, or say why not."""
    try:
        client.send_file_download(name, make(), save_immediately=True)
    except TimeoutError:
        controls.say([f"{name}: the browser sends no images"])
    except ImportError as error:
        controls.say([f"{name}: {install_hint(error.name or '') or error}"])


def _image(client: Any, transport: str) -> Any:
    return client.get_render(_HEIGHT, _WIDTH, transport_format=transport, timeout=_PATIENCE)


class Rerun:
    """Numbers of a scene that a page may change, and the run with them.

    Args:
        scene: The scene as it is.
        named: Numbers to change, `<part>.<argument>`.

    Attributes:
        starts: Independent joint -> first position, lowest and highest [rad or m].
        numbers: Number -> value, lowest and highest.

    Raises:
        SceneError: There is no such number.
    """

    def __init__(self, scene: Scene, named: Sequence[str] = ()) -> None:
        self._scene, self._duration = scene, 2.0
        self.starts = {
            joint.name: _ranged(float(scene.initial.q[joint.q]), joint.lower, joint.upper)
            for joint in scene.robot.joints
            if joint.name in scene.couplings.independent
        }
        self.starts = dict(list(self.starts.items())[:_MOST_SLIDERS])
        self.numbers = {name: self._number(name) for name in named}

    @property
    def duration(self) -> float:
        """Duration of a run [s]."""
        return self._duration

    @duration.setter
    def duration(self, value: float) -> None:
        if not 0.0 < value < np.inf:
            raise DataError(f"--time {value:g}: accepted are finite times > 0")
        self._duration = value

    def _number(self, name: str) -> tuple[float, float, float]:

        place, path = found_place(self._scene.origin.changed(), places_of(self._scene), name)
        value: Any = self._scene.entries[place.section]
        if place.at is not None:
            value = value[place.at]
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SceneError(f"{self._scene.name}: {name} is no single number of the file")
        ends = sorted((0.0, 2.0 * value)) if value else (-1.0, 1.0)
        return float(value), *map(float, ends)

    def run(self, wishes: Mapping[str, float]) -> tuple[Scene, Result, list[str]]:
        """Run the scene with other numbers.

        Args:
            wishes: Value of each of `starts` and `numbers` that differs.

        Returns:
            The scene that ran, its result, and lines for people.

        Raises:
            MbdError: The scene does not accept the numbers, or has no consistent start.
        """
        scene = self._scene
        numbers = {name: wishes[name] for name in self.numbers if name in wishes}
        if numbers:
            scene = with_numbers(scene, numbers)
        starts = {name: wishes[name] for name in self.starts if name in wishes}
        if starts:
            initial = dict(scene.entries.get("initial") or {})
            initial["position"] = {**(initial.get("position") or {}), **starts}
            scene = with_sections(scene, initial=initial)
        remarks = list[str]()
        try:
            return scene, simulate(scene, self._duration, say=remarks.append), remarks
        except Interrupted as error:
            if error.result is None:
                raise
            return scene, error.result, [*remarks, str(error)]


def _ranged(value: float, lower: float, upper: float) -> tuple[float, float, float]:
    low = lower if np.isfinite(lower) else value - _TURN
    high = upper if np.isfinite(upper) else value + _TURN
    return value, min(low, value), max(high, value)


def film(client: Any, controls: Controls) -> None:
    """Send a browser the motion at the speed at which it plays, an .mp4."""
    controls.plays = False
    count = round(controls.end / controls.speed * _RATE)
    times = np.linspace(0.0, controls.end, min(max(count, _FEWEST), _MOST)).tolist()
    _send(client, controls, "view.mp4", lambda: mp4(_images(client, controls, times)))


def _images(client: Any, controls: Controls, times: Iterable[float]) -> Iterable[Any]:
    for now in times:
        controls.now = now
        end = time.monotonic() + _PATIENCE
        while controls.reached != controls.now and time.monotonic() < end:
            time.sleep(_WAIT)
        yield _image(client, "jpeg")


def mp4(images: Iterable[Any]) -> bytes:
    """A film as a file, H.264 at 30 images a second.

    Args:
        images: At least one, all of one shape (height, width, 3 or 4), uint8, both sizes even.
    """
    import av  # of the extra `view`

    file, stream = io.BytesIO(), None
    with av.open(file, "w", format="mp4") as container:
        for image in images:
            pixels = np.ascontiguousarray(image[..., :3], dtype=np.uint8)
            if stream is None:
                stream = container.add_stream("libx264", rate=Fraction(_RATE))
                stream.height, stream.width = pixels.shape[:2]
                stream.pix_fmt = "yuv420p"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
    return file.getvalue()


def png(image: Any) -> bytes:
    """A picture as a file.

    Args:
        image: Shape (height, width, 3 or 4), uint8.
    """
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.asarray(image, dtype=np.uint8)).save(file, "PNG")
    return file.getvalue()
