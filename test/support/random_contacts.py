"""Random scenes with contacts: how many, of what, and what an oracle must know of them."""

from typing import NamedTuple

import numpy as np
from contact_oracle import Pair, Side
from mechanisms import joint, link, urdf

GROUND = Side("world", "half_space", [0.0, 0.0, 1.0])


class Case(NamedTuple):
    """A scene as a mapping, its description, and its pairs for an oracle.

    Attributes:
        kind: Which maker made it.
        scene: Sections.
        urdf: Description of `robot`, or None.
        pairs: What may touch.
        duration: [s].
        dt: [s].
        scale: Length of the smallest body [m].
    """

    kind: str
    scene: dict
    urdf: str | None
    pairs: list
    duration: float
    dt: float
    scale: float


def case(seed):
    """The case of a number, of a kind that follows from it."""
    rng = np.random.default_rng(seed)
    name, maker = list(MAKERS.items())[seed % len(MAKERS)]
    return maker(rng, name)


def entry(pair):
    """A pair as a scene writes it."""
    between = [_side(pair.a), _side(pair.b)]
    return {
        **{"type": "rigid", "name": pair.name, "between": between},
        **{"friction": pair.mu, "restitution": pair.e},
    }


def _side(side):
    more = {k: list(v) for k, v in (("xyz", side.xyz), ("rpy", side.rpy)) if any(v)}
    return {"frame": side.frame, side.kind: side.size, **more}


def _scene(pairs, bodies, twists=None, **more):
    initial = {"twist": twists} if twists else {}
    return {
        "bodies": bodies,
        "contacts": [entry(pair) for pair in pairs],
        "integrator": {"type": "moreau_jean"},
        **({"initial": initial} if initial else {}),
        **more,
    }


def _three(rng, size):
    return [float(x) for x in rng.uniform(-size, size, 3)]


def _mass(rng, size, heavy=0.0):
    """About that of water, or up to 10^heavy times as much."""
    return float(1000.0 * size**3 * 10.0 ** rng.uniform(0.0, heavy))


def _friction(rng):
    return float(rng.choice((0.0, 0.2, 0.6, 1.0, 2.5)))


def _size(rng):
    return float(10.0 ** rng.uniform(-3.0, 0.3))


def _shape(rng, size):
    """A shape that is the hull of balls, and how far it reaches from its centre."""
    kind = str(rng.choice(("sphere", "box", "capsule")))
    if kind == "sphere":
        return kind, size, size
    if kind == "box":
        sides = [float(x) for x in size * rng.uniform(0.5, 2.0, 3)]
        return kind, sides, float(np.linalg.norm(sides)) / 2.0
    radius, length = 0.4 * size, float(size * rng.uniform(0.5, 2.0))
    return kind, {"radius": radius, "length": length}, radius + length / 2.0


def _speed(size, rng, share=1.0):
    return float(share * rng.uniform(0.0, 2.0) * np.sqrt(9.81 * size))


def dropped(rng, kind):
    """Bodies that fall on a plane, which may lean, with spin."""
    size, lean = _size(rng), [float(x) for x in rng.uniform(-0.5, 0.5, 2)]
    n = np.array((*lean, 1.0)) / np.linalg.norm((*lean, 1.0))
    bodies, twists, pairs = {}, {}, []
    mu, e = _friction(rng), float(rng.choice((0.0, 0.0, 0.5, 0.9)))
    for i in range(int(rng.integers(1, 4))):
        what, sizes, reach = _shape(rng, size)
        at = n * reach * rng.uniform(1.01, 2.0) + np.cross(n, (0, 5.0 * size * i, 0))
        pose = {"xyz": [float(x) for x in at], "rpy": _three(rng, 3.0)}
        bodies[f"b{i}"] = {"shape": {what: sizes}, "mass": _mass(rng, size), "pose": pose}
        speed = _speed(size, rng)
        twists[f"b{i}"] = {"linear": _three(rng, speed), "angular": _three(rng, speed / size)}
        plane = Side("world", "half_space", [float(x) for x in n])
        pairs.append(Pair(f"c{i}", Side(f"b{i}", what, sizes), plane, mu, e))
    time = float(np.sqrt(size / 9.81))
    return Case(kind, _scene(pairs, bodies, twists), None, pairs, 6 * time, time / 50, size)


def pile(rng, kind):
    """Balls, of masses up to a million times one another, that fall into a trough."""
    size, count = _size(rng), int(rng.integers(2, 6))
    slopes = [
        Side("world", "half_space", [x, y, 1.0])
        for x, y in ((0.8, 0), (-0.8, 0), (0, 0.7), (0, -0.7))
    ]
    bodies, pairs, mu = {}, [], _friction(rng)
    e = float(rng.choice((0.0, 0.3)))
    for i in range(count):
        pose = {
            "xyz": [*(float(x) for x in rng.uniform(-0.1, 0.1, 2) * size), 2.2 * size * (i + 0.7)]
        }
        shape = {"shape": {"sphere": size}, "mass": _mass(rng, size, 6.0), "pose": pose}
        bodies[f"b{i}"] = shape
        pairs += [
            Pair(f"p{i}_{j}", Side(f"b{i}", "sphere", size), side, mu, e)
            for j, side in enumerate(slopes)
        ]
        pairs += [
            Pair(f"b{i}_{j}", Side(f"b{i}", "sphere", size), Side(f"b{j}", "sphere", size), mu, e)
            for j in range(i)
        ]
    pairs = pairs[-20:] if len(pairs) > 20 else pairs
    kept = {side.frame for pair in pairs for side in pair[1:3]}
    bodies = {name: body for name, body in bodies.items() if name in kept}
    time = float(np.sqrt(size / 9.81))
    return Case(kind, _scene(pairs, bodies), None, pairs, 6 * time, time / 50, size)


