"""Scenes: every part of the registry with arguments drawn from its signature, and spoilt ones."""

import inspect
import json
import random
import types
import typing
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from fuzz import urdf
from fuzz.documents import change_value
from fuzz.values import NUMBERS, anything, spoil_text

from mbd_ros.scene.schema.registry import PARTS, resolve

LISTS = ("constraints", "forces", "actuators")
CHOICES = {  # words that a key accepts
    "kind": ("point", "revolute", "full", "x"),
    "directions": ("x", "xy", "xz", "xyz", "yz"),
    "axis": ("x", "y", "z"),
    "expressed_in": ("world", "frame", "l0"),
    "backend": ("proxqp", "quadprog"),
}


class Scene(NamedTuple):
    text: str
    urdf: str


def mutated(rng: random.Random) -> Scene:
    """A scene of random parts, mostly with some fault."""
    is_mild = rng.random() < 0.4
    robot = urdf.robot(rng) if is_mild or rng.random() < 0.95 else urdf.mutated(rng)
    given: dict[str, Any] = {"robot": {"urdf": "r.urdf"}}
    nastiness = 0.0 if is_mild else rng.choice((0.0, 0.05, 0.3))
    for _ in range(rng.choice((0, 1, 1) if is_mild else (1, 1, 2, 3))):
        section = rng.choice(LISTS)
        given.setdefault(section, []).append(_part(rng, section, robot, nastiness))
    for section in ("integrator", "stabilization"):
        if rng.random() < 0.3:
            given[section] = _part(
                rng, {"integrator": "integrators"}.get(section, section), robot, nastiness
            )
    _fill(rng, given, robot, nastiness)
    for _ in range(0 if is_mild else rng.choice((0, 1, 2))):
        change_value(rng, given, mild=False)
    text = json.dumps(given, ensure_ascii=rng.random() < 0.5)
    if not is_mild and rng.random() < 0.2:
        text = spoil_text(rng, text)
    return Scene(text, robot.text)


def _fill(
    rng: random.Random, given: dict[str, Any], robot: urdf.Described, nastiness: float
) -> None:
    """Sections without parts."""
    if rng.random() < 0.2:
        given["robot"]["gravity"] = [_number(rng, nastiness) for _ in range(3)]
    if rng.random() < 0.1:
        given["robot"]["base"] = rng.choice(("fixed", "floating"))
    if rng.random() < 0.1:
        given["robot"]["locked"] = {rng.choice(robot.joints): _number(rng, nastiness)}
    if rng.random() < 0.4:
        dt = rng.choice((1e-3, 1e-2, 1e-4, _number(rng, nastiness)))
        given["dt"] = 1e-6 if dt == 1e-9 else dt  # accepted, and millions of steps
    if rng.random() < 0.5:
        given["initial"] = {
            key: {joint: _number(rng, nastiness) for joint in robot.joints if rng.random() < 0.5}
            for key in ("position", "velocity")
        }
    if rng.random() < 0.2:
        _add_bodies(rng, given, nastiness)
    if rng.random() < 0.25 and len(robot.joints) > 1:
        parent, child = rng.sample(robot.joints, 2)
        given["couplings"] = {child: {"parent": parent, **_law(rng, nastiness)}}
    if rng.random() < 0.2:
        backend = rng.choice(CHOICES["backend"])
        kind = rng.choice(("plain", "qp", "kkt", "reduced", "aba"))
        given["solver"] = {"type": kind, "backend": backend}
    if rng.random() < 0.1:
        given["external_wrenches"] = {
            "load": {"frame": rng.choice(robot.links), "threshold": _number(rng, nastiness)}
        }
    if rng.random() < 0.1:
        given["safe"] = {"type": "damping", "gain": _number(rng, nastiness)}


