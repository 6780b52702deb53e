"""Inertia of bodies: `<inertial>`, or the sum of their geoms and of what meshes enclose."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.scene.models.imported_model import MAX_BYTES
from mbd_ros.scene.models.mjcf.item import Compiler, Defaults, Item, placed, turned_to, unit
from mbd_ros.scene.models.urdf_text import Mass

_RULES = ("legacy", "convex", "exact", "shell")
_FLAT = 1.0e-9  # least over largest extent
_LARGEST_PLACE = 1.0e6  # of a vertex, in the unit of its mesh
_ENDINGS = (".stl", ".obj")
_TYPES = (
    *("sphere", "capsule", "cylinder", "box", "ellipsoid"),
    *("plane", "hfield", "mesh", "sdf"),
)
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}
_DENSITY = 1000.0  # kg/m^3, MuJoCo's default


def body_inertia(
    inertial: Item | None,
    geoms: Sequence[tuple[Item, Any]],
    compiler: Compiler,
    meshes: Meshes,
) -> Any:
    """`pinocchio.Inertia` of a body in its own axes.

    Args:
        inertial: Element `<inertial>`, if any.
        geoms: Its geoms and their places.
        meshes: Those of the model.

    Raises:
        SceneError: Mass or inertia that is negative, or that of a mesh that cannot be read.
    """
    from_geoms = compiler.from_geoms
    if inertial is not None and from_geoms != "true":
        inertia = _explicit_inertia(inertial, compiler)
    else:
        inertia = pin.Inertia.Zero()
        for geom, place in geoms if from_geoms != "false" else ():
            if compiler.groups[0] <= geom.number("group", 0.0) <= compiler.groups[1]:
                inertia += place.act(_solid(geom, meshes))
    return _bounded(inertia, compiler)


def _explicit_inertia(inertial: Item, compiler: Compiler) -> Any:
    at = placed(inertial, compiler)
    if "mass" not in inertial or inertial.number("mass", 0.0) < 0.0:
        raise inertial.error("it has no mass, or a negative one")
    if "fullinertia" in inertial:
        xx, yy, zz, xy, xz, yz = inertial.vector("fullinertia", [0.0] * 6)
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        tensor = np.diag(inertial.vector("diaginertia", [0.0] * 3))
    try:
        return at.act(pin.Inertia(inertial.number("mass", 0.0), np.zeros(3), tensor))
    except (ValueError, RuntimeError) as error:  # of Pinocchio
        raise inertial.error("its moments of inertia are negative") from error


def _solid(geom: Item, meshes: Meshes) -> Any:
    """A geom that its mass fills, in its own axes."""
    kind = geom_type(geom)
    mass = geom.number("mass", -1.0) if "mass" in geom else None
    density = geom.number("density", _DENSITY)
    if (mass is not None and mass < 0.0) or density < 0.0:
        raise geom.error("its mass or density is negative")
    if kind in ("plane", "hfield") or mass == 0.0 or (mass is None and density == 0.0):
        return pin.Inertia.Zero()
    is_shell = geom.flag("shellinertia", default=False)
    if kind == "mesh" and not is_shell:
        unit = meshes.unit(geom)
        scale = density if mass is None else mass / unit.mass
        return pin.Inertia(scale * unit.mass, unit.lever, scale * unit.inertia)
    if kind == "sdf" or "mesh" in geom or is_shell:
        what = f"shell of a {kind}" if is_shell else f"{kind} fitted to a mesh"
        raise geom.error(
            f"its body has no <inertial>, and inertia of a {what} is not computed: "
            "give <inertial>, or mass='0'"
        )
    sizes = geom_sizes(geom)
    return _filled(kind, sizes, density * _volume(kind, sizes) if mass is None else mass)


def _volume(kind: str, sizes: Sequence[float]) -> float:
    if kind == "box":
        return 8.0 * float(np.prod(sizes))
    radius = sizes[0]
    ball, rod = 4.0 / 3.0 * np.pi * radius**3, 2.0 * np.pi * radius**2 * sizes[-1]
    volumes = {
        **{"sphere": ball, "cylinder": rod, "capsule": ball + rod},
        "ellipsoid": 4.0 / 3.0 * np.pi * float(np.prod(sizes)),
    }
    return float(volumes[kind])


def _filled(kind: str, sizes: Sequence[float], mass: float) -> Any:
    if kind == "sphere":
        return pin.Inertia.FromSphere(mass, sizes[0])
    if kind == "capsule":
        return pin.Inertia.FromCapsule(mass, sizes[0], 2.0 * sizes[1])
    if kind == "cylinder":
        return pin.Inertia.FromCylinder(mass, sizes[0], 2.0 * sizes[1])
    if kind == "box":
        return pin.Inertia.FromBox(mass, *(2.0 * size for size in sizes))
    return pin.Inertia.FromEllipsoid(mass, *sizes)


def _bounded(inertia: Any, compiler: Compiler) -> Any:
    """Inertia as `boundmass`, `boundinertia` and `balanceinertia` change it."""
    if not (compiler.least_mass or compiler.least_inertia or compiler.balances):
        return inertia
    moments, axes = np.linalg.eigh(inertia.inertia)
    moments = np.maximum(moments, compiler.least_inertia)
    if compiler.balances and moments[0] + moments[1] < moments[2]:
        moments = np.full(3, moments.mean())
    tensor: Array = axes @ np.diag(moments) @ axes.T
    lever = inertia.lever if inertia.mass else np.zeros(3)
    return pin.Inertia(max(inertia.mass, compiler.least_mass), lever, tensor)


def mass_of(inertia: Any, scale: float = 1.0) -> Mass:
    """The mass of a link of the description; `scale` multiplies it."""
    xx, xy, yy, xz, yz, zz = (
        scale * inertia.inertia[i, j] for j in range(3) for i in range(j + 1)
    )
    centre = inertia.lever.tolist() if inertia.mass else [0.0] * 3
    return Mass(scale * inertia.mass, centre, [float(one) for one in (xx, yy, zz, xy, xz, yz)])


def geom_type(geom: Item) -> str:
    """Its shape.

    Raises:
        SceneError: An unknown one.
    """
    return geom.choice("type", _TYPES)


def geom_place(geom: Item, compiler: Compiler) -> Any:
    """`pinocchio.SE3` of a geom in its body; between two ends its z runs along them."""
    if "fromto" not in geom:
        return placed(geom, compiler)
    first, last = np.reshape(geom.vector("fromto", [0.0] * 6), (2, 3))
    return pin.SE3(turned_to(unit(geom, first - last, "fromto")), 0.5 * (first + last))


def geom_sizes(geom: Item) -> list[float]:
    """Radius and half length, or half axes [m].

    Raises:
        SceneError: Too few of them, or one that is not positive.
    """
    count = _SIZES[geom_type(geom)]
    sizes = geom.numbers("size", 1, 3) if "size" in geom else []
    if "fromto" in geom and count > 1:
        first, last = np.reshape(geom.vector("fromto", [0.0] * 6), (2, 3))
        half = 0.5 * float(np.linalg.norm(last - first))
        sizes = [*sizes[:1], half] if count == 2 else [*sizes[:1], *sizes[:1], half]
    if len(sizes) < count or min(sizes[:count]) <= 0.0:
        raise geom.error(f"size is {sizes}, expected {count} positive numbers")
    return sizes[:count]


class Meshes:
    """The meshes of a model, read when a body needs their inertia.

    Args:
        root: `<mujoco>`.
        defaults: Its default classes.
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
        try:
            return _inertia(corners, centre, is_signed)
        except (ValueError, RuntimeError) as error:  # of Pinocchio
            reason = "has an inertia that no body has: its triangles enclose nothing"
            raise geom.error(f"mesh '{name}' {reason}; give <inertial>, or mass='0'") from error

    def _corners(self, geom: Item, item: Item, is_convex: bool) -> Array:
        """Corners of all triangles in the axes of the mesh [m], shape (n, 3, 3)."""
        if "file" in item:
            vertices, faces = self._read(geom, item)
        else:
            numbers = item.numbers("vertex", 12, 3_000_000)
            vertices, faces = np.reshape(numbers[: len(numbers) // 3 * 3], (-1, 3)), None
            if "face" in item:
                indices = item.numbers("face", 3, 3_000_000)
                faces = np.reshape(indices[: len(indices) // 3 * 3], (-1, 3)).astype(np.intp)
                if faces.min() < 0 or faces.max() >= len(vertices):
                    raise item.error(f"face names vertices beyond 0 .. {len(vertices) - 1}")
        if not (np.abs(vertices) <= _LARGEST_PLACE).all():
            accepted = f"accepted are numbers up to {_LARGEST_PLACE:g}"
            raise geom.error(f"mesh '{item.name}' has a vertex at no place, {accepted}")
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
        if not file.exists():
            raise geom.error(f"mesh {file} is not there; {need}")
        if file.suffix.lower() not in _ENDINGS or file.stat().st_size > MAX_BYTES:
            raise geom.error(f"mesh {file} is no STL or OBJ of up to {MAX_BYTES} bytes; {need}")

        from mbd_ros.scene.reading.mesh_file import load_mesh  # most models bring their inertia

        try:
            model = load_mesh(file, (1.0, 1.0, 1.0), str(file))
        except SceneError as error:
            raise geom.error(f"{error}; {need}") from error
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


def _volume_and_centre(corners: Array, at: Array, is_signed: bool) -> tuple[float, Array]:
    """Volume [m^3], and the centre of mass of the pyramids on a point [m]."""
    volumes = _volumes(corners - at, is_signed)
    volume = float(volumes.sum())
    if volume <= 0.0:
        return volume, at
    return volume, at + 0.25 * volumes @ (corners - at).sum(axis=1) / volume


def _volumes(corners: Array, is_signed: bool) -> Array:
    """Volumes of the pyramids between triangles and the origin [m^3], shape (n,)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    volumes = np.einsum("ij,ij->i", a, np.cross(b, c)) / 6.0
    return volumes if is_signed else np.abs(volumes)


def _inertia(corners: Array, centre: Array, is_signed: bool) -> Any:
    """Inertia of the pyramids on the centre: integral of x x' is V / 20 (sum of products)."""
    local = corners - centre
    volumes = _volumes(local, is_signed)
    whole = local.sum(axis=1)
    products = np.einsum("n,nki,nkj->ij", volumes, local, local)
    products = (products + np.einsum("n,ni,nj->ij", volumes, whole, whole)) / 20.0
    tensor = np.trace(products) * np.eye(3) - products
    return pin.Inertia(float(volumes.sum()), centre, tensor)
