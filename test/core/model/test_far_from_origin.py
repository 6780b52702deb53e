"""Where a robot is mounted changes no digit of its accelerations, torques and forces."""

import functools
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import wrenches_of
from places import ROOT
from systems import free_system

from mbd_ros.applications.report.stability.scene_text import joint, link, robot
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.parts.integrators.dop853 import Dop853
from mbd_ros.parts.stabilization.none import NoStabilization
from mbd_ros.scene.from_python import scene_from
from mbd_ros.scene.schema.strict_yaml import read_mapping

CONFIG = ROOT / "config"
STOPS = {"type": "joint_stop", "joints": ["all"], "lower": -0.1, "upper": 0.1}
RUB = {"type": "dry_friction", "joint": "joint2", "limit": 3.0}
GROUND = {"type": "loop_closure", "frame_a": "base", "frame_b": "link7", "directions": "xz"}
BAR = {"type": "distance", "frame_a": "link2", "frame_b": "link7", "distance": 0.5}
PLANE = {"type": "point_on_plane", "plane_frame": "base", "frame": "link7", "normal": [0, 1, 1]}
SPRING = {"type": "point_spring", "frame_a": "base", "frame_b": "link6", "stiffness": 2e4}
PUSH = {"type": "applied_wrench", "frame": "link7", "force": [30, 5, -7], "point": [0.1, 0.2, 0]}
BLOW = {
    **{"type": "prescribed_wrench", "frame": "link4", "times": [-1.0, 1.0]},
    "wrenches": [[5, 2, 40, 1, 2, 3], [5, 2, 41, 1, 2, 3]],
}
HELD = [0.31, -0.1, 0.62]  # in the world, of a robot at its origin
ANCHOR = {"type": "frame_anchor", "frame": "link6", "position": HELD, "kind": "point"}
CASES = {
    "aba": ("arm7", {}),
    "forces": ("arm7", {"forces": [SPRING, PUSH, BLOW]}),
    "reduced": ("prosthetic_leg", {}),
    "mimic": ("prosthetic_arm", {}),
    "couplings as rows": ("prosthetic_arm", {"solver": {"type": "kkt"}}),
    "couplings in the QP": ("prosthetic_arm", {"solver": {"type": "qp"}}),
    "loop": ("four_bar_leg", {}),
    "loop in the QP": ("four_bar_leg", {"solver": {"type": "qp"}}),
    "loop to the ground": ("arm7", {"constraints": [GROUND]}),
    "loop in the chain": ("arm7", {"constraints": [BAR]}),
    "plane": ("arm7", {"constraints": [PLANE]}),
    "anchor": ("arm7", {"constraints": [ANCHOR]}),
    "stops": ("arm7", {"constraints": [STOPS, RUB]}),
    "stops and a loop": ("arm7", {"constraints": [GROUND, STOPS]}),
}
PLACES = [(0.0, 0.9, 1.2), (100.0, 100.0, 0.0), (-2.0e3, 31.7, 412.3)]


def mounted(name, sections, place):
    """A scene whose robot stands on a mount at a place in the world."""
    file = CONFIG / f"scenes/{name}.yaml"
    entries = {**read_mapping(file), **sections}
    tree = ElementTree.parse(file.parent / entries["robot"]["urdf"]).getroot()
    carried = {child.get("link") for child in tree.iter("child")}
    (root,) = (link.get("name") for link in tree.iter("link") if link.get("name") not in carried)
    ElementTree.SubElement(tree, "link", {"name": "mount"})
    fixed = ElementTree.SubElement(tree, "joint", {"name": "bolts", "type": "fixed"})
    ElementTree.SubElement(fixed, "parent", {"link": "mount"})
    ElementTree.SubElement(fixed, "child", {"link": root})
    ElementTree.SubElement(fixed, "origin", {"xyz": " ".join(map(repr, place)), "rpy": "0 0 0.3"})
    entries["robot"] = {key: v for key, v in entries["robot"].items() if key != "urdf"}
    entries["constraints"] = [
        {**one, "position": [a + b for a, b in zip(one["position"], place, strict=True)]}
        if "position" in one
        else one
        for one in entries.get("constraints", [])
    ]
    return scene_from(entries, urdf=ElementTree.tostring(tree, encoding="unicode"))


def consistent(scene, seed):
    """A state in motion that the constraints of a scene allow."""
    system, rng = scene.system(), np.random.default_rng(seed)
    nv = scene.robot.model.nv
    q = pin.integrate(system.model, scene.initial.q, 0.1 * rng.normal(size=nv))
    return system.expand(assemble(system, system.reduce(State(0.0, q, rng.normal(size=nv)))))


def away(found, expected):
    """Largest difference of two vectors, relative to the second one."""
    size = np.abs(expected).max(initial=0.0)
    return float(np.abs(found - expected).max(initial=0.0)) / (size or 1.0)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("case", CASES)
