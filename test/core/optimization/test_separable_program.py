"""Separable programs: against other solvers, by their conditions, on bad input."""

import numpy as np
import pytest

from mbd_ros.core.optimization.separable import SeparableCost, SeparableProgram, power_cost
from mbd_ros.errors import SolveError


def shared(rng, rows, n, reserves=1.0):
    """Rows that muscles and reserves share: arms of some joints each, bounds 0.01 and 1."""
    A = rng.normal(size=(rows, n)) * (rng.random((rows, n)) < 0.4) * 100.0
    A = np.concatenate((A, reserves * np.eye(rows)), axis=1)
    lower = np.concatenate((np.full(n, 0.01), np.full(rows, -np.inf)))
    upper = np.concatenate((np.ones(n), np.full(rows, np.inf)))
    b = A[:, :n] @ rng.uniform(0.0, 0.6, n) + rng.normal(size=rows)
    return A, b, lower, upper


def violation(cost_slope, A, b, lower, upper, optimum):
    """Of the conditions: rows in units of their terms, slopes in units of the largest one."""
    x, left = optimum.x, cost_slope - A.T @ optimum.multipliers
    inside = (x > lower) & (x < upper)
    wrong = np.where(inside, np.abs(left), np.where(x <= lower, -left, left))
    rows = np.abs(A @ x - b) / (np.abs(A) @ np.abs(x) + np.abs(b))
    return max(rows.max(), wrong.max() / np.abs(cost_slope).max())


