"""Gauss-Legendre and generalized-alpha: order, symmetry, stiffness, constraints, refusals."""

import math

import numpy as np
import pinocchio as pin
import pytest
from row_systems import (
    BODY,
    PIN,
    POINT,
    advance,
    away,
    floating,
    flow_derivative,
    joint,
    leg,
    link,
    pinned_bar,
    reference,
    returned,
    robot,
    sphere,
    spherical_pendulum,
    symplectic_defect,
)
from systems import free_system

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, ModelError
from mbd_ros.methods.integration.newton import FAILED, converge
from mbd_ros.parts.constraints.joint_stop import JointStop
from mbd_ros.parts.integrators.gauss_legendre import GaussLegendre
from mbd_ros.parts.integrators.generalized_alpha import GeneralizedAlpha
from mbd_ros.parts.integrators.rattle import Rattle
from mbd_ros.parts.integrators.shake import Shake

GAUSS = [GaussLegendre(stages=k) for k in (1, 2, 3)]
SLIDER = robot(
    *(link("world"), link("mass", 2.0)), joint("slide", "prismatic", "world", "mass", "1 0 0")
)
DOUBLE = robot(
    link("world"),
    link("upper", 1.0, "0 0 -0.5", (0.1, 0.1, 0.1)),
    link("lower", 1.0, "0 0 -0.5", (0.1, 0.1, 0.1)),
    joint("a", "revolute", "world", "upper", "0 1 0"),
    joint("b", "revolute", "upper", "lower", "0 1 0"),
)


class Spring(Load):
    """Linear spring and damper in every joint, and an energy k3 |q|^4 / 4 that couples them."""

    def __init__(self, stiffness=0.0, damping=0.0, hardening=0.0):
        self.stiffness, self.damping, self.hardening = stiffness, damping, hardening

    def force(self, k, x, u):
        return -self.damping * x.v - (self.stiffness + self.hardening * x.q.dot(x.q)) * x.q


def slider(stiffness, damping):
    return free_system(SLIDER, (Spring(stiffness, damping),))


@pytest.mark.parametrize("scene", [leg, floating])
@pytest.mark.parametrize(
    ("method", "dt"),
    [
        *((GAUSS[0], 0.01), (GAUSS[1], 0.02), (GAUSS[2], 0.04)),
        *((GeneralizedAlpha(), 0.005), (Rattle(), 0.005), (Shake(), 0.005)),
    ],
)
def test_observed_order_against_an_independent_solver(scene, method, dt):
    """0.2 s, so far from rounding at the largest step: errors 1e-3 .. 1e-11."""
    system, x = scene()
    exact = reference(system, x, 0.2)
    coarse, fine = (
        away(system, advance(method.prepare(system, h), x, 0.2), exact) for h in (dt, dt / 2)
    )
    assert math.log2(coarse / fine) == pytest.approx(method.order, abs=0.3)


@pytest.mark.parametrize("scene", [leg, floating, sphere])
@pytest.mark.parametrize("method", [*GAUSS, Shake()])
def test_reversed_motion_returns_to_its_start(scene, method):
    """Rounding of 100 steps; one step comes first, since SHAKE has velocities of its own."""
    system, x = scene()
    x = method.prepare(system, 0.01).step(x, None)
    assert returned(method, system, x, 0.01, 50) < 2e-12


@pytest.mark.parametrize("method", [*GAUSS, Rattle(), Shake()])
def test_symplectic_where_the_masses_are_constant(method):
    """Differences of a step of 0.05 s leave 1e-8 of the third derivative."""
    system = free_system(POINT, (Spring(3.0, hardening=20.0),))
    x = State(0.0, np.array([0.5, -0.3, 0.2]), np.array([1.0, 0.4, -2.0]))
    S = flow_derivative(method, system, x, 0.05)
    assert symplectic_defect(S) < 1e-8
    assert np.abs(S - np.eye(6)).max() > 0.05


