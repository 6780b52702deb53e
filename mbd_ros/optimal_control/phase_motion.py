"""The motion of a phase: its unknowns in a program, their values between nodes, and its errors.

Inputs, multipliers, accelerations and rates are polynomials through their values at the points of
an interval; velocities, internal states and positions are integrals of these.

Errors hold a motion against an integral of its own rates at more points than it has. Source: M. A.
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
_LOOKS = 24  # at an interval


def _free_body() -> pin.Model:
    model = pin.Model()
    model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    return model


BODY = Chart(_free_body())


class PhaseMotion(NamedTuple):
    """Values of the unknowns of a phase.

    Attributes:
        mesh: The intervals, with the widths that were found.
        begin: [s].
        duration: [s].
        nodes: As `Unknowns.nodes`.
        points: As `Unknowns.points`, and d, the `steps` of free bodies.
        bases: Where free bodies stand in q and in v.
    """

    mesh: Mesh
    begin: float
    duration: float
    nodes: Mapping[str, Array]
    points: Mapping[str, Array]
    bases: tuple[tuple[int, int], ...] = ()

    def at(self, shares: Array) -> dict[str, Array]:
        """Values between the nodes, letter -> shape (n, ..).

        Args:
            shares: Of the duration, shape (n,).
        """
        i, s = self.mesh.find(np.asarray(shares, dtype=np.float64))
        found = {key: np.empty((len(s), self.points[key].shape[1])) for key in ("q", *"vzawul")}
        degrees, h = self.mesh.degrees[i], self.duration * self.mesh.widths[i]
        for degree in np.unique(degrees).tolist():
            rows, scheme = np.flatnonzero(degrees == degree), self.mesh.scheme_of(degree)
            k, values = i[rows], scheme.values(s[rows])
            own = self.mesh.first_points[k][:, None] + np.arange(degree)
            integrals = h[rows, None] * scheme.integrals(s[rows])
            for key in "awul":
                found[key][rows] = _summed(values, self.points[key][own])
            for key, rate in (("v", "a"), ("z", "w")):
                moved = _summed(integrals, self.points[rate][own])
                found[key][rows] = self.nodes[key][k] + moved
            found["q"][rows] = self._configurations(k, own, integrals)
        return found

    def _configurations(self, k: Numbers, own: Numbers, integrals: Array) -> Array:
        """At places of the intervals k with the points own, shape (m, nq)."""
        q, v = self.nodes["q"][k], self.points["v"]
        if not self.bases:
            moved: Array = q + _summed(integrals, v[own])
            return moved
        found = np.empty(q.shape)
        flat_q, flat_v = np.ones(q.shape[1], dtype=bool), np.ones(v.shape[1], dtype=bool)
        for i, (at_q, at_v) in enumerate(self.bases):
            flat_q[at_q : at_q + 7], flat_v[at_v : at_v + 6] = False, False
            used, place = np.unique(own, return_inverse=True)
            steps = self.points["d"][used, 6 * i : 6 * i + 6]
            pairs = zip(steps, v[used, at_v : at_v + 6], strict=True)
            rates = np.array([BODY.rate(d, one) for d, one in pairs])
            for row, d in enumerate(_summed(integrals, rates[place.reshape(own.shape)])):
                found[row, at_q : at_q + 7] = BODY.integrate(q[row, at_q : at_q + 7], d)
        found[:, flat_q] = q[:, flat_q] + _summed(integrals, v[:, flat_v][own])
        return found


def _summed(weights: Array, values: Array) -> Array:
    """Weights (m, k) times values (m, k, n), shape (m, n)."""
    found: Array = (weights[:, None] @ values)[:, 0]
    return found


class Unknowns:
    """Numbers of the unknowns of a phase; n intervals, m points.

    Args:
        first: Number of the first unknown.

    Attributes:
        nodes: q, v, z at ends of intervals, letter -> shape (n + 1, ..).
        points: q, v, z, a, w (rates of z), u, l (multipliers) at points, letter -> (m, ..).
        steps: Steps in the tangent of free bodies, from the beginning of an interval to its points
            and then to its end, shape (m + n, 6 bodies); points first.
        shifts: What closes rows again at ends of intervals: on q and v, shape (n, 2 nv).
        pulls: Its multipliers, shape (n, mg + mk).
        begin: Time at which the phase begins.
        duration: Of the phase.
        widths: Shares of the intervals, shape (n,).
        end: Number after the last unknown.
    """

    def __init__(self, sizes: Sizes, mesh: Mesh, first: int = 0) -> None:
        self.sizes, self.mesh, self.end = sizes, mesh, first
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
    """Numbers of a system.

    Attributes:
        nq: Of the configuration of what is integrated.
        nv: Of its velocity.
        m: Rows of accelerations, with a multiplier each.
        mg: Those of them that state positions, and depend on no others.
        mk: Those of them that depend on no others.
        bases: Where free bodies stand in q and in v.
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
    """Relative error of each interval, shape (n,).

    It is the largest of positions, velocities and internal states, relative to 1 + the largest
    value of each.

    Args:
        rates: Accelerations and rates of internal states that its states and inputs make.
    """
    mesh, found = motion.mesh, np.zeros(motion.mesh.intervals)
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
            some = values[state].reshape(len(chosen), len(places), -1)
            slope = rate.reshape(len(chosen), len(places), -1)[:, :-1]
            weights = np.vstack((finer.A, finer.b))
            integral = h[:, None, None] * np.einsum("jk,ikn->ijn", weights, slope)
            off = np.abs(motion.nodes[state][chosen][:, None] + integral - some) / sizes[state]
            found[chosen] = np.maximum(found[chosen], off.max(axis=(1, 2)))
    return found


