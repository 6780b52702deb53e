"""Which rows of a phase follow from others, see `optimal_control.redundant_rows`."""

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.optimal_control.phase_equations import PhaseEquations
from mbd_ros.optimal_control.redundant_rows import Dependence

_DEPENDENT = 1.0e-6  # of the size of a row: what others leave of it
_CLOSED, _MOST = 1.0e-10, 50  # rad or m, Newton steps
_ASIDE, _TRIES = 0.2, 3  # rad or m from where the scene starts: rows may depend just there


def independent(equations: PhaseEquations, x: State, p: Array) -> PhaseEquations:
    """The equations without rows that depend on others.

    Args:
        equations: Of a phase.
        x: A state of what is integrated, near which the rows can hold.
        p: Parameters.
    """
    m, nv = equations.sizes.m, equations.sizes.nv
    if m < 2:
        return equations
    random, chart = np.random.default_rng(0), equations.equations.system.chart
    steps = [np.zeros(nv), *(_ASIDE * random.standard_normal((_TRIES, nv)))]
    best = Dependence((), np.zeros((0, m)), x.q)
    for number, step in enumerate(steps):
        q = _closed(equations, x.t, chart.integrate(x.q, step), p)
        found = best if q is None else _dependence(equations, x.t, q, p)
        if q is not None and (number == 0 or len(found.rows) < len(best.rows)):
            best = found
        if not best.rows:
            break
    return PhaseEquations(equations.equations, best)


def _closed(equations: PhaseEquations, t: float, q: Array, p: Array) -> Array | None:
    """The configuration near q in which the rows hold; None where none is found."""
    chart, still = equations.equations.system.chart, np.zeros(equations.sizes.nv)
    for _ in range(_MOST):
        g, J, _, _ = equations.rows_at(t, q, still, p)
        if np.abs(g).max(initial=0.0) < _CLOSED:
            return q
        q = chart.integrate(q, np.linalg.lstsq(J, -g, rcond=None)[0])
    return None


def _dependence(equations: PhaseEquations, t: float, q: Array, p: Array) -> Dependence:
    """Which rows are sums of rows before them."""
    J = equations.rows_at(t, q, np.zeros(equations.sizes.nv), p)[3]
    kept, rows, null = list[int](), list[int](), list[Array]()
    for i, row in enumerate(J):
        shares = np.linalg.lstsq(J[kept].T, row, rcond=None)[0] if kept else np.zeros(0)
        left = row - shares @ J[kept]
        if np.linalg.norm(left) > _DEPENDENT * np.linalg.norm(row):
            kept.append(i)
            continue
        rows.append(i)
        null.append(np.eye(len(J))[i])
        null[-1][kept] -= shares
    return Dependence(tuple(rows), np.array(null).reshape(-1, len(J)), q)