@pytest.mark.parametrize(
    ("method", "dt", "largest"),
    [(GAUSS[0], 0.005, 2e-5), (GAUSS[1], 0.02, 1e-7), (Rattle(), 0.01, 1e-3)],
)
def test_energy_of_reversible_motion_does_not_drift(method, dt, largest):
    """A double pendulum, whose masses turn: the last quarter is no worse than the first."""
    system = free_system(DOUBLE)
    x = State(0.0, np.array([1.0, -0.6]), np.array([0.0, 1.0]))
    start, stepper, errors = system.energy(x), method.prepare(system, dt), []
    for _ in range(8000):
        x = stepper.step(x, None)
        errors.append(abs(system.energy(x) - start))
    first, last = max(errors[:2000]), max(errors[-2000:])
    assert first < largest
    assert last < 1.05 * first


@pytest.mark.parametrize(
    ("method", "error"), [(GAUSS[0], 4e-5), (GAUSS[1], 2e-9), (GAUSS[2], 1e-11)]
)
def test_stiff_damper_at_a_long_step(method, error):
    """x'' + 8002 x' + 16000 x = 0 from its slow mode: exp(-2 t); rates -2 and -8000, dt 1e-2."""
    x = State(0.0, np.array([1.0]), np.array([-2.0]))
    y = advance(method.prepare(slider(32000.0, 16004.0), 0.01), x, 1.0)
    assert y.q[0] == pytest.approx(math.exp(-2.0), abs=error)


@pytest.mark.parametrize("method", [*GAUSS, GeneralizedAlpha()])
def test_fast_mode_decays_at_a_long_step(method):
    system, x = slider(32000.0, 16004.0), State(0.0, np.array([0.0]), np.array([100.0]))
    stepper, speeds = method.prepare(system, 0.01), []
    for _ in range(200):
        x = stepper.step(x, None)
        speeds.append(abs(x.v[0]))
    assert max(speeds) < 100.0
    assert max(speeds[-20:]) < 1.0


@pytest.mark.parametrize("radius", [0.0, 0.5, 0.9])
def test_spectral_radius_at_infinite_frequency(radius):
    """w dt = 1e3, so to 1e-6: a recurrence with the triple root -rho (Chung, Hulbert 1993)."""
    system, x, q = slider(2e10, 0.0), State(0.0, np.array([1.0]), np.zeros(1)), []
    stepper = GeneralizedAlpha(spectral_radius=radius).prepare(system, 0.01)
    for _ in range(6):
        x = stepper.step(x, None)
        q.append(x.q[0])
    for a, b, c, d in zip(q, q[1:], q[2:], q[3:], strict=False):
        left = d + 3 * radius * c + 3 * radius**2 * b + radius**3 * a
        assert abs(left) < 1e-5


@pytest.mark.parametrize("pendulum", [spherical_pendulum, lambda: spherical_pendulum(copies=2)])
def test_generalized_alpha_keeps_positions_and_is_second_order(pendulum):
    """P01_SPHERE at t = 1 s, closed form; a redundant row changes nothing."""
    exact = np.array([-0.7784218868194532, -0.2937694096784796, -0.5547602185247243])
    system, x = pendulum(), sphere()[1]
    errors = []
    for dt in (0.01, 0.005):
        y = advance(GeneralizedAlpha().prepare(system, dt), x, 1.0)
        assert np.abs(system.residual(1.0, y.q)).max() < 1e-14
        errors.append(np.abs(y.q - exact).max())
    assert errors[0] < 2e-3
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.1)


def test_generalized_alpha_is_well_conditioned_at_small_steps():
    """Without scaling the condition would grow as 1 / dt^2, by 1e8 here."""
    conditions = []
    for dt in (1e-2, 1e-6):
        system = pinned_bar()
        x, stepper = (
            State(0.0, PIN.at(1.0), np.zeros(3)),
            GeneralizedAlpha().prepare(system, dt),
        )
        for _ in range(20):
            x = stepper.step(x, None)
        assert np.abs(system.residual(x.t, x.q)).max() < 1e-15
        conditions.append(np.linalg.cond(stepper._inverse))
    assert conditions[1] < 2 * conditions[0] < 50


