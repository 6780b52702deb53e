"""A scene drawn in a `viser` scene: solids, the motion that they follow, and the ground."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.frames import Drawn, Frames, arrow_ends, cone_lines, largest, length_per, upright
from mbd_ros.view.motion import ViewedMotion, still
from mbd_ros.view.solids import Solid, box_around, solids_of_scene

FORCES = ("forces", "reactions")
MOMENTS = ("moments", "reaction moments")
_FARTHEST = 5.0  # sizes of the robot that a camera steps back for its motion
_LOOKED_AT = 20  # samples whose forces give the lengths of arrows
COLOURS = {  # of arrows
    "forces": (235, 85, 0),
    "moments": (170, 0, 150),
    "reactions": (0, 95, 200),
    "reaction moments": (80, 20, 190),
}
CONE, MARKER, GHOST = (120, 90, 200), (20, 140, 140), (110, 160, 210)
_NONE = np.zeros((0, 2, 3))
_SOFT = 0.35  # opacity of a ghost, and of what stands for an inertia
_CELLS, _REACH = 4, 3  # of the grid: in the size of a robot, and to each side in its sizes
_LINE, _MAIN_LINE = (226, 229, 233), (196, 202, 209)
_SUNK = 0.02  # of the size: what is deeper than that has its grid below it
_FROM = np.array([0.48, -0.82, 0.25])  # where the camera stands, in diagonals, z up
_SUN, _SHADE = np.array([1.0, -2.0, 3.0]), (150, 150, 165)
_FARTHER, _LOWER = 1.7, 0.55  # of telephones: distances, and diagonals that they look below
SMALLEST = 0.05  # m, of what is looked at


class Drawing:
    """Solids of a scene, a motion that they follow, and a second one drawn through.

    Args:
        server: The `viser.ViserServer` to draw in.

    Attributes:
        frames: What is drawn, as arrays.
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


def size_of(low: Array, high: Array) -> float:
    """Largest side of a box [m], at least 0.05."""
    return max(float((high - low).max()), SMALLEST)


class Stage:
    """Solids, lines, points, arrows and cones of one motion.

    Names of nodes are numbers: those of links are of others and may hold a slash.

    Args:
        scene: The `viser.SceneApi` to draw in.
        root: Name of the node above all.
        solids: What travels with joints.
        size: Of the robot [m]; lines and arrows are as thick as it asks for.
        is_ghost: Whether it is drawn through, in one colour.
    """

    def __init__(
        self, scene: Any, root: str, solids: Sequence[Solid], size: float, is_ghost: bool = False
    ) -> None:
        self._scene, self._root, self._size = scene, root, size
        self._joints, self.solids = dict[int, Any](), list[tuple[Solid, Any]]()
        self.shows_cones = self.shows_paths = True
        for i, solid in enumerate(solids):
            if solid.joint not in self._joints:
                self._joints[solid.joint] = self._frame(solid.joint)
            node = scene.add_mesh_simple(
                f"{root}/{solid.joint}/{i}",
                solid.surface.vertices,
                solid.surface.triangles,
                color=GHOST if is_ghost else solid.colour,
                opacity=_SOFT if is_ghost or solid.is_inertia else None,
                flat_shading=True,
                side="double",
            )
            self.solids.append((solid, node))
        self._nodes = dict[str, Any]()

    def _frame(self, joint: int) -> Any:
        long, thick = self._size * 0.08, self._size * 0.002
        name = f"{self._root}/{joint}"
        return self._scene.add_frame(name, show_axes=False, axes_length=long, axes_radius=thick)

    def place(self, drawn: Drawn) -> None:
        """Move the solids."""
        for joint, node in self._joints.items():
            node.position, node.wxyz = drawn.poses[joint, :3], drawn.poses[joint, 3:]

    def draw(self, drawn: Drawn, arrows: Mapping[str, Array], cone_scale: float) -> None:
        """Move everything.

        Args:
            drawn: What to draw.
            arrows: Key of `COLOURS` -> begin and end of each arrow [m], shape (n, 2, 3); those
                that are not named are hidden.
            cone_scale: Height of cones per force [m/N].
        """
        self.place(drawn)
        lines = drawn.lines if self.shows_paths else drawn.lines[:0]
        self._lines("lines", lines, drawn.colours[: len(lines)], 0.012)
        for name in COLOURS:
            self._arrows(name, arrows.get(name, _NONE))
        rims = cone_lines(drawn.cones if self.shows_cones else drawn.cones[:0], cone_scale)
        self._lines("cones", rims, np.tile(np.array(CONE, np.uint8), (len(rims), 1)), 0.002)
        self._points(drawn.points)

    def show_axes(self, seen: bool) -> None:
        """Show or hide the axes of joints."""
        for node in self._joints.values():
            node.show_axes = seen

    def remove(self) -> None:
        """Take everything away."""
        for node in (*self._joints.values(), *self._nodes.values()):
            node.remove()

    def _lines(self, name: str, pieces: Array, colours: Array, thickness: float) -> None:
        both = np.repeat(colours[:, None], 2, axis=1)
        node = self._nodes.get(name)
        if node is not None:
            node.visible = len(pieces) > 0
            if len(pieces):
                node.points, node.colors = pieces.astype(np.float32), both
        elif len(pieces):
            self._nodes[name] = self._scene.add_line_segments(
                f"{self._root}/{name}", pieces, both, thickness=thickness * self._size
            )

    def _arrows(self, name: str, ends: Array) -> None:
        node = self._nodes.get(name)
        if node is not None:
            node.visible = len(ends) > 0
            if len(ends):
                node.points = ends.astype(np.float32)
        elif len(ends):
            thick = self._size * 0.006
            self._nodes[name] = self._scene.add_arrows(
                f"{self._root}/{name}",
                ends,
                COLOURS[name],
                shaft_radius=thick,
                head_radius=2.2 * thick,
                head_length=5.0 * thick,
            )

    def _points(self, points: Array) -> None:
        node = self._nodes.get("points")
        if node is not None:
            node.points = points.astype(np.float32)
        elif len(points):
            self._nodes["points"] = self._scene.add_point_cloud(
                f"{self._root}/points",
                points,
                MARKER,
                point_size=self._size * 0.02,
                point_shape="circle",
                precision="float32",
            )


