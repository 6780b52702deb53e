"""A scene drawn in a `viser` scene: solids, and the motion that they follow."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.geometry import shapes
from mbd_ros.core.geometry.contact_pair import ContactPair
from mbd_ros.core.geometry.shapes import Side
from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.model.robot import Recipe, Robot
from mbd_ros.core.model.urdf import parse_urdf
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.contact_entries import Collision, geometry_of, names_of_link
from mbd_ros.view import surfaces
from mbd_ros.view.frames import (
    Drawn,
    Frames,
    Ground,
    arrow_ends,
    cone_lines,
    largest,
    length_per,
    size_of,
    upright,
)
from mbd_ros.view.motion import ViewedMotion, still
from mbd_ros.view.surfaces import Surface

# ---- solids -----------------------------------------------------------------------------------
# What links look like: their `<visual>` geometry, or bones where there is none to draw.


GREY, BONE = (160, 169, 181), (206, 187, 148)  # red, green, blue
_SHORTEST = 1.0e-4  # m, of a bone
_THIN = 0.03  # half a bone of the base, as a share of its length


class Solid(NamedTuple):
    """A surface that travels with a joint.

    Attributes:
        link: Name of the link in the scene.
        joint: Index in the model of the joint that carries it, 0 at rest.
        surface: In axes of that joint.
        colour: Red, green and blue, 0 .. 255.
        is_inertia: Whether it stands for an inertia, and hides nothing.
        is_ground: Whether it is a piece of what has no end.
    """

    link: str
    joint: int
    surface: Surface
    colour: tuple[int, int, int]
    is_inertia: bool = False
    is_ground: bool = False


class _Link(NamedTuple):
    """A link of a description.

    Attributes:
        recipe: What it is from.
        element: The `<link>`.
        name: In the scene.
        joint: Index in the model of the joint that carries it.
        at: `pinocchio.SE3` of the link in the frame of that joint.
    """

    recipe: Recipe
    element: ElementTree.Element
    name: str
    joint: int
    at: Any


def solids_of(robot: Robot) -> tuple[list[Solid], list[str]]:
    """All links of a robot, and a line on every mesh or geometry that cannot be drawn.

    Returns:
        The solids; and the lines, each file once.
    """
    solids, lacking = list[Solid](), dict[str, None]()
    inertias = robot.inertias()
    for recipe in robot.recipes:
        tree = parse_urdf(recipe.text, recipe.source)
        colours = _colours(tree)
        for link in _links(robot, recipe, tree):
            drawn, faults = _visuals(link, colours)
            lacking.update(dict.fromkeys(faults))
            solids += drawn or _bones(tree, link, inertias.get(link.name))
    return solids, list(lacking)


def _links(robot: Robot, recipe: Recipe, tree: ElementTree.Element) -> Iterator[_Link]:
    for element in tree.findall("link"):
        name = names_of_link(recipe, tree, element.get("name", ""))[0]
        frame = robot.model.frames[robot.frame(name)]
        yield _Link(recipe, element, name, int(frame.parentJoint), frame.placement)


def _visuals(link: _Link, colours: dict[str, Any]) -> tuple[list[Solid], list[str]]:
    solids, faults = list[Solid](), list[str]()
    if link.recipe.shape is not None:
        shape = Collision(*link.recipe.shape, [0.0] * 3, [0.0] * 3)
        return [_placed(link, shape, _surface(shape, link.name), GREY)], faults
    for i, element in enumerate(link.element.findall("visual")):
        where = f"{link.recipe.source}: {link.name}: <visual> {i}"
        try:
            shape = geometry_of(link.recipe, _beside_its_package(link.recipe, element), where)
            surface = _surface(shape, where)
        except SceneError as error:
            faults.append(_once(element, str(error)))
            continue
        solids.append(_placed(link, shape, surface, _colour(element, colours)))
    return solids, faults


def _once(element: ElementTree.Element, error: str) -> str:
    """The line of a mesh, the same for all links that show it."""
    mesh = element.find("geometry/mesh")
    name = "" if mesh is None else mesh.get("filename", "")
    return f"{name}: not found or no mesh, drawn as a bone" if name else f"{error}: not drawn"


def _beside_its_package(recipe: Recipe, element: ElementTree.Element) -> ElementTree.Element:
    """The element with the path of its mesh, where that is in the package of the description."""
    mesh = element.find("geometry/mesh")
    name = "" if mesh is None else mesh.get("filename", "")
    package, _, rest = name.removeprefix("package://").partition("/")
    if mesh is None or not name.startswith("package://") or ".." in Path(rest).parts:
        return element
    for folder in Path(recipe.source).absolute().parents:
        if folder.name == package and (folder / rest).is_file():
            mesh.set("filename", str(folder / rest))
    return element


def _placed(link: _Link, shape: Collision, surface: Surface, colour: Any) -> Solid:
    at = link.at * pin.SE3(rotation_matrix(shape.rpy), np.array(shape.xyz))
    return Solid(link.name, link.joint, moved(surface, at), colour)


def moved(surface: Surface, at: Any) -> Surface:
    """A surface at a `pinocchio.SE3`."""
    vertices = surface.vertices @ at.rotation.T + at.translation
    return surface._replace(vertices=vertices.astype(np.float32))


def _surface(shape: Collision, where: str) -> Surface:
    """Triangles of a geometry."""
    if shape.kind == "box":
        return surfaces.box(shape.size)
    if shape.kind == "sphere":
        return surfaces.sphere(shape.size)
    if shape.kind in ("cylinder", "capsule"):
        return getattr(surfaces, shape.kind)(**shape.size)
    from mbd_ros.view.meshes import mesh_surface

    size = shape.size if isinstance(shape.size, dict) else {"file": shape.size}
    return mesh_surface(Path(size["file"]), size.get("scale", (1.0, 1.0, 1.0)), where)


def _bones(tree: ElementTree.Element, link: _Link, inertia: Any) -> list[Solid]:
    """From the origin of a link to its joints, and the box of its inertia."""
    ends, name = list[Any](), link.element.get("name")
    for joint in tree.findall("joint"):
        parent, origin = joint.find("parent"), joint.find("origin")
        if parent is not None and parent.get("link") == name and origin is not None:
            ends.append(np.array([float(w) for w in origin.get("xyz", "0 0 0").split()]))
    if inertia is not None and not ends:
        ends.append(inertia.lever * 2.0)  # a last link is about as long
    long = [end for end in ends if np.linalg.norm(end) > _SHORTEST]
    thickness = {} if link.joint else {"thickness": _THIN}
    bones = [moved(surfaces.bone(end, **thickness), link.at) for end in long]
    solids = [Solid(link.name, link.joint, bone, BONE) for bone in bones]
    if inertia is not None and inertia.mass > 0.0:
        size, axes = equal_box(inertia)
        if size.max() > _SHORTEST:
            box = moved(surfaces.box(size), link.at * pin.SE3(axes, inertia.lever))
            solids.append(Solid(link.name, link.joint, box, BONE, is_inertia=True))
    return solids


def equal_box(inertia: Any) -> tuple[Any, Any]:
    """The even box with a mass and moments of inertia.

    Its sides are a_x^2 = 6 (I_y + I_z - I_x) / m and so on in turn, 0 where that is negative.

    Args:
        inertia: `pinocchio.Inertia` with a mass > 0.

    Returns:
        Sides [m], shape (3,), and axes of the box as columns, shape (3, 3).
    """
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes[:, 2] *= np.linalg.det(axes)
    squares = 6.0 * (moments.sum() - 2.0 * moments) / inertia.mass
    return np.sqrt(np.maximum(squares, 0.0)), axes


def _colours(tree: ElementTree.Element) -> dict[str, tuple[int, int, int]]:
    found = ((m.get("name", ""), _rgb(m)) for m in tree.findall("material"))
    return {name: colour for name, colour in found if colour is not None}


def _colour(element: ElementTree.Element, known: dict[str, Any]) -> tuple[int, int, int]:
    material = element.find("material")
    if material is None:
        return GREY
    return _rgb(material) or known.get(material.get("name", ""), GREY)


def _rgb(material: ElementTree.Element) -> tuple[int, int, int] | None:
    """Colour of a material; None where it gives none that can be read."""
    colour = material.find("color")
    words = () if colour is None else colour.get("rgba", "").split()
    try:
        values = [float(word) for word in words[:3]]
    except ValueError:
        return None
    if len(values) < 3 or not all(map(math.isfinite, values)):
        return None
    r, g, b = (round(255 * min(max(value, 0.0), 1.0)) for value in values)
    return r, g, b


def box_around(solids: Sequence[Solid], poses: Array) -> tuple[Array, Array]:
    """Least and greatest corner of the box around all solids [m], each of shape (3,).

    Args:
        solids: What there is; without any the box is around the joints and the origin.
        poses: As those of `Drawn`, shape (njoints, 7).
    """
    bounded = [solid for solid in solids if not solid.is_ground]
    corners = [] if bounded else [poses[1:, :3], np.zeros((1, 3))]
    for solid in bounded:
        pose = poses[solid.joint]
        w, xyz = pose[3], pose[4:]
        points = solid.surface.vertices
        cross = np.cross(xyz, points)
        corners.append(points + 2.0 * (w * cross + np.cross(xyz, cross)) + pose[:3])
    every = np.concatenate(corners)
    return every.min(axis=0), every.max(axis=0)


# ---- stage ------------------------------------------------------------------------------------
# The three-dimensional half of the page: nodes that are made once and moved by a frame.


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


# ---- contact solids ---------------------------------------------------------------------------
# Shapes of contacts, on links that have nothing else to show there; spokes to points.


_TOUCHING = (150, 140, 120)  # red, green, blue
_CONTACT_SOLIDS_THIN = 0.03  # half a spoke, as a share of its length
_PLATE = 20.0  # side of the piece of a half space that is shown, over the reach of solids
_CONTACT_SOLIDS_SHORTEST = 1.0e-4  # m


def solids_of_scene(scene: Scene) -> tuple[list[Solid], list[str]]:
    """What links look like, and what contacts see of links that show bones alone.

    Returns:
        Solids, and lines on what cannot be drawn.
    """
    solids, lacking = solids_of(scene.robot)
    seen = {solid.link for solid in solids if solid.colour != BONE}
    parts = (*scene.constraints, *scene.forces)
    pairs = [part.pair for part in parts if isinstance(getattr(part, "pair", None), ContactPair)]
    sides = {id(side): side for pair in pairs for side in pair.between}
    for side in sides.values():
        if side.frame not in seen:
            solids += _solids(scene.robot, side)
    reach = max((float(np.abs(s.surface.vertices).max()) for s in solids), default=1.0)
    for plane in _planes(scene.robot, sides.values()):
        plate = surfaces.box([_PLATE * reach, _PLATE * reach, 1.0e-3 * reach])
        solids.append(
            Solid("", 0, moved(plate, plane), _TOUCHING, is_inertia=True, is_ground=True)
        )
    return solids, lacking


def _planes(robot: Robot, sides: Iterable[Side]) -> Iterator[Any]:
    """Half spaces at rest that are not the floor, which the grid shows, each once."""
    floor = upright(robot)[:, 2]
    found = dict[bytes, Any]()
    for side in sides:
        for shape in side.shapes:
            place = robot.places.points[shape.at.number]
            if isinstance(shape, shapes.HalfSpace) and place.joint == 0:
                normal = place.at.rotation[:, 2]
                if not np.allclose(normal, floor, atol=1e-6):
                    found[np.round(place.at.homogeneous, 9).tobytes()] = place.at
    yield from found.values()


def _solids(robot: Robot, side: Side) -> Iterator[Solid]:
    for shape in side.shapes:
        place = robot.places.points[shape.at.number]
        for surface in _surfaces(shape):
            yield Solid(side.frame, place.joint, moved(surface, place.at), _TOUCHING)
        if place.joint:
            for centre in _centres(shape, place.at):
                if np.linalg.norm(centre) > _CONTACT_SOLIDS_SHORTEST:
                    yield Solid(
                        side.frame, place.joint, surfaces.bone(centre, _CONTACT_SOLIDS_THIN), BONE
                    )


def _surfaces(shape: Any) -> Iterator[Surface]:
    """Of shapes that have some."""
    if isinstance(shape, shapes.Sphere) and shape.radius > 0.0:
        yield surfaces.sphere(shape.radius)
    elif isinstance(shape, shapes.Box):
        yield surfaces.box(shape.sides)
    elif isinstance(shape, shapes.Capsule):
        yield surfaces.capsule(shape.radius, shape.length)
    elif isinstance(shape, shapes.Cylinder):
        yield surfaces.cylinder(shape.radius, shape.length)


def _centres(shape: Any, at: Any) -> Sequence[Any]:
    """Points and centres, in axes of the joint."""
    if isinstance(shape, shapes.Points):
        return [at.act(point) for point in shape.points]
    return [at.translation] if isinstance(shape, shapes.Sphere) else []


# ---- drawing ----------------------------------------------------------------------------------
# A scene drawn in a `viser` scene: solids, and the motion that they follow.


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