def test_accelerations_and_forces_do_not_depend_on_the_mount(case, place):
    home = mounted(*CASES[case], (0.0, 0.0, 0.0))
    far = mounted(*CASES[case], place)
    ours, theirs = far.system(), home.system()
    for seed in range(3):
        x = consistent(home, seed)
        expected, found = theirs.evaluate(x), ours.evaluate(x)
        assert away(found.a, expected.a) <= 1e-12
        assert away(found.lam, expected.lam) <= 1e-12
        pulls = wrenches_of(ours, x, found.lam), wrenches_of(theirs, x, expected.lam)
        for pull, known in zip(*pulls, strict=True):
            assert away(pull.force, known.force) <= 1e-12
            assert pull.point + far.robot.origin == pytest.approx(known.point + place, abs=1e-11)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("case", ["forces", "reduced", "mimic", "loop", "loop to the ground"])
def test_inverse_dynamics_does_not_depend_on_the_mount(case, place):
    home = mounted(*CASES[case], (0.0, 0.0, 0.0))
    far = mounted(*CASES[case], place)
    x, rng = consistent(home, 5), np.random.default_rng(6)
    if home.has_loops:
        x, a = home.closed_loop().project_motion(x, rng.normal(size=len(x.v)))
        expected, found = home.closed_loop().solve(x, a), far.closed_loop().solve(x, a)
    else:
        y = home.system().reduce(x)
        a = rng.normal(size=len(y.v))
        expected = home.inverse_dynamics().solve(y.q, y.v, a)
        found = far.inverse_dynamics().solve(y.q, y.v, a)
    assert away(found.tau, expected.tau) <= 1e-12
    assert away(found.multipliers, expected.multipliers) <= 1e-12


MOMENTS = (0.1, 0.2, 0.3)  # kg·m^2
SPIN = (0.01, 4.0, 0.02)  # rad/s, about the intermediate axis: it flips, close to gimbal lock


@functools.cache
def tumbled(duration, order=20, step=0.05):
    """Rotation and angular velocity in body axes, by Taylor series in extended precision.

    Euler's equations w' = c (w2 w3, w3 w1, w1 w2) and Q' = Q (w, 0) / 2 of a unit quaternion.
    """
    a, b, c = MOMENTS
    factor = np.array([(b - c) / a, (c - a) / b, (a - b) / c], dtype=np.longdouble)
    w, Q = np.array(SPIN, dtype=np.longdouble), np.array([0, 0, 0, 1], dtype=np.longdouble)
    for _ in range(round(duration / step)):
        ws, Qs = [w], [Q]
        for k in range(order):
            pairs = [(ws[i], ws[k - i]) for i in range(k + 1)]
            turn = sum(np.array([u[1] * s[2], u[2] * s[0], u[0] * s[1]]) for u, s in pairs)
            bent = sum(
                np.append(P[3] * s + np.cross(P[:3], s), -P[:3].dot(s))
                for P, s in zip(Qs, reversed(ws), strict=True)
            )
            ws.append(factor * turn / (k + 1))
            Qs.append(bent / (2 * (k + 1)))
        powers = np.array([np.longdouble(step) ** k for k in range(order + 1)])[:, None]
        w, Q = (powers * ws).sum(axis=0), (powers * Qs).sum(axis=0)
    x, y, z, r = (float(component) for component in Q)
    return pin.Quaternion(r, x, y, z).matrix(), w.astype(float)


def rotor(place, base):
    """A free rotor through three hinges, or as a floating base."""
    body = link("rotor", 1.0, (0.0, 0.0, 0.0), np.diag(MOMENTS))
    if base == "floating":
        return read_robot(f"<robot name='r'>{body}</robot>", base=base, gravity=(0, 0, 0))
    axes, names = np.eye(3)[::-1], ("world", "outer", "inner", "rotor")
    hinges = [
        joint(f"h{i}", "continuous", names[i : i + 2], place if i == 0 else (0, 0, 0), axis=axis)
        for i, axis in enumerate(axes)
    ]
    massless = [f'<link name="{name}"/>' for name in names[1:3]]
    return read_robot(robot(*hinges, *massless, body), gravity=(0, 0, 0))


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (7.0, -5.0, 2.0), (100.0, 100.0, 0.0)])
def test_free_rotor_through_gimbal_lock_for_ten_seconds(base, place):
    body = rotor(place, base)
    system, start = free_system(body), body.neutral()
    v = np.array(SPIN[::-1]) if base == "fixed" else np.array([0.0, 0.0, 0.0, *SPIN])
    if base == "floating":
        start[:3] = place
    integrator = Dop853(tolerance=1e-13)
    simulation = Simulation(system, integrator, NoStabilization(), 0.1)
    *_, end = simulation.run(State(0.0, start, v), 10.0)
    data, frame = body.model.createData(), body.frame("rotor")
    pin.forwardKinematics(body.model, data, end.q, end.v)
    found = pin.updateFramePlacement(body.model, data, frame).rotation
    spin = pin.getFrameVelocity(body.model, data, frame, pin.LOCAL).angular
    rotation, expected = tumbled(10.0)
    assert np.abs(found - rotation).max() <= 1e-9
    assert np.abs(spin - expected).max() <= 1e-9
