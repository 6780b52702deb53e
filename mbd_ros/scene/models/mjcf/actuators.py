"""Actuators of a model -> actuators and forces with an input."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.imported_model import NO_PLACE, Unexpressed
from mbd_ros.scene.models.mjcf.inertia import geom_sizes, geom_type
from mbd_ros.scene.models.mjcf.item import ACTUATORS, Item, unit
from mbd_ros.scene.models.mjcf.reading import Reading
from mbd_ros.scene.models.urdf_text import xyz_rpy

_SERVOS = ("position", "velocity", "intvelocity")
_DYNAMICS = ("none", "integrator", "filter", "filterexact", "muscle", "user", "dcmotor")
_GAINS = ("fixed", "affine", "muscle", "user", "dcmotor")
_BIASES = ("none", "affine", "muscle", "user", "dcmotor")
_LAW = "its joint, tendon or site has an actuator, its law is left to a controller"
_ENDS = ("joint", "jointinparent", "tendon", "site", "body", "cranksite")
_ENDLESS = 1.0e3  # m, of a cylinder whose length MuJoCo does not read when it wraps
_NOT_SAID = ("damping", "frictionloss", "armature", "range", "actuatorfrcrange")


def read_actuators(reading: Reading, sections: dict[str, Any]) -> None:
    """Add what drives joints, tendons and sites to `actuators` and `forces`.

    Raises:
        SceneError: An unknown joint, tendon or site, or values that are wrong.
    """
    for item in reading.items("actuator"):
        if item.type not in ACTUATORS:
            raise item.error(f"unknown element <{item.type}>, accepted: {', '.join(ACTUATORS)}")
        try:
            section, entry = _entry(reading, item)
        except Unexpressed as error:
            reading.leave_out(item, str(error))
            continue
        if entry.get("limit") == 0.0:
            reading.leave_out(item, "its limit is 0")
            continue
        name = reading.names.part(item.name, "actuator")
        sections[section].append({"name": name, **entry})
        if _is_servo(item):
            reading.leave_out(item, _LAW)
        elif item.choice("dyntype", _DYNAMICS) != "none":
            reading.leave_out(item, "its actuator is there, its activation is not")


def _entry(reading: Reading, item: Item) -> tuple[str, dict[str, Any]]:
    if item.type not in ("general", "motor", *_SERVOS):
        raise Unexpressed(NO_PLACE)
    if item.type == "general" and item.choice("gaintype", _GAINS) != "fixed":
        raise Unexpressed(f"its gain is {item.text('gaintype')}")
    if item.type == "general" and item.choice("biastype", _BIASES) not in ("none", "affine"):
        raise Unexpressed(f"its bias is {item.text('biastype')}")
    gear = item.vector("gear", (1.0, *[0.0] * 5), 1)
    for key in _ENDS[:2]:
        if key in item:
            joint = reading.joint(item, key)
            limit = min(abs(gear[0]) * _limit(reading, item), _most(reading, joint.item))
            return "actuators", {"type": "ideal", "joints": [joint.name], **_effort_limit(limit)}
    if "tendon" in item:
        limit = abs(gear[0]) * _limit(reading, item)
        return "forces", {
            "type": "path_force",
            "path": _path(reading, item),
            **_effort_limit(limit),
        }
    if "site" in item:
        return "forces", _at_site(reading, item, np.array(gear))
    if not any(key in item for key in _ENDS):
        raise item.error(f"it drives nothing, expected one of {', '.join(_ENDS)}")
    raise Unexpressed("a scene has no place for what it drives")


def _limit(reading: Reading, item: Item) -> float:
    """Largest force before the gear, in either direction."""
    auto, limit = reading.compiler.autolimits, math.inf
    if item.is_limited("forcelimited", "forcerange", auto):
        limit = max(map(abs, item.vector("forcerange", (0.0, 0.0))))
    dynamics = item.choice("dyntype", _DYNAMICS)
    is_force = not _is_servo(item) and dynamics == "none"
    if is_force and item.is_limited("ctrllimited", "ctrlrange", auto):
        gain = 1.0
        if item.type == "general" and "gainprm" in item:
            gain = item.numbers("gainprm", 1, 10)[0]
        limit = min(limit, abs(gain) * max(map(abs, item.vector("ctrlrange", (0.0, 0.0)))))
    return limit


def _is_servo(item: Item) -> bool:
    if item.type == "general":
        return item.choice("biastype", _BIASES) != "none"
    return item.type in _SERVOS


def _most(reading: Reading, joint: Item) -> float:
    """Largest force of all actuators of a joint."""
    auto = reading.compiler.autolimits
    if joint.is_limited("actuatorfrclimited", "actuatorfrcrange", auto):
        return max(map(abs, joint.vector("actuatorfrcrange", (0.0, 0.0))))
    return math.inf


def _effort_limit(limit: float) -> dict[str, float]:
    return {"limit": limit} if limit < math.inf else {}


def _path(reading: Reading, item: Item) -> str:
    name = item.text("tendon")
    if name in reading.titles:
        return reading.titles[name]
    if name not in reading.tendons:
        raise item.error(f"tendon: there is no tendon '{name}'")
    raise Unexpressed(f"tendon '{name}' is left out")


def _at_site(reading: Reading, item: Item, gear: Any) -> dict[str, Any]:
    """A force, or a torque, in the axes of a site."""
    body, site = reading.place(item, "site")
    force, torque = gear[:3], gear[3:]
    if "refsite" in item or (force.any() and torque.any()):
        raise Unexpressed("it is no force alone and no torque alone")
    if not reading.tree.moves(body):
        raise Unexpressed("its site does not move")
    reading.refuse_rigid(body, "world")
    load, kind = (force, "force") if force.any() else (torque, "torque")
    size = float(np.linalg.norm(load))
    if size == 0.0:
        raise Unexpressed("its gear is 0")
    direction = (site.at.rotation @ load / size).tolist()
    entry = {"frame": body, "kind": kind, "direction": direction}
    if kind == "force":
        entry["point"] = site.at.translation.tolist()
    return {"type": "body_force", **entry, **_effort_limit(size * _limit(reading, item))}


def add_rotors(reading: Reading, sections: dict[str, Any]) -> None:
    """Give `armature` to the first actuator of each joint, or to one that nobody commands."""
    drives = {
        entry["joints"][0]: i
        for i, entry in reversed(list(enumerate(sections["actuators"])))
        if entry["type"] == "ideal"
    }
    for name, hinge in reading.tree.hinges.items():
        is_plain = reading.tree.joint_names.get(name) == [name]
        inertia = hinge.item.number("armature", 0.0) if is_plain else 0.0
        if inertia < 0.0:
            raise hinge.item.error("armature is negative")
        if not inertia or name in reading.fixed:
            continue
        motor = {"type": "geared_motor", "joint": name, "ratio": 1.0, "rotor_inertia": inertia}
        if name in drives:
            old = sections["actuators"][drives[name]]
            limit = {"limit": old["limit"]} if "limit" in old else {}
            sections["actuators"][drives[name]] = {"name": old["name"], **motor, **limit}
        else:
            title = reading.names.part(f"{name}_armature", "armature")
            sections["actuators"].append({"name": title, **motor})


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
    for element in reading.inner(item):
        if element.type != "joint":
            raise item.error(f"unknown element <{element.type}>, accepted: joint")
        if "coef" not in element:
            raise item.error("a joint has no coef")
        name = reading.joint(element, "joint").name
        terms[name] = terms.get(name, 0.0) + element.number("coef", 0.0)
    if not terms:
        raise item.error("it has no joint")
    return {"joints": terms}


def _spatial(reading: Reading, item: Item) -> dict[str, Any]:
    points, wraps, bodies = list[Any](), list[Any](), list[str]()
    waiting: Item | None = None
    for element in reading.inner(item):
        if element.type == "pulley":
            raise Unexpressed("pulleys divide it")
        if element.type == "geom":
            if waiting is not None or not points:
                raise item.error("a geom stands between two sites")
            waiting = element
            continue
        if element.type != "site":
            raise item.error(f"unknown element <{element.type}>, accepted: site, geom, pulley")
        body, place = reading.place(element, "site")
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


def _without_turn(at: Any) -> dict[str, Any]:
    return {key: value for key, value in xyz_rpy(at).items() if key == "xyz"}


def _wrap(reading: Reading, item: Item) -> dict[str, Any]:
    """A sphere, or a cylinder without end, over the side of `sidesite` where it is given."""
    body, (geom, at) = reading.place(item, "geom", "geoms")
    kind = geom_type(geom)
    if kind not in ("sphere", "cylinder"):
        raise item.error(f"geom '{geom.name}' is a {kind}, expected sphere or cylinder")
    radius, side = geom_sizes(geom)[0], {}
    if "sidesite" in item:
        other, site = reading.place(item, "sidesite")
        if other != body:
            raise Unexpressed("its side site is on another body than its geom")
        at = _towards(item, at, site.at.translation, radius, kind)
        side = {"side": "x"} if kind == "cylinder" else {}
    link, at = reading.tree.frame(body, at)
    shape: Any = radius if kind == "sphere" else {"radius": radius, "length": _ENDLESS}
    return {"frame": link, kind: shape, "pose": xyz_rpy(at), **side}


def _towards(item: Item, at: Any, site: Array, radius: float, kind: str) -> Any:
    """The place of a cylinder with its x towards a site; a sphere stays as it is."""
    x = at.rotation.T @ (site - at.translation)
    if kind == "cylinder":
        x[2] = 0.0
    if np.linalg.norm(x) < radius:
        raise Unexpressed("it wraps inside a geom")
    if kind == "sphere":
        return at
    x, z = unit(item, x, "sidesite"), np.array([0.0, 0.0, 1.0])
    return at * pin.SE3(np.column_stack((x, np.cross(z, x), z)), np.zeros(3))


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
    item = {"path": title, "stiffness": stiffness[0], "resting_length": upper}
    return [{"type": "path_spring", "name": name, **item}]
