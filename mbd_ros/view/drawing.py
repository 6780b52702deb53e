"""A scene drawn in a `viser` scene: solids, and the motion that they follow."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.arrows import arrow_ends, largest, length_per
from mbd_ros.view.contact_solids import solids_of_scene
from mbd_ros.view.frames import Drawn, Frames
from mbd_ros.view.ground import Ground, size_of, upright
from mbd_ros.view.motion import ViewedMotion, still
from mbd_ros.view.solids import box_around
from mbd_ros.view.stage import Stage

FORCES = ("forces", "reactions")
MOMENTS = ("moments", "reaction moments")
_FARTHEST = 5.0  # sizes of the robot that a camera steps back for its motion
_LOOKED_AT = 20  # samples whose forces give the lengths of arrows


class Drawing:
    """Solids of a scene, a motion that they follow, and a second one drawn through.

    Args:
        server: The `viser.ViserServer` to draw in.
        scene: The scene.

    Attributes:
        frames: What is drawn, as arrays.
        stage: The nodes.
        motion: What is shown.
        remarks: What cannot be drawn, a line each.
        size: Of the robot [m].
        shown: Which arrows are drawn, of `FORCES` and `MOMENTS`.
        scale: Factor of their lengths.
    """

    def __init__(self, server: Any, scene: Scene) -> None:
        self._api, self.frames = server.scene, Frames(scene)
        self._solids, lacking = solids_of_scene(scene)
        self.remarks = list(lacking)
        low, high = box_around(self._solids, self.frames.at(still(scene).states[0]).poses)
        self.size, self._ground = size_of(low, high), Ground(server, upright(scene.robot))
        self.stage = Stage(self._api, "/robot", self._solids, self.size)
        self.shown, self.scale, self._tightest = {"forces"}, 1.0, 0.0
        self._ghost: tuple[Stage, ViewedMotion] | None = None
        self.show(still(scene))

    def show(self, motion: ViewedMotion, frames: Frames | None = None) -> None:
        """Follow a motion.

        Args:
            motion: States of all joints.
            frames: Of the scene that moved, where its numbers are not those of `scene`.
        """
        self.motion, self.frames = motion, frames or self.frames
        rows = np.unique(np.linspace(0, len(motion.times) - 1, _LOOKED_AT).astype(int))
        every = [self._arrows(self._drawn(row), row) for row in rows]
        self._peaks = {
            name: max(largest(one[name]) for one in every) for name in (*FORCES, *MOMENTS)
        }
        self._ground.surround(*self._way(rows))
        lam = motion.multipliers
        tensions = [] if lam is None else [self._tensions(row, lam[row]) for row in rows]
        self._tightest = float(np.nan_to_num(np.array(tensions)).max(initial=0.0))

    def _way(self, rows: Sequence[int]) -> tuple[Array, Array]:
        """Box around the motion, no farther from its begin than some sizes."""
        poses = [self.frames.at(self.motion.states[row]).poses.copy() for row in rows]
        boxes = np.array([box_around(self._solids, one) for one in poses])
        begin, far = boxes[0], _FARTHEST * self.size
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        return np.maximum(low, begin[0] - far), np.minimum(high, begin[1] + far)

    def show_ghost(self, motion: ViewedMotion) -> None:
        """Draw a second motion through, at the same times."""
        stage = Stage(self._api, "/ghost", self._solids, self.size, is_ghost=True)
        self._ghost = stage, motion

    def draw(self, row: int) -> Drawn:
        """Draw a sample of the motion."""
        drawn = self._drawn(row)
        per = {**self._per(FORCES), **self._per(MOMENTS)}
        short = 1.0e-3 * self.size
        every = self._arrows(drawn, row)
        ends = {name: arrow_ends(every[name], per[name], short) for name in self.shown}
        self.stage.draw(drawn, ends, per["forces"])
        if self._ghost is not None:
            stage, motion = self._ghost
            other = np.searchsorted(motion.times, self.motion.times[row])
            stage.place(self.frames.at(motion.states[min(int(other), len(motion.times) - 1)]))
        return drawn

    def _per(self, names: Sequence[str]) -> dict[str, float]:
        """Length per force or moment: the largest shown is a third as long as the robot."""
        most = max((self._peaks[name] for name in names if name in self.shown), default=0.0)
        return dict.fromkeys(
            names, length_per(most or self._peaks[names[0]], self.size) * self.scale
        )

    def _arrows(self, drawn: Drawn, row: int) -> dict[str, Array]:
        """Where forces and moments act, and they themselves."""
        forces, moments = drawn.arrows[:0], drawn.moments[:0]
        motion = self.motion
        if motion.multipliers is not None:
            x, a, lam = motion.states[row], motion.accelerations[row], motion.multipliers[row]
            forces, moments = self.frames.reactions(x, a, lam)
        return dict(
            zip((*FORCES, *MOMENTS), (drawn.arrows, forces, drawn.moments, moments), strict=True)
        )

    def _drawn(self, row: int) -> Drawn:
        motion = self.motion
        lam = None if motion.multipliers is None else motion.multipliers[row]
        return self.frames.at(motion.states[row], motion.accelerations[row], lam, self._tightest)

    def _tensions(self, row: int, lam: Array) -> Array:
        return self.frames.tensions(self.motion.states[row], self.motion.accelerations[row], lam)
