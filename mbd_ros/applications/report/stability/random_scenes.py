"""Random mechanisms from a seed: trees with couplings, loops, springs, friction and stops."""

from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.scene_text import (
    ROBOT,
    Entry,
    SceneText,
    joint,
    link,
    load,
    robot,
    yaml_text,
)
from mbd_ros.scene.built_scene import Scene

_STREAM = 20_250  # tells these numbers from those of others with the same seed
_KINDS, _SHARES = ("revolute", "prismatic", "continuous"), (0.55, 0.25, 0.2)
Random = np.random.Generator


def random_scene(seed: int) -> SceneText:
    """A scene of 1 to 12 joints; the same for the same seed.

    Loops are closed by construction: their points coincide at the initial configuration. The
    initial velocities are random; a simulation begins at the nearest ones that the constraints
    allow.
    """
    rng = np.random.default_rng([_STREAM, seed])
    n = int(rng.integers(1, 13))
    kinds = [str(rng.choice(_KINDS, p=_SHARES)) for _ in range(n)]
    urdf = _tree(rng, kinds)
    sections: dict[str, Any] = {"robot": {"urdf": ROBOT, "gravity": _gravity(rng)}}
    if couplings := _couplings(rng, n):
        sections["couplings"] = couplings
    sections["initial"] = _initial(rng, kinds, couplings)
    scene = load(SceneText(yaml_text(sections), urdf)).scene
    sections["constraints"] = [
        *_loops(rng, scene, n - len(couplings) - 1),
        *_bounded(rng, scene, kinds),
    ]
    sections["forces"] = _forces(rng, kinds)
    return SceneText(yaml_text({key: value for key, value in sections.items() if value}), urdf)


def _tree(rng: Random, kinds: list[str]) -> str:
    """Robot description: joints j0, j1, ... carry links b0, b1, ..."""
    elements = []
    for i, kind in enumerate(kinds):
        before = i - 1 if rng.random() < 0.6 else int(rng.integers(-1, i))
        parent = f"b{before}" if before >= 0 else "world"
        axis = np.eye(3)[rng.integers(3)] if rng.random() < 0.5 else _direction(rng)
        at = _rounded(rng.uniform(0.1, 0.4) * _direction(rng))
        rpy = _rounded(rng.uniform(-np.pi, np.pi, 3))
        elements.append(joint(f"j{i}", kind, (parent, f"b{i}"), at, rpy, _rounded(axis)))
        elements.append(_body(rng, f"b{i}"))
    return robot(*elements)


def _body(rng: Random, name: str) -> str:
    """A homogeneous box of 0.05 to 0.5 m and 0.1 to 10 kg, turned at random."""
    mass = round(float(10.0 ** rng.uniform(-1.0, 1.0)), 4)
    square = rng.uniform(0.05, 0.5, 3) ** 2
    turn = pin.rpy.rpyToMatrix(rng.uniform(-np.pi, np.pi, 3))
    inertia = turn @ np.diag(mass / 12.0 * (square.sum() - square)) @ turn.T
    return link(name, mass, _rounded(rng.uniform(-0.15, 0.15, 3)), inertia)


def _gravity(rng: Random) -> list[float]:
    return [0.0, 0.0, -9.81] if rng.random() < 0.5 else _rounded(9.81 * _direction(rng))


