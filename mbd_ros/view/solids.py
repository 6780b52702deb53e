"""Solids of a scene: what links look like, and shapes of contacts.

Links show their `<visual>` geometry, or bones where there is none to draw. Links that have nothing
else to show show the shapes of their contacts, with spokes to points.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from mbd_ros.core.geometry import shapes
from mbd_ros.core.geometry.contact_pair import ContactPair
from mbd_ros.core.geometry.shapes import Side
from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.model.robot import ModelSource, Robot
from mbd_ros.core.model.urdf import parse_urdf
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.robot_entry import Collision, geometry_of, names_of_link
from mbd_ros.view import surfaces
from mbd_ros.view.frames import upright
from mbd_ros.view.surfaces import Surface

GREY, BONE = (160, 169, 181), (206, 187, 148)  # red, green, blue
_SHORTEST = 1.0e-4  # m, of a bone or a spoke
_THIN = 0.03  # half a bone of the base, or a spoke, as a share of its length
_TOUCHING = (150, 140, 120)  # red, green, blue
_PLATE = 20.0  # side of the piece of a half space that is shown, over the reach of solids


def solids_of_scene(scene: Scene) -> tuple[list[Solid], list[str]]:
    """Return the visible solids of links, and contact shapes of links that show only bones.

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
            solids += _contact_solids(scene.robot, side)
    reach = max((float(np.abs(s.surface.vertices).max()) for s in solids), default=1.0)
    for plane in _planes(scene.robot, sides.values()):
        plate = surfaces.box([_PLATE * reach, _PLATE * reach, 1.0e-3 * reach])
        solids.append(
            Solid("", 0, moved(plate, plane), _TOUCHING, is_inertia=True, is_ground=True)
        )
    return solids, lacking


def _contact_solids(robot: Robot, side: Side) -> Iterator[Solid]:
    for shape in side.shapes:
        place = robot.places.points[shape.at.number]
        for surface in _contact_surfaces(shape):
            yield Solid(side.frame, place.joint, moved(surface, place.at), _TOUCHING)
        if place.joint:
            for centre in _centres(shape, place.at):
                if np.linalg.norm(centre) > _SHORTEST:
                    yield Solid(side.frame, place.joint, surfaces.bone(centre, _THIN), BONE)


def _contact_surfaces(shape: Any) -> Iterator[Surface]:
    """Yield the surfaces of a contact shape, if it has any."""
    if isinstance(shape, shapes.Sphere) and shape.radius > 0.0:
        yield surfaces.sphere(shape.radius)
    elif isinstance(shape, shapes.Box):
        yield surfaces.box(shape.sides)
    elif isinstance(shape, shapes.Capsule):
        yield surfaces.capsule(shape.radius, shape.length)
    elif isinstance(shape, shapes.Cylinder):
        yield surfaces.cylinder(shape.radius, shape.length)


def moved(surface: Surface, at: Any) -> Surface:
    """A surface at a `pinocchio.SE3`."""
    vertices = surface.vertices @ at.rotation.T + at.translation
    return surface._replace(vertices=vertices.astype(np.float32))


def _centres(shape: Any, at: Any) -> Sequence[Any]:
    """Points and centres, in axes of the joint."""
    if isinstance(shape, shapes.Points):
        return [at.act(point) for point in shape.points]
    return [at.translation] if isinstance(shape, shapes.Sphere) else []


def _planes(robot: Robot, sides: Iterable[Side]) -> Iterator[Any]:
    """Half spaces at rest that are not the floor, which the grid shows, each once."""
    floor = upright(robot)[:, 2]
    planes = dict[bytes, Any]()
    for side in sides:
        for shape in side.shapes:
            place = robot.places.points[shape.at.number]
            if isinstance(shape, shapes.HalfSpace) and place.joint == 0:
                normal = place.at.rotation[:, 2]
                if not np.allclose(normal, floor, atol=1e-6):
                    planes[np.round(place.at.homogeneous, 9).tobytes()] = place.at
    yield from planes.values()


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


