"""Steps as long as a tolerance allows, by an explicit Runge-Kutta method."""

import math
from typing import Any

import numpy as np

from mbd_ros.core.integration.runge_kutta import RungeKutta
from mbd_ros.core.integration.tableau import Tableau
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import DivergedError, ModelError

_SAFETY, _LEAST, _MOST = 0.9, 0.2, 6.0  # factors of the step length
_MEMORY = 0.04  # exponent of the last error
_NO_ERROR, _SMALL_ERROR = 1.0e-10, 1.0e-4  # smallest that counts, and that is remembered
_SHORTEST, _PROBE = 1.0e-10, 0.01  # in dt


def runge_kutta(system: Any, tableau: Tableau, dt: float, tolerance: float | None) -> RungeKutta:
    """The stepper for fixed steps, or with a tolerance for adaptive ones."""
    if tolerance is None:
        return RungeKutta(system, tableau, dt)
    return AdaptiveRungeKutta(system, tableau, dt, tolerance)


def check_tolerance(tolerance: float | None) -> None:
    """Refuse a tolerance that double precision or the error estimate does not allow.

    Raises:
        ModelError: It is not in 1e-13 .. 0.1.
    """
    if tolerance is not None and not 1e-13 <= tolerance <= 0.1:
        raise ModelError(f"tolerance {tolerance:g} is outside 1e-13 .. 0.1")


class AdaptiveRungeKutta(RungeKutta):
    """Explicit Runge-Kutta steps with error control.

    A step is accepted if the root mean square of e_i / (tolerance (1 + |y_i|)) is below one,
    with e the estimated error of the step in y = [q; v], taken at its start. On configurations
    that are no vector space, dq stands for q and its tolerance is absolute. The next length
    follows from this error and from the last one (PI control).

    Source: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.4; II.10
    for the two estimates of DOP853; Hairer, Wanner, II, 1996, IV.2 for PI control.

    Args:
        system: The system.
        tableau: The method.
        dt: Longest first step [s]; later steps may be longer.
        tolerance: Relative and absolute.
    """

    kept = ("_length", "_last_error")
    is_fixed = False

    def __init__(self, system: Any, tableau: Tableau, dt: float, tolerance: float) -> None:
        super().__init__(system, tableau, dt)
        self._system, self._tolerance = system, tolerance
        self._accelerate = system.accelerator()
        self._weights = np.zeros(2 * int(system.nv))
        self._power = 1.0 / (tableau.error_order + 1)
        self._length, self._last_error = 0.0, _SMALL_ERROR

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step of its own length, not beyond `end`; x itself at or after it.

        Raises:
            DivergedError: No step is short enough.
        """
        left, most = end - x.t, _MOST
        if left <= 0.0:
            return x
        self.stages.start(x, u)
        scale = self._scale(x)
        if self._length == 0.0:
            self._length = self._first_length(x, u, scale)
        while True:
            is_last = left <= 1.01 * self._length
            h = left if is_last else self._length
            after = self.stages.advance(h, end if is_last else x.t + h)
            error = _norm(self.stages.errors() / scale)
            if error < 1.0:
                break
            most = 1.0
            self._length = h * max(_LEAST, _SAFETY * error**-self._power)
            self._check_length(x)
        longer = h * min(most, self._factor(error))
        self._length = max(longer, self._length) if is_last else longer
        return after

    @property
    def pace(self) -> tuple[float, ...]:
        """As `Stepper.pace`."""
        return self._length, self._last_error

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        self._length, self._last_error = pace

    def restart(self) -> None:
        """Forget the last step and its length."""
        super().restart()
        self._length, self._last_error = 0.0, _SMALL_ERROR

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """As `Stepper.follow`."""
        super().follow(accelerate, mode)
        self._accelerate = accelerate

    def _factor(self, error: float) -> float:
        """Change of the step length after an accepted step."""
        error = max(error, _NO_ERROR)
        factor = error ** (0.75 * _MEMORY - self._power) * self._last_error**_MEMORY
        self._last_error = max(error, _SMALL_ERROR)
        return float(max(_LEAST, _SAFETY * factor))

    def _scale(self, x: State) -> Array:
        """Size of an error that counts as one, shape (2 nv,)."""
        scale, nv = self._weights, len(x.v)
        scale[:nv] = x.q if self._system.chart.is_flat else 0.0
        scale[nv:] = x.v
        np.abs(scale, out=scale)
        scale += self._system.chart.sizes
        scale *= self._tolerance
        return scale

    def _first_length(self, x: State, u: Array | None, scale: Array) -> float:
        """Length of a first step from the slope and its change over a short Euler step."""
        probe, a = _PROBE * self._dt, self.stages.first
        q, v = self._system.chart.integrate(x.q, probe * x.v), x.v + probe * a
        there = np.concatenate([v, np.empty_like(v)])
        self._accelerate(x.t + probe, q, v, u, there[len(v) :])
        here = np.concatenate([x.v, a])[None]
        steepest = max(_norm(here / scale), _norm((there - here) / scale / probe))
        if not steepest > 0.0:
            return self._dt
        return float(min(self._dt, (0.01 / steepest) ** self._power))

    def _check_length(self, x: State) -> None:
        if self._length > max(_SHORTEST * self._dt, 8.0 * math.ulp(x.t)):
            return
        i = int(np.abs(x.v).argmax())
        raise DivergedError(
            f"no step from t = {x.t:.9g} s down to {self._length:.2g} s meets tolerance "
            f"{self._tolerance:g}; fastest there: velocity {i} with {x.v[i]:.4g}"
        )


def _norm(errors: Array) -> float:
    """Root mean square of an error estimate, or of the two of DOP853 combined."""
    square = errors[0].dot(errors[0])
    if len(errors) == 2:
        whole = square + 0.01 * errors[1].dot(errors[1])
        square = square * square / whole if whole else square
    return math.sqrt(square / errors.shape[1])