def stack(rng, kind):
    """Boxes one on another, heavy ones above light ones, perhaps with a push."""
    size, count = _size(rng), int(rng.integers(2, 5))
    bodies, pairs, twists, height = {}, [], {}, 0.0
    mu = float(rng.choice((0.3, 0.8)))
    for i in range(count):
        sides = [
            float(x) for x in size * np.array((*rng.uniform(0.8, 1.5, 2), rng.uniform(0.2, 0.6)))
        ]
        pose = {
            "xyz": [0.0, 0.0, height + sides[2] / 2],
            "rpy": [0.0, 0.0, float(rng.uniform(-1, 1))],
        }
        bodies[f"b{i}"] = {"shape": {"box": sides}, "mass": _mass(rng, size, 6.0), "pose": pose}
        height += sides[2]
        below = GROUND if not i else Side(f"b{i - 1}", "box", bodies[f"b{i - 1}"]["shape"]["box"])
        pairs.append(Pair(f"c{i}", Side(f"b{i}", "box", sides), below, mu))
        if rng.random() < 0.5:
            twists[f"b{i}"] = {"linear": [_speed(size, rng, 0.3), 0.0, 0.0]}
    time = float(np.sqrt(size / 9.81))
    return Case(kind, _scene(pairs, bodies, twists), None, pairs, 3 * time, time / 50, size)


def table(rng, kind):
    """Many feet under one plate, at heights that differ or not, on a plane."""
    size, count = _size(rng), int(rng.integers(3, 21))
    t = 2 * np.pi * np.arange(count) / count
    rise = rng.choice((0.0, 0.01)) * size * rng.random(count)
    feet = np.column_stack((size * np.cos(t), size * np.sin(t), rise - 0.5 * size))
    points = [[float(x) for x in foot] for foot in feet]
    shape = {"box": [2 * size, 2 * size, 0.1 * size]}
    pose = {"xyz": [0.0, 0.0, float(0.5 * size - rise.min() + rng.choice((0.0, 0.1)) * size)]}
    bodies = {"b0": {"shape": shape, "mass": _mass(rng, size, 3.0), "pose": pose}}
    mu, e = _friction(rng), float(rng.choice((0.0, 0.5)))
    pairs = [Pair("c0", Side("b0", "points", points), GROUND, mu, e)]
    speed = _speed(size, rng, 0.5)
    twists = {
        "b0": {
            "linear": [speed, 0.0, 0.0],
            "angular": [0.0, 0.0, float(rng.uniform(-1, 1)) * speed / size],
        }
    }
    time = float(np.sqrt(size / 9.81))
    return Case(kind, _scene(pairs, bodies, twists), None, pairs, 4 * time, time / 50, size)


def arm(rng, kind):
    """An arm of some rods, its tip above ground and beside a free ball."""
    count, parts, parent = int(rng.integers(2, 6)), [link("root")], "root"
    for i in range(count):
        axis = [tuple(float(x) for x in rng.normal(size=3)), (0, 1, 0)][int(rng.random() < 0.5)]
        mass = float(10.0 ** rng.uniform(-1, 1))
        moments = tuple(mass * 0.1 * x for x in (1.0, 1.1, 0.3))
        parts.append(link(f"l{i}", mass, (0.2, 0.0, 0.0), moments))
        at = (0.0, 0.0, 0.0) if not i else (0.4, 0.0, 0.0)
        parts.append(joint(f"j{i}", "revolute", parent, f"l{i}", axis, at))
        parent = f"l{i}"
    mu, e = _friction(rng), float(rng.choice((0.0, 0.6)))
    tip = Side(parent, "sphere", 0.05, (0.4, 0.0, 0.0))
    ground = Side("world", "half_space", [0.0, 0.0, 1.0], (0.0, 0.0, -0.3))
    ball = Side("ball", "sphere", 0.2)
    mass, pose = float(10.0 ** rng.uniform(-2, 4)), {"xyz": [0.3, 0.1, 0.8]}
    bodies = {"ball": {"shape": {"sphere": 0.2}, "mass": mass, "pose": pose}}
    beside = ("tip", tip, ground), ("below", ball, ground), ("both", ball, tip)
    pairs = [Pair(*names, mu, e) for names in beside]
    more = {}
    if rng.random() < 0.5:
        more["couplings"] = {"j1": {"parent": "j0", "factor": float(rng.normal())}}
    scene = _scene(pairs, bodies, **more)
    return Case(kind, scene, urdf(*parts), pairs, 0.8, 4e-3, 0.05)


MAKERS = {"dropped": dropped, "pile": pile, "stack": stack, "table": table, "arm": arm}
