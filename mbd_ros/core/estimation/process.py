"""What an estimator knows of a process: how it goes on, and what is seen of it.

    x_k+1 = f(x_k, u_k) (+) G w_k,   y_k = h(x_k) + n_k

Processes are mechanisms (`mechanism_process`) or matrices (`LinearProcess`). x is whatever the
process takes for a state; steps d of the tangent are vectors.
"""

from typing import Any, NamedTuple, Protocol

import numpy as np

from mbd_ros.core.estimation.kalman_update import Bools, updated
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError

_ASYMMETRY = 1.0e-12  # of a covariance, relative


class Transition(NamedTuple):
    """One interval of a process.

    Attributes:
        x: State at its end, without disturbance.
        F: Derivative of it by the state at the start, shape (n, n), both in their tangents.
        G: Derivative of it by the disturbance w, shape (n, nw).
        Q: Covariance of w, shape (nw, nw).
    """

    x: Any
    F: Array
    G: Array
    Q: Array

    @property
    def noise(self) -> Array:
        """Covariance that the interval adds, shape (n, n)."""
        return self.G.dot(self.Q).dot(self.G.T)


class Observation(NamedTuple):
    """What should be measured at a state.

    Attributes:
        y: Without noise, shape (m,).
        H: Derivative by a step of the tangent, shape (m, n).
        R: Covariance of the noise, shape (m, m).
    """

    y: Array
    H: Array
    R: Array


class Bounded(NamedTuple):
    """What has bounds at a state.

    Attributes:
        values: Shape (b,).
        by: Derivative by a step of the tangent, shape (b, n).
        lower: Smallest accepted values, shape (b,).
        upper: Largest accepted values, shape (b,).
        may_be_wrong: Which bounds give way to measurements that contradict them beyond doubt,
            shape (b,); None for none.
    """

    values: Array
    by: Array
    lower: Array
    upper: Array
    may_be_wrong: Bools | None = None


class Process(Protocol):
    """A process in time.

    Attributes:
        n: Size of a step of its tangent.
        nw: Size of a disturbance.
        sizes: Steps of the tangent that count as one where it is linearised, inf where it is
            linear, shape (n,).
    """

    n: int
    nw: int
    sizes: Array

    def advance(self, x: Any, u: Array | None, t: float) -> Transition:
        """From a state to a later time [s], under inputs that are held."""

    def observe(self, x: Any, u: Array | None) -> Observation:
        """What all sensors should see."""

    def plus(self, x: Any, d: Array) -> Any:
        """The state x (+) d."""

    def minus(self, x1: Any, x0: Any) -> Array:
        """The d with x0 (+) d = x1, shape (n,)."""

    def near(self, x: Any, values: Array, P: Array) -> Any:
        """The state that fits a measurement, on the way from x; P says what goes easily."""

    def at_rest(self, x: Any, t: float) -> Any:
        """The configuration at another time [s], at rest: nobody knows how it came there."""

    def unforeseen(self, acceleration: float, dt: float) -> Array:
        """Variance that accelerations nobody foresees bring within a time [s], shape (n,)."""

    def turned(self, x0: Any, x1: Any) -> Array | None:
        """From steps at x0 to the same steps at a state beside it, (n, n); None for unity."""

    def bounded(self, x: Any) -> Bounded:
        """What has bounds at a state."""


