"""The three-dimensional half of the page: nodes that are made once and moved by a frame."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.view.arrows import cone_lines
from mbd_ros.view.frames import Drawn
from mbd_ros.view.solids import Solid

COLOURS = {  # of arrows
    "forces": (235, 85, 0),
    "moments": (170, 0, 150),
    "reactions": (0, 95, 200),
    "reaction moments": (80, 20, 190),
}
CONE, MARKER, GHOST = (120, 90, 200), (20, 140, 140), (110, 160, 210)
_NONE = np.zeros((0, 2, 3))
_SOFT = 0.35  # opacity of a ghost, and of what stands for an inertia


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
