"""Tendons of a model -> paths, and springs along them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.imported_model import Unexpressed
from mbd_ros.scene.models.mjcf.inertia import geom_sizes, geom_type
from mbd_ros.scene.models.mjcf.item import Item, unit
from mbd_ros.scene.models.mjcf.reading import Reading
from mbd_ros.scene.models.urdf_text import xyz_rpy

_ENDLESS = 1.0e3  # m, of a cylinder whose length MuJoCo does not read when it wraps
_NOT_SAID = ("damping", "frictionloss", "armature", "range", "actuatorfrcrange")


def read_tendons(reading: Reading) -> list[dict[str, Any]]:
    """Fill the paths of a model; entries of `forces` along them.

    Raises:
        SceneError: An unknown joint, site or geom, or values that are wrong.
    """
    forces = list[dict[str, Any]]()
    for item in reading.items("tendon"):
        if item.type not in ("fixed", "spatial"):
            raise item.error(f"unknown element <{item.type}>, accepted: fixed, spatial")
        try:
            path = _fixed(reading, item) if item.type == "fixed" else _spatial(reading, item)
        except Unexpressed as error:
            reading.leave_out(item, str(error))
            continue
        title = reading.names.part(item.name, "tendon")
        reading.paths[title], reading.titles[item.name] = path, title
        forces += _spring(reading, item, title)
        missing = [key for key in _NOT_SAID if key in item and any(item.text(key).split())]
        missing = [key for key in missing if any(item.numbers(key, 1, 3))]
        if missing:
            reading.leave_out(item, f"its path is there, not its {', '.join(missing)}")
    return forces


def _fixed(reading: Reading, item: Item) -> dict[str, Any]:
    """Length sum of coef q."""
    terms = dict[str, float]()
    for one in reading.inner(item):
        if one.type != "joint":
            raise item.error(f"unknown element <{one.type}>, accepted: joint")
        if "coef" not in one:
            raise item.error("a joint has no coef")
        name = reading.joint(one, "joint").name
        terms[name] = terms.get(name, 0.0) + one.number("coef", 0.0)
    if not terms:
        raise item.error("it has no joint")
    return {"joints": terms}


def _spatial(reading: Reading, item: Item) -> dict[str, Any]:
    points, wraps, bodies = list[Any](), list[Any](), list[str]()
    waiting: Item | None = None
    for one in reading.inner(item):
        if one.type == "pulley":
            raise Unexpressed("pulleys divide it")
        if one.type == "geom":
            if waiting is not None or not points:
                raise item.error("a geom stands between two sites")
            waiting = one
            continue
        if one.type != "site":
            raise item.error(f"unknown element <{one.type}>, accepted: site, geom, pulley")
        body, place = reading.place(one, "site")
        link, at = reading.tree.frame(body, place.at)
        bodies.append(body)
        points.append({"frame": link, **_without_turn(at)})
        if waiting is not None:
            ends = [len(points) - 2, len(points) - 1]
            wraps.append({**_wrap(reading, waiting), "between": ends})
            waiting = None
    if len(points) < 2 or waiting is not None:
        raise item.error("expected two or more sites, at both ends too")
    reading.refuse_rigid(*bodies)
    return {"points": points, **({"wraps": wraps} if wraps else {})}


def _wrap(reading: Reading, given: Item) -> dict[str, Any]:
    """A sphere, or a cylinder without end, over the side of `sidesite` where it is given."""
    body, (geom, at) = reading.place(given, "geom", "geoms")
    kind = geom_type(geom)
    if kind not in ("sphere", "cylinder"):
        raise given.error(f"geom '{geom.name}' is a {kind}, expected sphere or cylinder")
    radius, side = geom_sizes(geom)[0], {}
    if "sidesite" in given:
        other, site = reading.place(given, "sidesite")
        if other != body:
            raise Unexpressed("its side site is on another body than its geom")
        at = _towards(given, at, site.at.translation, radius, kind)
        side = {"side": "x"} if kind == "cylinder" else {}
    link, at = reading.tree.frame(body, at)
    shape: Any = radius if kind == "sphere" else {"radius": radius, "length": _ENDLESS}
    return {"frame": link, kind: shape, "pose": xyz_rpy(at), **side}


def _towards(given: Item, at: Any, site: Array, radius: float, kind: str) -> Any:
    """The place of a cylinder with its x towards a site; a sphere stays as it is."""
    x = at.rotation.T @ (site - at.translation)
    if kind == "cylinder":
        x[2] = 0.0
    if np.linalg.norm(x) < radius:
        raise Unexpressed("it wraps inside a geom")
    if kind == "sphere":
        return at
    x, z = unit(given, x, "sidesite"), np.array([0.0, 0.0, 1.0])
    return at * pin.SE3(np.column_stack((x, np.cross(z, x), z)), np.zeros(3))


def _without_turn(at: Any) -> dict[str, Any]:
    return {key: value for key, value in xyz_rpy(at).items() if key == "xyz"}


def _spring(reading: Reading, item: Item, title: str) -> list[dict[str, Any]]:
    """A spring that is slack below a length; others push as well, which none here does."""
    stiffness = item.vector("stiffness", [0.0] * 3, 1)
    if not any(stiffness):
        return []
    lower, upper = item.vector("springlength", (-1.0, -2.0), 1)
    if lower != 0.0 or upper < 0.0 or any(stiffness[1:]):
        reading.leave_out(item, "its path is there, not its spring, which pushes too")
        return []
    name = reading.names.part(f"{title}_spring", "spring")
    entry = {"path": title, "stiffness": stiffness[0], "resting_length": upper}
    return [{"type": "path_spring", "name": name, **entry}]
