"""Actuators and equality constraints of a model -> sections of a scene."""

import math
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

from mbd_ros.scene.models.imported import Unexpressed
from mbd_ros.scene.models.mjcf.item import ACTUATORS, Item
from mbd_ros.scene.models.mjcf.reading import Reading

# ---- actuators --------------------------------------------------------------------------------
# Actuators of a model -> actuators and forces with an input.


_SERVOS = ("position", "velocity", "intvelocity")
_LAW = "its joint, tendon or site has an actuator, its law is left to a controller"
_ENDS = ("joint", "jointinparent", "tendon", "site", "body", "cranksite")


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


def add_rotors(reading: Reading, sections: dict[str, Any]) -> None:
    """Give `armature` to the first actuator of each joint, or to one that nobody commands."""
    drives = {
        entry["joints"][0]: i
        for i, entry in reversed(list(enumerate(sections["actuators"])))
        if entry["type"] == "ideal"
    }
    for name, hinge in reading.tree.hinges.items():
        is_plain = reading.tree.given.get(name) == [name]
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


_DYNAMICS = ("none", "integrator", "filter", "filterexact", "muscle", "user", "dcmotor")
_GAINS = ("fixed", "affine", "muscle", "user", "dcmotor")
_BIASES = ("none", "affine", "muscle", "user", "dcmotor")


def _is_servo(item: Item) -> bool:
    if item.type == "general":
        return item.choice("biastype", _BIASES) != "none"
    return item.type in _SERVOS


def _entry(reading: Reading, item: Item) -> tuple[str, dict[str, Any]]:
    if item.type not in ("general", "motor", *_SERVOS):
        raise Unexpressed("a scene has no place for it")
    if item.type == "general" and item.choice("gaintype", _GAINS) != "fixed":
        raise Unexpressed(f"its gain is {item.text('gaintype')}")
    if item.type == "general" and item.choice("biastype", _BIASES) not in ("none", "affine"):
        raise Unexpressed(f"its bias is {item.text('biastype')}")
    gear = item.vector("gear", (1.0, *[0.0] * 5), 1)
    for key in _ENDS[:2]:
        if key in item:
            joint = reading.joint(item, key)
            limit = min(abs(gear[0]) * _limit(reading, item), _most(reading, joint.item))
            return "actuators", {"type": "ideal", "joints": [joint.name], **_kept(limit)}
    if "tendon" in item:
        limit = abs(gear[0]) * _limit(reading, item)
        return "forces", {"type": "path_force", "path": _path(reading, item), **_kept(limit)}
    if "site" in item:
        return "forces", _at_site(reading, item, np.array(gear))
    if not any(key in item for key in _ENDS):
        raise item.error(f"it drives nothing, expected one of {', '.join(_ENDS)}")
    raise Unexpressed("a scene has no place for what it drives")


def _path(reading: Reading, item: Item) -> str:
    name = item.text("tendon")
    if name in reading.titles:
        return reading.titles[name]
    if all(one.name != name for one in reading.items("tendon")):
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
    return {"type": "body_force", **entry, **_kept(size * _limit(reading, item))}


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


def _most(reading: Reading, joint: Item) -> float:
    """Largest force of all actuators of a joint."""
    auto = reading.compiler.autolimits
    if joint.is_limited("actuatorfrclimited", "actuatorfrcrange", auto):
        return max(map(abs, joint.vector("actuatorfrcrange", (0.0, 0.0))))
    return math.inf


def _kept(limit: float) -> dict[str, float]:
    return {"limit": limit} if limit < math.inf else {}


# ---- equalities -------------------------------------------------------------------------------
# Equality constraints of a model -> couplings, locked joints and constraints.


_KINDS = ("connect", "weld", "joint", "tendon", "flex", "flexvert", "flexstrain", "distance")
_LINEAR = (0.0, 1.0, 0.0, 0.0, 0.0)


def read_couplings(reading: Reading) -> dict[str, dict[str, Any]]:
    """Couplings of joints; joints that equalities hold still join those that do not move.

    Raises:
        SceneError: An unknown joint, or values that are wrong.
    """
    found: dict[str, tuple[str, Polynomial]] = {}
    for item in _active(reading, "joint"):
        try:
            _couple(reading, item, found)
        except Unexpressed as error:
            reading.leave_out(item, str(error))
    settled = True
    while settled:  # what follows something that stands still stands still
        still = [name for name, (parent, _) in found.items() if parent in reading.fixed]
        for name in still:
            parent, function = found.pop(name)
            reading.fixed[name] = float(function(reading.fixed[parent]))
        settled = bool(still)
    return {
        name: {"parent": parent, "polynomial": [float(c) for c in function.coef]}
        for name, (parent, function) in found.items()
    }


