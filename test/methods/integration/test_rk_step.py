"""The explicit Runge-Kutta step from its tableau, and all steps that compute the same."""

import numpy as np
import pytest
from places import ROOT
from scipy.integrate._ivp import rk

from mbd_ros.api import load_scene
from mbd_ros.core.state import State
from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.linear_motion import LinearMotion, runge_kutta_growth
from mbd_ros.methods.integration.runge_kutta import RK4, rk_step
from mbd_ros.parts.integrators.dopri5 import Dopri5

ROUNDING = 1.0e-12
TABLEAUS = {"rk4": RK4, "dopri5": Dopri5.tableau, "dop853": DOP853}
SCIPY = {"dopri5": rk.RK45, "dop853": rk.DOP853}
SCENES = ["arm7", "prosthetic_leg", "four_bar_leg", "free_flyer"]


def one_step(system, tableau, y, h):
    """The state after a step, as its page says."""
    s = tableau.stages
    A = [row[:i] for i, row in enumerate(tableau.a[: s + 1])]
    accelerate, K = system.accelerator(), np.zeros((s, 2 * system.nv))
    K[0, : system.nv] = y.v
    accelerate(y.t, y.q, y.v, None, K[0, system.nv :])
    c = tableau.a.sum(axis=1).tolist()
    return rk_step(accelerate, system.chart, A, c, y, None, h, K)


def assert_same(found, expected):
    for a, b in zip(found, expected, strict=True):
        assert np.abs(a - b).max() <= ROUNDING * (1.0 + np.abs(b).max())


def started(name, integrator, **solver):
    scene = load_scene(SCENES_AT / f"{name}.yaml")
    simulation = scene.simulation(integrator={"type": integrator}, **solver)
    return simulation, simulation.start(scene.initial._replace(v=0.3 + scene.initial.v))


SCENES_AT = ROOT / "config/scenes"


@pytest.mark.parametrize("method", TABLEAUS)
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("solver", ["plain", "compiled"])
def test_steppers_take_the_step(method, name, solver):
    simulation, y = started(name, method, solver={"type": solver})
    h = simulation.dt
    after = simulation.stepper.step(y, None, y.t + h)
    plain, _ = started(name, method, solver={"type": "plain"})
    expected = one_step(plain.system, TABLEAUS[method], y, h)
    assert_same((after.q, after.v), expected)


@pytest.mark.parametrize("method", SCIPY)
def test_scipy_takes_the_step(method):
    simulation, y = started("arm7", method)
    system, h, n = simulation.system, simulation.dt, simulation.system.nv
    accelerate, a = system.accelerator(), np.zeros(n)

    def rates(t, x):
        accelerate(t, x[:n], x[n:], None, a)
        return np.concatenate((x[n:], a))

    start, of = np.concatenate((y.q, y.v)), SCIPY[method]
    K = np.empty((of.n_stages + 1, 2 * n))
    x, _ = rk.rk_step(rates, y.t, start, rates(y.t, start), h, of.A, of.B, of.C, K)
    assert_same((x[:n], x[n:]), one_step(system, TABLEAUS[method], y, h))


@pytest.mark.parametrize("method", TABLEAUS)
def test_its_stability_function_is_that_of_the_step(method):
    """A linear oscillation grows in a step as R(lambda h) says."""

    class Oscillator:
        nv = 1

        class chart:
            integrate = staticmethod(np.add)
            rate = staticmethod(lambda dq, v: v)

        @staticmethod
        def accelerator():
            def write(t, q, v, u, out):
                out[...] = -q

            return write

    h, steps = 0.7, []
    for q, v in np.eye(2):
        steps.append(one_step(Oscillator, TABLEAUS[method], State(0.0, q[None], v[None]), h))
    growth = np.abs(np.linalg.eigvals(np.array(steps)[:, :, 0])).max()
    motion = LinearMotion(np.array([[-1.0]]), np.array([[0.0]]))
    assert growth == pytest.approx(runge_kutta_growth(TABLEAUS[method], motion, h), rel=1e-12)
