"""One robot of a live page: drawn, dragged and pulled with the mouse."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError, ModelError, SolveError, printable
from mbd_ros.features.markers.marker_fit import Fit
from mbd_ros.features.markers.marker_kinematics import Mark, MarkerKinematics
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.curves import LiveCurves, LiveSample
from mbd_ros.view.drawing import MARKER, Stage, size_of
from mbd_ros.view.frames import Drawn, Frames, arrow_ends, largest, length_per, upright
from mbd_ros.view.solids import box_around, solids_of_scene

_LINE = np.array((MARKER,), np.uint8)
_SHORTEST = 1.0e-3  # of the size of the robot, an arrow
_TENSION = 2  # its place among what is largest
_FADING = 0.998  # a frame, of what is largest: half of them within 12 s
_POSTURE = 1.0e-4  # weight of a radian beside one of a size of the robot, squared
_NEAR, _BETTER = 1.0e-5, 0.9  # of the size, where it is reached; of a miss, what is progress
_STEPS = 20  # of the solver: the next frame goes on
# A spring that swings what the joint carries 0.7 times a second: slow enough for a browser, whose
# pointer is known some 0.1 s late, and for what is lighter than that by a factor of ten.
_STIFFNESS = (2.0 * np.pi * 0.7) ** 2  # 1/s^2
_LONGEST = 2.0  # of the size of the robot, what counts of a pull at most
COLOUR = (40, 90, 200)


class LiveRobot:
    """Draws a scene as samples of it come.

    Args:
        title: What people call it; empty for the only one.
        kept: Samples that curves show.

    Attributes:
        frames: What is drawn of it.
        curves: Its last seconds.
        remarks: What cannot be drawn, a line each.
        size: Of the robot [m].
        low: Least corner of the box around it at the start, less `Robot.origin` [m], shape (3,).
        up: Axes whose last one is up, shape (3, 3).
        offset: From there to the page [m], shape (3,).
        drawn: What was drawn last.
        masses: What each joint of the model carries [kg], shape (njoints,).
        stage: Its half of the page, once `show` was called.
    """

    stage: Stage
    curves: LiveCurves

    def __init__(self, title: str, scene: Scene, length: int) -> None:
        self.title, self.scene, self.frames = title, scene, Frames(scene)
        self.solids, lacking = solids_of_scene(scene)
        self.remarks = list(lacking)
        self._curve_length = length
        self.measure(())
        begin = scene.initial._replace(t=0.0)
        self.begin: State = begin._replace(z=np.nan_to_num(begin.z))
        self.drawn: Drawn = self.frames.at(self.begin)
        self._plain = self.drawn
        self.low, self.high = box_around(self.solids, self.drawn.poses)
        self.size = size_of(self.low, self.high)
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
        self.curves = LiveCurves(self.scene, self.frames.rows, loads, self._curve_length)

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


class Pull:
    """Forces of the mouse on links: of the browser that began last.

    Args:
        robots: The robots of the page, as shown.
        server: The `viser.ViserServer`.

    Attributes:
        strength: Factor of the force.
    """

    def __init__(self, robots: list[LiveRobot], server: Any) -> None:
        self._robots, self._scene = robots, server.scene
        self.strength = 1.0
        self._grip: _Grip | None = None
        self._line: Any = None
        self._takers = [
            (node, self._taker(number, solid))
            for number, robot in enumerate(robots)
            for solid, node in robot.stage.solids
            if solid.joint
        ]
        self._needs_shift = True
        for node, take in self._takers:
            node.on_drag("left", modifier="shift")(take)

    def need_shift(self, is_needed: bool) -> None:
        """Let a drag with shift pull, or any drag on a link, as fingers need it."""
        if is_needed == self._needs_shift:
            return
        self._needs_shift = is_needed
        for node, take in self._takers:
            if is_needed:
                node.remove_drag_callback(take)
                node.on_drag("left", modifier="shift")(take)
            else:
                node.on_drag("left")(take)

    def now(self) -> Pulled | None:
        """The force at the poses that were drawn last; None while nobody pulls."""
        grip = self._grip
        if grip is None:
            self._show(None)
            return None
        robot = self._robots[grip.robot]
        at = _pose(robot, grip.joint)
        place = at.act(grip.point)
        away = grip.pointer - robot.offset - place
        length = float(np.linalg.norm(away))
        away *= min(1.0, _LONGEST * robot.size / max(length, 1.0e-12))
        force = self.strength * _STIFFNESS * max(float(robot.masses[grip.joint]), 1.0e-6) * away
        self._show(np.array([[place + robot.offset, grip.pointer]]))
        return Pulled(grip.robot, grip.joint, grip.link, place, force)

    def _taker(self, number: int, solid: Any) -> Any:
        async def take(event: Any) -> None:  # as a coroutine, so that phases keep their order
            self._take(number, solid, event)

        return take

    def _take(self, number: int, solid: Any, event: Any) -> None:
        if event.phase == "end":
            self._grip = None
            return
        robot, pointer = self._robots[number], np.array(event.end_position, dtype=np.float64)
        grip = self._grip
        if grip is None or event.phase == "start":
            start = np.array(event.start_position, dtype=np.float64) - robot.offset
            held = _pose(robot, solid.joint).actInv(start)
            grip = _Grip(number, solid.joint, solid.link, held, pointer)
        if np.isfinite(grip.point).all() and np.isfinite(pointer).all():
            self._grip = grip._replace(pointer=pointer)

    def _show(self, line: Array | None) -> None:
        if self._line is not None:
            self._line.visible = line is not None
            if line is not None:
                self._line.points = line.astype(np.float32)
        elif line is not None:
            thick = 0.008 * max(robot.size for robot in self._robots)
            both = np.tile(np.array(COLOUR, np.uint8), (1, 2, 1))
            self._line = self._scene.add_line_segments("/pull", line, both, thickness=thick)


class _Grip(NamedTuple):
    """The grip of the mouse: a point in the axes of a joint [m], and the pointer on the page."""

    robot: int
    joint: int
    link: str
    point: Array
    pointer: Array


def _pose(robot: LiveRobot, joint: int) -> Any:
    """`pinocchio.SE3` of a joint as it was drawn last."""
    pose = robot.drawn.poses[joint]
    turn = pin.Quaternion(*pose[3:].tolist())
    return pin.SE3(turn.matrix(), pose[:3].copy())


class Pulled(NamedTuple):
    """A force on a link.

    Attributes:
        robot: Which of the robots.
        joint: Index in the model of the joint that carries the link.
        link: Name of the link.
        place: Where the force acts, less `Robot.origin` [m], shape (3,).
        force: In world axes [N], shape (3,).
    """

    robot: int
    joint: int
    link: str
    place: Array
    force: Array


class Reach:
    """A handle on a link, and the posture that follows it: on couplings, loops and limits.

    The problem is that of marker kinematics with one marker; joints that it leaves open stay.

    Args:
        robot: One of the robots of a page.
        joint: Index in the model of the joint whose solids are led.
        server: The `viser.ViserServer`.
        start: Configuration to begin with, shape (nq,).

    Raises:
        ModelError: Something flies, or the joint carries nothing that is drawn.
    """

    def __init__(self, robot: LiveRobot, joint: int, server: Any, start: Array) -> None:
        scene = robot.scene
        if scene.robot.bases:
            raise ModelError("a target would move what flies: none for scenes with free bodies")
        self.robot, self.joint = robot, joint
        solids = [solid for solid in robot.solids if solid.joint == joint]
        if not solids:
            raise ModelError("nothing of this joint is drawn")
        vertices = np.concatenate([solid.surface.vertices for solid in solids])
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
        origin = scene.robot.carrier(solids[0].link)
        mark = Mark("handle", scene.robot.shifted(origin, centre.astype(np.float64)), 1.0)
        weight = _POSTURE * robot.size**2
        self._solver = MarkerKinematics(
            scene.robot,
            scene.couplings,
            [mark],
            constraints=scene.constraints,
            tasks=dict.fromkeys(scene.couplings.independent, weight),
        )
        self._q = start.copy()
        self._place = self._position_of(centre)
        self._wanted: Array | None = None
        self._goal: Array | None = None
        self._miss = np.inf
        self._show(server)

    def posture(self) -> Array | None:
        """The configuration for the place of the handle, shape (nq,); None where it stays.

        Raises:
            SolveError: Loops do not close there.
        """
        wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self._goal, self._miss = wanted, np.inf
        if self._goal is None:
            return None
        goal, self._goal = self._goal, None
        fit = self._fitted(goal)
        miss = float(np.linalg.norm(fit.misses[0, 0]))
        if _NEAR * self.robot.size < miss < _BETTER * self._miss:
            self._goal, self._miss = goal, miss  # the posture holds it back: again from there
        self._q = fit.q[0]
        state = self.robot.begin._replace(q=self._q, v=np.zeros_like(self.robot.begin.v))
        self._ghost.place(self.robot.frames.at(state))
        return self._q

    def remove(self) -> None:
        """Take handle and ghost away."""
        self._handle.remove()
        self._ghost.remove()

    def _fitted(self, goal: Array) -> Fit:
        robot = self.robot.scene.robot
        asked = {j.name: self._q[[j.q]] for j in robot.joints if j.name in self._solver.tasks}
        place = (goal - self.robot.offset + robot.origin).reshape(1, 1, 3)
        seen = self._solver.seen(place, np.zeros(1), asked)
        fit = self._solver.solver.fit(self._q[None], seen, steps=_STEPS)
        if not np.isfinite(fit.q).all():
            raise SolveError("no posture for this target")
        return fit

    def _position_of(self, point: Array) -> Array:
        pose = self.robot.drawn.poses[self.joint]
        w, xyz = pose[3], pose[4:]
        turned = np.cross(xyz, point)
        place: Array = point + 2.0 * (w * turned + np.cross(xyz, turned)) + pose[:3]
        return place + self.robot.offset

    def _show(self, server: Any) -> None:
        robot, scene = self.robot, server.scene
        scene.add_frame("/target", show_axes=False, position=robot.offset)
        self._ghost = Stage(scene, "/target", robot.solids, robot.size, is_ghost=True)
        self._ghost.place(robot.drawn)
        self._handle = scene.add_transform_controls(
            "/handle", scale=0.25 * robot.size, disable_rotations=True, position=self._place
        )

        async def take(event: Any) -> None:
            place = np.array(event.target.position, dtype=np.float64)
            if np.isfinite(place).all():
                self._wanted = place

        self._handle.on_update(take)
