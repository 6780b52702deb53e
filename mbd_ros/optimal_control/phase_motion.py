"""The motion of a phase: unknowns of a program, values between nodes, and collocation errors.

Inputs, multipliers, accelerations and rates are polynomials through their values at the points of
an interval; velocities, internal states and positions are integrals of these.

Errors compare a motion with the integral of its rates at more points than it has. Source: M. A.
Patterson, W. W. Hager, A. V. Rao, A ph mesh refinement method for optimal control, Optimal Control
Applications and Methods 36, 2015, sec. 3.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.dynamics.chart import Chart
from mbd_ros.core.state import Array
from mbd_ros.optimal_control.mesh import Mesh, Numbers

# shares (m,), then q, v, z, u of each -> accelerations (m, nv), rates of internal states (m, nz)
Rates = Callable[[Array, dict[str, Array]], tuple[Array, Array]]
_PLACES = 24  # per interval, between its points


def _free_body() -> pin.Model:
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    return model


BODY = Chart(_free_body())


class PhaseMotion(NamedTuple):
    """Values of the unknowns of a phase.

    Attributes:
        mesh: The intervals.
        begin: Time at which the phase begins [s].
        duration: Duration [s].
        nodes: Values of `Unknowns.nodes`.
        points: Values of `Unknowns.points`, and of `Unknowns.steps` as letter d.
        bases: Indices of free bodies in q and in v.
    """

    mesh: Mesh
    begin: float
    duration: float
    nodes: Mapping[str, Array]
    points: Mapping[str, Array]
    bases: tuple[tuple[int, int], ...] = ()

    def at(self, shares: Array) -> dict[str, Array]:
        """Return values between the nodes, letter -> shape (n, ..).

        Args:
            shares: Shares of the duration, shape (n,).
        """
        i, s = self.mesh.find(np.asarray(shares, dtype=np.float64))
        between = {key: np.empty((len(s), self.points[key].shape[1])) for key in ("q", *"vzawul")}
        degrees, h = self.mesh.degrees[i], self.duration * self.mesh.widths[i]
        for degree in np.unique(degrees).tolist():
            rows, scheme = np.flatnonzero(degrees == degree), self.mesh.scheme_of(degree)
            k, values = i[rows], scheme.values(s[rows])
            points = self.mesh.first_points[k][:, None] + np.arange(degree)
            integrals = h[rows, None] * scheme.integrals(s[rows])
            for key in "awul":
                between[key][rows] = _weighted_sum(values, self.points[key][points])
            for key, rate in (("v", "a"), ("z", "w")):
                change = _weighted_sum(integrals, self.points[rate][points])
                between[key][rows] = self.nodes[key][k] + change
            between["q"][rows] = self._configurations(k, points, integrals)
        return between

    def _configurations(self, k: Numbers, points: Numbers, integrals: Array) -> Array:
        """Return configurations in the intervals k with the given points, shape (m, nq)."""
        q, v = self.nodes["q"][k], self.points["v"]
        if not self.bases:
            flat: Array = q + _weighted_sum(integrals, v[points])
            return flat
        configurations = np.empty(q.shape)
        flat_q, flat_v = np.ones(q.shape[1], dtype=bool), np.ones(v.shape[1], dtype=bool)
        for i, (at_q, at_v) in enumerate(self.bases):
            flat_q[at_q : at_q + 7], flat_v[at_v : at_v + 6] = False, False
            used, place = np.unique(points, return_inverse=True)
            steps = self.points["d"][used, 6 * i : 6 * i + 6]
            pairs = zip(steps, v[used, at_v : at_v + 6], strict=True)
            rates = np.array([BODY.rate(d, twist) for d, twist in pairs])
            rates = rates[place.reshape(points.shape)]
            for row, d in enumerate(_weighted_sum(integrals, rates)):
                configurations[row, at_q : at_q + 7] = BODY.integrate(q[row, at_q : at_q + 7], d)
        change = _weighted_sum(integrals, v[:, flat_v][points])
        configurations[:, flat_q] = q[:, flat_q] + change
        return configurations


def _weighted_sum(weights: Array, values: Array) -> Array:
    """Return weights (m, k) times values (m, k, n), shape (m, n)."""
    sums: Array = (weights[:, None] @ values)[:, 0]
    return sums


class Unknowns:
    """Indices of the unknowns of a phase in a program, for n intervals with m points.

    Args:
        sizes: Sizes of the system.
        mesh: The intervals.
        first: Index of the first unknown.

    Attributes:
        nodes: q, v, z at ends of intervals, letter -> shape (n + 1, ..).
        points: q, v, z, a, w (rates of z), u, l (multipliers) at points, letter -> (m, ..).
        steps: Steps in the tangent of free bodies, from the beginning of an interval to its points
            and then to its end, shape (m + n, 6 bodies); points first.
        shifts: Changes of q and v that satisfy the rows at ends of intervals, shape (n, 2 nv).
        pulls: Multipliers of the shifts, shape (n, mg + mk).
        begin: Time at which the phase begins.
        duration: Duration of the phase.
        widths: Shares of the intervals, shape (n,).
        end: Index after the last unknown.
    """

    def __init__(self, sizes: Sizes, mesh: Mesh, first: int = 0) -> None:
        self.sizes = sizes
        self.mesh = mesh
        self.end = first
        n, m = mesh.intervals, int(mesh.degrees.sum())
        of_state = {"q": sizes.nq, "v": sizes.nv, "z": sizes.nz}
        at_point = of_state | {"a": sizes.nv, "w": sizes.nz, "u": sizes.nu, "l": sizes.m}
        self.nodes = {key: self._some(n + 1, size) for key, size in of_state.items()}
        self.points = {key: self._some(m, size) for key, size in at_point.items()}
        self.steps = self._some(m + n, 6 * len(sizes.bases))
        closed = n if sizes.m else 0
        self.shifts = self._some(closed, 2 * sizes.nv)
        self.pulls = self._some(closed, sizes.mg + sizes.mk)
        self.begin, self.duration = (int(self._some(1, 1)[0, 0]) for _ in range(2))
        self.widths = self._some(n, 1)[:, 0]

    @property
    def state(self) -> Numbers:
        """q, v, z at nodes, shape (n + 1, nq + nv + nz)."""
        return np.hstack([self.nodes[key] for key in "qvz"])

    def _some(self, rows: int, columns: int) -> Numbers:
        begin, self.end = self.end, self.end + rows * columns
        return np.arange(begin, self.end, dtype=np.intp).reshape(rows, columns)


class Sizes(NamedTuple):
    """Sizes of a system.

    Attributes:
        nq: Size of the configuration, as integrated.
        nv: Size of the velocity, as integrated.
        nz: Number of internal states.
        nu: Number of inputs.
        m: Number of acceleration rows, with one multiplier each.
        mg: Number of position rows that are not redundant.
        mk: Number of all rows that are not redundant.
        bases: Indices of free bodies in q and in v.
    """

    nq: int
    nv: int
    nz: int
    nu: int
    m: int = 0
    mg: int = 0
    mk: int = 0
    bases: tuple[tuple[int, int], ...] = ()


def collocation_errors(motion: PhaseMotion, rates: Rates) -> Array:
    """Return the relative error of each interval, shape (n,).

    It is the largest error of velocities and internal states, relative to 1 + the largest
    value of each.

    Args:
        rates: Function from states and inputs to accelerations and rates of internal states.
    """
    mesh, errors = motion.mesh, np.zeros(motion.mesh.intervals)
    knots, sizes = mesh.knots, _sizes(motion)
    for degree in np.unique(mesh.degrees).tolist():
        chosen = np.flatnonzero(mesh.degrees == degree)
        finer = mesh.scheme_of(degree).finer
        places = np.append(finer.c, 1.0)
        shares = knots[chosen][:, None] + mesh.widths[chosen][:, None] * places
        shares = np.minimum(shares, np.nextafter(knots[chosen + 1][:, None], 0.0))
        values = motion.at(shares.ravel())
        a, w = rates(shares.ravel(), values)
        h = motion.duration * mesh.widths[chosen]
        for state, rate in (("v", a), ("z", w)):
            if not values[state].shape[1]:
                continue
            states = values[state].reshape(len(chosen), len(places), -1)
            slope = rate.reshape(len(chosen), len(places), -1)[:, :-1]
            weights = np.vstack((finer.A, finer.b))
            integral = h[:, None, None] * np.einsum("jk,ikn->ijn", weights, slope)
            error = np.abs(motion.nodes[state][chosen][:, None] + integral - states)
            error = error / sizes[state]
            errors[chosen] = np.maximum(errors[chosen], error.max(axis=(1, 2)))
    return errors


def _sizes(motion: PhaseMotion) -> dict[str, Array]:
    return {key: 1.0 + np.abs(motion.nodes[key]).max(axis=0, initial=0.0) for key in ("v", "z")}


def intermediate_values(motion: PhaseMotion) -> tuple[Array, dict[str, Array]]:
    """Return places between the points, as shares of the duration, and the motion there.

    Returns:
        Shares, shape (n places,), interval by interval, and letter -> values.
    """
    mesh, places = motion.mesh, (np.arange(_PLACES) + 0.5) / _PLACES
    shares = (mesh.knots[:-1, None] + mesh.widths[:, None] * places).ravel()
    return shares, motion.at(shares)


def beyond_bounds(values: Array, lower: Array, upper: Array) -> Array:
    """Return the largest violation of bounds in each interval, shape (n, k).

    Args:
        values: Values at the places of `intermediate_values`, shape (n places, k).
        lower: Lower bounds, shape (k,).
        upper: Upper bounds, shape (k,).
    """
    violation = np.maximum(np.maximum(lower - values, values - upper), 0.0)
    return violation.reshape(-1, _PLACES, values.shape[1]).max(axis=1)


def tangent_steps(
    mesh: Mesh, nodes: Array, points: Array, bases: tuple[tuple[int, int], ...]
) -> Array:
    """Return the steps of free bodies from the begin of an interval to its points and its end.

    Args:
        nodes: Configurations at nodes.
        points: Configurations at points.
        bases: Indices of the poses in configurations.

    Returns:
        Values of `Unknowns.steps`.
    """
    interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
    begins = np.concatenate((nodes[interval], nodes[:-1]))
    ends = np.concatenate((points, nodes[1:]))
    steps = np.zeros((len(ends), 6 * len(bases)))
    for i, (at, _) in enumerate(bases):
        pairs = zip(begins[:, at : at + 7], ends[:, at : at + 7], strict=True)
        steps[:, 6 * i : 6 * i + 6] = [BODY.difference(*pair) for pair in pairs]
    return steps
