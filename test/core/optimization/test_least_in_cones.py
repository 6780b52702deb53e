"""Least norms within cones of friction, against SciPy's SLSQP, which shares no code."""

import numpy as np
import pytest
from scipy.optimize import minimize

from mbd_ros.core.optimization.least_norm import Limits, least_in_cones, least_with_open
from mbd_ros.errors import SolveError

CONTACTS, EFFORTS, SIZE = 4, 2, 300.0  # N


def problem(seed, mu=0.6, most=np.inf, dimension=6):
    """Forces that something in the cones exerts, with directions that exert nothing."""
    random, n = np.random.default_rng(seed), EFFORTS + 3 * CONTACTS
    N = np.linalg.qr(random.normal(size=(n, dimension)))[0]
    inside = random.normal(size=n)
    inside[EFFORTS::3] = np.abs(inside[EFFORTS::3]) + 0.1
    for tangent in (1, 2):
        inside[EFFORTS + tangent :: 3] *= 0.5 * mu * inside[EFFORTS::3]
    inside[EFFORTS:] *= 0.3
    lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
    lower[:EFFORTS], upper[:EFFORTS] = -most, most
    cones = np.arange(EFFORTS, n).reshape(-1, 3)
    limits = Limits(lower * SIZE, upper * SIZE, cones, np.full(CONTACTS, mu))
    y = inside + N.dot(3.0 * random.normal(size=dimension))
    y -= N.dot(N.T.dot(y))  # the smallest without limits
    A = np.diag(np.where(np.arange(n) < EFFORTS, 1.0, 0.3))
    return SIZE * y, N, A, np.zeros(n), limits


def by_slsqp(y, N, A, limits):
    """The least cost, in units of SIZE."""
    cones = limits.cones

    def force(w):
        return y / SIZE + N.dot(w)

    def room(w):
        f = force(w)
        tangents = (f[cones[:, 1:]] ** 2).sum(axis=1)
        normal = f[cones[:, 0]]
        return np.concatenate(((limits.mu * normal) ** 2 - tangents, normal, box(f)))

    def box(f):
        below, above = np.isfinite(limits.lower), np.isfinite(limits.upper)
        lower, upper = limits.lower[below] / SIZE, limits.upper[above] / SIZE
        return np.concatenate((f[below] - lower, upper - f[above]))

    best = np.inf
    for start in np.random.default_rng(0).normal(size=(2, N.shape[1])):
        found = minimize(
            lambda w: 0.5 * np.sum((A.dot(force(w))) ** 2),
            start,
            constraints={"type": "ineq", "fun": room},
            method="SLSQP",
            options={"maxiter": 500, "ftol": 1e-14},
        )
        if room(found.x).min() >= -1e-8:
            best = min(best, found.fun)
    return best


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("most", [np.inf, 0.4])
def test_cost_is_the_least(seed, most):
    y, N, A, c, limits = problem(seed, most=most)
    found, is_within = least_in_cones(y, N, A, c, limits)
    best = by_slsqp(y, N, A, limits)
    assert is_within == np.isfinite(best)
    if is_within:
        assert limits.excess(found).max() <= 1e-7 * SIZE
        off = found - y
        assert np.abs(off - N.dot(N.T.dot(off))).max() <= 1e-10  # it exerts what y exerts
        cost = 0.5 * np.sum((A.dot(found) / SIZE) ** 2)
        assert 0.999 * best <= cost <= (1.0 + 1e-5) * best  # SLSQP stops early near a tip


@pytest.mark.parametrize(("ahead", "aside"), [(0.7, 0.5), (0.9, 0.2), (0.55, 0.5)])
def test_a_foot_on_its_edge_leaves_a_corner_open(ahead, aside):
    """The centre of pressure is beyond the line between two corners; closed form."""
    corners = np.array([(x, y) for x in (1.0, -1.0) for y in (1.0, -1.0)])
    normals = np.column_stack((np.ones(4), corners)).T
    y = np.zeros(12)
    y[::3] = np.linalg.pinv(normals).dot(SIZE * np.array([1.0, ahead, aside]))
    assert y[9] < 0.0
    N = np.zeros((12, 1))
    N[::3, 0] = 0.5 * np.array([1.0, -1.0, -1.0, 1.0])
    free = np.full(12, np.inf)
    limits = Limits(-free, free, np.arange(12).reshape(-1, 3), np.ones(4))
    found, is_within = least_in_cones(y, N, np.eye(12), np.zeros(12), limits)
    share = 0.5 * SIZE * np.array([ahead + aside, 1.0 - aside, 1.0 - ahead, 0.0])
    assert is_within and found[::3] == pytest.approx(share, abs=1e-9)
    assert least_with_open(y, N, np.eye(12), np.zeros(12), limits) == pytest.approx(found)


def test_what_nothing_keeps_is_said():
    """One contact must pull: no direction helps."""
    n = EFFORTS + 3 * CONTACTS
    y = np.zeros(n)
    y[EFFORTS] = -5.0
    N = np.zeros((n, 1))
    N[0] = 1.0
    limits = problem(0)[4]
    _, is_within = least_in_cones(y, N, np.eye(n), np.zeros(n), limits)
    assert not is_within
    with pytest.raises(SolveError, match="not finite"):
        least_in_cones(np.full(n, np.nan), N, np.eye(n), np.zeros(n), limits)
