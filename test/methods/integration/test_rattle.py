"""RATTLE and SHAKE on constraints: published vectors, closed forms, long runs."""

import math

import numpy as np
import pytest
from row_systems import (
    GRAVITY,
    PIN,
    POINT,
    advance,
    away,
    moving_sphere,
    pinned_bar,
    returned,
    sphere,
    spherical_pendulum,
)
from scipy.special import ellipj
from systems import free_system

from mbd_ros.core.contracts import Load
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError
from mbd_ros.parts.integrators.generalized_alpha import GeneralizedAlpha
from mbd_ros.parts.integrators.rattle import Rattle
from mbd_ros.parts.integrators.shake import Shake

# P01_SPHERE, RATTLE closed form: t = 10 s, q, v, largest energy error [J] on the way
VECTORS = {
    0.01: (
        [0.020750573897981373, 0.777932680592357905, -0.628004902965966396],
        [-1.360974477592567794, -0.940505989183382350, -1.210008621207098961],
        0.0014437070307763986,
    ),
    0.005: (
        [0.021576102459187015, 0.778639190269666112, -0.627100855667467064],
        [-1.360581360857877057, -0.934899368929466284, -1.207629241147723177],
        0.0003609784657491329,
    ),
    0.0025: (
        [0.021782349540912339, 0.778815143061261499, -0.626875188683476530],
        [-1.360482401120230567, -0.933499450151748519, -1.207031359164315714],
        9.024416551618774e-05,
    ),
}
LONG_RUN = 0.0014439425609529266  # largest energy error of 10^6 steps of 0.01 s, same source


def run(method, system, x, dt, steps):
    """Last state, |energy error|, |g| and |J v| of every step."""
    stepper, start, errors = method.prepare(system, dt), system.energy(x), []
    for _ in range(steps):
        x = stepper.step(x, None)
        gap = np.abs(system.residual(x.t, x.q)).max()
        rate = system.jacobian(x.t, x.q).dot(x.v) + system.rate(x.t, x.q)
        errors.append((abs(system.energy(x) - start), gap, np.abs(rate).max()))
    return x, *np.array(errors).T


@pytest.mark.parametrize("dt", VECTORS)
@pytest.mark.parametrize("copies", [1, 2])
def test_published_vectors(dt, copies):
    """1e-12 is their own tolerance; a redundant row changes nothing."""
    q, v, energy = VECTORS[dt]
    _, x = sphere()
    y, energies, gaps, rates = run(Rattle(), spherical_pendulum(copies), x, dt, round(10 / dt))
    assert y.q == pytest.approx(q, abs=1e-12)
    assert y.v == pytest.approx(v, abs=1e-12)
    assert energies.max() == pytest.approx(energy, abs=1e-12)
    assert gaps.max() <= 1e-15
    assert rates.max() <= 1e-14


def test_shake_has_the_positions_of_rattle_and_a_velocity_defect_of_second_order():
    system, x = sphere()
    defects = []
    for dt in (0.01, 0.005):
        y, _, gaps, rates = run(Shake(), system, x, dt, round(2 / dt))
        z = advance(Rattle().prepare(system, dt), x, 2.0)
        assert y.q == pytest.approx(z.q, abs=1e-12)
        assert gaps.max() <= 1e-15
        assert system.jacobian(z.t, z.q).dot(z.v) == pytest.approx([0.0], abs=1e-14)
        defects.append(rates.max())
    assert 1e-4 < defects[0] < 1e-3
    assert defects[0] / defects[1] == pytest.approx(4.0, rel=0.02)


def test_shake_velocities_are_central_differences():
    system, x = sphere()
    stepper, states = Shake().prepare(system, 0.01), [x]
    for _ in range(10):
        states.append(stepper.step(states[-1], None))
    for before, at, after in zip(states, states[1:], states[2:], strict=False):
        assert (after.q - before.q) / 0.02 == pytest.approx(at.v, abs=1e-13)


@pytest.mark.parametrize("method", [Rattle(), Shake()])
def test_shake_and_rattle_do_not_need_their_memory(method):
    """A stepper that restarts before every step takes the same steps, but for rounding."""
    system, x = sphere()
    kept, fresh, y = method.prepare(system, 0.01), method.prepare(system, 0.01), x
    for _ in range(50):
        fresh.restart()
        x, y = kept.step(x, None), fresh.step(y, None)
    assert away(system, x, y) < 1e-12


