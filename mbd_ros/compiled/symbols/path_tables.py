"""Surfaces as the native search of paths reads them, and its source."""

from pathlib import Path
from typing import Any, NamedTuple

from mbd_ros.core.kinematics.paths.cylinder import Cylinder
from mbd_ros.core.kinematics.paths.ellipsoid import Ellipsoid
from mbd_ros.core.kinematics.paths.sphere import Sphere
from mbd_ros.core.kinematics.paths.torus import Torus

NATIVE = Path(__file__).parents[1] / "native"
SURFACES = (Cylinder, Sphere, Ellipsoid, Torus)  # in the order of `kind` of native/surfaces.h
_FILES = (
    *("surfaces.h", "ellipsoid.h", "torus.h", "curved_flow.h", "geodesics.h", "chain.h"),
    *("geodesic_search.h", "routes.h", "wraps.h"),
)


class SurfaceRow(NamedTuple):
    """A surface as `Surface` of native/surfaces.h has it.

    Attributes:
        kind: Number of its shape.
        axis: Of its side.
        sign: Of its side, 0 for all.
        size: Typical length [m].
        half: Half the length of a cylinder [m].
        axes: Half axes of an ellipsoid; the first is the radius of the circle of a torus [m].
    """

    kind: int
    axis: int
    sign: float
    size: float
    half: float
    axes: tuple[float, ...]


def row_of(surface: Any) -> SurfaceRow:
    """A surface of a shape that native code knows."""
    axes = surface.half_axes.tolist() if isinstance(surface, Ellipsoid) else [0.0] * 3
    if isinstance(surface, Torus):
        axes[0] = float(surface.outer)
    half = float(getattr(surface, "half_length", 0.0))
    given = float(surface.sign), float(surface.size), half, tuple(axes)
    return SurfaceRow(SURFACES.index(type(surface)), surface.axis, *given)


def c_row(row: SurfaceRow) -> str:
    """The same in C."""
    numbers = ", ".join(number.hex() for number in row[2:5])
    axes = ", ".join(axis.hex() for axis in row.axes)
    return f"{{{row.kind}, {row.axis}, {numbers}, {{{axes}}}}}"


def search_text() -> str:
    """The search in C; `MOST_WRAPS` and `MOST_LINES` of a path stand before it."""
    return "".join((NATIVE / name).read_text(encoding="utf-8") for name in _FILES)
