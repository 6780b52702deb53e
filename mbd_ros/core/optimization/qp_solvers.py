"""QP solvers: ProxQP with warm starts, or any solver of qpsolvers.

    min 1/2 x' H x + g' x   subject to   low <= C x <= high,   lower <= x <= upper

No other module imports a QP solver. Solutions are not checked here; every caller recomputes the
optimality conditions.

Source: A. Bambade et al., Robotics: Science and Systems (2022), doi:10.15607/RSS.2022.XVIII.040.
"""

from typing import Any, TypeVar

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, install_hint

_SETTINGS = {
    "eps_abs": 1.0e-9,
    "eps_primal_inf": 1.0e-12,  # the default calls solvable problems infeasible
    "eps_dual_inf": 1.0e-12,
    "max_iter": 40,
    "max_iter_in": 60,
}
_INFINITE = 1.0e20  # ProxQP treats larger bounds as infinite
_NO_ROWS = None, None, None
Counts = TypeVar("Counts")


class WarmProxQp:
    """ProxQP solver that starts each solve from the result of the previous one.

    Args:
        n: Size of x.
        rows: Number of rows of C.

    Raises:
        ModelError: proxsuite is not installed.
    """

    def __init__(self, n: int, rows: int = 0) -> None:
        try:
            from proxsuite import proxqp
        except ImportError as error:
            raise ModelError(f"solver qp: {install_hint('proxsuite')}") from error
        self._proxqp = proxqp
        self._size = (n, 0, rows)
        self._qp: Any = None

    def solve(
        self, H: Array, g: Array, lower: Array, upper: Array, rows: Any = _NO_ROWS, *, cold: bool
    ) -> Array:
        """Return the final x of ProxQP, whatever its status, a new array, shape (n,).

        Args:
            H: Matrix of the cost, shape (n, n).
            g: Linear term of the cost, shape (n,).
            lower: Lower bounds, shape (n,), infinite for none.
            upper: Upper bounds, shape (n,), infinite for none.
            rows: C, low and high.
            cold: Whether to ignore the previous result.
        """
        C, low, high = rows
        problem = H, g, None, None, C, *_clipped(low, high), *_clipped(lower, upper)
        if not cold and self._qp is not None:
            self._qp.update(*problem)
            self._qp.solve()
        else:
            guess = self._proxqp.InitialGuess
            qp = self._proxqp.dense.QP(*self._size, True)
            self._qp = qp
            for name, value in _SETTINGS.items():
                setattr(qp.settings, name, value)
            qp.init(*problem)
            qp.settings.initial_guess = guess.EQUALITY_CONSTRAINED_INITIAL_GUESS
            qp.solve()
            qp.settings.initial_guess = guess.WARM_START_WITH_PREVIOUS_RESULT
        return np.array(self._qp.results.x)

    @property
    def multipliers(self) -> Array:
        """Multipliers of the last solve: of rows, then of bounds, negative at lower bounds."""
        return np.array(self._qp.results.z)


class OtherSolver:
    """Solver of qpsolvers, without warm starts.

    Args:
        backend: Name of the solver.

    Raises:
        ModelError: The solver is not installed.
    """

    def __init__(self, backend: str) -> None:
        check_backend(backend)
        self._backend = backend

    def solve(self, H: Array, g: Array, lower: Array, upper: Array, *, cold: bool) -> Array:
        """Return x as `WarmProxQp.solve` does, NaN if the solver fails; `cold` has no effect."""
        import qpsolvers

        lower, upper = _clipped(lower, upper)
        problem = qpsolvers.Problem(H, g, lb=lower, ub=upper)
        try:
            x = qpsolvers.solve_problem(problem, solver=self._backend).x
        except qpsolvers.ProblemError:  # such as a singular H, which damping makes regular
            x = None
        return np.full(len(g), np.nan) if x is None else x


def check_backend(backend: str) -> None:
    """Refuse a QP solver that is not installed; proxqp is checked when it is used.

    Raises:
        ModelError: The solver is not installed; the message lists those that are.
    """
    if backend == "proxqp":
        return
    try:
        import qpsolvers
    except ImportError as error:
        raise ModelError(
            f"solver backend {backend}: {install_hint('qpsolvers')} {backend}"
        ) from error
    if backend not in qpsolvers.available_solvers:
        installed = ", ".join(dict.fromkeys(["proxqp", *qpsolvers.available_solvers]))
        raise ModelError(
            f"solver backend '{backend}' is not installed: pip install {backend}; there are "
            f"{installed}"
        )


def counted(counts: Counts, what: str) -> Counts:
    """Return a NamedTuple of counts with one of them incremented."""
    named_tuple: Any = counts
    return named_tuple._replace(**{what: getattr(counts, what) + 1})


def _clipped(low: Any, high: Any) -> tuple[Any, Any]:
    if low is None:
        return None, None
    return np.maximum(low, -_INFINITE), np.minimum(high, _INFINITE)