@pytest.mark.parametrize("method", [*GAUSS, GeneralizedAlpha(), Rattle(), Shake()])
def test_last_step_ends_at_the_end(method):
    """The shorter step is one of a stepper with that dt, and steps go on after it."""
    system, x = leg()
    stepper = method.prepare(system, 0.01)
    y = stepper.step(x, None, 0.004)
    assert y.t == 0.004
    assert away(system, y, method.prepare(system, 0.004).step(x, None)) < 1e-13
    stepper.restart()
    assert away(system, stepper.step(x, None), method.prepare(system, 0.01).step(x, None)) < 1e-13
    assert stepper.step(x, None, 0.01 + 1e-15).t == 0.01 + 1e-15


def test_linearization_equals_analytic_derivatives():
    """Forward differences leave 1e-8 of the second derivatives, here 1e-6 of the accelerations."""
    system, x = leg()
    at = system.derivatives(x)
    model, data = system.model, system.model.createData()
    pin.computeABADerivatives(model, data, x.q, x.v, np.zeros(5))
    for ours, exact in ((at.q, data.ddq_dq), (at.v, data.ddq_dv)):
        assert np.abs(ours - exact).max() < 1e-6 * np.abs(data.ddq).max()


def test_iteration_stops_at_rounding_and_fails_when_it_grows():
    def sizes(*values):
        left = iter(values)
        return lambda: next(left, values[-1])

    assert converge(sizes(0.0), 1e-12) == 0.0
    assert converge(sizes(1.0, 1e-3, 1e-6, 1e-9, 1e-12), 1e-10) == pytest.approx(1e-3)
    assert converge(sizes(1.0, 1e-2, 1e-13, 1e-13), 1e-12) == pytest.approx(1e-2)
    for stuck in ((1.0, 1e-2), (1.0, 2.0, 5.0), (1.0, 20.0), (math.nan,)):
        assert converge(sizes(*stuck), 1e-12) == FAILED


class Broken(Load):
    def force(self, k, x, u):
        return np.full(1, math.nan)


@pytest.mark.parametrize("method", [*GAUSS, GeneralizedAlpha(), Rattle(), Shake()])
def test_forces_that_are_not_finite_end_in_a_named_error(method):
    system = free_system(SLIDER, (Broken(),))
    with pytest.raises(DivergedError, match="t = 0 s|forces at t = 0.01 s"):
        method.prepare(system, 0.01).step(State(0.0, np.zeros(1), np.ones(1)), None)


@pytest.mark.parametrize("method", [GeneralizedAlpha(), Rattle(), Shake()])
def test_one_sided_rows_are_refused(method):
    body = robot(*BODY)
    stop = JointStop(body, joint="swing", upper=1.0, smoothed=True)
    system = build_system(body, Couplings(body), [stop], Loads(1))
    with pytest.raises(ModelError, match="rows only, the scene bounds joint_stop.torque;"):
        method.prepare(system, 0.01)


@pytest.mark.parametrize(
    ("method", "values", "message"),
    [
        (GaussLegendre, {"stages": 4}, "stages 4, accepted: 1, 2, 3"),
        (GaussLegendre, {"tolerance": 0.0}, "tolerance 0, accepted: between 0 and 1"),
        (GeneralizedAlpha, {"spectral_radius": 1.0}, "spectral_radius 1, accepted: 0 <= . < 1"),
        (GeneralizedAlpha, {"tolerance": 2.0}, "tolerance 2, accepted: between 0 and 1"),
        (Rattle, {"tolerance": math.nan}, "tolerance nan, accepted: between 0 and 1"),
        (Shake, {"tolerance": -1.0}, "tolerance -1, accepted: between 0 and 1"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(method, values, message):
    with pytest.raises(ModelError) as caught:
        method(**values)
    assert message in str(caught.value)