def _couplings(rng: Random, n: int) -> dict[str, Entry]:
    """Up to two dependent joints; a chain of them may arise, a cycle cannot."""
    order = [f"j{i}" for i in rng.permutation(n)]
    wanted = min(int(rng.choice([0, 0, 0, 1, 1, 2])), n // 2)
    couplings: dict[str, Entry] = {}
    for k in range(wanted):
        coupling: dict[str, Any] = {"parent": order[int(rng.integers(n - wanted + k))]}
        kind = rng.choice(["factor", "polynomial", "spline"])
        if kind == "factor":
            coupling["factor"] = float(np.round(rng.choice([-1, 1]) * rng.uniform(0.2, 2.0), 4))
            coupling["offset"] = _rounded(rng.uniform(-0.3, 0.3, 1))[0]
        elif kind == "polynomial":
            coupling["polynomial"] = _rounded(rng.uniform(-0.5, 0.5, int(rng.integers(2, 5))))
        else:
            knots = _rounded(np.linspace(-2.0, 2.0, 6))
            coupling["spline"] = {"x": knots, "y": _rounded(rng.uniform(-0.5, 0.5, 6))}
        couplings[order[n - wanted + k]] = coupling
    return couplings


def _initial(rng: Random, kinds: list[str], couplings: dict[str, Entry]) -> Entry:
    """Positions and velocities of the independent joints; metres are a fifth of radians."""
    speed = 10.0 ** rng.uniform(-1.0, 1.3)
    free = [f"j{i}" for i in range(len(kinds)) if f"j{i}" not in couplings]
    size = [0.2 if kinds[int(name[1:])] == "prismatic" else 1.0 for name in free]
    position = _rounded(np.multiply(size, rng.uniform(-1.5, 1.5, len(free))))
    velocity = _rounded(speed * np.multiply(size, rng.normal(size=len(free))))
    return {
        "position": dict(zip(free, position, strict=True)),
        "velocity": dict(zip(free, velocity, strict=True)),
    }


def _loops(rng: Random, scene: Scene, freedom: int) -> list[Entry]:
    """Bilateral constraints that the initial configuration satisfies, and leave some motion."""
    model = scene.robot.model
    data, loops = model.createData(), []
    pin.framesForwardKinematics(model, data, scene.initial.q)
    for _ in range(int(rng.choice([0, 0, 1, 1, 2]))):
        wanted = str(rng.choice(["xyz", "xy", "x", "distance", "plane"]))
        rows = len(wanted) if wanted in ("x", "xy", "xyz") else 1
        first, second = (int(i) for i in rng.integers(-1, len(scene.robot.joints), 2))
        if rows > freedom or first == second:
            continue
        freedom -= rows
        a, b = (f"b{i}" if i >= 0 else "world" for i in (first, second))
        places = [data.oMf[scene.robot.frame(name)] for name in (a, b)]
        loops.append(_loop(rng, wanted, (a, b), places))
    return loops


def _loop(rng: Random, wanted: str, frames: tuple[str, str], places: list[Any]) -> Entry:
    (a, b), (at_a, at_b) = frames, places
    point_a = rng.uniform(-0.3, 0.3, 3)
    there = at_a.act(point_a)
    if wanted == "distance":
        point_b = rng.uniform(-0.3, 0.3, 3)
        away = float(np.linalg.norm(at_b.act(point_b) - there))
        ends = {"frame_a": a, "point_a": point_a.tolist(), "frame_b": b}
        return {"type": "distance", **ends, "point_b": point_b.tolist(), "distance": away}
    point_b = at_b.actInv(there)
    if wanted == "plane":
        plane = {"plane_frame": a, "plane_point": point_a.tolist(), "normal": _direction(rng)}
        plane["normal"] = _rounded(plane["normal"])
        return {"type": "point_on_plane", "frame": b, "point": point_b.tolist(), **plane}
    ends = {"frame_a": a, "point_a": point_a.tolist(), "frame_b": b, "point_b": point_b.tolist()}
    return {"type": "loop_closure", "kind": "point", "directions": wanted, **ends}


def _bounded(rng: Random, scene: Scene, kinds: list[str]) -> list[Entry]:
    """Joint stops around the initial positions, and dry friction."""
    parts: list[Entry] = []
    for i, one in enumerate(scene.robot.joints):
        q, size = float(scene.initial.q[one.q]), 0.1 if kinds[i] == "prismatic" else 0.5
        if rng.random() < 0.06:
            room = 0.05 * abs(float(scene.initial.v[one.v])) + size * rng.uniform(0.02, 1.0, 2)
            lower, upper = _rounded((q - room[0], q + room[1]))
            stop = {"joint": one.name, "lower": lower, "upper": upper, "time_constant": 0.02}
            parts.append({"type": "joint_stop", **stop, "smoothed": True})
        if rng.random() < 0.04:
            limit = round(float(10.0 ** rng.uniform(-2.0, 1.0)), 4)
            entry = {"type": "dry_friction", "joint": one.name, "limit": limit}
            parts.append({**entry, "smoothed": True})
    return parts


def _forces(rng: Random, kinds: list[str]) -> list[Entry]:
    forces: list[Entry] = []
    for i in range(len(kinds)):
        if rng.random() < 0.3:
            spring = {"stiffness": 10.0 ** rng.uniform(0, 4), "rest": rng.uniform(-0.3, 0.3)}
            spring["damping"] = rng.choice([0.0, 10.0 ** rng.uniform(-2, 1)])
            forces.append({"type": "joint_spring", "joint": f"j{i}", **_numbers(spring)})
        if rng.random() < 0.2:
            rub = {"coulomb": rng.uniform(0.0, 1.0), "viscous": rng.uniform(0.0, 0.5)}
            rub["smoothing"] = 10.0 ** rng.uniform(-2, 0)
            forces.append({"type": "joint_friction", "joint": f"j{i}", **_numbers(rub)})
        if rng.random() < 0.1:
            torque = round(float(rng.normal(scale=3.0)), 4)
            forces.append({"type": "joint_torque", "joint": f"j{i}", "torque": torque})
    return forces


def _direction(rng: Random) -> Any:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _numbers(values: Any) -> Entry:
    return {key: round(float(value), 4) for key, value in values.items()}


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 4) for value in values]
