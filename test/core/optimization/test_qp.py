"""The box QP of Gauss's principle: against other solvers, along trajectories, and on bad input."""

import gc
import time

import numpy as np
import pytest

from mbd_ros.core.optimization import hard_soft_qp
from mbd_ros.core.optimization.box_qp import BoxQp, complementarity_residual
from mbd_ros.core.optimization.hard_soft_qp import COMPLIANCES, BoundedLeastSquares, HardSoftQp
from mbd_ros.errors import ModelError, SolveError


def problem(rng, n, rank=None, scale=1.0):
    """A random A of the given rank, b, and bounds as stops (0, inf) and friction (-c, c) have."""
    rank = n if rank is None else rank
    Y = rng.normal(size=(rank, n)) * scale
    stop = rng.random(n) < 0.5
    limit = rng.uniform(0.1, 2.0, size=n) / scale
    lower, upper = np.where(stop, 0.0, -limit), np.where(stop, np.inf, limit)
    return Y.T @ Y, Y.T @ rng.normal(size=rank), lower, upper


def primal_oracle(A, b, lower, upper, solver):
    qpsolvers = pytest.importorskip("qpsolvers")
    big = np.minimum(upper, 1e6)
    return qpsolvers.solve_qp(A, b, lb=lower, ub=big, solver=solver)


@pytest.mark.parametrize("solver", ["daqp", "quadprog"])
@pytest.mark.parametrize("n", [1, 3, 8])
def test_agrees_with_another_solver(n, solver):
    rng = np.random.default_rng(n)
    qp = BoxQp(n)
    for _ in range(100):
        A, b, lower, upper = problem(rng, n)
        A += 1e-3 * np.eye(n)  # both demand a positive definite A
        lam = qp.solve(A, b, lower, upper)
        expected = primal_oracle(A, b, lower, upper, solver)
        assert np.abs(lam - expected).max() <= 1e-8 * (1.0 + np.abs(expected).max())
    assert qp.statistics.failed == 0


@pytest.mark.parametrize("backend", ["daqp", "quadprog"])
def test_other_backends_give_the_same_answer(backend):
    rng = np.random.default_rng(5)
    kept, other = BoxQp(4), BoxQp(4, backend)
    for _ in range(30):
        A, b, lower, upper = problem(rng, 4)
        A += 1e-3 * np.eye(4)
        expected = kept.solve(A, b, lower, upper)
        assert np.abs(other.solve(A, b, lower, upper) - expected).max() <= 1e-8 * (
            1.0 + np.abs(expected).max()
        )


def test_rows_on_one_axis_that_differ_in_the_last_digits_end_with_one_at_its_bound():
    """Stiction and a stop of one joint, beside a load that makes 1e-7 less than a solver sees."""
    A = np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    b, lower = np.array([3.0, -3.0 + 1e-7, 1e3]), np.array([-2.0, 0.0, 0.0])
    lam = BoxQp(3).solve(A, b, lower, np.array([2.0, np.inf, np.inf]))
    assert np.abs(lam - [-2.0, 1.0 - 1e-7, 0.0]).max() <= 1e-12


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_singular_problems_and_any_scale_end_complementary(scale):
    rng = np.random.default_rng(3)
    qp = BoxQp(6)
    for _ in range(200):
        A, b, lower, upper = problem(rng, 6, rank=4, scale=scale)
        lam = qp.solve(A, b, lower, upper)
        assert complementarity_residual(A, b, lower, upper, lam) <= 1e-9
        assert ((lower <= lam) & (lam <= upper)).all()
    assert qp.statistics.failed == 0


