"""Benchmark scenes are the published mechanisms: loops, masses and springs.

Checked by Pinocchio alone, with formulas for the constraints of its own.
"""

import math

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT
from scene_geometry import Mechanism
from scipy.linalg import eigh

from mbd_ros.applications.report.precision.reference_problems import PROBLEMS, reference
from mbd_ros.core.state import State

CONFIG = ROOT / "config"
BY_NAME = {problem.name: problem for problem in PROBLEMS}


def benchmark(name):
    return Mechanism(CONFIG / f"scenes/benchmark/{name}.yaml")


def bricard(t, xyz):
    """Joint angles from the place of joint 3: (1 + sin th1)(1 + sin th2) = 1, alternating."""
    x, y, z = xyz
    first = math.atan2(-z, x)
    second = math.atan2(1 / (1 + math.sin(first)) - 1, -y)
    return {f"theta_{i}": first if i % 2 else second for i in range(1, 7)}


def four_bars(t, xy):
    phi, count = math.atan2(*xy), 41
    angles = {f"crank_{i}": phi for i in range(count)}
    return angles | {f"coupler_{i}": -phi for i in range(count - 1)}


def car_axis(t, y):
    slider = 0.1 * math.sin(10 * t)
    masses = dict(zip(("left_x", "left_y", "right_x", "right_y"), y[:4], strict=True))
    return {"bar": math.asin(slider), "slider": slider, **masses}


def chained(*names):
    def joints(t, angles):
        return dict(zip(names, np.diff(angles, prepend=0.0), strict=True))

    return joints


def platform(offset):
    def joints(t, theta):
        return {"x": math.sin(theta[0]) + offset, "y": -math.cos(theta[0])}

    return joints


ANDREWS = ("q1", "q2", "q3", "q4", "q5", "q6", "q7")
FOUR_BARS_2 = [f"{kind}_{i}" for i in range(3) for kind in ("crank", "coupler")][:-1]
CONFIGURATIONS = {  # scene -> time and reference outputs -> position of every joint
    "a01_pendulum": lambda t, xy: {"hinge": math.atan2(xy[0], -xy[1])},
    "a01_pendulum_maximal": lambda t, xy: dict(zip("xy", xy, strict=True)),
    "a02_four_bars_2": lambda t, xy: {n: four_bars(t, xy)[n] for n in FOUR_BARS_2},
    "a02_four_bars_40": four_bars,
    "ts_andrews": lambda t, q: dict(zip(ANDREWS, q, strict=True)),
    "a04_bricard": bricard,
    "ts_car_axis": car_axis,
    "p01_spherical_pendulum": lambda t, xyz: dict(zip("xyz", xyz, strict=True)),
    "x01_light_outer": chained("joint_1", "joint_2"),
    "x02_four_bar_1e-2": chained("crank", "coupler", "rocker"),
    "x02_four_bar_1e-4": chained("crank", "coupler", "rocker"),
    "x02_four_bar_1e-6": chained("crank", "coupler", "rocker"),
    "x07_light_tip": chained("joint_1", "joint_2", "joint_3"),
    "x09_cranks": platform(0.0),
    "x09_cranks_offset": platform(0.25),
}


@pytest.mark.parametrize("problem", PROBLEMS, ids=lambda problem: problem.name)
def test_mechanism_starts_closed(problem):
    """1e-15: the given angles are rounded to 2e-16 of angles up to pi/2."""
    mechanism = benchmark(problem.name)
    q, v = mechanism.start()
    assert max(mechanism.gaps(0.0, q), default=0.0) <= 1e-15
    h = 1e-6  # and goes on so: the gap of a velocity that leaves it would be of the order of h
    assert max(mechanism.gaps(h, q + h * v), default=0.0) <= 100 * h * h


@pytest.mark.parametrize("name", CONFIGURATIONS)
def test_reference_motion_stays_on_the_constraints(name):
    """The reference of x02 is good to 1e-12, angles of Andrews' crank are large."""
    problem, mechanism = BY_NAME[name], benchmark(name)
    known = reference(problem.reference)
    for t, outputs in zip(known.times, known.values, strict=True):
        q = mechanism.vector(CONFIGURATIONS[name](t, outputs))
        assert max(mechanism.gaps(t, q), default=0.0) <= 3e-12
        computed = problem.outputs(mechanism.robot, State(t, q, np.zeros_like(q)))
        places = 4 if name == "ts_car_axis" else len(outputs)  # then come velocities
        assert computed[:places] == pytest.approx(outputs[:places], abs=1e-12)


@pytest.mark.parametrize(
    "problem",
    [p for p in PROBLEMS if reference(p.reference).energy is not None],
    ids=lambda p: p.name,
)
def test_energy_at_the_start_is_the_published_one(problem):
    """Masses, centres, inertias and springs together; tiny stand-in inertias stay below 1e-14."""
    mechanism = benchmark(problem.name)
    energy = reference(problem.reference).energy
    assert mechanism.energy(*mechanism.start()) == pytest.approx(energy, rel=1e-14, abs=2e-15)


def test_governor_has_the_published_angular_momentum():
    mechanism = benchmark("a05_governor")
    momentum = pin.computeCentroidalMomentum(mechanism.model, mechanism.data, *mechanism.start())
    assert momentum.angular[2] == pytest.approx(53.868998658418434, rel=1e-14)


def test_hanging_chain_has_the_frequencies_of_bernoulli():
    """omega^2 l/g are the zeros of the Laguerre polynomial of degree 100 (D. Bernoulli).

    The slow half comes from the mass matrix and the fast one from its inverse: an eigenvalue
    solver is precise relative to the largest value.
    """
    chain, zero = benchmark("x06_chain"), np.zeros(100)
    stiffness = pin.computeGeneralizedGravityDerivatives(chain.model, chain.data, zero)
    mass = pin.crba(chain.model, chain.data, zero, pin.Convention.WORLD).copy()
    pin.computeMinverse(chain.model, chain.data, zero)
    compliance = np.triu(chain.data.Minv) + np.triu(chain.data.Minv, 1).T
    root = np.linalg.cholesky(stiffness)
    slow = eigh(stiffness, mass, eigvals_only=True)[:50]
    fast = np.linalg.eigvalsh(root.T @ compliance @ root)[50:]
    zeros = np.polynomial.laguerre.laggauss(100)[0]
    found = np.sqrt(np.concatenate([slow, fast]) * 0.01 / 9.81)
    assert found == pytest.approx(np.sqrt(zeros), rel=1e-10)