class LinearProcess:
    """A process of matrices: x_k+1 = A x_k + B u_k + G w_k, y_k = C x_k + n_k.

    Args:
        A: Shape (n, n).
        C: Shape (m, n).
        Q: Covariance of w, shape (nw, nw).
        R: Covariance of the noise, shape (m, m).
        G: Shape (n, nw); unity by default.
        B: Shape (n, nu); no inputs by default.
        lower: Bounds of x, shape (n,), -inf without; none by default.
        upper: Bounds of x, shape (n,), inf without; none by default.

    Attributes:
        n: Size of x.
        nw: Size of w.
        sizes: Inf: it is linear.

    Raises:
        ModelError: Shapes that do not fit, or a covariance that is none; names the matrix.
    """

    def __init__(
        self,
        A: Array,
        C: Array,
        Q: Array,
        R: Array,
        G: Array | None = None,
        B: Array | None = None,
        lower: Array | None = None,
        upper: Array | None = None,
    ) -> None:
        self.A, self.C, self.Q, self.R = (
            np.atleast_2d(np.asarray(M, float)) for M in (A, C, Q, R)
        )
        self.n = len(self.A)
        self.G = np.eye(self.n) if G is None else np.asarray(G, float).reshape(self.n, -1)
        self.B = None if B is None else np.asarray(B, float).reshape(self.n, -1)
        self.nw, self.sizes = self.G.shape[1], np.full(self.n, np.inf)
        shapes = {
            "A": (self.A, (self.n, self.n)),
            "C": (self.C, (len(self.C), self.n)),
            "Q": (self.Q, (self.nw, self.nw)),
            "R": (self.R, (len(self.C), len(self.C))),
        }
        for name, (matrix, shape) in shapes.items():
            if matrix.shape != shape:
                raise ModelError(f"{name} has shape {matrix.shape}, accepted: {shape}")
        for name in ("Q", "R"):
            refuse_no_covariance(name, shapes[name][0])
        none = np.full(self.n, np.inf)
        low = -none if lower is None else np.asarray(lower, float)
        high = none if upper is None else np.asarray(upper, float)
        self._has_bound = np.isfinite(low) | np.isfinite(high)
        self._selected = np.eye(self.n)[self._has_bound]
        self._bounds = low[self._has_bound], high[self._has_bound]

    def advance(self, x: Array, u: Array | None, t: float) -> Transition:
        """As `Process.advance`; the interval is the one that the matrices were made for."""
        after = self.A.dot(x)
        if self.B is not None and u is not None:
            after += self.B.dot(u)
        return Transition(after, self.A, self.G, self.Q)

    def observe(self, x: Array, u: Array | None) -> Observation:
        """As `Process.observe`."""
        return Observation(self.C.dot(x), self.C, self.R)

    def plus(self, x: Array, d: Array) -> Array:
        """As `Process.plus`."""
        return x + d

    def minus(self, x1: Array, x0: Array) -> Array:
        """As `Process.minus`."""
        return x1 - x0

    def near(self, x: Array, values: Array, P: Array) -> Array:
        """As `Process.near`."""
        return x + updated(P, self.C, self.R, values - self.C.dot(x)).step

    def at_rest(self, x: Array, t: float) -> Array:
        """As `Process.at_rest`."""
        return x

    def unforeseen(self, acceleration: float, dt: float) -> Array:
        """As `Process.unforeseen`: nobody says what an acceleration is here."""
        return np.zeros(self.n)

    def turned(self, x0: Array, x1: Array) -> None:
        """As `Process.turned`: the same everywhere."""

    def bounded(self, x: Array) -> Bounded:
        """As `Process.bounded`."""
        return Bounded(x[self._has_bound], self._selected, *self._bounds)


def moved(process: Process, P: Array, x0: Any, x1: Any) -> Array:
    """A covariance in the tangent of x1 that was found in that of a state x0 beside it."""
    turn = process.turned(x0, x1)
    return P if turn is None else turn.dot(P).dot(turn.T)


def refuse_no_covariance(name: str, matrix: Array) -> None:
    """Refuse what is no covariance.

    Raises:
        ModelError: Names the matrix and the condition.
    """
    if not np.isfinite(matrix).all():
        raise ModelError(f"{name} is not finite")
    size = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > _ASYMMETRY * size:
        raise ModelError(f"{name} is not symmetric")
    if len(matrix) and np.linalg.eigvalsh(matrix)[0] < -_ASYMMETRY * size:
        raise ModelError(f"{name} is not positive semidefinite")