@pytest.mark.parametrize(
    ("A", "b", "lower", "upper"),
    [
        (np.eye(2) * np.nan, np.ones(2), np.zeros(2), np.ones(2)),
        (np.eye(2), np.array([1.0, np.inf]), np.zeros(2), np.ones(2)),
        (np.eye(2), np.ones(2), np.ones(2), np.zeros(2)),
        (np.eye(2), np.ones(2), np.array([0.0, np.nan]), np.ones(2)),
    ],
)
def test_what_is_no_problem_is_refused_before_the_solver_sees_it(A, b, lower, upper):
    qp = BoxQp(2)
    with pytest.raises(SolveError, match="QP refused: A or b is not finite, or lower > upper"):
        qp.solve(A, b, lower, upper)
    assert qp.statistics.solves == 0


def test_a_problem_without_optimum_is_an_error_and_counted():
    qp = BoxQp(2)
    with pytest.raises(SolveError, match="QP not solved: complementarity residual"):
        qp.solve(np.zeros((2, 2)), -np.ones(2), np.zeros(2), np.full(2, np.inf))
    assert qp.statistics.cold == qp.statistics.damped == qp.statistics.failed == 1
    A, b, lower, upper = problem(np.random.default_rng(0), 2)
    assert complementarity_residual(A, b, lower, upper, qp.solve(A, b, lower, upper)) <= 1e-9


def test_unknown_backend_is_named_with_the_pip_line():
    with pytest.raises(ModelError, match="backend 'nosuch' is not installed: pip install nosuch"):
        BoxQp(2, "nosuch")


def test_complementarity_sees_every_kind_of_wrong_answer():
    A, b = np.eye(2), np.array([-1.0, -1.0])
    lower, upper = np.zeros(2), np.array([0.5, 2.0])
    assert complementarity_residual(A, b, lower, upper, np.array([0.5, 1.0])) == 0.0
    for wrong in ([0.5, 0.9], [0.4, 1.0], [0.0, 1.0], [0.5, 2.0]):
        assert complementarity_residual(A, b, lower, upper, np.array(wrong)) > 1e-2
    assert complementarity_residual(A, b, lower, upper, np.array([np.nan, 1.0])) == np.inf


def along_a_path(rng, n, count):
    """Problems that change a little from one to the next, as those of a trajectory do."""
    first, second = problem(rng, n), problem(rng, n)
    for s in np.linspace(0.0, 1.0, count):
        A = (1 - s) * first[0] + s * second[0]
        b = np.cos(9.0 * s) * first[1] + np.sin(7.0 * s) * second[1]
        yield A, b, first[2], first[3]


@pytest.mark.parametrize("seed", range(3))
def test_warm_started_solves_along_a_path_are_all_right(seed):
    solved_along_paths(seed, 1, 700)


@pytest.mark.soak
@pytest.mark.alone
def test_thirty_thousand_warm_started_solves():
    gc.disable()  # a collection of what pytest holds takes 10 ms, wherever it happens
    try:
        costs = [cost for seed in range(6) for cost in solved_along_paths(seed, 5, 1000)]
    finally:
        gc.enable()
    assert max(costs) <= 100.0 * np.median(costs)


def solved_along_paths(seed, paths, count):
    """What each solve costs [s of CPU]; every answer is checked, none may fail or need damping."""
    rng, costs = np.random.default_rng(seed), []
    for n in rng.integers(2, 9, size=paths):
        qp = BoxQp(int(n))
        for A, b, lower, upper in along_a_path(rng, int(n), count):
            begin = time.thread_time()
            lam = qp.solve(A, b, lower, upper)
            costs.append(time.thread_time() - begin)
            assert complementarity_residual(A, b, lower, upper, lam) <= 1e-9
        assert qp.statistics.failed == 0
        assert qp.statistics.damped == 0
    return costs


# ---------------------------------------------------------------------- limits that give way


def limited(rng, n, soft, tight):
    """Rows, the first n hard, with limits around what a random y reaches, some out of reach."""
    G = rng.normal(size=(n + soft, n))
    reached = G @ rng.normal(size=n) * 3.0
    spread = rng.uniform(0.1, 2.0, size=n + soft)
    reached[n:] += tight * rng.normal(size=soft)
    lower, upper = reached - spread, reached + spread
    lower[rng.random(n + soft) < 0.2] = -np.inf
    fixed = rng.random(soft) < 0.2
    upper[n:][fixed] = np.maximum(lower[n:], reached[n:])[fixed]
    return G, lower, upper


