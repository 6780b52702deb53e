"""Shapes of contacts, on links that have nothing else to show there; spokes to points."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.geometry import shapes
from mbd_ros.core.geometry.contact_pair import ContactPair
from mbd_ros.core.geometry.shapes import Side
from mbd_ros.core.model.robot import Robot
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view import surfaces
from mbd_ros.view.ground import upright
from mbd_ros.view.solids import BONE, Solid, moved, solids_of
from mbd_ros.view.surfaces import Surface

_TOUCHING = (150, 140, 120)  # red, green, blue
_THIN = 0.03  # half a spoke, as a share of its length
_PLATE = 20.0  # side of the piece of a half space that is shown, over the reach of solids
_SHORTEST = 1.0e-4  # m


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
                if np.linalg.norm(centre) > _SHORTEST:
                    yield Solid(side.frame, place.joint, surfaces.bone(centre, _THIN), BONE)


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
