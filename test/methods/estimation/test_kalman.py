"""Estimators of linear processes, beside stored and independent answers.

Reference: the system of C. V. Rao, J. B. Rawlings, J. H. Lee, Automatica 37 (2001) 1619, with
frozen data; optima were computed in 40 digits. The state at x_T is that of y_0 .. y_T-1.
"""

import numpy as np
import pytest
import qpsolvers

from mbd_ros.core.optimization.hard_soft_qp import RowBoundedQp
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.estimation.faults import InnovationWatch
from mbd_ros.methods.estimation.kalman_filter import FilterSample, smooth
from mbd_ros.methods.estimation.process import LinearProcess, Measurement
from mbd_ros.parts.estimators.extended_kalman import ExtendedKalman
from mbd_ros.parts.estimators.kalman import Kalman
from mbd_ros.parts.estimators.moving_horizon import MovingHorizon

A, G, C = np.array([[0.99, 0.2], [-0.1, 0.3]]), np.array([[0.0], [1.0]]), np.array([[1.0, -3.0]])
Y = (
    *(1.378328, 0.048834, -1.777882, -3.031803, -0.436372, -3.200906, -1.3023, -0.493292),
    *(-3.407232, 0.135515, -0.818664, -0.572223, 1.269143, -2.788316, 0.394595, 0.963457),
    *(-0.841302, 2.646146, 0.347847, 1.102039, 2.468043, -2.325047, 2.091509, 1.951013),
    *(1.2251, 3.822707, 0.285019, 2.563685, 2.944707, 0.606707),
)
W = (
    *(0.300321, 0.719008, 1.05419, 0.069902, 1.339709, 0.548145, 0.450325, 1.591682, 0.156818),
    *(0.914071, 0.835827, 0.211092, 1.819182, 0.392013, 0.611272, 1.21882, 0.016489, 1.152237),
    *(0.651524, 0.356642, 2.02788, 0.244938, 0.789939, 0.965352, 0.123515, 1.484156, 0.487132),
    *(0.510211, 1.425445, 0.103003),
)

KALMAN_10 = [-0.06547203807032845, -0.013417194810502946]
KALMAN_30 = [0.1160941599030346, -0.060717784590097135]
SMOOTHED_W = [0.2548548060256624, 1.2401278619970881, 1.3532366897565649]


def process(**more):
    return LinearProcess(A, C, np.eye(1), 0.01 * np.eye(1), G, **more)


def truth():
    x, states = np.array([0.5, -0.3]), []
    for w in W:
        states.append(x)
        x = A @ x + G[:, 0] * w
    return np.array([*states, x])


def predictions(estimator):
    """Estimates of x_0 .. x_30, each from the measurements before it."""
    found = [estimator.begin(np.zeros(2), np.eye(2)).x]
    for k, y in enumerate(Y):
        assert estimator.correct(Measurement(float(k), np.array([y]))).is_trusted
        found.append(estimator.predict(None, k + 1.0).x)
    return np.array(found)


def squares(found):
    return float(((found - truth())[1:] ** 2).sum())


def test_the_kalman_filter_is_that_of_the_reference():
    found = predictions(Kalman(process()))
    np.testing.assert_allclose(squares(found), 246.1071756591136, rtol=1e-12)
    np.testing.assert_allclose(found[10], KALMAN_10, rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[30], KALMAN_30, rtol=0, atol=1e-12)


@pytest.mark.parametrize("samples", [10, 0, 3])
def test_a_horizon_without_bounds_is_the_kalman_filter(samples):
    horizon = predictions(MovingHorizon(process(), samples=samples))
    np.testing.assert_allclose(horizon, predictions(Kalman(process())), rtol=0, atol=1e-11)


@pytest.mark.parametrize(("samples", "expected"), [(0, 32.44117498367757), (10, 33.6060155689996)])
def test_bounded_disturbances_give_the_sums_of_the_reference(samples, expected):
    found = predictions(MovingHorizon(process(), samples=samples, lower=0.0))
    np.testing.assert_allclose(squares(found), expected, rtol=1e-12)


def test_full_information_finds_the_disturbances_and_their_bounds():
    estimator = MovingHorizon(process(), samples=0, lower=0.0)
    predictions(estimator)
    answer = estimator.answer
    assert answer.active == 1 and answer.residual <= 1e-12
    assert answer.w.argmin() == 16 and abs(answer.w.min()) <= 1e-14
    np.testing.assert_allclose(answer.w[[0, 15, 28], 0], SMOOTHED_W, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("lower", "expected"), [(-np.inf, 225.86215719424), (0.0, 33.56610854498461)]
)
def test_without_an_arrival_cost_only_the_prior_counts(lower, expected):
    horizon = MovingHorizon(process(), samples=10, arrival="none", lower=lower)
    np.testing.assert_allclose(squares(predictions(horizon)), expected, rtol=1e-11)