def least(G, lower, upper, n, y, excess):
    """Slope of sum (excess / |row|)² along what the hard rows leave free, 0 at the least."""
    length = np.sqrt((G**2).sum(axis=1))
    C = G[n:] @ np.linalg.inv(G[:n])
    slope = C.T @ (excess / length[n:] ** 2)
    x, slack = G[:n] @ y, 1e-9 * (1.0 + np.abs(G[:n] @ y))
    held = ((x <= lower[:n] + slack) & (slope > 0)) | ((x >= upper[:n] - slack) & (slope < 0))
    scale = np.abs(C).T @ (1.0 / length[n:] ** 2)
    return np.where(held, 0.0, np.abs(slope) / scale).max()


@pytest.mark.parametrize("tight", [0.0, 1.0, 10.0])
@pytest.mark.parametrize(("n", "soft"), [(1, 1), (3, 0), (3, 5), (7, 7), (5, 12)])
def test_limits_hold_or_give_way_by_the_least(n, soft, tight):
    """Against quadprog where all can be kept; by the slope of the excess where they cannot."""
    quadprog = pytest.importorskip("quadprog")
    rng, qp = np.random.default_rng(n), HardSoftQp(n, soft)
    for _ in range(60):
        G, lower, upper = limited(rng, n, soft, tight)
        if (lower <= 0.0).all() and (upper >= 0.0).all():
            continue
        found = qp.solve(G, lower, upper)
        reached = G @ found.y
        size = 1e-9 * (1.0 + np.abs(G) @ np.abs(found.y))
        assert (reached[:n] >= lower[:n] - size[:n]).all()
        assert (reached[:n] <= upper[:n] + size[:n]).all()
        excess = np.maximum(reached - upper, 0.0) + np.minimum(reached - lower, 0.0)
        if found.is_softened:
            assert np.abs(excess[n:]).max() > 0.0
            assert least(G, lower, upper, n, found.y, excess[n:]) <= 1e-8
            continue
        assert (np.abs(excess) <= size).all()
        rows, limit = np.vstack([G, -G]), np.concatenate([lower, -upper])
        kept = np.isfinite(limit)
        try:
            y = quadprog.solve_qp(np.eye(n), np.zeros(n), rows[kept].T, limit[kept])[0]
        except ValueError:  # equal limits, to quadprog contradictions
            continue
        assert np.abs(found.y - y).max() <= 1e-8 * (1.0 + np.abs(y).max())
    assert qp.counts.damped == qp.counts.failed == 0


def test_among_excesses_that_are_least_y_is_the_smallest():
    """Two soft rows ask for opposite values of the same sum, a third variable is free to be 0."""
    G = np.vstack([np.eye(3), [1.0, 1.0, 0.0], [-1.0, -1.0, 0.0]])
    lower = np.array([-9.0, -9.0, -9.0, 4.0, 0.0])
    upper = np.array([9.0, 9.0, 9.0, np.inf, np.inf])
    found = HardSoftQp(3, 2).solve(G, lower, upper)
    assert found.is_softened
    np.testing.assert_allclose(found.y, [1.0, 1.0, 0.0], rtol=0, atol=1e-12)
    assert found.side.tolist() == [0, 0, 0, 1, 1]


def test_a_row_that_nothing_moves_asks_nothing():
    G = np.vstack([np.eye(2), np.ones(2), np.zeros(2)])
    lower, upper = np.array([-9.0, -9.0, 2.0, 5.0]), np.full(4, 9.0)
    found = HardSoftQp(2, 2).solve(G, lower, upper)
    assert not found.is_softened
    np.testing.assert_allclose(found.y, [1.0, 1.0], rtol=0, atol=1e-12)


