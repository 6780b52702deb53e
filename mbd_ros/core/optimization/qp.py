"""The quadratic program of Gauss's principle, in its multipliers; the only user of QP solvers.

    min 1/2 lam' A lam + b' lam   subject to   lower <= lam <= upper

Its optimum is complementarity: with w = A lam + b, w = 0 inside the bounds, w >= 0 at the lower
and w <= 0 at the upper one. Source: P. Lötstedt, SIAM J. Sci. Stat. Comput. 5 (1984).
"""

from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.optimization.box_active_set import complementarity, polish
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SolveError, install_hint

_TOLERANCE = 1.0e-9  # of the size of the terms in A lam + b
_DAMPING = 1.0e-10  # beside a diagonal of ones
_SETTINGS = {
    "eps_abs": 1.0e-9,
    "eps_primal_inf": 1.0e-12,  # the default calls solvable problems infeasible
    "eps_dual_inf": 1.0e-12,
    "max_iter": 40,
    "max_iter_in": 60,
}
INFINITE = 1.0e20  # what ProxQP takes for no bound
_TINY = 1.0e-300


class Statistics(NamedTuple):
    """How the solves of a `BoxQp` went.

    Attributes:
        solves: Problems that reached the solver.
        cold: Those that needed a restart from nothing.
        damped: Those that needed damping.
        failed: Those that none of it solved.
    """

    solves: int = 0
    cold: int = 0
    damped: int = 0
    failed: int = 0


class BoxQp:
    """A kept, warm-started ProxQP over n multipliers, every answer checked.

    The ladder: warm start; cold restart; damping of A; then `SolveError`. Each rung is judged by
    the complementarity residual recomputed here, never by the status of the solver.

    Args:
        n: Number of multipliers.
        backend: `proxqp`, kept between calls, or any solver of qpsolvers, started anew.

    Attributes:
        statistics: Counts so far.

    Raises:
        ModelError: The backend is not installed.
    """

    def __init__(self, n: int, backend: str = "proxqp") -> None:
        self.statistics = Statistics()
        self._n, self._backend = n, backend
        self._identity = np.eye(n)
        self._start = _proxqp(n) if backend == "proxqp" else _qpsolvers(backend)
        self._kept: Any = None
        self._previous: Array | None = None

    def solve(self, A: Array, b: Array, lower: Array, upper: Array) -> Array:
        """Multipliers, shape (n,), fresh.

        Raises:
            SolveError: Input that is not finite, lower > upper, or no rung of the ladder gives an
                answer that passes the check.
        """
        if not (np.isfinite(A).all() and np.isfinite(b).all() and (lower <= upper).all()):
            raise SolveError("QP refused: A or b is not finite, or lower > upper")
        self._count("solves")
        residual, scale = np.inf, 1.0 / np.sqrt(np.maximum(A.diagonal(), _TINY))
        size = max(float(np.abs(scale * b).max(initial=0.0)), _TINY)
        unit = scale * size  # lam in its own unit: A gets ones on its diagonal, b at most 1
        scaled = (
            scale[:, None] * A * scale,
            scale * b / size,
            np.maximum(lower / unit, -INFINITE),
            np.minimum(upper / unit, INFINITE),
        )
        for rung, start in (("", self._warm), ("cold", self._cold), ("damped", self._damped)):
            if rung:
                self._count(rung)
            lam = np.clip(unit * start(*scaled), lower, upper)
            lam = polish(A, b, lower, upper, lam)
            residual = complementarity(A, b, lower, upper, lam)
            if residual <= _TOLERANCE:
                self._previous = lam / unit
                return lam
        self._count("failed")
        raise SolveError(f"QP not solved: complementarity residual {residual:.1e}")

    def _warm(self, A: Array, b: Array, lower: Array, upper: Array) -> Array:
        if self._kept is None:
            return self._cold(A, b, lower, upper)
        self._kept, lam = self._start(self._kept, A, b, lower, upper, self._previous)
        return lam

    def _cold(self, A: Array, b: Array, lower: Array, upper: Array) -> Array:
        self._kept, lam = self._start(None, A, b, lower, upper, None)
        return lam

    def _damped(self, A: Array, b: Array, lower: Array, upper: Array) -> Array:
        damped = A + _DAMPING * self._identity
        self._kept, lam = self._start(None, damped, b, lower, upper, None)
        return lam

    def _count(self, what: str) -> None:
        self.statistics = self.statistics._replace(**{what: getattr(self.statistics, what) + 1})


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


def import_proxqp() -> Any:
    """The module of ProxQP.

    Raises:
        ModelError: proxsuite is not installed.
    """
    try:
        from proxsuite import proxqp
    except ImportError as error:
        raise ModelError(f"solver qp: {install_hint('proxsuite')}") from error
    return proxqp


def solve_cold(proxqp: Any, kept: Any, *problem: Any, **settings: float) -> None:
    """Solve a fresh problem of ProxQP; later ones start from its result."""
    for name, value in {**_SETTINGS, **settings}.items():
        setattr(kept.settings, name, value)
    kept.init(*problem)
    kept.settings.initial_guess = proxqp.InitialGuess.EQUALITY_CONSTRAINED_INITIAL_GUESS
    kept.solve()
    kept.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT


def _proxqp(n: int) -> Any:
    proxqp = import_proxqp()

    def start(
        kept: Any, A: Array, b: Array, lower: Array, upper: Array, guess: Array | None
    ) -> tuple[Any, Array]:
        if kept is None:
            kept = proxqp.dense.QP(n, 0, 0, True)
            solve_cold(proxqp, kept, A, b, None, None, None, None, None, lower, upper)
        else:
            kept.update(A, b, None, None, None, None, None, lower, upper)
            kept.solve()
        return kept, np.array(kept.results.x)

    return start


def _qpsolvers(backend: str) -> Any:
    check_backend(backend)
    import qpsolvers

    def start(
        kept: Any, A: Array, b: Array, lower: Array, upper: Array, guess: Array | None
    ) -> tuple[Any, Array]:
        problem = qpsolvers.Problem(A, b, lb=lower, ub=upper)
        try:
            lam = qpsolvers.solve_problem(problem, solver=backend, initvals=guess).x
        except qpsolvers.ProblemError:  # a singular A, for one, which damping makes regular
            lam = None
        return None, np.full(len(b), np.nan) if lam is None else lam

    return start