def test_bounds_of_states_are_kept_and_optimal():
    """The whole window beside an independent solver."""
    upper = np.array([np.inf, 0.6])
    estimator = MovingHorizon(process(upper=upper), samples=0)
    estimator.begin(np.zeros(2), np.eye(2))
    for k, y in enumerate(Y[:8]):
        belief = estimator.correct(Measurement(float(k), np.array([y])))
        estimator.predict(None, k + 1.0)
    powers = [np.linalg.matrix_power(A, k) for k in range(8)]
    rows = [
        np.hstack([powers[k], *(powers[k - 1 - i] @ G if i < k else 0 * G for i in range(7))])
        for k in range(8)
    ]
    H, g = np.eye(9), np.zeros(9)
    for row, y in zip(rows, Y, strict=False):
        H += (C @ row).T @ (C @ row) / 0.01
        g -= (C @ row)[0] * y / 0.01
    limits = np.array([row[1] for row in rows])
    best = qpsolvers.solve_qp(H, g, limits, np.full(8, 0.6), solver="daqp", primal_tol=1e-12)
    np.testing.assert_allclose(belief.x, rows[7] @ best, rtol=0, atol=1e-9)
    assert (limits @ best > 0.6 - 1e-9).any()


def gaussian(rng, n, R=0.01):
    x, found = np.zeros(2), []
    for _ in range(n):
        found.append(C @ x + np.sqrt(R) * rng.standard_normal(1))
        x = A @ x + G[:, 0] * rng.standard_normal()
    return found


def watched(measured, R=0.01):
    estimator = Kalman(LinearProcess(A, C, np.eye(1), R * np.eye(1), G))
    estimator.begin(np.zeros(2), np.zeros((2, 2)))
    watch = InnovationWatch(samples=20_000)
    for k, y in enumerate(measured):
        watch.add(estimator.correct(Measurement(float(k), y)).innovation)
        estimator.predict(None, k + 1.0)
    return watch.consistency()


def test_innovations_of_a_right_model_are_white_and_of_their_size():
    found = watched(gaussian(np.random.default_rng(5), 10_000))
    assert found.nis_band == pytest.approx((0.964, 1.036), abs=5e-4)
    assert found.nis_band[0] <= found.nis <= found.nis_band[1] and found.fault == ""


@pytest.mark.parametrize(("true", "assumed", "said"), [(1, 0.01, "larger"), (0.01, 1, "smaller")])
def test_a_wrong_covariance_is_flagged(true, assumed, said):
    found = watched(gaussian(np.random.default_rng(5), 2000, 100.0 * true), 100.0 * assumed)
    assert said in found.fault


def test_a_colored_innovation_is_flagged():
    steady = [y + np.sin(0.05 * k) for k, y in enumerate(gaussian(np.random.default_rng(5), 2000))]
    assert watched(steady, R=1.0).fault


def test_the_smoother_is_the_optimum_over_all_measurements():
    estimator = ExtendedKalman(process())
    samples = []
    estimator.begin(np.zeros(2), np.eye(2))
    for k, y in enumerate(Y):
        if k:
            estimator.predict(None, float(k))
        belief = estimator.correct(Measurement(float(k), np.array([y])))
        F = None if estimator.transition is None else estimator.transition.F
        samples.append(FilterSample(F, estimator.predicted, belief))
    horizon = MovingHorizon(process(), samples=0)
    predictions(horizon)
    found = smooth(process(), samples)
    np.testing.assert_allclose([b.x for b in found], horizon.window(), rtol=0, atol=1e-10)
    assert np.linalg.eigvalsh(samples[0].belief.P - found[0].P)[0] > -1e-12


def test_a_quadratic_program_is_exact_beside_another_solver():
    rng, qp = np.random.default_rng(1), RowBoundedQp()
    for _ in range(50):
        n, m = rng.integers(2, 20, 2)
        root = rng.standard_normal((n + 2, n))
        H, g, rows = root.T @ root, 5 * rng.standard_normal(n), rng.standard_normal((m, n))
        inside = rows @ rng.standard_normal(n)
        lower, upper = inside - rng.random(m), inside + rng.random(m)
        found = qp.solve(H, g, rows, lower, upper)
        C_both, high = np.vstack((rows, -rows)), np.concatenate((upper, -lower))
        best = qpsolvers.solve_qp(H, g, C_both, high, solver="daqp", primal_tol=1e-12)
        np.testing.assert_allclose(found.x, best, rtol=0, atol=1e-7 * (1 + abs(best).max()))
        push = H @ found.x + g - rows.T @ found.multipliers
        assert abs(push).max() <= 1e-9 * (1 + abs(g).max())


def test_bounds_that_contradict_are_an_error():
    rows = np.array([[1.0, 0.0], [1.0, 0.0]])
    with pytest.raises(SolveError, match="contradict"):
        RowBoundedQp().solve(np.eye(2), np.zeros(2), rows, np.array([1.0, -5]), np.array([2.0, 0]))


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"Q": np.eye(2)}, "Q has shape"),
        ({"R": -np.eye(1)}, "R is not positive semidefinite"),
        ({"R": np.array([[np.nan]])}, "R is not finite"),
    ],
)
def test_matrices_that_do_not_fit_are_named(given, said):
    right = {"A": A, "C": C, "Q": np.eye(1), "R": np.eye(1), "G": G}
    with pytest.raises(ModelError, match=said):
        LinearProcess(**{**right, **given})


def test_a_prior_that_is_no_covariance_is_refused():
    with pytest.raises(ModelError, match="P has shape"):
        Kalman(process()).begin(np.zeros(2), np.eye(3))
    with pytest.raises(ModelError, match="lower and upper must be one number or"):
        MovingHorizon(process(), lower=(0.0, 1.0, 2.0))
