"""Filters against the matrix exponential, faults of the stream, fits against polynomials."""

import math

import numpy as np
import pytest
from scipy.linalg import expm

from mbd_ros.errors import DataError
from mbd_ros.methods.signals.differentiation import (
    CausalDifferentiator,
    LowPass,
    SampleStatus,
    local_polynomials,
)

SECOND, MS = 1_000_000_000, 1_000_000
NAN = np.array([np.nan])


def state_matrix(low_pass, order):
    """Of [y, y', .., u, u'] with (s/w + 1)^order y = u and u' constant."""
    w = order / low_pass.delay
    A = np.diag(np.ones(order - 1), 1)
    A[-1] = [-math.comb(order, k) * w ** (order - k) for k in range(order)]
    A = np.pad(A, (0, 2))
    A[order - 1, order], A[order, order + 1] = w**order, 1.0
    return A


@pytest.mark.parametrize("order", [2, 3])
def test_low_pass_is_exact_for_a_piecewise_linear_signal_with_irregular_stamps(order):
    rng, low_pass = np.random.default_rng(0), LowPass(order, 5.0, 2)
    A = state_matrix(low_pass, order)
    slope = np.array([2.0, -1.0])
    low_pass.start(np.array([0.5, -3.0]), slope)
    y, u = low_pass.state.copy(), np.array([0.5, -3.0])
    assert y[0] == pytest.approx(u - low_pass.delay * slope)
    for step in rng.integers(1000, 80 * MS, 300).tolist() + [7 * MS] * 3 + [2 * SECOND]:
        newest = u + rng.normal(scale=0.1, size=2)
        h = step / SECOND
        y = (expm(A * h) @ np.vstack([y, u, (newest - u) / h]))[:order]
        low_pass.update(newest, step)
        scale = np.abs(y).max() + order / low_pass.delay
        assert low_pass.state == pytest.approx(y, abs=1e-8 * scale)
        u = newest


