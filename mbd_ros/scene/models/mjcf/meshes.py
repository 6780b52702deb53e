"""Inertia of what the triangles of a mesh enclose."""

from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.mjcf.defaults import Defaults
from mbd_ros.scene.models.mjcf.item import Item
from mbd_ros.scene.models.xml_text import MAX_BYTES

_RULES = ("legacy", "convex", "exact", "shell")
_FLAT = 1.0e-9  # least over largest extent
_ENDINGS = (".stl", ".obj")


class Meshes:
    """The meshes of a model, read when a body needs their inertia.

    Args:
        root: `<mujoco>`.
        defaults: Its default classes.
        path: Its file.
    """

    def __init__(self, root: Element, defaults: Defaults, path: Path) -> None:
        self._folder, self._is_exact = path.parent, False
        for one in root.iterfind("compiler"):
            self._folder = path.parent / one.get("meshdir", one.get("assetdir", ""))
            self._is_exact = one.get("exactmeshinertia") == "true"
        items = [defaults.item(element) for element in root.iterfind("asset/mesh")]
        self._items = {item.name or Path(item.text("file")).stem: item for item in items}

    def unit(self, geom: Item) -> Any:
        """`pinocchio.Inertia` of a mesh of density 1 in its own axes; its mass is its volume.

        `legacy` counts the pyramids over all triangles as positive, as MuJoCo does by default;
        they stand on the centroid of the surface first and on the centre found so then.

        Source: MuJoCo, XML reference, attribute `inertia` of `asset/mesh`.

        Raises:
            SceneError: No such mesh, no file, none of STL and OBJ, or a shell.
        """
        name = geom.text("mesh")
        if name not in self._items:
            raise geom.error(f"there is no mesh '{name}'")
        item = self._items[name]
        rule = item.choice("inertia", _RULES)
        if rule == "shell" or "builtin" in item:
            raise geom.error(f"inertia of mesh '{name}', a shell or builtin, is not computed")
        corners = self._corners(geom, item, rule == "convex")
        is_signed = rule == "exact" or ("inertia" not in item and self._is_exact)
        volume, centre = _volume_and_centre(corners, _centroid(corners), is_signed)
        if is_signed and volume < 0.0:
            raise geom.error(f"triangles of mesh '{name}' face inwards")
        if volume <= 0.0:
            raise geom.error(f"mesh '{name}' has no volume: give <inertial>, or mass='0'")
        return _inertia(corners, centre, is_signed)

    def _corners(self, geom: Item, item: Item, is_convex: bool) -> Array:
        """Corners of all triangles in the axes of the mesh [m], shape (n, 3, 3)."""
        if "file" in item:
            vertices, faces = self._read(geom, item)
        else:
            numbers = item.numbers("vertex", 12, 3_000_000)
            vertices, faces = np.reshape(numbers[: len(numbers) // 3 * 3], (-1, 3)), None
            if "face" in item:
                given = item.numbers("face", 3, 3_000_000)
                faces = np.reshape(given[: len(given) // 3 * 3], (-1, 3)).astype(np.intp)
                if faces.min() < 0 or faces.max() >= len(vertices):
                    raise item.error(f"face names vertices beyond 0 .. {len(vertices) - 1}")
        vertices = vertices - np.array(item.vector("refpos", [0.0] * 3))
        w, *xyz = item.vector("refquat", (1.0, 0.0, 0.0, 0.0))
        turn = pin.Quaternion(w, *xyz).normalized().toRotationMatrix()
        vertices = (vertices @ turn) * np.array(item.vector("scale", (1.0, 1.0, 1.0)))
        if is_convex or faces is None:
            return _hull(geom, vertices)
        corners: Array = vertices[faces]
        return corners

    def _read(self, geom: Item, item: Item) -> tuple[Array, Any]:
        file = self._folder / item.text("file")
        need = "inertia of its body comes from it: give <inertial>, or mass='0'"
        if not file.is_file():
            raise geom.error(f"mesh {file} is not there; {need}")
        if file.suffix.lower() not in _ENDINGS or file.stat().st_size > MAX_BYTES:
            raise geom.error(f"mesh {file} is no STL or OBJ of up to {MAX_BYTES} bytes; {need}")
        import coal  # here, since most models bring their inertia

        try:
            model = coal.MeshLoader().load(str(file), np.ones(3))
        except (ValueError, RuntimeError) as error:
            raise geom.error(f"{file} holds no mesh; {need}") from error
        if not model.num_tris:
            raise geom.error(f"{file} holds no triangle; {need}")
        faces = [[t[0], t[1], t[2]] for t in map(model.tri_indices, range(model.num_tris))]
        return np.array(model.vertices()), np.array(faces, dtype=np.intp)


def _hull(geom: Item, vertices: Array) -> Array:
    """Corners of the triangles of a convex hull [m], shape (n, 3, 3)."""
    import coal

    spread = np.linalg.svd(vertices - vertices.mean(axis=0), compute_uv=False)
    if not spread[-1] > _FLAT * spread[0]:  # on which coal ends the process
        raise geom.error("its mesh is flat, it has no convex hull")
    points = coal.StdVec_Vec3s()
    points.extend(list(vertices))
    try:
        hull = coal.Convex.convexHull(points, True, "Qt")
    except (ValueError, RuntimeError) as error:
        raise geom.error(f"its mesh has no convex hull: {error}") from error
    faces = [[t[0], t[1], t[2]] for t in map(hull.polygons, range(hull.num_polygons))]
    corners: Array = np.array(hull.points())[np.array(faces, dtype=np.intp)]
    return corners


def _centroid(corners: Array) -> Array:
    """Centroid of the surface [m], shape (3,)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    return np.asarray(areas @ corners.mean(axis=1) / max(float(areas.sum()), 1.0e-300))


def _volumes(corners: Array, is_signed: bool) -> Array:
    """Volumes of the pyramids between triangles and the origin [m^3], shape (n,)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    found = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return found if is_signed else np.abs(found)


def _volume_and_centre(corners: Array, at: Array, is_signed: bool) -> tuple[float, Array]:
    """Volume [m^3], and the centre of mass of the pyramids on a point [m]."""
    volumes = _volumes(corners - at, is_signed)
    volume = float(volumes.sum())
    if volume <= 0.0:
        return volume, at
    return volume, at + 0.25 * volumes @ (corners - at).sum(axis=1) / volume


def _inertia(corners: Array, centre: Array, is_signed: bool) -> Any:
    """Inertia of the pyramids on the centre: integral of x x' is V / 20 (sum of products)."""
    local = corners - centre
    volumes = _volumes(local, is_signed)
    whole = local.sum(axis=1)
    products = np.einsum("n,nki,nkj->ij", volumes, local, local)
    products = (products + np.einsum("n,ni,nj->ij", volumes, whole, whole)) / 20.0
    tensor = np.trace(products) * np.eye(3) - products
    return pin.Inertia(float(volumes.sum()), centre, tensor)
