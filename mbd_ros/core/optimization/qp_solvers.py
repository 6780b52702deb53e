"""A kept ProxQP, or any solver of qpsolvers; no other module imports a QP solver.

    min 1/2 x' H x + g' x   subject to   low <= C x <= high,   lower <= x <= upper

Nothing here judges an answer: every caller recomputes the conditions of its optimum.
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
_INFINITE = 1.0e20  # what ProxQP takes for no bound
_NO_ROWS = None, None, None
Counts = TypeVar("Counts")


class KeptProxQp:
    """A ProxQP that stays, so that a solve starts from the result of the last one.

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
        self._kept: Any = None

    def solve(
        self, H: Array, g: Array, lower: Array, upper: Array, rows: Any = _NO_ROWS, *, cold: bool
    ) -> Array:
        """The x that ProxQP ends with, whatever its status, fresh, shape (n,).

        Args:
            H: Shape (n, n).
            g: Shape (n,).
            lower: Shape (n,), infinite without a bound.
            rows: C, low and high.
            cold: Whether to start from nothing instead of the previous result.
        """
        C, low, high = rows
        problem = H, g, None, None, C, *_clipped(low, high), *_clipped(lower, upper)
        if not cold and self._kept is not None:
            self._kept.update(*problem)
            self._kept.solve()
        else:
            guess = self._proxqp.InitialGuess
            self._kept = kept = self._proxqp.dense.QP(*self._size, True)
            for name, value in _SETTINGS.items():
                setattr(kept.settings, name, value)
            kept.init(*problem)
            kept.settings.initial_guess = guess.EQUALITY_CONSTRAINED_INITIAL_GUESS
            kept.solve()
            kept.settings.initial_guess = guess.WARM_START_WITH_PREVIOUS_RESULT
        return np.array(self._kept.results.x)

    @property
    def multipliers(self) -> Array:
        """Those of the last solve: of the rows, then of the bounds; < 0 at a lower one, fresh."""
        return np.array(self._kept.results.z)


class OtherSolver:
    """A solver of qpsolvers, which starts anew every time.

    Raises:
        ModelError: It is not installed.
    """

    def __init__(self, backend: str) -> None:
        check_backend(backend)
        self._backend = backend

    def solve(self, H: Array, g: Array, lower: Array, upper: Array, *, cold: bool) -> Array:
        """As `KeptProxQp.solve`; NaN without an answer."""
        import qpsolvers

        lower, upper = _clipped(lower, upper)
        problem = qpsolvers.Problem(H, g, lb=lower, ub=upper)
        try:
            x = qpsolvers.solve_problem(problem, solver=self._backend).x
        except qpsolvers.ProblemError:  # a singular H, for one, which damping makes regular
            x = None
        return np.full(len(g), np.nan) if x is None else x


def check_backend(backend: str) -> None:
    """Refuse a solver of QPs that is not there; proxqp is looked for when it is needed.

    Raises:
        ModelError: Lists those that are.
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
        have = ", ".join(dict.fromkeys(["proxqp", *qpsolvers.available_solvers]))
        raise ModelError(
            f"solver backend '{backend}' is not installed: pip install {backend}; there are {have}"
        )


def counted(counts: Counts, what: str) -> Counts:
    """A NamedTuple of counts with one of them raised by one."""
    raised: Any = counts
    return raised._replace(**{what: getattr(counts, what) + 1})


def _clipped(low: Any, high: Any) -> tuple[Any, Any]:
    if low is None:
        return None, None
    return np.maximum(low, -_INFINITE), np.minimum(high, _INFINITE)
