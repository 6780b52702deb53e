"""Random scenes as expressions, beside the plain tier and beside complex steps."""

import numpy as np
import pytest
from complex_steps import slopes
from traced_scenes import EXACT, called, conditions, states, tangent

from mbd_ros.applications.report.stability.scene_text import load
from mbd_ros.applications.report.stability.scenes import random_scene
from mbd_ros.compiled.symbols.trace import trace
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.thresholds import NEAR_TOGGLE

BODY = {"shape": {"box": [0.1, 0.2, 0.3]}, "mass": 1.5, "pose": {"xyz": [0.4, -0.7, 1.1]}}
ENDS = ("frame", "frame_a", "frame_b", "plane_frame")
ROOT = (2.0, [0.1, 0.0, 0.05], np.diag([0.02, 0.03, 0.04]))  # of a free base, without mass else
SECOND = "package://mbd_ros/config/robots/prosthetic_leg.urdf"


def scene_of(seed):
    """A random mechanism, with drives, loads on points, free bodies and a far origin at times."""
    scene, rng = load(random_scene(seed)).scene, np.random.default_rng([7, seed])
    rigid = [e for e in scene.entries.get("constraints") or () if not e.get("smoothed")]
    links = [f"b{i}" for i in range(len(scene.robot.joints))]
    names = [joint.name for joint in scene.robot.joints]
    frame, joint = str(rng.choice(links)), str(rng.choice(names))
    forces = list(scene.entries.get("forces") or ())
    chosen = rng.random(6) < 0.4
    point, force = rng.normal(size=(2, 3)).round(3).tolist()
    axes = str(rng.choice(["world", "frame"]))
    if chosen[0]:
        wrench = {"frame": frame, "force": force, "torque": point, "point": force}
        forces.append({"type": "applied_wrench", **wrench, "expressed_in": axes})
    if chosen[1]:
        ends = {"frame_a": "world", "frame_b": frame, "point_a": point, "point_b": [0.1, 0.2, 0.3]}
        forces.append({"type": "point_spring", **ends, "stiffness": 80.0, "damping": 2.0})
    if chosen[2]:
        ends = [{"frame": "world", "xyz": point}, {"frame": frame, "xyz": [0.05, 0.0, 0.1]}]
        path = {"points": ends, "joints": {joint: [0.0, 0.1, 0.02]}}
        forces.append({"type": "cable", "path": path, "stiffness": 200.0, "slack_length": 0.4})
    more = {"constraints": rigid or None, "forces": forces or None}
    if chosen[3]:
        drive = {"type": "series_elastic_drive", "joint": joint, "stiffness": 300.0}
        more["actuators"] = [{**drive, "rotor_inertia": 1e-4, "ratio": 50.0, "damping": 0.4}]
    elif chosen[4]:
        motor = {"type": "geared_motor", "joint": joint, "ratio": -30.0, "rotor_inertia": 1e-5}
        more["actuators"] = [{**motor, "efficiency": 0.8, "viscous": 1e-5, "limit": 0.5}]
    return scene.with_(**more)


def elsewhere(seed):
    """The same mechanism, turned, 100 m away or on a free base, or with a body or a second robot.

    Rows that hold it to the world stay behind, its pose would break them.
    """
    scene, rng = scene_of(seed), np.random.default_rng([8, seed])
    given, n = dict(scene.entries["robot"]), seed % 4
    far = (100.0 * rng.choice([-1.0, 1.0], 3)).tolist()
    given["pose"] = {"xyz": far, "rpy": rng.uniform(-3.0, 3.0, 3).round(3).tolist()}
    given["gravity"] = (9.81 * rng.choice([-0.6, 0.48, 0.64], 3)).round(4).tolist()
    given["base"] = "floating" if n in (1, 3) else "fixed"
    rows = scene.entries.get("constraints") or ()
    rows = [row for row in rows if "world" not in [row.get(key) for key in ENDS]]
    more = {"robot": given, "constraints": rows or None}
    if n in (2, 3):
        more["bodies"] = {"box": BODY}
    if n == 2:
        more["robots"] = {"second": {"urdf": SECOND, "pose": {"xyz": far[::-1]}}}
        tie = {"type": "point_spring", "frame_a": "box", "frame_b": "b0", "stiffness": 40.0}
        more["forces"] = [*(scene.entries.get("forces") or ()), tie]
    moved = scene.with_(**more)
    return moved.with_inertias({"world": ROOT}) if given["base"] == "floating" else moved