def _add_bodies(rng: random.Random, given: dict[str, Any], nastiness: float) -> None:
    """Robots and bodies beside the robot, or in its place, and where they start."""

    def some(count: int) -> list[Any]:
        return [_number(rng, nastiness) for _ in range(count)]

    def pose() -> dict[str, Any]:
        turn = {"rpy": some(3)} if rng.random() < 0.5 else {"quaternion": some(4)}
        return {"xyz": some(3), **turn}

    round_ = {"radius": _number(rng, nastiness), "length": _number(rng, nastiness)}
    shapes = {"box": some(3), "sphere": _number(rng, nastiness)} | dict.fromkeys(
        ("cylinder", "capsule"), round_
    )
    kind = rng.choice(tuple(shapes))
    box = {"shape": {kind: shapes[kind]}, "mass": _number(rng, nastiness), "pose": pose()}
    if rng.random() < 0.3:
        box["inertia"] = some(rng.choice((3, 3, 2)))
    given["bodies"] = {"box": box, "table": {**box, "free": False}}
    given["robots"] = {
        name: {"urdf": "r.urdf", "base": rng.choice(("fixed", "floating")), "pose": pose()}
        for name in rng.sample(("left", "right", "base"), rng.randint(0, 2))
    }
    if rng.random() < 0.2:
        given.pop("robot")
    initial = given.setdefault("initial", {})
    frame = rng.choice(("body", "world"))
    twist = {"linear": some(3), "angular": some(3), "expressed_in": frame}
    initial.update(pose={"box": pose()}, twist={rng.choice(("box", "left")): twist})


def _law(rng: random.Random, nastiness: float) -> dict[str, Any]:
    def some(count: int) -> list[Any]:
        return [_number(rng, nastiness) for _ in range(count)]

    kind = rng.choice(("factor", "polynomial", "spline", "piecewise_polynomial"))
    if kind == "factor":
        return {"factor": _number(rng, nastiness), "offset": _number(rng, nastiness)}
    if kind == "polynomial":
        return {"polynomial": some(rng.randint(1, 6))}
    x = [-2.0, -1.0, 0.0, 1.5] if rng.random() > nastiness else some(4)
    if kind == "spline":
        return {"spline": {"x": x, "y": some(4)}}
    return {"piecewise_polynomial": {"breaks": x, "coefficients": [some(3) for _ in range(3)]}}


def _part(
    rng: random.Random, section: str, robot: urdf.Described, nastiness: float
) -> dict[str, Any]:
    kind = rng.choice(tuple(PARTS[section]))
    part = resolve(section, kind, "")
    entry: dict[str, Any] = {"type": kind}
    hints = typing.get_type_hints(part.__init__)
    for name, parameter in inspect.signature(part).parameters.items():
        needed = parameter.default is inspect.Parameter.empty
        if name != "robot" and name in hints and (needed or rng.random() < 0.4):
            entry[name] = _argument(rng, name, hints[name], robot, nastiness)
    return entry


def _argument(
    rng: random.Random, name: str, hint: Any, robot: urdf.Described, nastiness: float
) -> Any:
    if rng.random() < 0.1 * nastiness:
        return anything(rng)
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    if origin in (types.UnionType, typing.Union):
        return _argument(rng, name, inner[0], robot, nastiness)
    if isinstance(origin, type) and issubclass(origin, Mapping):
        keys = robot.joints if name not in ("spline", "harmonic") else ("x", "y", "amplitude")
        return {k: _argument(rng, name, inner[1], robot, nastiness) for k in rng.sample(keys, 1)}
    if isinstance(origin, type) and issubclass(origin, Sequence):
        if name == "joints":
            return rng.sample(robot.joints, rng.randint(1, len(robot.joints)))
        count = 2 if name in ("times", "wrenches", "torque") else rng.choice((3, 3, 3, 3, 2, 6))
        if name == "times":
            return [0.0, 1.0]
        return [_argument(rng, "", inner[0], robot, nastiness) for _ in range(count)]
    if hint is str:
        return rng.choice(_words(name, robot))
    if hint in (int, bool):
        return rng.choice((hint(1), hint(2), hint(3), hint(0)))
    if hint is float:
        return _number(rng, nastiness)
    return _example(rng, name, robot, nastiness)


def _words(name: str, robot: urdf.Described) -> Sequence[str]:
    if name in CHOICES:
        return CHOICES[name]
    if "frame" in name:
        return (*robot.links, "universe")
    return robot.joints


def _example(rng: random.Random, name: str, robot: urdf.Described, nastiness: float) -> Any:
    """What annotations do not tell."""
    some = [_number(rng, nastiness) for _ in range(4)]
    return rng.choice(
        (
            some,
            {"x": [0.0, 0.1, 0.5, 1.0], "y": some},
            {"amplitude": some[0], "angular_frequency": some[1]},
            {robot.joints[0]: some},
        )
    )


def _number(rng: random.Random, nastiness: float) -> Any:
    if rng.random() < nastiness:
        return rng.choice(NUMBERS)
    return rng.choice((round(rng.uniform(-1, 1), 3), 0.1, 1.0, 0.5, round(rng.uniform(0, 50), 2)))
