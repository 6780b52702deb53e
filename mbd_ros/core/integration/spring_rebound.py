"""What steps make of an impact on a spring: a mass rebounds as fast as it came, or faster."""

import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

from mbd_ros.core.dynamics.system import Accelerator
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.errors import DivergedError

GAIN = 0.01  # of the speed of the approach, which counts as none
_PHASES, _STAGED = 24, 256  # of a step in which a mass arrives, more where stages stand inside it
_BEFORE = 10  # steps on the way there, in which methods with a history gather theirs
_STEPS = 400
_SHARES = np.geomspace(1.0e-3, 1.0, 25).tolist()
_HALVINGS = 8


class Bouncer:
    """Unit masses that fall on springs and dampers of one side, without gravity; dt is 1.

    It has what steppers ask of a system.

    Args:
        a: Stiffness k dt^2/m.
        b: Damping c dt/m.
        n: How many masses.
    """

    is_flat, sizes = True, 1.0

    def __init__(self, a: float, b: float, n: int) -> None:
        self._a, self._b = a, b
        self.nq = self.nv = n
        self.chart, self.model = self, SimpleNamespace(nv=n, nq=n)

    def integrate(self, q: Array, dq: Array) -> Array:
        """The q + dq."""
        return q + dq

    def difference(self, q0: Array, q1: Array) -> Array:
        """The q1 - q0."""
        return q1 - q0

    def accelerator(self, mode: Mode = ()) -> Accelerator:
        """Forces of the springs that are pressed."""

        def write(t: float, q: Array, v: Array, u: Array | None, out: Array) -> None:
            out[:] = np.where(q < 0.0, np.maximum(-self._a * q - self._b * v, 0.0), 0.0)

        return write


def rebound(method: Integrator, a: float, b: float) -> float:
    """Largest speed after an impact over that before, whenever in a step it begins; inf unbounded.

    Args:
        method: An explicit method of fixed steps.
        a: Stiffness k dt^2/m.
        b: Damping c dt/m.
    """
    n = _PHASES if method.order == 1 else _STAGED
    x = State(0.0, _BEFORE + (np.arange(n) + 0.5) / n, np.full(n, -1.0))
    stepper = method.prepare(Bouncer(a, b, n), 1.0)
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(_BEFORE + _STEPS):
                x = stepper.step(x, None)
                if ((x.q > 0.0) & (x.v >= 0.0)).all():
                    break
    except DivergedError:
        return math.inf
    fastest = float(x.v.max())
    return fastest if math.isfinite(fastest) else math.inf


def largest_without_gain(method: Integrator, a: float, b: float) -> float:
    """Largest share of a below which no rebound is faster than the approach, but for `GAIN`.

    Args:
        method: As for `rebound`.
        a: As for `rebound`.
        b: Damping, for all shares of a.
    """

    def gains(share: float) -> bool:
        return not rebound(method, share * a, b) <= 1.0 + GAIN

    first = next((i for i, share in enumerate(_SHARES) if gains(share)), len(_SHARES))
    if first in (0, len(_SHARES)):
        return 1.0 if first else 0.0
    return bisected(lambda share: not gains(share), _SHARES[first - 1], _SHARES[first], _HALVINGS)


def bisected(holds: Callable[[float], bool], low: float, high: float, halvings: int) -> float:
    """A number between one for which something holds and one for which it does not, by ratios."""
    for _ in range(halvings):
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return float(low)