@pytest.mark.parametrize("order", [2, 3])
def test_low_pass_has_half_power_at_its_cutoff(order):
    low_pass, cutoff, t = LowPass(order, 4.0, 1), 4.0, np.arange(1, 4001) / 2000.0
    low_pass.start(np.zeros(1), 0.0)
    out = []
    for x in np.sin(2 * np.pi * cutoff * t):
        low_pass.update(np.array([x]), SECOND // 2000)
        out.append(low_pass.state[0, 0])
    last = slice(2000, None)  # four whole periods after one second
    basis = np.column_stack([f(2 * np.pi * cutoff * t) for f in (np.sin, np.cos)])[last]
    amplitude = np.linalg.norm(np.linalg.lstsq(basis, np.array(out)[last], rcond=None)[0])
    assert amplitude == pytest.approx(math.sqrt(0.5), rel=1e-4)


@pytest.mark.parametrize("order", [2, 3])
def test_low_pass_settles_to_one_percent_in_the_stated_time(order):
    low_pass = LowPass(order, 3.0, 1)
    low_pass.start(np.zeros(1), 0.0)
    low_pass.update(np.ones(1), 1000)
    low_pass.update(np.ones(1), round(low_pass.settling_time * SECOND))
    assert low_pass.state[0, 0] == pytest.approx(0.99, abs=1e-5)


def causal(limit=(np.inf,), wraps=None, cutoff=5.0, **options):
    limit = np.array(limit)
    wraps = np.zeros(len(limit), dtype=bool) if wraps is None else np.array(wraps)
    return CausalDifferentiator(cutoff=cutoff, velocity_limit=limit, wraps=wraps, **options)


def feed(d, stamps, positions, velocity=NAN):
    return [d.update(t, np.array([x]), velocity) for t, x in zip(stamps, positions, strict=True)]


def irregular(n, seed=1):
    return np.cumsum(np.random.default_rng(seed).integers(MS, 12 * MS, n)).tolist()


def test_ramp_is_followed_at_once_and_a_parabola_with_the_stated_lag():
    d, stamps = causal(), irregular(400)
    for t in stamps:
        d.update(t, np.array([1.0 - 2.0 * t / SECOND]), NAN)
        if t > stamps[0]:
            assert (d.velocity[0], d.acceleration[0]) == pytest.approx((-2.0, 0.0), abs=1e-6)
    d.reset()
    for t in stamps:
        d.update(t, np.array([0.5 * 3.0 * (t / SECOND) ** 2]), NAN)
    assert stamps[-1] / SECOND > 2 * d.settling_time
    assert d.acceleration[0] == pytest.approx(3.0, abs=0.05)
    lagging = 3.0 * (stamps[-1] / SECOND - d.delay)
    assert d.velocity[0] == pytest.approx(lagging, abs=0.02)
    assert d.delay == pytest.approx(3 / (2 * np.pi * 5.0 / math.sqrt(2 ** (1 / 3) - 1)))


def test_velocity_that_is_measured_passes_and_its_derivative_lags_by_the_smaller_delay():
    d, w = causal(), 2 * np.pi
    slow = d.delay
    for t in irregular(600):
        v = np.array([np.sin(w * t / SECOND)])
        d.update(t, np.array([-np.cos(w * t / SECOND) / w]), v)
        assert np.array_equal(d.velocity, v)
    expected = w * np.cos(w * (t / SECOND - d.delay))
    assert d.delay == pytest.approx(2 / (2 * np.pi * 5.0 / math.sqrt(2 ** (1 / 2) - 1)))
    assert d.delay < slow
    assert d.acceleration[0] == pytest.approx(expected, abs=0.1 * w)


def test_velocity_missing_for_some_joints_or_for_a_while_never_shows():
    """Joint 0 is measured, joint 1 never, joint 2 until 1 s; all turn at 1, 2 and 3 rad/s."""
    d, rate = causal([np.inf] * 3), np.array([1.0, 2.0, 3.0])
    for t in irregular(400):
        lost = np.array([False, True, SECOND < t < 1.2 * SECOND])
        d.update(t, rate * t / SECOND, np.where(lost, np.nan, rate))
        assert np.isfinite(d.acceleration).all()
        if t > 13 * MS:
            assert d.velocity == pytest.approx(rate, abs=1e-6)
            assert d.acceleration == pytest.approx(np.zeros(3), abs=1e-3)
    assert d.delay == causal().delay
    d.update(t + 5 * MS, rate * (t + 5 * MS) / SECOND, np.full(3, 99.0))
    assert d.velocity == pytest.approx([99.0, 2.0, 3.0], abs=1e-6)  # once lost, until a reset


def test_spike_is_rejected_and_a_jump_that_stays_is_believed():
    d = causal([2.0], patience=4)
    assert feed(d, range(0, 10 * MS, MS), np.arange(10) * 1e-3) == [SampleStatus.USED] * 10
    before = d.position, d.velocity, d.acceleration
    assert feed(d, [10 * MS], [7.0]) == [SampleStatus.JUMP]
    assert (d.position, d.velocity, d.acceleration) == before
    assert feed(d, [11 * MS], [0.011]) == [SampleStatus.USED]
    assert d.velocity[0] == pytest.approx(1.0, abs=1e-6)
    jumped = feed(d, range(12 * MS, 16 * MS, MS), 7.0 + np.arange(4) * 1e-3)
    assert jumped == [SampleStatus.JUMP] * 3 + [SampleStatus.RESTARTED]
    assert feed(d, [16 * MS, 17 * MS], [1.0, 7.005]) == [SampleStatus.JUMP, SampleStatus.USED]
    assert (d.position[0], d.velocity[0]) == pytest.approx((7.005, 1.0), abs=1e-6)


def test_limit_holds_for_every_joint_and_grows_with_the_time_between_samples():
    d = causal([1.0, np.inf, 1.0])
    none, still = np.full(3, np.nan), np.zeros(3)
    assert d.update(0, still, none) is SampleStatus.USED
    assert d.update(10 * MS, np.array([0.0099, 50.0, 0.0]), none) is SampleStatus.USED
    assert d.update(20 * MS, np.array([0.0099, 0.0, 0.0102]), none) is SampleStatus.JUMP
    assert d.update(30 * MS, np.array([0.0099, 0.0, 0.0102]), none) is SampleStatus.USED


@pytest.mark.parametrize("step", [MS, 2 * MS, 33 * MS])
@pytest.mark.parametrize("is_measured", [True, False])
def test_a_joint_that_really_moves_faster_than_its_limit_is_no_glitch(step, is_measured):
    """It spins up to ten times its limit; an encoder that jumps on the way is still seen."""
    d, limit = causal([2.0]), 2.0
    h = step / SECOND
    t = np.arange(0.0, 200 * h, h)
    ramp = 100 * h
    v = np.where(t < ramp, 10.0 * limit * t / ramp, 10.0 * limit)
    q = np.cumsum(v) * h
    for k in range(200):
        velocity = np.array([v[k] if is_measured else np.nan])
        glitch = np.array([q[k] + 3.0 * limit * h])
        if k == 150:
            assert d.update(k * step, glitch, velocity) is SampleStatus.JUMP
        else:
            assert d.update(k * step, q[k : k + 1], velocity) is SampleStatus.USED
    assert d.velocity[0] == pytest.approx(20.0, rel=0.05)


def test_a_fast_joint_without_velocity_is_believed_once_for_all():
    d = causal([2.0], patience=3)
    assert d.update(0, np.array([0.0]), np.array([np.nan])) is SampleStatus.USED
    assert feed(d, [MS] * 3, [0.02] * 3) == [SampleStatus.JUMP] * 2 + [SampleStatus.RESTARTED]
    assert feed(d, range(2 * MS, 9 * MS, MS), 0.02 * np.arange(2, 9)) == [SampleStatus.USED] * 7


def test_a_first_step_of_a_fast_joint_is_believed_where_its_velocity_is_measured():
    d = causal([2.0])
    assert d.update(0, np.array([0.0]), np.array([20.0])) is SampleStatus.USED
    assert d.update(MS, np.array([0.02]), np.array([20.0])) is SampleStatus.USED
    assert d.update(2 * MS, np.array([0.06]), np.array([20.0])) is SampleStatus.JUMP


def test_two_pi_wrap_is_unwrapped_only_where_the_joint_is_continuous():
    d = causal([50.0, np.inf], wraps=[True, False], cutoff=20.0)
    for t in range(0, 3 * SECOND, 5 * MS):
        angle = 9.0 * t / SECOND
        wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
        assert d.update(t, np.array([wrapped, wrapped]), np.full(2, np.nan)) is SampleStatus.USED
        assert d.position == pytest.approx([angle, wrapped], abs=1e-9)
        if t:
            assert d.velocity[0] == pytest.approx(9.0, abs=1e-6)
    assert d.position[0] > 4 * np.pi


def test_duplicate_old_and_rewound_stamps():
    d = causal(rewind=0.5)
    feed(d, [0, SECOND, 2 * SECOND], [0.0, 1.0, 2.0])
    before = d.velocity.copy(), d.acceleration.copy()
    assert feed(d, [2 * SECOND], [2.0]) == [SampleStatus.DUPLICATE]
    assert feed(d, [2 * SECOND - 1, SECOND + SECOND // 2], [9.0, 9.0]) == [SampleStatus.OLD] * 2
    assert (d.position[0], d.velocity, d.acceleration) == (2.0, *before)
    assert feed(d, [SECOND + SECOND // 2 - 1], [9.0]) == [SampleStatus.RESTARTED]
    assert (d.position[0], d.velocity[0], d.acceleration[0]) == (9.0, 0.0, 0.0)
    assert feed(d, [2 * SECOND], [9.0]) == [SampleStatus.USED]
    d.reset()
    assert feed(d, [0], [5.0]) == [SampleStatus.USED]
    assert d.velocity[0] == 0.0


def test_reset_leaves_no_trace_of_the_past():
    fresh, used, stamps = causal([99.0]), causal([99.0]), irregular(50)
    feed(used, irregular(80, 2), np.random.default_rng(3).normal(scale=0.01, size=80))
    feed(used, [10**12], [0.0], np.array([4.0]))
    used.reset()
    for d in (fresh, used):
        feed(d, stamps, np.sin(np.arange(50) / 9))
    assert np.array_equal(fresh.velocity, used.velocity)
    assert np.array_equal(fresh.acceleration, used.acceleration)


def test_arguments_stay_as_they_were():
    d, position, velocity = causal([9.0], wraps=[True]), np.array([3.1]), np.array([np.nan])
    d.update(0, position, velocity)
    wrapped = np.array([-3.1])
    d.update(10 * MS, wrapped, velocity)
    assert (position[0], wrapped[0]) == (3.1, -3.1)
    assert np.isnan(velocity[0])


@pytest.mark.parametrize("cutoff", [0.0, -1.0, math.nan, math.inf])
def test_cutoff_that_makes_no_sense_is_refused(cutoff):
    with pytest.raises(DataError, match=rf"cutoff {cutoff} Hz must be finite and > 0"):
        causal(cutoff=cutoff)


def shaken(n, seed=4):
    """Stamps from 1.76e18 ns with 30 % jitter, and seconds from the middle."""
    jitter = np.random.default_rng(seed).integers(-15 * MS // 10, 15 * MS // 10, n)
    stamps = 1_760_000_000 * SECOND + np.arange(n) * 5 * MS + jitter
    return stamps, (stamps - stamps[n // 2]) / SECOND


@pytest.mark.parametrize("half_width", [2, 4, 7])
def test_local_polynomials_are_exact_for_quartics_with_irregular_stamps(half_width):
    stamps, t = shaken(60)
    c = np.random.default_rng(5).normal(size=(5, 3))
    p, v, a = (
        sum(f[k] * c[k] * t[:, None] ** max(k - d, 0) for k in range(5))
        for d, f in ((0, [1] * 5), (1, range(5)), (2, [k * (k - 1) for k in range(5)]))
    )
    velocity, acceleration = local_polynomials(stamps, p, half_width=half_width)
    assert velocity == pytest.approx(v, abs=1e-8)
    assert acceleration == pytest.approx(a, abs=1e-5)
    kept, from_velocity = local_polynomials(stamps, p, v, half_width=half_width)
    assert np.array_equal(kept, v)
    assert from_velocity == pytest.approx(a, abs=1e-8)


def test_local_polynomials_do_not_lag():
    """In phase with the exact derivative; a lag of 1 us would show as 6e-6."""
    t = np.arange(400) / 200
    w, inner = 2 * np.pi, slice(50, 350)
    stamps = (t * SECOND).astype(np.int64)
    velocity, acceleration = local_polynomials(stamps, np.sin(w * t)[:, None], half_width=4)
    for got, exact, quadrature in (
        (velocity, w * np.cos(w * t), np.sin(w * t)),
        (acceleration, -(w**2) * np.sin(w * t), np.cos(w * t)),
    ):
        basis = np.column_stack([exact, quadrature])[inner]
        share, lag = np.linalg.lstsq(basis, got[inner, 0], rcond=None)[0]
        assert share == pytest.approx(1.0, abs=1e-4)
        assert abs(lag) < 1e-6


def test_local_polynomials_take_a_velocity_only_where_it_is_whole():
    stamps, t = shaken(40)
    p = np.column_stack([t, 2 * t])
    given = np.column_stack([np.full(40, 7.0), np.full(40, 7.0)])
    given[20, 1] = np.nan
    velocity, acceleration = local_polynomials(stamps, p, given, half_width=4)
    assert np.array_equal(velocity[:, 0], given[:, 0])
    assert velocity[:, 1] == pytest.approx(2.0, abs=1e-9)
    assert acceleration == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize(("n", "half_width"), [(8, 4), (0, 4), (50, 1), (50, 0), (50, -3)])
def test_local_polynomials_say_what_it_needs(n, half_width):
    with pytest.raises(DataError, match=rf"half width {half_width} need .* there are {n}"):
        local_polynomials(np.arange(n), np.zeros((n, 1)), half_width=half_width)