def solids_of(robot: Robot) -> tuple[list[Solid], list[str]]:
    """All links of a robot, and a line on every mesh or geometry that cannot be drawn.

    Returns:
        The solids; and the lines, each file once.
    """
    solids, lacking = list[Solid](), dict[str, None]()
    inertias = robot.inertias()
    for model_source in robot.model_sources:
        tree = parse_urdf(model_source.text, model_source.source)
        colours = _colours(tree)
        for link in _links(robot, model_source, tree):
            drawn, faults = _visuals(link, colours)
            lacking.update(dict.fromkeys(faults))
            solids += drawn or _bones(tree, link, inertias.get(link.name))
    return solids, list(lacking)


def _colours(tree: ElementTree.Element) -> dict[str, tuple[int, int, int]]:
    found = ((m.get("name", ""), _rgb(m)) for m in tree.findall("material"))
    return {name: colour for name, colour in found if colour is not None}


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


def _links(robot: Robot, model_source: ModelSource, tree: ElementTree.Element) -> Iterator[_Link]:
    for element in tree.findall("link"):
        name = names_of_link(model_source, tree, element.get("name", ""))[0]
        frame = robot.model.frames[robot.frame(name)]
        yield _Link(model_source, element, name, int(frame.parentJoint), frame.placement)


class _Link(NamedTuple):
    """A link of a description.

    Attributes:
        model_source: What it is from.
        element: The `<link>`.
        name: In the scene.
        joint: Index in the model of the joint that carries it.
        at: `pinocchio.SE3` of the link in the frame of that joint.
    """

    model_source: ModelSource
    element: ElementTree.Element
    name: str
    joint: int
    at: Any


def _visuals(link: _Link, colours: dict[str, Any]) -> tuple[list[Solid], list[str]]:
    solids, faults = list[Solid](), list[str]()
    if link.model_source.shape is not None:
        shape = Collision(*link.model_source.shape, [0.0] * 3, [0.0] * 3)
        return [_placed(link, shape, _visual_surface(shape, link.name), GREY)], faults
    for i, element in enumerate(link.element.findall("visual")):
        where = f"{link.model_source.source}: {link.name}: <visual> {i}"
        try:
            shape = geometry_of(
                link.model_source, _beside_its_package(link.model_source, element), where
            )
            surface = _visual_surface(shape, where)
        except SceneError as error:
            faults.append(_once(element, str(error)))
            continue
        solids.append(_placed(link, shape, surface, _colour(element, colours)))
    return solids, faults


def _placed(link: _Link, shape: Collision, surface: Surface, colour: Any) -> Solid:
    at = link.at * pin.SE3(rotation_matrix(shape.rpy), np.array(shape.xyz))
    return Solid(link.name, link.joint, moved(surface, at), colour)


def _visual_surface(shape: Collision, where: str) -> Surface:
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


def _beside_its_package(
    model_source: ModelSource, element: ElementTree.Element
) -> ElementTree.Element:
    """The element with the path of its mesh, where that is in the package of the description."""
    mesh = element.find("geometry/mesh")
    name = "" if mesh is None else mesh.get("filename", "")
    package, _, rest = name.removeprefix("package://").partition("/")
    if mesh is None or not name.startswith("package://") or ".." in Path(rest).parts:
        return element
    for folder in Path(model_source.source).absolute().parents:
        if folder.name == package and (folder / rest).is_file():
            mesh.set("filename", str(folder / rest))
    return element


def _once(element: ElementTree.Element, error: str) -> str:
    """The line of a mesh, the same for all links that show it."""
    mesh = element.find("geometry/mesh")
    name = "" if mesh is None else mesh.get("filename", "")
    return f"{name}: not found or no mesh, drawn as a bone" if name else f"{error}: not drawn"


def _colour(element: ElementTree.Element, known: dict[str, Any]) -> tuple[int, int, int]:
    material = element.find("material")
    if material is None:
        return GREY
    return _rgb(material) or known.get(material.get("name", ""), GREY)


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


def box_around(solids: Sequence[Solid], poses: Array) -> tuple[Array, Array]:
    """Least and greatest corner of the box around all solids [m], each of shape (3,).

    Args:
        solids: What there is; without any the box is around the joints and the origin.
        poses: Place and quaternion (w, x, y, z) of every joint, shape (njoints, 7).
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
