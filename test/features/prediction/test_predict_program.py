"""Derivatives of the programs behind `mbd-ros predict`."""

import casadi as ca
import numpy as np
import pytest
from prediction_scenes import biped, cart_pole, four_bar, hanging_muscle

from mbd_ros.features.prediction.problem import build_problem
from mbd_ros.features.prediction.task import predict_task
from mbd_ros.optimal_control.ipopt import solve
from mbd_ros.optimal_control.motion_program import MotionProgram
from mbd_ros.optimal_control.sparse_program import Block, Form, SparseProgram

STEP = 1.0e-4  # of unknowns in their usual sizes


def program_of(scene, task):
    """The program of a task on its first mesh, and bounds of its unknowns."""
    problem = build_problem(scene, predict_task(task, "predict"))
    motion: MotionProgram = problem.program
    program, guess, *_ = motion.assemble(problem.guesses, problem.parameters, 1.0)
    return program, guess


def slope(function, x, direction):
    """A directional derivative by differences of order 8."""
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    return (
        sum(
            w * (function(x + k * STEP * direction) - function(x - k * STEP * direction))
            for k, w in weights.items()
        )
        / STEP
    )


MECHANISMS = {
    "a loop": four_bar,
    "an impact and other names": biped,
    "a muscle and its tendon": lambda: hanging_muscle("elastic"),
}


@pytest.mark.parametrize("name", MECHANISMS)
def test_derivatives_are_exact(name):
    """Gradient, Jacobian and Hessian, along random directions at random points."""
    scene, task, _ = MECHANISMS[name]()
    program, guess = program_of(scene, task | {"mesh": {"intervals": 3, "degree": 3}})
    guess = np.where(guess == 1.0e-4, 0.3, guess)  # off the least excitation, where rates bend
    functions = program.functions()
    random = np.random.default_rng(3)
    at = program.open
    x = guess[at] / program.sizes[at]
    x = x + 1.0e-3 * random.standard_normal(len(at))
    d, lam = random.standard_normal(len(at)), random.standard_normal(program.m)
    d /= np.abs(d).max()
    jac, grad, hess = (functions[key] for key in ("jac_g", "grad_f", "hess_lag"))
    rows = lambda y: jac(y, [])[0].full().ravel()  # noqa: E731
    cost = lambda y: float(grad(y, [])[0])  # noqa: E731
    J = jac(x, [])[1]
    _compare((J @ d).full().ravel(), slope(rows, x, d))
    _compare(float(ca.dot(grad(x, [])[1], d)), slope(cost, x, d))
    pull = lambda y: (  # noqa: E731
        (grad(y, [])[1] + jac(y, [])[1].T @ lam).full().ravel()
    )
    upper = hess(x, [], 1.0, lam)
    whole = (upper + ca.triu(upper, False).T).full()
    _compare(whole @ d, slope(pull, x, d))


@pytest.mark.parametrize("of_row", [False, True])
def test_bounds_that_nearly_meet_are_kept_from_a_near_guess(of_row):
    """IPOPT would end in a segmentation fault: it divides by slacks that are 0."""
    x, width = ca.SX.sym("x", 3), 1.0e-18
    rows = Form(x, ca.SX(0, 1), x[0] if of_row else ca.sum1(x), ca.sumsqr(x - 1.0))
    block = Block("sum", rows, np.arange(3), None, 0.0, width if of_row else 0.0)
    program = SparseProgram([block], np.ones(3), np.full(3, np.nan))
    lower, upper = np.full(3, -np.inf), np.full(3, np.inf)
    if not of_row:
        lower[0], upper[0] = 0.0, width
    solved = solve(program, np.zeros(3), lower, upper, is_near=True)
    assert solved.is_good
    assert -1.0e-9 < solved.x[0] < 1.0e-9


def _compare(found, wanted):
    size = max(np.abs(wanted).max(), 1.0)
    assert np.abs(found - wanted).max() < 1.0e-9 * size


def test_entries_are_those_of_the_equations():
    """Of the cart-pole on n intervals of degree d with a fixed duration, counted by hand.

    A row of collocation has the beginning, its own value and d rates; those of fixed ends have
    one entry less. At a point x'' + 0.15 cos q q'' - .. has x'', q'', q, q' and the force, and
    cos q x'' + 0.5 q'' + g sin q has x'', q'' and q.
    """
    n, d = 4, 3
    end = {"slide.position": 1.0, "swing.position": 3.0, "*.velocity": 0.0}
    task = {"duration": 2.0, "end": end, "goals": [{"type": "effort"}]}
    program, _ = program_of(cart_pole(), task | {"mesh": {"intervals": n, "degree": d}})
    pattern = program.functions()["jac_g"].sparsity_out(1)
    collocation = 4 * (n * (d + 1) * (d + 2) - (d + 1) - 1)
    assert pattern.nnz() == collocation + 8 * n * d
    assert program.m == 4 * n * (d + 1) + 2 * n * d
    hessian = program.functions()["hess_lag"].sparsity_out(0)
    assert hessian.nnz() == n * d * len([("q", "q"), ("q", "v"), ("v", "v"), *"xa", "u"])
