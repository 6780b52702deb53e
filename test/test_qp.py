"""The box QP of Gauss's principle: against other solvers, along trajectories, and on bad input."""

import gc
import time

import numpy as np
import pytest

from mbd_ros.core.active_set import complementarity
from mbd_ros.core.qp import BoxQp
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


@pytest.mark.parametrize("scale", [1e-4, 1.0, 1e4])
def test_singular_problems_and_any_scale_end_complementary(scale):
    rng = np.random.default_rng(3)
    qp = BoxQp(6)
    for _ in range(200):
        A, b, lower, upper = problem(rng, 6, rank=4, scale=scale)
        lam = qp.solve(A, b, lower, upper)
        assert complementarity(A, b, lower, upper, lam) <= 1e-9
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
    assert complementarity(A, b, lower, upper, qp.solve(A, b, lower, upper)) <= 1e-9


def test_unknown_backend_is_named_with_the_pip_line():
    with pytest.raises(ModelError, match="backend 'nosuch' is not installed: pip install nosuch"):
        BoxQp(2, "nosuch")


def test_complementarity_sees_every_kind_of_wrong_answer():
    A, b = np.eye(2), np.array([-1.0, -1.0])
    lower, upper = np.zeros(2), np.array([0.5, 2.0])
    assert complementarity(A, b, lower, upper, np.array([0.5, 1.0])) == 0.0
    for wrong in ([0.5, 0.9], [0.4, 1.0], [0.0, 1.0], [0.5, 2.0]):
        assert complementarity(A, b, lower, upper, np.array(wrong)) > 1e-2
    assert complementarity(A, b, lower, upper, np.array([np.nan, 1.0])) == np.inf


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
def test_thirty_thousand_warm_started_solves():
    gc.disable()  # a collection of what pytest holds takes 10 ms, wherever it happens
    try:
        worst = max(solved_along_paths(seed, 5, 1000) for seed in range(6))
    finally:
        gc.enable()
    assert worst <= 5e-3


def solved_along_paths(seed, paths, count):
    """Longest solve [s of CPU]; every answer is checked, none may fail or need damping."""
    rng, worst = np.random.default_rng(seed), 0.0
    for n in rng.integers(2, 9, size=paths):
        qp = BoxQp(int(n))
        for A, b, lower, upper in along_a_path(rng, int(n), count):
            begin = time.thread_time()
            lam = qp.solve(A, b, lower, upper)
            worst = max(worst, time.thread_time() - begin)
            assert complementarity(A, b, lower, upper, lam) <= 1e-9
        assert qp.statistics.failed == 0
        assert qp.statistics.damped == 0
    return worst
