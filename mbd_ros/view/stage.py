"""The three-dimensional half of the page: nodes that are made once and moved by a frame."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.view.frames import Drawn, arrow_ends, cone_lines
from mbd_ros.view.solids import Solid

ARROW, CONE, MARKER, GHOST = (214, 90, 30), (120, 90, 200), (20, 140, 140), (110, 160, 210)
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
        self.shows_frames = self.shows_arrows = self.shows_cones = self.shows_paths = True
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

    def draw(self, drawn: Drawn, scale: float) -> None:
        """Move everything.

        Args:
            drawn: What to draw.
            scale: Length of arrows and cones per force [m/N].
        """
        self.place(drawn)
        lines = drawn.lines if self.shows_paths else drawn.lines[:0]
        self._lines("lines", lines, drawn.colours[: len(lines)], 0.012)
        ends = arrow_ends(drawn.arrows, scale, self._size * 1.0e-3)
        self._arrows(ends if self.shows_arrows else ends[:0])
        rims = cone_lines(drawn.cones if self.shows_cones else drawn.cones[:0], scale)
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

    def _arrows(self, ends: Array) -> None:
        node = self._nodes.get("arrows")
        if node is not None:
            node.visible = len(ends) > 0
            if len(ends):
                node.points = ends.astype(np.float32)
        elif len(ends):
            thick = self._size * 0.006
            self._nodes["arrows"] = self._scene.add_arrows(
                f"{self._root}/arrows",
                ends,
                ARROW,
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


def show_ground(server: Any, size: float, centre: Array) -> None:
    """A grid at height 0, and where cameras begin.

    Args:
        server: The `viser.ViserServer`.
        size: Of what is looked at [m].
        centre: Of it [m], shape (3,).
    """
    server.scene.set_up_direction("+z")
    sides = {"width": 8.0 * size, "height": 8.0 * size}
    server.scene.add_grid("/ground", **sides, cell_size=size / 4.0, section_size=size)
    server.initial_camera.position = centre + np.array([0.9, -1.25, 0.6]) * size
    server.initial_camera.look_at = centre
