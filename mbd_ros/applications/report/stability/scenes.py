"""Extreme and random scenes as texts."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.reference_motion import Grid, Known, elsewhere, rotor
from mbd_ros.applications.report.stability.scene_text import (
    ROBOT,
    Entry,
    LoadedScene,
    SceneText,
    joint,
    link,
    load,
    load_file,
    robot,
    yaml_text,
)
from mbd_ros.scene.built_scene import Scene

_SCENES = "package://mbd_ros/config/scenes"
_DOWN = [0.0, -9.81, 0.0]
_CAREFUL = 0.1  # of the longest step that `check` does not warn of
_STREAM = 20_250  # tells these numbers from those of others with the same seed
_KINDS, _SHARES = ("revolute", "prismatic", "continuous"), (0.55, 0.25, 0.2)
Random = np.random.Generator


def extremes(quick: bool) -> list[Extreme]:
    """All rows of the map, or one of each family."""
    families = (_masses, _stiffness, _steps, _speeds, _toggles, _redundant, _chains, _hours)
    families = (*families, _places, _gimbals)
    found = [list(family()) for family in families]
    return [row for rows in found for row in (rows[:1] if quick else rows)]


def _masses() -> Iterator[Extreme]:
    grid, start = Grid(0.05, 12), {"velocity": {"j0": 1.0, "j1": -2.0}}
    for ratio in (1.0e2, 1.0e4, 1.0e6, 1.0e8):
        label = f"1 to {ratio:.0e}".replace("e+0", "e")
        for place, masses in (("inside", (1.0 / ratio, 1.0)), ("outside", (1.0, 1.0 / ratio))):
            scene = mechanism({"initial": start}, *rods(masses))
            yield Extreme("mass ratio", f"{label} {place}", scene, grid)
        four_bar = _four_bar((1.0, 1.0 / ratio, 1.0))
        yield Extreme("mass ratio", f"{label} in a loop", four_bar, grid)


def mechanism(sections: Mapping[str, Any], *elements: str) -> Callable[[], LoadedScene]:
    """Reads a scene with some sections and a robot of some elements; gravity along -y."""
    whole = {"robot": {"urdf": ROBOT, "gravity": _DOWN}, **sections}
    return partial(load, SceneText(yaml_text(whole), robot(*elements)))


def rods(
    masses: Sequence[float], length: float = 1.0, base: Sequence[float] = (0.0, 0.0, 0.0)
) -> list[str]:
    """A chain of rods in the x-y plane from a base: joints j0, j1, .. and links b0, b1, .."""
    elements = []
    for i, mass in enumerate(masses):
        ends = (f"b{i - 1}", f"b{i}") if i else ("world", "b0")
        at = (length, 0.0, 0.0) if i else base
        elements += [joint(f"j{i}", "continuous", ends, at), rod(f"b{i}", length, mass)]
    return elements


def rod(name: str, length: float, mass: float) -> str:
    """A homogeneous rod along x from its origin."""
    slender, thin = mass * length**2 / 12.0, 1.0e-4 * mass * length**2
    return link(name, mass, (0.5 * length, 0.0, 0.0), np.diag((thin, slender, slender)))


def _four_bar(
    masses: Sequence[float],
    copies: int = 1,
    speed: float = 2.0,
    base: Sequence[float] = (0.0, 0.0, 0.0),
) -> Callable[[], LoadedScene]:
    """Three rods of 1 m on a ground of 1.3 m, closed by one or more equal constraints."""
    closure = {"type": "loop_closure", "kind": "point", "directions": "xy", "frame_a": "world"}
    ground = [base[0] + 1.3, *base[1:]]
    ends = {"point_a": ground, "frame_b": "b2", "point_b": [1.0, 0.0, 0.0]}
    initial = {
        "position": {"j0": 1.5708, "j1": -1.6174, "j2": -1.218},
        "velocity": {"j0": speed, "j1": -speed, "j2": speed},
    }
    sections = {"constraints": [{**closure, **ends}] * copies, "initial": initial}
    return mechanism(sections, *rods(masses, base=base))


def _stiffness() -> Iterator[Extreme]:
    hinge, slide = ("world", "arm"), ("arm", "bob")
    elements = [
        joint("hinge", "continuous", hinge),
        link("arm", 0.1, (0.0, 0.0, 0.0), np.eye(3) * 0.01),
        joint("stretch", "prismatic", slide, (1.0, 0.0, 0.0), axis=(1.0, 0.0, 0.0)),
        link("bob", 1.0, (0.0, 0.0, 0.0), np.eye(3) * 0.01),
    ]
    for power in range(3, 11):
        spring = {"type": "joint_spring", "joint": "stretch", "stiffness": 10.0**power}
        scene = mechanism({"forces": [spring]}, *elements)
        yield Extreme("stiffness", f"1e{power} N/m at 1 ms", scene, Grid(0.02, 12), dt=1.0e-3)
    for power in (1, 2, 3, 4):
        damper = {"type": "joint_spring", "joint": "stretch", "stiffness": 100.0}
        scene = mechanism({"forces": [{**damper, "damping": 10.0**power}]}, *elements)
        yield Extreme("stiffness", f"1e{power} N s/m at 1 ms", scene, Grid(0.02, 12), dt=1.0e-3)


def _steps() -> Iterator[Extreme]:
    grids = {
        "benchmark/arm7_swing": Grid(0.02, 24),
        "benchmark/arm7_swing_coupled": Grid(0.02, 24),
        "four_bar_leg": Grid(0.01, 24),
    }
    for name, grid in grids.items():
        for factor in (0.03, 0.1, 0.3, 1.0, 2.0, 5.0, 10.0):
            label = f"{factor:g} x recommended, {name.rpartition('/')[2]}"
            yield Extreme("step", label, _file(name), grid, factor, repeats=factor != 1.0)


def _file(name: str) -> Callable[[], LoadedScene]:
    return partial(load_file, f"{_SCENES}/{name}.yaml")


def _speeds() -> Iterator[Extreme]:
    for speed in (1.0e1, 1.0e2, 1.0e3):
        start = {"velocity": {"j0": speed, "j1": -0.3 * speed}}
        free = mechanism({"initial": start}, *rods((1.0, 1.0)))
        yield Extreme("speed", f"{speed:g} rad/s", free, Grid(2.0 / speed, 12))
        closed = _four_bar((1.0, 1.0, 1.0), speed=speed)
        yield Extreme("speed", f"{speed:g} rad/s in a loop", closed, Grid(0.5 / speed, 12))


def _toggles() -> Iterator[Extreme]:
    for short in ("1e-2", "1e-4", "1e-6"):
        scene = _file(f"benchmark/x02_four_bar_{short}")
        yield Extreme("toggle", f"four-bar {short} m from one", scene, Grid(0.2, 12), 0.02)
    for name, span in (("a02_four_bars_2", 1.0), ("a02_four_bars_40", 0.06)):
        scene = _file(f"benchmark/{name}")
        yield Extreme("toggle", f"through it, {name}", scene, Grid(span / 12, 12), 0.02)


def _redundant() -> Iterator[Extreme]:
    for copies in (1, 2, 4, 16):
        scene = _four_bar((1.0, 1.0, 1.0), copies)
        yield Extreme("redundant rows", f"closed {copies} times", scene, Grid(0.02, 12))
    for name in ("x09_cranks", "x09_cranks_offset", "a04_bricard"):
        yield Extreme("redundant rows", name, _file(f"benchmark/{name}"), Grid(0.02, 12))


def _chains() -> Iterator[Extreme]:
    for count, seconds in ((10, 2.0), (50, 10.0), (100, 30.0), (200, 120.0)):
        bodies = rods([1.0 / count] * count, 1.0 / count)
        grid = Grid(0.01, 4) if count > 50 else Grid(0.02, 6)
        start = {"velocity": {f"j{i}": 3.0 * (-1.0) ** i for i in range(count)}}
        scene = mechanism({"initial": start}, *bodies)
        yield Extreme("chain", f"{count} bodies", scene, grid, seconds=seconds)


def _hours() -> Iterator[Extreme]:
    slide = joint("slide", "prismatic", ("world", "bob"), axis=(1.0, 0.0, 0.0))
    bob = link("bob", 1.0, (0.0, 0.0, 0.0), np.eye(3) * 0.01)
    spring = {"type": "joint_spring", "joint": "slide", "stiffness": 0.01}
    start = {"forces": [spring], "initial": {"position": {"slide": 1.0}}}
    yield Extreme("long", "oscillator, 4 h", mechanism(start, slide, bob), Grid(1200.0, 12))
    swing = {"initial": {"position": {"j0": -0.5}}}
    yield Extreme("long", "pendulum, 10 min", mechanism(swing, *rods((1,))), Grid(50.0, 12))


def _places() -> Iterator[Extreme]:
    """Reference: the same at the origin, with couplings as rows, and with rows in the QP."""
    away, grid = (100.0, 100.0, 0.0), Grid(0.02, 12)
    coupled = {"couplings": {"j2": {"parent": "j1", "factor": -0.7}}}
    sections = {**coupled, "initial": {"velocity": {"j0": 2.0, "j1": -3.0}}}
    here, there = (
        mechanism(sections, *rods((1.0, 1.0, 1.0), base=base)) for base in ((0.0, 0.0, 0.0), away)
    )
    yield Extreme("mounted", "100 m away", there, grid, known=elsewhere(here, "kkt"))
    masses = (1.0, 1.0, 1.0)
    closed, loop = elsewhere(_four_bar(masses), "qp"), _four_bar(masses, base=away)
    yield Extreme("mounted", "100 m away, in a loop", loop, grid, known=closed)


def _gimbals() -> Iterator[Extreme]:
    """Reference: Euler's equations, which have no mass matrix of the hinges."""
    moments, rates, names = (0.1, 0.2, 0.3), (0.02, 4.0, 0.05), ("world", "outer", "inner", "body")
    hinges = [
        joint(f"h{i}", "continuous", (names[i], names[i + 1]), axis=axis)
        for i, axis in enumerate(np.eye(3)[::-1])
    ]
    massless = [f'<link name="{name}"/>' for name in names[1:3]]
    start = {"velocity": {f"h{i}": rate for i, rate in enumerate(rates)}}
    body = link("body", 1.0, (0.0, 0.0, 0.0), np.diag(moments))
    scene = mechanism({"initial": start}, *hinges, *massless, body)
    known, grid = rotor(moments, rates), Grid(0.1, 10)
    yield Extreme("gimbal lock", "free rotor", scene, grid, dt=5.0e-4, known=known)


