"""Steps between states, on flat and on curved configurations."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.core.dynamics.chart import Chart, chart_of
from mbd_ros.core.state import State


def model(*kinds):
    """Joints one after another, none of them on the other."""
    made = pin.Model()
    for i, kind in enumerate(kinds):
        made.addJoint(0, kind, pin.SE3.Identity(), f"joint{i}")
    return made


FREE, HINGE, SLIDE = pin.JointModelFreeFlyer, pin.JointModelRX, pin.JointModelPY
MODELS = {
    "flat": model(HINGE(), SLIDE(), HINGE()),
    "base": model(FREE(), HINGE(), HINGE()),
    "body": model(HINGE(), FREE(), SLIDE(), FREE()),
}


def state(chart_model, seed, nz=0):
    rng = np.random.default_rng(seed)
    q = pin.integrate(
        chart_model, pin.neutral(chart_model), rng.uniform(-1.0, 1.0, chart_model.nv)
    )
    return State(0.5, q, rng.normal(size=chart_model.nv), rng.normal(size=nz), (1, 0))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("nz", [0, 2])
def test_minus_undoes_plus_and_plus_minus(name, nz):
    """d covers q, v and z; time and mode are those of the state it starts from."""
    chart, rng = Chart(MODELS[name]), np.random.default_rng(3)
    x0, x1 = (state(MODELS[name], seed, nz) for seed in (1, 2))
    d = rng.uniform(-0.5, 0.5, 2 * chart.nv + nz)
    moved = chart.plus(x0, d)
    assert chart.minus(moved, x0) == pytest.approx(d, abs=1e-12)
    again = chart.plus(x0, chart.minus(x1, x0))
    assert pin.isSameConfiguration(MODELS[name], again.q, x1.q, 1e-12)
    assert again.v == pytest.approx(x1.v, abs=1e-12)
    assert again.z == pytest.approx(x1.z, abs=1e-12)
    assert (moved.t, moved.mode) == (x0.t, x0.mode)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("size", [1e-3, 1.0])
def test_the_rate_of_a_step_is_that_of_the_difference(name, size):
    """Central differences of q0 (+) dq while q moves with v, free bodies anywhere."""
    chart, rng = Chart(MODELS[name]), np.random.default_rng(5)
    q0 = state(MODELS[name], 1).q
    dq, v = size * rng.uniform(-1.0, 1.0, chart.nv), rng.normal(size=chart.nv)
    q, h = chart.integrate(q0, dq), 1.0e-5
    ahead, behind = (chart.difference(q0, chart.integrate(q, way * v)) for way in (h, -h))
    assert chart.rate(dq, v) == pytest.approx((ahead - behind) / (2.0 * h), abs=1e-8)


def test_the_chart_of_some_coordinates_moves_them_as_the_whole_one():
    whole, some = MODELS["body"], [*range(1, 7), 7]
    rng = np.random.default_rng(7)
    q, dq = state(whole, 4).q, rng.uniform(-1.0, 1.0, whole.nv)
    chart, at = chart_of(whole, some), np.arange(1, 9)
    dq[np.setdiff1d(np.arange(whole.nv), some)] = 0.0
    moved = chart.integrate(q[at], dq[some])
    assert (chart.nq, chart.nv, chart.is_flat) == (8, 7, False)
    assert np.array_equal(moved, Chart(whole).integrate(q, dq)[at])
