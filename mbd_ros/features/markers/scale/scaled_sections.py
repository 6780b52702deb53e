"""Sections of a scene whose segments have other sizes."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError

_AXES = "xyz"
_UNSCALED = ("constraints", "contacts", "forces", "actuators", "external_wrenches")
Entries = dict[str, Any]


def scaled_sections(
    entries: Mapping[str, Any], factors: Mapping[str, Array], stretch: Mapping[str, float]
) -> Entries:
    """Sections with other places; those of muscles are scaled by the lengths of their paths.

    Args:
        entries: By key.
        factors: Link -> factors along its axes, shape (3,).
        stretch: Sliding joint -> factor of its position.

    Raises:
        DataError: A coupling that follows a joint which is stretched itself.
    """
    scaled = deepcopy(dict(entries))
    for entry in scaled.get("sensors", {}).values():
        _scale_place(entry, "xyz", factors.get(entry.get("frame")))
    for path in scaled.get("paths", {}).values():
        for point in path.get("points", []):
            factor = factors.get(point.get("frame"))
            _scale_place(point, "xyz", factor)
            _scale_moves(point.get("moves"), factor)
        for wrap in path.get("wraps", []):
            _scale_wrap(wrap, factors.get(wrap.get("frame")))
    for joint, entry in scaled.get("couplings", {}).items():
        if stretch.get(entry["parent"], 1.0) != 1.0:
            raise DataError(
                f"scale: coupling {joint} follows {entry['parent']}, a sliding joint of a scaled "
                "segment, which is not served"
            )
        _scale_function(entry, stretch.get(joint, 1.0))
    return scaled


def left_as_they_are(entries: Mapping[str, Any]) -> list[str]:
    """Keys of sections with places or sizes that are not scaled."""
    return [key for key in _UNSCALED if entries.get(key)]


def _scale_place(entry: Entries, key: str, factor: Array | None) -> None:
    if factor is not None and key in entry:
        entry[key] = (factor * np.array(entry[key], dtype=np.float64)).tolist()


def _scale_moves(moves: Entries | None, factor: Array | None) -> None:
    if moves is None or factor is None:
        return
    for i, axis in enumerate(_AXES):
        if isinstance(moves.get(axis), dict):
            _scale_function(moves[axis], float(factor[i]))


def _scale_wrap(wrap: Entries, factor: Array | None) -> None:
    """Place by axes; radii and lengths by the mean of the factors."""
    if factor is None:
        return
    if isinstance(wrap.get("pose"), dict):
        _scale_place(wrap["pose"], "xyz", factor)
    mean = float(factor.mean())
    for key in ("cylinder", "sphere", "ellipsoid", "torus"):
        if key in wrap:
            wrap[key] = _times(wrap[key], mean)


def _scale_function(entry: Entries, factor: float) -> None:
    """Values of a coupling function, wherever its kind keeps them."""
    if factor == 1.0:
        return
    for key in ("factor", "offset", "polynomial"):
        if key in entry:
            entry[key] = _times(entry[key], factor)
    if not {"factor", "polynomial"} & entry.keys() and "offset" in entry:
        entry["factor"] = factor
    for key in ("spline", "simm_spline", "linear"):
        if isinstance(entry.get(key), dict):
            entry[key]["y"] = _times(entry[key]["y"], factor)
    if "piecewise_polynomial" in entry:
        pieces = entry["piecewise_polynomial"]
        pieces["coefficients"] = _times(pieces["coefficients"], factor)


def _times(value: Any, factor: float) -> Any:
    if isinstance(value, dict):
        return {key: _times(one, factor) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [_times(one, factor) for one in value]
    return factor * value