def read_closures(reading: Reading) -> list[dict[str, Any]]:
    """Entries of `constraints`: `connect`, `weld` and `tendon`.

    Raises:
        SceneError: An unknown body, site or tendon, or values that are wrong.
    """
    entries = list[dict[str, Any]]()
    for item in reading.items("equality"):
        if item.type not in _KINDS:
            raise item.error(f"unknown element <{item.type}>, accepted: {', '.join(_KINDS)}")
        if item.type == "joint" or not item.flag("active", default=True):
            continue
        try:
            entry = _closure(reading, item)
        except Unexpressed as error:
            reading.leave_out(item, str(error))
            continue
        name = reading.names.part(item.name, item.type)
        entries.append({"name": name, **entry})
    return entries


def _active(reading: Reading, kind: str) -> list[Item]:
    return [
        item
        for item in reading.items("equality")
        if item.type == kind and item.flag("active", default=True)
    ]


def _couple(reading: Reading, item: Item, found: dict[str, tuple[str, Polynomial]]) -> None:
    """q1 - ref1 = c0 + c1 (q2 - ref2) + ..; without a second joint q1 - ref1 = c0."""
    joint = reading.joint(item, "joint1")
    function = Polynomial(item.vector("polycoef", _LINEAR, 1))
    if joint.name in found:
        raise Unexpressed(f"'{joint.name}' follows '{found[joint.name][0]}' already")
    if "joint2" not in item:
        reading.fixed[joint.name] = joint.ref + float(function.coef[0])
        return
    name = item.text("joint2")
    if name in reading.fixed:
        ref = reading.tree.hinges[name].ref
        value = joint.ref + float(function(reading.fixed[name] - ref))
        reading.fixed[joint.name] = value
        return
    parent = reading.joint(item, "joint2")
    above = parent.name
    while above in found:
        above = found[above][0]
    if above == joint.name:
        raise Unexpressed(f"'{parent.name}' follows '{joint.name}', which leads in a circle")
    moved = function(Polynomial([-parent.ref, 1.0])) + joint.ref
    found[joint.name] = parent.name, moved.trim()


def _closure(reading: Reading, item: Item) -> dict[str, Any]:
    if item.type == "tendon":
        return _tendon(reading, item)
    if item.type not in ("connect", "weld"):
        raise Unexpressed("a scene has no place for it")
    if "site1" in item or "site2" in item:
        (body, a), (other, b) = reading.place(item, "site1"), reading.place(item, "site2")
        ends = (body, a.at), (other, b.at)
    elif "body1" not in item:
        raise item.error("expected body1, or site1 and site2")
    else:
        body, other = reading.body(item, "body1"), reading.body(item, "body2")
        place = _welded if item.type == "weld" else _connected
        ends = place(reading, item, body, other)
    reading.refuse_rigid(body, other)
    kind = "full" if item.type == "weld" else "point"
    closure = {"type": "loop_closure", "kind": kind}
    for key, (end, at) in zip("ab", ends, strict=True):
        at = at if item.type == "weld" else pin.SE3(np.eye(3), at.translation)
        closure |= reading.placed(key, end, at)
    return closure


def _connected(reading: Reading, item: Item, body: str, other: str) -> Any:
    """The anchor in both bodies, as they are at the reference pose."""
    if "anchor" not in item:
        raise item.error("expected anchor")
    anchor = pin.SE3(np.eye(3), np.array(item.vector("anchor", [0.0] * 3)))
    return (body, anchor), (other, _between(reading, other, body) * anchor)


def _welded(reading: Reading, item: Item, body: str, other: str) -> Any:
    """The anchor in both bodies: where relpose puts it, else as at the reference pose."""
    anchor = pin.SE3(np.eye(3), np.array(item.vector("anchor", [0.0] * 3)))
    x, y, z, *quaternion = item.vector("relpose", (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    if any(quaternion):
        w, *imaginary = np.array(quaternion) / np.linalg.norm(quaternion)
        held = pin.SE3(pin.Quaternion(w, *imaginary).toRotationMatrix(), np.array([x, y, z]))
    else:
        held = _between(reading, body, other) * anchor
    return (body, held), (other, anchor)


def _between(reading: Reading, body: str, other: str) -> Any:
    """Place of the second body in the first at the reference pose."""
    bodies = reading.tree.bodies.all
    return bodies[body].world.actInv(bodies[other].world)


def _tendon(reading: Reading, item: Item) -> dict[str, Any]:
    """A tendon of constant length; that of joints alone, whose length is known."""
    name = item.text("tendon1")
    if name not in reading.titles:
        if all(one.name != name for one in reading.items("tendon")):
            raise item.error(f"tendon1: there is no tendon '{name}'")
        raise Unexpressed(f"tendon '{name}' is left out")
    path = reading.paths[reading.titles[name]]
    if "tendon2" in item or "joints" not in path:
        raise Unexpressed("only a fixed tendon alone is held at a length")
    hinges = reading.tree.hinges
    length = sum(factor * hinges[joint].ref for joint, factor in path["joints"].items())
    length += item.vector("polycoef", _LINEAR, 1)[0]
    if length <= 0.0:
        raise Unexpressed(f"its length {length:g} is not positive")
    return {"type": "path_length", "path": reading.titles[name], "length": length}
