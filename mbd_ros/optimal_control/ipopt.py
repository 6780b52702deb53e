"""Solution of a sparse program by IPOPT; the last iterate is returned in any case.

Source: A. Waechter, L. T. Biegler, On the implementation of an interior-point filter line-search
algorithm for large-scale nonlinear programming, Mathematical Programming 106, 2006.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.sparse_program import SparseProgram

STOPPED = "User_Requested_Stop"
_GOOD = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Feasible_Point_Found")
_WARM = {
    "mu_strategy": "adaptive",
    "mu_init": 1.0e-7,
    "bound_push": 1.0e-4,  # nearer to inactive bounds, steps would be short
    "bound_frac": 1.0e-4,
}
_BY_SLACKS = {"bound_mult_init_method": "mu-based"}  # multipliers of bounds are mu over slacks
_NARROW = 1.0e-10  # of the size of bounds: closer ones leave no slack, and IPOPT would crash
# for programs with discontinuous derivatives: ends where the cost no longer changes, although the
# gradient of the Lagrangian does
KINKED: Mapping[str, Any] = {
    "mumps_pivot_order": 4,  # PORD: a third less time for long chains of many unknowns
    "acceptable_iter": 3,
    "acceptable_tol": 1.0e-2,
    "acceptable_constr_viol_tol": 1.0e-6,
    "acceptable_dual_inf_tol": 1.0e3,
    "acceptable_compl_inf_tol": 1.0e-7,
    "acceptable_obj_change_tol": 1.0e-8,
}
# for programs whose derivatives jump within a motion: the barrier is lowered before its subproblem
# is solved, whose optimum may be where a derivative jumps, so that steps would oscillate there
PIECEWISE: Mapping[str, Any] = {"barrier_tol_factor": 1.0e3}
_NO_OPTIONS: Mapping[str, Any] = {}
Progress = Callable[[], tuple[float, float]]  # cost and violation
Tell = Callable[[int, Progress], bool]  # number of the iteration; whether to stop


def solve(
    program: SparseProgram,
    guess: Array,
    lower: Array,
    upper: Array,
    *,
    accuracy: float = 1.0e-9,
    most: int = 1000,
    is_near: bool = False,
    tell: Tell | None = None,
    options: Mapping[str, Any] = _NO_OPTIONS,
) -> SolverResult:
    """Solve a program.

    Args:
        program: The program.
        guess: Initial values of all unknowns, including fixed ones, shape (n,).
        lower: Lower bounds of the unknowns, shape (n,).
        upper: Upper bounds of the unknowns, shape (n,).
        accuracy: Tolerance of the conditions of optimality, for scaled unknowns.
        most: Largest number of iterations.
        is_near: Whether the guess solves a program that is nearly this one.
        tell: Callback after every iteration, which returns whether to stop.
        options: Further options of IPOPT, by name.
    """
    functions, at = program.functions(), program.open
    sizes, (row_lower, row_upper) = program.sizes[at], program.bounds
    lower, upper = lower[at] / sizes, upper[at] / sizes
    is_narrow = _are_narrow(lower, upper) or _are_narrow(row_lower, row_upper)
    ipopt: dict[str, Any] = {
        "print_level": 0,
        "sb": "yes",
        "tol": accuracy,
        "constr_viol_tol": accuracy,
        "dual_inf_tol": 1.0e3 * accuracy,
        "compl_inf_tol": accuracy,
        "bound_relax_factor": 0.0,
        "max_iter": most,
        "linear_solver": "mumps",
        "mumps_permuting_scaling": 0,  # unknowns are scaled; permuted factors are a third larger
        **(_WARM if is_near else {}),
        **(_BY_SLACKS if is_near and not is_narrow else {}),
        **options,
    }
    derivatives = {name: functions[name] for name in ("grad_f", "jac_g", "hess_lag")}
    more = {"print_time": False, "no_nlp_grad": True, "calc_lam_p": False}
    watch = _Watch(program.bounds, tell) if tell is not None else None
    if watch is not None:
        more["iteration_callback"] = watch
    arguments = {**derivatives, **more, "ipopt": ipopt}
    solver = ca.nlpsol("predict", "ipopt", functions["program"], arguments)
    result = solver(
        x0=guess[at] / sizes,
        lbx=lower,
        ubx=upper,
        lbg=row_lower,
        ubg=row_upper,
    )
    return _unscale(program, guess, result, solver.stats(), functions)


def _are_narrow(lower: Array, upper: Array) -> bool:
    """Return whether some bounds differ by no more than rounding, but differ."""
    size = np.maximum(1.0, np.maximum(np.abs(lower), np.abs(upper)))
    return bool(((lower < upper) & (upper - lower < _NARROW * size)).any())


class _Watch(ca.Callback):  # type: ignore[misc]
    """CasADi callback after every iteration."""

    def __init__(self, bounds: tuple[Array, Array], tell: Tell) -> None:
        ca.Callback.__init__(self)
        self._bounds = bounds
        self._tell = tell
        self.iterations = 0
        self.construct("watch", {})

    def get_n_in(self) -> int:
        return int(ca.nlpsol_n_out())

    def get_n_out(self) -> int:
        return 1

    def get_name_in(self, i: int) -> str:
        return str(ca.nlpsol_out(i))

    def get_name_out(self, i: int) -> str:
        return "ret"

    def get_sparsity_in(self, i: int) -> Any:
        sizes = {"f": 1, "g": len(self._bounds[0])}
        size = sizes.get(ca.nlpsol_out(i))
        return ca.Sparsity(0, 0) if size is None else ca.Sparsity.dense(size, 1)

    def eval(self, arguments: Any) -> list[int]:
        self.iterations += 1

        def progress() -> tuple[float, float]:
            rows, (lower, upper) = _flat(arguments[2]), self._bounds
            violation = np.maximum(lower - rows, rows - upper).max(initial=0.0)
            return float(arguments[1]), float(violation)

        return [int(self._tell(self.iterations, progress))]


def _flat(values: Any) -> Array:
    return np.array(ca.DM(values).full(), dtype=np.float64).ravel()


def _unscale(
    program: SparseProgram, guess: Array, result: Any, stats: Any, functions: Any
) -> SolverResult:
    """Return the result of IPOPT for unknowns and rows without scaling."""
    at, sizes, x = program.open, program.sizes[program.open], guess.copy()
    y, lam = _flat(result["x"]), _flat(result["lam_g"])
    pulls, bounds = _flat(result["lam_x"]), np.zeros(len(x))
    x[at] = y * sizes
    rows = _flat(result["g"])
    lower, upper = program.bounds
    violation = np.maximum(np.maximum(lower - rows, rows - upper), 0.0)
    slope = _flat(functions["grad_f"](y, [])[1])
    if program.m:
        slope = slope + _flat(functions["jac_g"](y, [])[1].T @ result["lam_g"])
    cost = program.cost_size
    bounds[at] = pulls * cost / sizes
    status = str(stats["return_status"])
    return SolverResult(
        x,
        float(result["f"]) * cost,
        rows * program.row_sizes,
        lam * cost / program.row_sizes,
        bounds,
        status,
        int(stats["iter_count"]),
        status in _GOOD,
        float(violation.max(initial=0.0)),
        float(np.abs(slope + pulls).max(initial=0.0)),
    )


class SolverResult(NamedTuple):
    """Result of the solver: a solution, or the last iterate.

    Attributes:
        x: The unknowns, shape (n,).
        cost: Value of the cost.
        rows: Values of the rows, shape (m,).
        row_forces: Multipliers of the rows: decrease of the cost per unit of their bounds, (m,).
        bound_forces: Multipliers of bounds of the unknowns, shape (n,).
        status: Status of IPOPT.
        iterations: Number of iterations.
        is_good: Whether conditions of optimality hold.
        violation: Largest violation of rows, relative to their sizes.
        stationarity: Largest entry of the gradient of the Lagrangian, for scaled unknowns.
    """

    x: Array
    cost: float
    rows: Array
    row_forces: Array
    bound_forces: Array
    status: str
    iterations: int
    is_good: bool
    violation: float
    stationarity: float