class Extreme(NamedTuple):
    """One row of the map.

    Attributes:
        family: The extreme property.
        load: Reads the scene.
        grid: Times of the comparison.
        factor: Step in multiples of the longest one without a warning; with `dt` unused.
        dt: Step of all methods [s], or 0.
        seconds: About how long it takes.
        stops: Text of the stop that is expected here; empty if none is.
        repeats: Whether another row has the runs of methods that choose their steps.
        known: Gives the motion by other equations than those of the scene; by default DOP853 does.
    """

    family: str
    label: str
    load: Callable[[], LoadedScene]
    grid: Grid
    factor: float = _CAREFUL
    dt: float = 0.0
    seconds: float = 3.0
    stops: str = ""
    repeats: bool = False
    known: Known | None = None

    @property
    def name(self) -> str:
        """Unique name of letters, digits, points and dashes."""
        return item_name(f"{self.family}-{self.label}")


def item_name(text: str) -> str:
    """A text as letters, digits, points, dashes and underscores."""
    return re.sub(r"[^\w.-]+", "_", text, flags=re.ASCII)


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


def _direction(rng: Random) -> Any:
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


def _rounded(values: Any) -> list[float]:
    return [round(float(value), 4) for value in values]


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
    for i, robot_joint in enumerate(scene.robot.joints):
        q, size = float(scene.initial.q[robot_joint.q]), 0.1 if kinds[i] == "prismatic" else 0.5
        if rng.random() < 0.06:
            room = 0.05 * abs(float(scene.initial.v[robot_joint.v])) + size * rng.uniform(
                0.02, 1.0, 2
            )
            lower, upper = _rounded((q - room[0], q + room[1]))
            stop = {
                "joint": robot_joint.name,
                "lower": lower,
                "upper": upper,
                "time_constant": 0.02,
            }
            parts.append({"type": "joint_stop", **stop, "smoothed": True})
        if rng.random() < 0.04:
            limit = round(float(10.0 ** rng.uniform(-2.0, 1.0)), 4)
            entry = {"type": "dry_friction", "joint": robot_joint.name, "limit": limit}
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


def _numbers(values: Any) -> Entry:
    return {key: round(float(value), 4) for key, value in values.items()}