class Ground:
    """Lights, a grid, and where cameras begin.

    Software draws shadows and mirrored surroundings at a frame a second, and these at thirty.

    Args:
        server: The `viser.ViserServer`.
        axes: As `upright` gives them.
    """

    def __init__(self, server: Any, axes: Array) -> None:
        self._server, self._axes = server, axes
        scene = server.scene
        scene.set_up_direction(axes[:, 2])
        scene.configure_default_lights(enabled=False)
        scene.configure_environment_map(None)
        sky = {"ground_color": _SHADE, "intensity": 2.2, "position": axes[:, 2]}
        scene.add_light_hemisphere("/sky", **sky)
        scene.add_light_directional("/sun", intensity=1.6, position=axes @ _SUN)
        self._telephone: tuple[Array, Array] | None = None
        server.on_client_connect(self._turn)

    def surround(self, low: Array, high: Array) -> None:
        """Lay the grid, and tell cameras where to begin.

        Args:
            low: Least corner of the box around all that is looked at [m], shape (3,).
        """
        lines, colours = _grid(self._axes, size_of(low, high), low, high)
        thickness = {"thickness": 1.0, "thickness_units": "screen"}
        self._server.scene.add_line_segments("/ground", lines, colours, **thickness)
        centre, away = (low + high) / 2.0, max(float(np.linalg.norm(high - low)), SMALLEST)
        there = self._axes @ _FROM * away
        self._server.initial_camera.position = centre + there
        self._server.initial_camera.look_at = centre
        below = centre - self._axes[:, 2] * (_LOWER * away)
        self._telephone = below + there * _FARTHER, below

    def _turn(self, client: Any) -> None:
        """Use the upper half of a window that is taller than wide: the panel covers the lower."""
        if self._telephone and client.camera.image_width < client.camera.image_height:
            client.camera.position, client.camera.look_at = self._telephone


def _grid(axes: Array, size: float, low: Array, high: Array) -> tuple[Array, Array]:
    """Lines, shape (n, 2, 3), and their colours."""
    corners = np.array([low, high]) @ axes
    sunk = float(corners[:, 2].min())
    height = sunk if sunk < -_SUNK * size else 0.0
    middle = np.round(corners.mean(axis=0)[:2] / size) * size
    offset = np.array([*middle, height])
    along = np.arange(-_REACH * _CELLS, _REACH * _CELLS + 1)
    lines, colours = [], []
    for i in along:
        at, end = size * i / _CELLS, size * _REACH
        for across in (0, 1):
            ends = np.array([[at, -end, 0.0], [at, end, 0.0]])
            ends = ends if across == 0 else ends[:, [1, 0, 2]]
            lines.append((ends + offset) @ axes.T)
            colours.append(_LINE if i % _CELLS else _MAIN_LINE)
    both = np.repeat(np.array(colours, np.uint8)[:, None], 2, axis=1)
    return np.array(lines), both