def _sizes(motion: PhaseMotion) -> dict[str, Array]:
    return {key: 1.0 + np.abs(motion.nodes[key]).max(axis=0, initial=0.0) for key in ("v", "z")}


def intermediate_values(motion: PhaseMotion) -> tuple[Array, dict[str, Array]]:
    """Places between the points, as shares of the duration, and the motion there.

    Returns:
        Shape (n looks,), intervals one after the other, and letter -> values.
    """
    mesh, places = motion.mesh, (np.arange(_LOOKS) + 0.5) / _LOOKS
    shares = (mesh.knots[:-1, None] + mesh.widths[:, None] * places).ravel()
    return shares, motion.at(shares)


def beyond_bounds(values: Array, lower: Array, upper: Array) -> Array:
    """How far numbers pass their bounds at most in each interval, shape (n, k).

    Args:
        values: At the places of `intermediate_values`, shape (n looks, k).
        lower: Shape (k,).
        upper: Shape (k,).
    """
    off = np.maximum(np.maximum(lower - values, values - upper), 0.0)
    return off.reshape(-1, _LOOKS, values.shape[1]).max(axis=1)


def tangent_steps(
    mesh: Mesh, nodes: Array, points: Array, bases: tuple[tuple[int, int], ...]
) -> Array:
    """Steps of free bodies from the beginning of an interval to its points, and to its end.

    Args:
        nodes: Configurations at nodes.
        bases: Where the poses stand in them.

    Returns:
        As `Unknowns.steps`.
    """
    interval = np.repeat(np.arange(mesh.intervals), mesh.degrees)
    begins = np.concatenate((nodes[interval], nodes[:-1]))
    ends = np.concatenate((points, nodes[1:]))
    found = np.zeros((len(ends), 6 * len(bases)))
    for i, (at, _) in enumerate(bases):
        pairs = zip(begins[:, at : at + 7], ends[:, at : at + 7], strict=True)
        found[:, 6 * i : 6 * i + 6] = [BODY.difference(one, other) for one, other in pairs]
    return found
