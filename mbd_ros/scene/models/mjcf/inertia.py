"""What bodies weigh: `<inertial>`, or the sum of their geoms."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.mjcf.item import Item
from mbd_ros.scene.models.mjcf.meshes import Meshes
from mbd_ros.scene.models.mjcf.placement import Compiler, placed, turned_to, unit
from mbd_ros.scene.models.urdf_text import Mass

_TYPES = (
    *("sphere", "capsule", "cylinder", "box", "ellipsoid"),
    *("plane", "hfield", "mesh", "sdf"),
)
_SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3, "ellipsoid": 3}
_DENSITY = 1000.0  # kg/m^3, MuJoCo's default


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
    given = geom.numbers("size", 1, 3) if "size" in geom else []
    if "fromto" in geom and count > 1:
        first, last = np.reshape(geom.vector("fromto", [0.0] * 6), (2, 3))
        half = 0.5 * float(np.linalg.norm(last - first))
        given = [*given[:1], half] if count == 2 else [*given[:1], *given[:1], half]
    if len(given) < count or min(given[:count]) <= 0.0:
        raise geom.error(f"size is {given}, expected {count} positive numbers")
    return given[:count]


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
        compiler: The settings.
        meshes: Those of the model.

    Raises:
        SceneError: Mass or inertia that is negative, or that of a mesh that cannot be read.
    """
    from_geoms = compiler.from_geoms
    if inertial is not None and from_geoms != "true":
        found = _given(inertial, compiler)
    else:
        found = pin.Inertia.Zero()
        for geom, place in geoms if from_geoms != "false" else ():
            if compiler.groups[0] <= geom.number("group", 0.0) <= compiler.groups[1]:
                found += place.act(_solid(geom, meshes))
    return _bounded(found, compiler)


def mass_of(inertia: Any, scale: float = 1.0) -> Mass:
    """The mass of a link of the description; `scale` multiplies it."""
    xx, xy, yy, xz, yz, zz = (
        scale * inertia.inertia[i, j] for j in range(3) for i in range(j + 1)
    )
    centre = inertia.lever.tolist() if inertia.mass else [0.0] * 3
    return Mass(scale * inertia.mass, centre, [float(one) for one in (xx, yy, zz, xy, xz, yz)])


def _given(inertial: Item, compiler: Compiler) -> Any:
    at = placed(inertial, compiler)
    if "mass" not in inertial or inertial.number("mass", 0.0) < 0.0:
        raise inertial.error("it has no mass, or a negative one")
    if "fullinertia" in inertial:
        xx, yy, zz, xy, xz, yz = inertial.vector("fullinertia", [0.0] * 6)
        tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        tensor = np.diag(inertial.vector("diaginertia", [0.0] * 3))
    return at.act(pin.Inertia(inertial.number("mass", 0.0), np.zeros(3), tensor))


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
