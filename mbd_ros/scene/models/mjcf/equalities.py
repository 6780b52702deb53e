"""Equality constraints of a model -> couplings, locked joints and constraints."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

from mbd_ros.scene.models.imported_model import NO_PLACE, Unexpressed
from mbd_ros.scene.models.mjcf.item import Item
from mbd_ros.scene.models.mjcf.reading import Reading

_KINDS = ("connect", "weld", "joint", "tendon", "flex", "flexvert", "flexstrain", "distance")
_LINEAR = (0.0, 1.0, 0.0, 0.0, 0.0)


def read_couplings(reading: Reading) -> dict[str, dict[str, Any]]:
    """Couplings of joints; joints that equalities hold still join those that do not move.

    Raises:
        SceneError: An unknown joint, or values that are wrong.
    """
    couplings: dict[str, tuple[str, Polynomial]] = {}
    for item in _active(reading, "joint"):
        try:
            _couple(reading, item, couplings)
        except Unexpressed as error:
            reading.leave_out(item, str(error))
    settled = True
    while settled:  # what follows something that stands still stands still
        still = [name for name, (parent, _) in couplings.items() if parent in reading.fixed]
        for name in still:
            parent, function = couplings.pop(name)
            reading.fixed[name] = float(function(reading.fixed[parent]))
        settled = bool(still)
    return {
        name: {"parent": parent, "polynomial": [float(c) for c in function.coef]}
        for name, (parent, function) in couplings.items()
    }


def _active(reading: Reading, kind: str) -> list[Item]:
    return [
        item
        for item in reading.items("equality")
        if item.type == kind and item.flag("active", default=True)
    ]


def _couple(reading: Reading, item: Item, couplings: dict[str, tuple[str, Polynomial]]) -> None:
    """q1 - ref1 = c0 + c1 (q2 - ref2) + ..; without a second joint q1 - ref1 = c0."""
    joint = reading.joint(item, "joint1")
    function = Polynomial(item.vector("polycoef", _LINEAR, 1))
    if joint.name in couplings:
        raise Unexpressed(f"'{joint.name}' follows '{couplings[joint.name][0]}' already")
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
    while above in couplings:
        above = couplings[above][0]
    if above == joint.name:
        raise Unexpressed(f"'{parent.name}' follows '{joint.name}', which leads in a circle")
    moved = function(Polynomial([-parent.ref, 1.0])) + joint.ref
    couplings[joint.name] = parent.name, moved.trim()


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


def _closure(reading: Reading, item: Item) -> dict[str, Any]:
    if item.type == "tendon":
        return _tendon(reading, item)
    if item.type not in ("connect", "weld"):
        raise Unexpressed(NO_PLACE)
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
        if name not in reading.tendons:
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
