"""Trajectories of joints over time: polynomials between points, at rest before and after."""

import numpy as np

from mbd_ros.core.control.contract import Reference
from mbd_ros.core.state import Array

# Rows: value, slope and curvature at the begin, the same at the end of an interval of length 1;
# columns: powers 0 .. 5.
_QUINTIC = np.array(
    [
        [1.0, 0.0, 0.0, -10.0, 15.0, -6.0],
        [0.0, 1.0, 0.0, -6.0, 8.0, -3.0],
        [0.0, 0.0, 0.5, -1.5, 1.5, -0.5],
        [0.0, 0.0, 0.0, 10.0, -15.0, 6.0],
        [0.0, 0.0, 0.0, -4.0, 7.0, -3.0],
        [0.0, 0.0, 0.0, 0.5, -1.0, 0.5],
    ]
)
_CUBIC = np.array(
    [
        [1.0, 0.0, -3.0, 2.0],
        [0.0, 1.0, -2.0, 1.0],
        [0.0, 0.0, 3.0, -2.0],
        [0.0, 0.0, -1.0, 1.0],
    ]
)
PEAK_SPEED = 1.875  # of a quintic from rest to rest, in distance over duration
_SAMPLES = 16  # a piece, where extremes are looked for


class ReferenceTrajectory:
    """Quintic pieces through points with accelerations, else cubic ones; C2 or C1.

    It stands at the first point before, and at the last point after. A point without velocity
    takes the mean slope of its neighbours; the first and last point rest.

    Args:
        times: [s], strictly increasing, shape (k,), k >= 1.
        q: Positions [rad or m], shape (k, n).
        v: Velocities [rad/s or m/s], shape (k, n), or None.
        a: Accelerations [rad/s^2 or m/s^2], shape (k, n), or None; read beside `v` only.
    """

    def __init__(
        self, times: Array, q: Array, v: Array | None = None, a: Array | None = None
    ) -> None:
        self._times, self._last = times, len(times) - 1
        self._first_q, self._last_q = q[0], q[-1]
        self._rest = np.zeros(q.shape[1])
        h = np.diff(times)[:, None]
        self._h = h[:, 0]
        rates = slopes(times, q) if v is None else v
        begin, end = [q[:-1], h * rates[:-1]], [q[1:], h * rates[1:]]
        basis = _CUBIC
        if v is not None and a is not None:
            basis = _QUINTIC
            begin.append(h**2 * a[:-1])
            end.append(h**2 * a[1:])
        pieces = np.stack([*begin, *end])
        self._pieces = np.einsum("rp,rkn->kpn", basis, pieces)  # (k - 1, powers, n)
        self._powers = np.arange(len(basis[0]))

    @property
    def begin(self) -> float:
        """Time of the first point [s]."""
        return float(self._times[0])

    @property
    def end(self) -> float:
        """Time of the last point [s]."""
        return float(self._times[-1])

    def at(self, t: float) -> Reference:
        """Position, velocity and acceleration at a time [s]; fresh arrays."""
        if t >= self.end:
            return Reference(self._last_q, self._rest, self._rest)
        if t < self.begin:
            return Reference(self._first_q, self._rest, self._rest)
        k = int(np.searchsorted(self._times, t, side="right")) - 1
        h, powers, piece = self._h[k], self._powers, self._pieces[k]
        monomials = ((t - self._times[k]) / h) ** powers
        first = powers[1:] * monomials[:-1]
        second = powers[2:] * first[:-1]
        return Reference(
            monomials.dot(piece), first.dot(piece[1:]) / h, second.dot(piece[2:]) / h**2
        )

    def samples(self) -> tuple[Array, Array, Array]:
        """Times (m,), positions (m, n) and velocities (m, n), dense enough to see extremes."""
        parts, powers = np.linspace(0.0, 1.0, _SAMPLES, endpoint=False), self._powers
        inner = (self._times[:-1, None] + parts * self._h[:, None]).ravel()
        monomials = parts[:, None] ** powers
        first = powers[1:] * monomials[:, :-1]
        n = len(self._rest)
        q = np.einsum("sp,kpn->ksn", monomials, self._pieces).reshape(-1, n)
        v = np.einsum("sp,kpn,k->ksn", first, self._pieces[:, 1:], 1.0 / self._h).reshape(-1, n)
        return (
            np.append(inner, self.end),
            np.vstack([q, self._last_q]),
            np.vstack([v, self._rest]),
        )


def slopes(times: Array, q: Array) -> Array:
    """Velocities of points that have none: the mean slope of both sides, rest at both ends.

    Args:
        times: [s], shape (k,).
        q: [rad or m], shape (k, n).

    Returns:
        Fresh, shape (k, n).
    """
    v = np.zeros_like(q)
    if len(times) > 2:
        v[1:-1] = np.gradient(q, times, axis=0)[1:-1]
    return v