def test_the_limits_that_acted_before_save_the_solver():
    rng, qp = np.random.default_rng(2), HardSoftQp(4, 6)
    G, lower, upper = limited(rng, 4, 6, 1.0)
    for k in range(20):
        qp.solve(G, lower + 1e-6 * k, upper + 1e-6 * k)
    assert qp.counts.solves == 20
    assert qp.counts.qp == 2
    assert qp.counts.softened in (0, 20)


def wrong(*_, **__):
    return np.zeros(10)


@pytest.mark.parametrize("tight", [0.0, 10.0])
def test_without_proxqp_the_descent_in_the_box_finds_the_same(monkeypatch, tight):
    rng = np.random.default_rng(7)
    right, lame = HardSoftQp(4, 6), HardSoftQp(4, 6)
    monkeypatch.setattr(lame, "_soft_forces", wrong)
    monkeypatch.setattr(hard_soft_qp, "_CHANGES", 1)
    for _ in range(40):
        G, lower, upper = limited(rng, 4, 6, tight)
        expected = right.solve(G, lower, upper).y
        found = lame.solve(G, lower, upper).y
        assert np.abs(found - expected).max() <= 1e-8 * (1.0 + np.abs(expected).max())
    assert lame.counts.boxed >= 35
    assert lame.counts.qp >= lame.counts.cold >= lame.counts.boxed
    assert lame.counts.failed == 0


def test_the_last_rung_keeps_hard_rows_and_is_nearly_the_least(monkeypatch):
    rng = np.random.default_rng(8)
    right, lame = HardSoftQp(4, 6), HardSoftQp(4, 6)
    monkeypatch.setattr(lame, "_exact", lambda *_: None)
    for _ in range(40):
        G, lower, upper = limited(rng, 4, 6, 3.0)
        expected, found = right.solve(G, lower, upper), lame.solve(G, lower, upper)
        reached = G @ found.y
        size = 1.0 + np.abs(reached)
        assert (reached[:4] >= lower[:4] - 1e-12 * size[:4]).all()
        assert (reached[:4] <= upper[:4] + 1e-12 * size[:4]).all()
        assert np.abs(found.y - expected.y).max() <= 1e-4 * (1.0 + np.abs(expected.y).max())
    assert lame.counts.damped == lame.counts.solves == 40


@pytest.mark.parametrize("bad", ["row", "limit", "crossed", "singular"])
def test_what_is_no_limited_problem_is_refused(bad):
    qp, G = HardSoftQp(2, 1), np.vstack([np.eye(2), np.ones(2)])
    lower, upper, message = np.ones(3), np.full(3, 2.0), "QP refused: a row is not finite, or"
    if bad == "row":
        G[0, 0] = np.nan
    elif bad == "limit":
        lower[1] = np.nan
    elif bad == "crossed":
        lower[2] = 3.0
    else:
        G[1], message = G[0], "QP not solved: Singular matrix"
    with pytest.raises(SolveError, match=message):
        qp.solve(G, lower, upper)
    assert qp.counts.solves == qp.counts.failed == (bad == "singular")


def test_descent_in_a_box_ends_where_no_slope_is_left():
    rng = np.random.default_rng(4)
    for _ in range(50):
        E, C = rng.normal(size=(4, 4)) + 2.0 * np.eye(4), rng.normal(size=(5, 4))
        low = rng.normal(size=5)
        lower, upper = -rng.random(4), rng.random(4)
        x = BoundedLeastSquares(E, C, low, low + 0.1).solve(lower, upper)
        assert (lower <= x).all() and (x <= upper).all()
        excess = np.minimum(C @ x - low, 0.0) + np.maximum(C @ x - low - 0.1, 0.0)
        slope = E.T @ (E @ x) * COMPLIANCES[-1] + C.T @ excess
        held = ((x <= lower) & (slope > 0)) | ((x >= upper) & (slope < 0))
        assert np.where(held, 0.0, np.abs(slope)).max() <= 1e-11
