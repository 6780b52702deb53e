"""The page: a `viser` server that shows one scene, its motion and curves under it."""

import contextlib
import io
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, MbdError
from mbd_ros.files.recordings import Source
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.controls import Controls
from mbd_ros.view.curves import MotionCurves
from mbd_ros.view.follower import Follower
from mbd_ros.view.frames import Drawn, Frames, force_scale
from mbd_ros.view.motion import ViewedMotion, still, viewed_motion
from mbd_ros.view.player import Player
from mbd_ros.view.rerun import Rerun
from mbd_ros.view.solids import extent, solids_of
from mbd_ros.view.stage import Stage, show_ground

_RATE = 30.0  # frames a second, at most
_LOOKED_AT = 20  # samples whose forces give the scale of arrows


class Page:
    """A scene in browsers; one thread draws, callbacks of the page only leave wishes.

    Args:
        scene: The scene.
        host: Address to listen on.
        port: Port; the next one that is free where it is taken.
        named: Numbers of the scene that the page offers to change, `<part>.<argument>`.

    Attributes:
        address: Of the page.
        remarks: What cannot be drawn, a line each.
        said: These, and what is to be said of the motion.

    Raises:
        MbdError: The scene has no consistent start, or no such number.
    """

    def __init__(
        self, scene: Scene, host: str = "127.0.0.1", port: int = 8080, named: Sequence[str] = ()
    ) -> None:
        import viser  # takes long, and is asked for by this command alone

        if not 0 < port < 65536:
            raise DataError(f"--port {port}: accepted are 1 .. 65535")
        self._scene, self._frames = scene, Frames(scene)
        self._solids, lacking = solids_of(scene.robot)
        self.remarks = list(lacking)
        self._ghost: tuple[Stage, ViewedMotion] | None = None
        rerun = Rerun(scene, named)
        self._size, centre = extent(self._solids, self._frames.at(still(scene).states[0]).poses)
        with contextlib.redirect_stdout(io.StringIO()):  # viser greets there
            name = Path(scene.name).name
            self._server = viser.ViserServer(host=host, port=port, label=name, verbose=False)
        self._server.request_share_url = lambda: None  # any page could ask for a public address
        self.address = f"http://{self._server.get_host()}:{self._server.get_port()}"
        self._set_up(centre)
        self._stage = Stage(self._server.scene, "/robot", self._solids, self._size)
        self._controls = Controls(self._server, scene, rerun)
        for solid, node in self._stage.solids:
            node.on_click(self._controls.chooser(solid.joint))
        self._player, self._follower = Player(self._controls), Follower(self._server)
        self._show(still(scene))

    def simulate(self, duration: float) -> None:
        """Run the scene, and show the motion as far as it came.

        Raises:
            MbdError: A time that is no time.
        """
        if not 0.0 < duration < math.inf:
            raise DataError(f"--time {duration:g}: accepted are finite times > 0")
        self._controls.rerun.duration = duration
        self._run_again()

    def show(self, source: Source, topic: str = "/joint_states") -> None:
        """Show a motion; arguments and errors are those of `viewed_motion`."""
        self._show(viewed_motion(self._scene, source, self._frames.rows, topic))

    def show_ghost(self, source: Source | Path, topic: str = "/joint_states") -> None:
        """Draw a second motion through; arguments and errors as for `viewed_motion`."""
        motion = viewed_motion(self._scene, source, self._frames.rows, topic)
        stage = Stage(self._server.scene, "/ghost", self._solids, self._size, is_ghost=True)
        self._ghost = stage, motion

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
        row = self._player.row(clock, self._motion.times)
        now = self._controls.now
        if self._controls.changed() or row != self._row:
            self._draw(row)
        self._controls.reached = now

    def close(self) -> None:
        """End the server."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()

    def _set_up(self, centre: Array) -> None:
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        show_ground(self._server, self._size, centre)

    def _run_again(self) -> None:
        controls = self._controls
        try:
            scene, result, said = controls.rerun.run(controls.wishes())
            frames = Frames(scene)
            motion = viewed_motion(scene, result, frames.rows)
        except MbdError as error:
            self.said = (*self.remarks, f"not run: {error}")
            controls.say(self.said)
            return
        self._scene, self._frames = scene, frames
        self._show(motion, said)

    def _show(self, motion: ViewedMotion, said: Sequence[str] = ()) -> None:
        """Show a motion from its begin."""
        self._motion, self._row = motion, -1
        self._curves = MotionCurves(self._scene, motion, self._frames.rows)
        self._controls.show_motion(motion, self._curves)
        self.said = (*self.remarks, *motion.remarks, *said)
        self._controls.say(self.said)
        at = np.unique(np.linspace(0, len(motion.times) - 1, _LOOKED_AT).astype(int))
        self._scale = force_scale([self._drawn(motion, row).arrows for row in at], self._size)
        tensions = [self._frames.tensions(*each) for each in self._with_forces(motion, at)]
        self._most = float(np.nan_to_num(np.array(tensions)).max(initial=0.0))
        self._draw(0)

    def _with_forces(self, motion: ViewedMotion, rows: Any) -> list[tuple[Any, Array, Array]]:
        if motion.multipliers is None:
            return []
        of = motion.states, motion.accelerations, motion.multipliers
        return [(of[0][row], of[1][row], of[2][row]) for row in rows]

    def _drawn(self, motion: ViewedMotion, row: int, most: float = 0.0) -> Drawn:
        lam = None if motion.multipliers is None else motion.multipliers[row]
        return self._frames.at(motion.states[row], motion.accelerations[row], lam, most)

    def _draw(self, row: int) -> None:
        controls, self._row = self._controls, row
        now = float(self._motion.times[row])
        with self._server.atomic():
            drawn = self._drawn(self._motion, row, self._most)
            controls.apply_to(self._stage)
            self._stage.draw(drawn, self._scale * controls.scale)
            joint = controls.followed
            self._follower.follow(joint, None if joint is None else drawn.poses[joint, :3])
            if self._ghost is not None:
                stage, motion = self._ghost
                other = int(np.searchsorted(motion.times, now).clip(0, len(motion.times) - 1))
                stage.place(self._frames.at(motion.states[other]))
        controls.show_sample(now, row)