@pytest.mark.parametrize("n", [6, 18, 54])
def test_squares_agree_with_another_solver(n):
    """By quadprog, which is accurate to about 1e-9 here."""
    qpsolvers = pytest.importorskip("qpsolvers")
    rng, rows = np.random.default_rng(n), max(n // 3, 2)
    program, cost = SeparableProgram(n + rows, rows), power_cost(2.0, np.ones(n + rows))
    for _ in range(20):
        A, b, lower, upper = shared(rng, rows, n, reserves=10.0)
        found = program.solve(cost, A, b, lower, upper)
        wide = np.where(np.isfinite(lower), lower, -1e4), np.where(np.isfinite(upper), upper, 1e4)
        expected = qpsolvers.solve_qp(
            2.0 * np.eye(len(lower)), np.zeros(len(lower)), A=A, b=b, lb=wide[0], ub=wide[1],
            solver="quadprog",
        )  # fmt: skip
        assert np.abs(found.x - expected).max() <= 1e-7
        assert found.x @ found.x <= expected @ expected + 1e-7


@pytest.mark.parametrize("p", [1.2, 1.5, 2.0, 3.0, 5.0])
@pytest.mark.parametrize("reserves", [1.0, 100.0])
def test_conditions_of_the_optimum_hold_for_every_power(p, reserves):
    rng, n, rows = np.random.default_rng(3), 18, 7
    weight = rng.uniform(0.2, 1.0, n + rows)
    program = SeparableProgram(n + rows, rows)
    for _ in range(20):
        A, b, lower, upper = shared(rng, rows, n, reserves)
        found = program.solve(power_cost(p, weight), A, b, lower, upper)
        slope = p * weight * np.sign(found.x) * np.abs(found.x) ** (p - 1.0)
        assert found.is_feasible
        assert violation(slope, A, b, lower, upper, found) <= 1e-8
        assert found.residual <= 1e-8


def test_exponent_one_agrees_with_a_linear_program():
    """|reserve| as the difference of two unknowns, by scipy's HiGHS."""
    from scipy.optimize import linprog

    rng, n, rows = np.random.default_rng(4), 18, 7
    program, weight = SeparableProgram(n + rows, rows), rng.uniform(0.5, 1.0, n + rows)
    for _ in range(20):
        A, b, lower, upper = shared(rng, rows, n)
        found = program.solve(power_cost(1.0, weight), A, b, lower, upper)
        wide = np.concatenate((A, -A[:, n:]), axis=1)
        bounds = [(0.01, 1.0)] * n + [(0.0, None)] * (2 * rows)
        prices = np.concatenate((weight, weight[n:]))
        expected = linprog(prices, A_eq=wide, b_eq=b, bounds=bounds, method="highs")
        assert weight @ np.abs(found.x) == pytest.approx(expected.fun, rel=1e-9)
        assert np.abs(A @ found.x - b).max() <= 1e-8 * np.abs(b).max()


def test_linear_costs_name_what_is_not_unique():
    """Two muscles with equal arms and prices share any way; squares share evenly."""
    A, b, low, high = np.array([[2.0, 2.0, 5.0]]), np.array([2.0]), np.zeros(3), np.ones(3)
    prices = np.array([1.0, 1.0, 9.0])
    linear = SeparableProgram(3, 1).solve(power_cost(1.0, prices), A, b, low, high)
    square = SeparableProgram(3, 1).solve(power_cost(2.0, prices), A, b, low, high)
    unlike = SeparableProgram(3, 1).solve(power_cost(1.0, prices * [1, 2, 1]), A, b, low, high)
    assert linear.movable == (0, 1)
    assert linear.x.sum() == pytest.approx(1.0)
    assert square.movable == unlike.movable == ()
    assert unlike.x == pytest.approx([1.0, 0.0, 0.0], abs=1e-9)


def test_tracking_without_rows_to_obey_gives_the_targets():
    target = np.array([0.2, 0.5, 2.0])
    none = np.zeros(3)
    cost = SeparableCost(2.0, none, none, np.ones(3), target)
    found = SeparableProgram(3, 0).solve(cost, np.zeros((0, 3)), np.zeros(0), none, np.ones(3))
    assert found.x == pytest.approx([0.2, 0.5, 1.0], abs=1e-12)


def test_a_problem_that_cannot_be_met_names_what_each_row_lacks():
    """Two muscles of 10 N·m at most: 25 lack 5; the second row is met as it was."""
    A = np.array([[10.0, 10.0, 0.0], [0.0, 0.0, 4.0]])
    b, lower, upper = np.array([25.0, 2.0]), np.zeros(3), np.ones(3)
    found = SeparableProgram(3, 2).solve(power_cost(2.0, np.ones(3)), A, b, lower, upper)
    assert not found.is_feasible
    assert found.lacking == pytest.approx([5.0, 0.0], abs=1e-4)
    assert found.x == pytest.approx([1.0, 1.0, 0.5], abs=1e-5)


def test_a_row_without_any_unknown_lacks_all():
    A, b = np.array([[1.0, 1.0], [0.0, 0.0]]), np.array([1.0, 3.0])
    found = SeparableProgram(2, 2).solve(
        power_cost(2.0, np.ones(2)), A, b, np.zeros(2), np.ones(2)
    )
    assert not found.is_feasible
    assert found.lacking == pytest.approx([0.0, 3.0], abs=1e-6)


def test_rows_that_repeat_one_another_are_solved():
    A, b = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0]]), np.array([1.0, 2.0])
    found = SeparableProgram(3, 2).solve(
        power_cost(2.0, np.ones(3)), A, b, np.zeros(3), np.ones(3)
    )
    assert found.x == pytest.approx(np.array([1.0, 2.0, 3.0]) / 14.0, abs=1e-9)


def test_equal_bounds_fix_an_unknown():
    A, b = np.array([[1.0, 1.0]]), np.array([0.8])
    lower, upper = np.array([0.3, 0.0]), np.array([0.3, 1.0])
    found = SeparableProgram(2, 1).solve(power_cost(3.0, np.ones(2)), A, b, lower, upper)
    assert found.x == pytest.approx([0.3, 0.5], abs=1e-9)


def test_an_answer_does_not_depend_on_the_one_before():
    rng = np.random.default_rng(5)
    warm, cost = SeparableProgram(25, 7), power_cost(2.0, np.ones(25))
    for _ in range(10):
        problem = shared(rng, 7, 18)
        cold = SeparableProgram(25, 7).solve(cost, *problem)
        assert np.abs(warm.solve(cost, *problem).x - cold.x).max() <= 1e-10
    assert warm.statistics.solves == 10


@pytest.mark.parametrize("fault", ["A", "b", "bounds"])
def test_bad_input_is_refused(fault):
    A, b, lower, upper = shared(np.random.default_rng(1), 2, 4)
    if fault == "A":
        A[0, 0] = np.nan
    elif fault == "b":
        b[0] = np.inf
    else:
        lower[0] = 2.0
    with pytest.raises(SolveError, match="refused"):
        SeparableProgram(6, 2).solve(power_cost(2.0, np.ones(6)), A, b, lower, upper)
