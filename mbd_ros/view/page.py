"""The page: a `viser` server that shows one scene, its motion and curves under it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, MbdError
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.controls import Controls, Rerun
from mbd_ros.view.curves import MotionCurves
from mbd_ros.view.drawing import Drawing
from mbd_ros.view.frames import Frames
from mbd_ros.view.motion import ViewedMotion, still, viewed_motion
from mbd_ros.view.server import PageServer

_RATE = 30.0  # frames a second, at most


class Page:
    """A scene in browsers; one thread draws, callbacks of the page only leave wishes.

    Args:
        host: Address to listen on.
        port: Port; the next one that is free where it is taken.
        named: Numbers of the scene that the page offers to change, `<part>.<argument>`.

    Attributes:
        address: Of the page, with the token that it asks for on another host.
        remarks: What cannot be drawn, a line each.
        notes: These, and what is to be notes of the motion.

    Raises:
        MbdError: The scene has no consistent start, or no such number.
    """

    def __init__(
        self, scene: Scene, host: str = "127.0.0.1", port: int = 8080, named: Sequence[str] = ()
    ) -> None:
        if not 0 < port < 65536:
            raise DataError(f"--port {port}: accepted are 1 .. 65535")
        self._scene, rerun = scene, Rerun(scene, named)
        self._guarded = PageServer(host, port, Path(scene.name).name)
        self.address = self._guarded.address_with_token
        self._server = self._guarded.viser
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self._fill(rerun)
            undo.pop_all()

    def _fill(self, rerun: Rerun) -> None:
        server, scene = self._server, self._scene
        self._drawing = Drawing(server, scene)
        self.remarks = self._drawing.remarks
        self._controls = Controls(server, scene, rerun)
        for solid, node in self._drawing.stage.solids:
            node.on_click(self._controls.chooser(solid.joint))
        self._player, self._follower = Player(self._controls), Follower(server)
        self._show(still(scene))

    def simulate(self, duration: float) -> None:
        """Run the scene, and show the motion as far as it came.

        Raises:
            MbdError: A time that is no time.
        """
        self._controls.rerun.duration = duration
        self._run_again()

    def show(self, source: Source, topic: str = "/joint_states") -> None:
        """Show a motion; arguments and errors are those of `viewed_motion`."""
        self._show(viewed_motion(self._scene, source, self._drawing.frames.rows, topic))

    def show_ghost(self, source: Source | Path, topic: str = "/joint_states") -> None:
        """Draw a second motion through; arguments and errors as for `viewed_motion`."""
        motion = viewed_motion(self._scene, source, self._drawing.frames.rows, topic)
        self._drawing.show_ghost(motion)

    def play(self) -> None:
        """Draw until the process is interrupted."""
        while True:
            begin = time.monotonic()
            self.tick(begin)
            time.sleep(max(0.0, 1.0 / _RATE - (time.monotonic() - begin)))

    def tick(self, clock: float) -> None:
        """Do what the page asks for, and draw if anything changed.

        Args:
            clock: A time that only grows [s].
        """
        if self._controls.take_run():
            self._run_again()
        row = self._player.row(clock, self._drawing.motion.times)
        now = self._controls.now
        if self._controls.changed() or row != self._row:
            self._draw(row)
        self._controls.reached = now

    def close(self) -> None:
        """End the server."""
        self._guarded.close()

    def _run_again(self) -> None:
        controls = self._controls
        try:
            scene, result, notes = controls.rerun.run(controls.wishes())
            frames = Frames(scene)
            motion = viewed_motion(scene, result, frames.rows)
        except MbdError as error:
            self.notes = (*self.remarks, f"not run: {error}")
            controls.say(self.notes)
            return
        self._scene = scene
        self._show(motion, notes, frames)

    def _show(
        self, motion: ViewedMotion, notes: Sequence[str] = (), frames: Frames | None = None
    ) -> None:
        """Show a motion from its begin."""
        self._row = -1
        self._drawing.show(motion, frames)
        curves = MotionCurves(self._scene, motion, self._drawing.frames.rows)
        self._controls.show_motion(motion, curves)
        self.notes = (*self.remarks, *motion.remarks, *notes)
        self._controls.say(self.notes)
        self._draw(0)

    def _draw(self, row: int) -> None:
        controls, self._row = self._controls, row
        with self._server.atomic():
            controls.apply_to(self._drawing)
            drawn, joint = self._drawing.draw(row), controls.followed
            self._follower.follow(joint, None if joint is None else drawn.poses[joint, :3])
        controls.show_sample(float(self._drawing.motion.times[row]), row)


class Player:
    """Time of a motion.

    Args:
        controls: Slider, play, speed and loop.
    """

    def __init__(self, controls: Controls) -> None:
        self._controls = controls
        self._before: float | None = None

    def row(self, clock: float, times: Array) -> int:
        """The sample to show.

        Args:
            clock: A time that only grows [s].
            times: Of the samples [s], shape (n,).
        """
        controls = self._controls
        passed = 0.0 if self._before is None else clock - self._before
        self._before = clock
        now = controls.now
        if controls.plays and passed > 0.0:
            now = advanced(now, passed * controls.speed, float(times[-1]), controls.loops)
            controls.now = now
            if now >= times[-1] and not controls.loops:
                controls.plays = False
        return nearest_row(times, now)


def advanced(now: float, step: float, end: float, loops: bool) -> float:
    """The time after a step [s]: at the end it stays, or begins again at 0."""
    after = now + step
    if after <= end:
        return after
    return after % end if loops and end > 0.0 else end


def nearest_row(times: Array, now: float) -> int:
    """The last sample that is not after a time, to a nanosecond."""
    row = int(np.searchsorted(times, now + 1.0e-9, side="right")) - 1
    return min(max(row, 0), len(times) - 1)


class Follower:
    """Moves the cameras of all browsers as the joint moves that they follow.

    Args:
        server: The `viser.ViserServer`.
    """

    def __init__(self, server: Any) -> None:
        self._server = server
        self._joint: Any = None
        self._place: Array | None = None

    def follow(self, joint: Any, place: Array | None) -> None:
        """Go along.

        Args:
            joint: What is followed; another one is no reason to move.
            place: Where it is [m], shape (3,); None to stay.
        """
        before, is_same = self._place, joint == self._joint
        self._joint, self._place = joint, None if place is None else place.copy()
        if place is None or before is None or not is_same:
            return
        for client in self._server.get_clients().values():
            client.camera.position = client.camera.position + place - before  # looks along
