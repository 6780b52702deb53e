"""One of the robots of a live page: its solids, forces and curves."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError, printable
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.arrows import arrow_ends, largest, length_per
from mbd_ros.view.contact_solids import solids_of_scene
from mbd_ros.view.frames import Drawn, Frames
from mbd_ros.view.ground import SMALLEST, upright
from mbd_ros.view.live_curves import LiveCurves, LiveSample
from mbd_ros.view.solids import box_around
from mbd_ros.view.stage import MARKER, Stage

_LINE = np.array((MARKER,), np.uint8)
_SHORTEST = 1.0e-3  # of the size of the robot, an arrow
_TENSION = 2  # its place among what is largest
_FADING = 0.998  # a frame, of what is largest: half of them within 12 s


class LiveRobot:
    """Draws a scene as samples of it come.

    Args:
        title: What people call it; empty for the only one.
        scene: The scene.
        kept: Samples that curves show.

    Attributes:
        title: As given.
        scene: The scene.
        frames: What is drawn of it.
        curves: Its last seconds.
        remarks: What cannot be drawn, a line each.
        size: Of the robot [m].
        low: Least corner of the box around it at the start, less `Robot.origin` [m], shape (3,).
        high: Greatest corner.
        up: Axes whose last one is up, shape (3, 3).
        offset: From there to the page [m], shape (3,).
        drawn: What was drawn last.
        masses: What each joint of the model carries [kg], shape (njoints,).
        stage: Its half of the page, once `show` was called.
    """

    stage: Stage
    curves: LiveCurves

    def __init__(self, title: str, scene: Scene, kept: int) -> None:
        self.title, self.scene, self.frames = title, scene, Frames(scene)
        self.solids, lacking = solids_of_scene(scene)
        self.remarks = list(lacking)
        self._kept = kept
        self.measure(())
        begin = scene.initial._replace(t=0.0)
        self.begin: State = begin._replace(z=np.nan_to_num(begin.z))
        self.drawn: Drawn = self.frames.at(self.begin)
        self._plain = self.drawn
        self.low, self.high = box_around(self.solids, self.drawn.poses)
        self.size = max(float((self.high - self.low).max()), SMALLEST)
        self.up, self.offset = upright(scene.robot), np.zeros(3)
        model = scene.robot.model
        data = pin.Data(model)
        pin.computeSubtreeMasses(model, data)
        self.masses = np.array(list(data.mass))
        self._no_acceleration = np.zeros(model.nv)
        self._most = np.zeros(3)  # force [N], moment [N·m], tension [N]
        self.fault = ""

    def measure(self, loads: tuple[str, ...]) -> None:
        """Have curves for the loads of samples, by their names."""
        self.curves = LiveCurves(self.scene, self.frames.rows, loads, self._kept)

    def show(self, server: Any, root: str) -> None:
        """Put it on a page, where it begins.

        Args:
            server: The `viser.ViserServer`.
            root: Name of the node above all.
        """
        server.scene.add_frame(root, show_axes=False, position=self.offset)
        self.stage = Stage(server.scene, root, self.solids, self.size)
        self.stage.draw(self.drawn, {}, 0.0)
        if self.title:
            high = (self.low + self.high) / 2.0 + self.up[:, 2] * 0.6 * self.size
            server.scene.add_label(f"{root}/title", printable(self.title), position=high)

    def draw(self, sample: LiveSample, shown: Sequence[str], scale: float) -> None:
        """Draw a sample.

        Args:
            sample: What is known.
            shown: Which arrows: `forces`, `moments`.
            scale: Factor of their length.
        """
        self.drawn = drawn = self._with_loads(self._drawn(sample), sample)
        self._most *= _FADING
        arrows, lengths = {"forces": drawn.arrows, "moments": drawn.moments}, {}
        for i, (name, each) in enumerate(arrows.items()):
            self._most[i] = max(self._most[i], largest(each))
            lengths[name] = scale * length_per(float(self._most[i]), self.size)
        shortest = _SHORTEST * self.size
        ends = {n: arrow_ends(arrows[n], lengths[n], shortest) for n in shown}
        self.stage.draw(drawn, ends, lengths["forces"])

    def place_of(self, joint: int) -> Array:
        """Where a joint of the model was drawn, on the page [m], shape (3,)."""
        place: Array = self.drawn.poses[joint, :3] + self.offset
        return place

    def _drawn(self, sample: LiveSample) -> Drawn:
        x, lam, self.fault = sample.state, sample.multipliers, ""
        if np.isfinite(lam).all() and np.isfinite(x.z).all():
            try:
                self._note_tension(sample)
                most = float(self._most[_TENSION])
                return self.frames.at(x, self._no_acceleration, lam, most)
            except (MbdError, ArithmeticError) as error:  # a message may say anything
                self.fault = f"no forces: {error}"
        try:
            self._plain = self.frames.at(x._replace(z=np.nan_to_num(x.z)))
        except (MbdError, ArithmeticError) as error:
            self.fault = f"not drawn: {error}"
        return self._plain

    def _note_tension(self, sample: LiveSample) -> None:
        found = self.frames.tensions(sample.state, self._no_acceleration, sample.multipliers)
        self._most[_TENSION] = max(
            self._most[_TENSION], float(np.nan_to_num(found).max(initial=0.0))
        )

    def _with_loads(self, drawn: Drawn, sample: LiveSample) -> Drawn:
        loads = sample.loads[np.isfinite(sample.loads).all(axis=(1, 2))]
        return drawn._replace(
            poses=drawn.poses.copy(),
            arrows=np.concatenate((drawn.arrows, loads)),
            points=np.concatenate((drawn.points, sample.points)),
            lines=np.concatenate((drawn.lines, sample.lines)),
            colours=np.concatenate((drawn.colours, np.tile(_LINE, (len(sample.lines), 1)))),
        )