def test_energy_error_stays_that_of_the_first_steps():
    system, x = sphere()
    _, energies, gaps, rates = run(Rattle(), system, x, 0.01, 20_000)
    assert energies.max() <= LONG_RUN * (1 + 1e-6)
    assert energies[10_000:].max() <= energies[:10_000].max() * (1 + 1e-3)
    assert gaps.max() <= 1e-12
    assert rates.max() <= 1e-12


@pytest.mark.soak
def test_energy_error_of_a_million_steps():
    """The maximum of 10^6 samples exceeds that of the first 10^4 by where the samples fall."""
    system, x = sphere()
    _, energies, gaps, rates = run(Rattle(), system, x, 0.01, 1_000_000)
    assert energies.max() == pytest.approx(LONG_RUN, rel=1e-6)
    assert energies.max() <= energies[:10_000].max() * (1 + 1e-3)
    assert max(gaps.max(), rates.max()) <= 1e-12


@pytest.mark.parametrize("method", [Rattle(), Shake(), GeneralizedAlpha()])
def test_bar_in_maximal_coordinates_swings_as_a_pendulum(method):
    """Released at 1.2 rad: sin(angle / 2) = k cd(w t, k)."""
    system = pinned_bar()
    k, w = math.sin(0.6), math.sqrt(PIN.mass_times_arm * GRAVITY / PIN.inertia)
    _, cn, dn, _ = ellipj(w * 1.0, k * k)
    exact, errors = 2 * math.asin(k * cn / dn), []
    for dt in (0.01, 0.005):
        x = State(0.0, PIN.at(1.2), np.zeros(3))
        x = advance(method.prepare(system, dt), x, 1.0)
        assert np.abs(system.residual(1.0, x.q)).max() < 1e-15
        errors.append(abs(x.q[2] - exact))
    assert errors[0] < 2e-4
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)


def test_rattle_returns_to_its_start():
    system, x = sphere()
    assert returned(Rattle(), system, x, 0.01, 200) < 1e-12
    bar = pinned_bar()
    y = State(0.0, PIN.at(0.4), 1.5 * np.array([0.8 * np.cos(0.4), 0.8 * np.sin(0.4), 1.0]))
    assert returned(Rattle(), bar, y, 0.01, 200) < 1e-12


def test_rows_that_move_with_time_are_kept():
    system = moving_sphere()
    x = State(
        0.0, np.array([0.6, 0.0, -0.8]), np.array([0.0, 1.0, 0.0]) + 0.3 * np.array([0.6, 0, -0.8])
    )
    _, _, gaps, rates = run(Rattle(), system, x, 0.01, 300)
    assert gaps.max() <= 1e-15
    assert rates.max() <= 1e-14


def test_a_step_that_turns_the_rows_far_is_solved_with_fresh_ones():
    """A tenth of a turn in one step; the contraction of the old rows is far from 0.5 there."""
    system, x = sphere()
    fast = State(0.0, x.q, 30.0 * np.array([0.0, 1.0, 0.0]))
    y = Rattle().prepare(system, 0.03).step(fast, None)
    assert np.abs(system.residual(y.t, y.q)).max() < 1e-15
    assert abs(float(y.q.dot(x.q))) < 0.8


@pytest.mark.parametrize("method", [Rattle(), Shake()])
def test_a_step_too_long_for_the_constraints_names_the_row(method):
    system, x = sphere()
    with pytest.raises(DivergedError, match=r"by 10 s .* row distance.force stays"):
        method.prepare(system, 10.0).step(x, None)


class Damper(Load):
    def force(self, k, x, u):
        return -500.0 * x.v


@pytest.mark.parametrize("method", [Rattle(), Shake()])
def test_a_damper_too_stiff_for_iteration_is_named(method):
    """Half a step of 10 ms times 500 1/s is 2.5: the repetition grows."""
    system = free_system(POINT, (Damper(),))
    with pytest.raises(DivergedError, match="depend on the velocity change too much"):
        method.prepare(system, 0.01).step(sphere()[1], None)