def is_regular(system, y):
    """Whether rows are independent enough for their multipliers."""
    if not system.bilateral.rows:
        return True
    return system.bilateral.factor_at(y.t, system.expand(y).q).condition < 0.03 * NEAR_TOGGLE


def check(seed):
    compare(scene_of(seed).system(), seed)


def compare(system, seed):
    traced, model = trace(system), system.chart.model
    try:
        traced.function("multipliers")
    except Untraceable as error:
        assert "singular in every state" in str(error)
        found = [conditions(system, y) for y, _ in states(system, 2, patience=8)]
        assert found and min(found) > 1e12  # the plain tier finds no rank there either
        return
    for y, u in states(system, 2, patience=8):
        expected = system.evaluate(system.expand(y), u)
        a, lam = called(traced.function("multipliers"), y, u)
        _, zdot, health = called(traced.function("accelerate"), y, u)
        condition = conditions(system, y)
        bound = EXACT * max(1.0, condition / 100.0)
        if not health.item() > traced.least_health:
            assert condition > 1e6  # what hands over to the plain tier has a reason
            continue
        size = max(np.abs(expected.a).max(), weight(system, y, expected.lam))
        assert np.abs(a - expected.a).max() <= bound * size, seed
        np.testing.assert_allclose(zdot, expected.zdot, rtol=1e-12, atol=1e-12)
        if len(expected.lam) and is_regular(system, y):
            most = max(np.abs(expected.lam).max(), 1.0)
            assert np.abs(lam - expected.lam).max() <= bound * most, seed
        given = np.array([y.t]), y.q, y.v, y.z, u, np.zeros(0)
        found = [np.array(one) for one in traced.function("derivatives")(*given)]
        for by, got in enumerate(found, 1):
            with np.errstate(all="ignore"):
                steps = slopes(traced.function("accelerate"), by, *given)[: traced.nv + traced.nz]
            if by == 1 and model.nq > model.nv:
                steps = steps @ tangent(model, y.q)
            known = np.isfinite(steps)  # not where a branch that is not taken divides by zero
            most = max(np.abs(steps[known]).max(initial=0.0), 1e-3 * size)
            error = np.abs(got - steps)[known].max(initial=0.0)
            assert error <= max(1e-9, bound) * most, (seed, by)


def weight(system, y, lam):
    """Size of the accelerations that cancel in the sum: of a free fall, and of the rows."""
    falls = float(np.linalg.norm(system.model.gravity.linear))
    if not system.bilateral.rows:
        return falls
    M, J = np.array(system.mass(y.q).dense), system.bilateral.jacobian(y.t, y.q)
    return max(falls, np.abs(np.linalg.solve(M, J.T @ lam)).max())


@pytest.mark.parametrize("block", [0, *(pytest.param(k, marks=pytest.mark.soak) for k in (1, 2))])
def test_random_scenes_are_those_of_the_plain_tier(block):
    for seed in range(8 * block, 8 * block + 8):
        check(seed)


@pytest.mark.parametrize("block", range(2))
def test_random_scenes_elsewhere_are_those_of_the_plain_tier(block):
    for seed in range(4 * block, 4 * block + 4):
        compare(elsewhere(seed).system(), seed)


@pytest.mark.soak
@pytest.mark.parametrize("block", range(20))
def test_many_random_scenes_elsewhere_are_those_of_the_plain_tier(block):
    for seed in range(10 * block, 10 * block + 10):
        compare(elsewhere(seed).system(), seed)


@pytest.mark.soak
@pytest.mark.parametrize("block", range(50))
def test_many_random_scenes_are_those_of_the_plain_tier(block):
    for seed in range(10 * block, 10 * block + 10):
        check(seed)
