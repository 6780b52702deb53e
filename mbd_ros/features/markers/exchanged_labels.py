"""Pairs of markers whose labels were exchanged, found by how much better they fit exchanged."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.features.markers.marker_cost import Seen
from mbd_ros.features.markers.marker_fit import Bools, Fit, Indices, MarkerFit, chosen
from mbd_ros.features.markers.marker_trial import of_frames

_SUSPECT = 0.15  # of the objective: what an exchange of a suspected pair should save
_BETTER = 0.9  # of the objective of a frame, once a pair is exchanged and fitted
_CONFIRMED = 0.75  # of the mean objective of such frames in a row
_SHORTEST = 3  # frames in a row
_MOST_PAIRS = 10  # that are fitted again, first in some frames
_PROBES = 3
_POOR = 1.5  # times the median objective: a frame that fits badly
_CHUNK = 50  # frames at once
_FLOOR = 1.0e-9  # of the trace of the Hessian, so that it is regular
Pair = tuple[int, int]


class Exchange(NamedTuple):
    """Two markers whose labels were exchanged for some time.

    Attributes:
        first: Number of one marker.
        second: Number of the other one.
        frames: First and last frame, both included.
        before: Mean objective of these frames as labelled [m^2].
        after: Mean objective with the two exchanged [m^2].
    """

    first: int
    second: int
    frames: tuple[int, int]
    before: float
    after: float


def exchanged_labels(solver: MarkerFit, fit: Fit, seen: Seen) -> list[Exchange]:
    """Find exchanges of two labels that lower the objective much in several successive frames.

    Args:
        solver: Solver of the frames.
        fit: Fit of the frames with their labels.
        seen: Measured markers.
    """
    exchanges = []
    for pair, frames in _probed(solver, fit, seen):
        again = _fitted_again(solver, fit, seen, frames, [pair] * len(frames))
        is_better = again.objective < _BETTER * fit.objective[frames]
        for run in _runs(frames[is_better]):
            in_run = np.isin(frames, run)
            before, after = fit.objective[run].mean(), again.objective[in_run].mean()
            if after < _CONFIRMED * before:
                ends = int(run[0]), int(run[-1])
                exchanges.append(Exchange(*pair, ends, float(before), float(after)))
    return _without_copies(exchanges)


def _probed(solver: MarkerFit, fit: Fit, seen: Seen) -> list[tuple[Pair, Indices]]:
    """Return suspected pairs that fit better when exchanged in some of their frames."""
    suspects = _suspects(solver, fit, seen)
    if not suspects:
        return []
    some = [f[np.linspace(0, len(f) - 1, _PROBES).astype(np.intp)] for _, f in suspects]
    frames, pairs = np.concatenate(some), [pair for pair, _ in suspects for _ in range(_PROBES)]
    again = _fitted_again(solver, fit, seen, frames, pairs)
    is_better: Bools = (again.objective < _BETTER * fit.objective[frames]).reshape(-1, _PROBES)
    return [
        suspect
        for suspect, better in zip(suspects, is_better.tolist(), strict=True)
        if any(better)
    ]


def _fitted_again(
    solver: MarkerFit, fit: Fit, seen: Seen, frames: Indices, pairs: Sequence[Pair]
) -> Fit:
    """Fit some frames again, with a pair of labels exchanged in each."""
    part, at = seen.of(frames), np.arange(len(frames))[:, None]
    these = np.array(pairs)
    places = part.places.copy()
    places[at, these] = part.places[at, these[:, ::-1]]
    part = part._replace(places=places)
    from_fit = solver.fit(fit.q[frames], part, far=True)
    usual = _usual(solver, fit, seen)[frames]  # an exchange may have turned a whole link
    other = solver.fit(usual, part, far=True)
    return chosen(from_fit, other, other.objective < from_fit.objective)


def _suspects(solver: MarkerFit, fit: Fit, seen: Seen) -> list[tuple[Pair, Indices]]:
    """Return pairs that should fit better when exchanged, best first, and their frames."""
    n = fit.misses.shape[1]
    if n < 2:
        return []
    every = _savings(solver, fit, seen, fit.q)  # (N, n, n)
    poor = np.flatnonzero(fit.objective > _POOR * np.median(fit.objective))
    if len(poor) >= _SHORTEST:
        usual = _usual(solver, fit, seen)[poor]
        more = _savings(solver, of_frames(fit, poor), seen.of(poor), usual)
        every[poor] = np.maximum(every[poor], more)
    suspected = every > _SUSPECT
    counts = suspected.sum(axis=0)
    shares = np.where(suspected, every, 0.0).sum(axis=0) / np.maximum(counts, 1)
    pairs = [pair for pair in itertools.combinations(range(n), 2) if counts[pair] >= _SHORTEST]
    pairs.sort(key=lambda pair: -float(shares[pair]))
    return [(pair, np.flatnonzero(suspected[:, pair[0], pair[1]])) for pair in pairs[:_MOST_PAIRS]]


def _savings(solver: MarkerFit, fit: Fit, seen: Seen, q: Array) -> Array:
    """The shares below, some frames at a time."""
    parts = []
    for i in range(0, len(q), _CHUNK):
        part = slice(i, i + _CHUNK)
        own = None if q is fit.q else q[part]
        parts.append(_shares(solver, of_frames(fit, part), seen.of(part), own))
    return np.concatenate(parts)


def _shares(solver: MarkerFit, fit: Fit, seen: Seen, q: Array | None) -> Array:
    """Share of the objective that an exchange should save, shape (N, n, n).

    That is the objective of the fit less the one that is expected: what an exchange leaves at a
    pose q, less half the square of its slope over the Hessian, since the pose follows. At the fit
    itself, where none is given, its slope counts as 0: limits may hold what is left of it.
    """
    w, places, is_fit = seen.weights, seen.places, q is None
    q = fit.q if q is None else q
    cost = solver.cost.at(q, seen, np.zeros(len(q)))
    apart = places[:, :, None] - places[:, None]  # (N, n, n, 3)
    left = cost.misses[:, :, None] + apart
    own = (cost.misses**2).sum(axis=2)
    changed = w[:, :, None] * ((left**2).sum(axis=3) - own[:, :, None])
    pull = w[:, :, None, None] * solver.cost.rows(q)  # (N, n, 3, ny)
    size = np.trace(cost.hessian, axis1=1, axis2=2)[:, None, None]
    floor = (_FLOOR * size + TINY) * np.eye(cost.hessian.shape[1])
    root = np.linalg.cholesky(cost.hessian + floor)
    by_root = np.linalg.solve(root[:, None], pull.transpose(0, 1, 3, 2))  # (N, n, ny, 3)
    each = (by_root[:, :, None] @ apart[..., None])[..., 0]  # of one marker, (N, n, n, ny)
    both = each + each.transpose(0, 2, 1, 3)
    if not is_fit:
        both = both + np.linalg.solve(root, cost.slope[:, :, None])[:, None, None, :, 0]
    expected = cost.value[:, None, None] + 0.5 * (changed + changed.transpose(0, 2, 1))
    expected -= 0.5 * (both**2).sum(axis=3)
    objective = np.maximum(fit.objective, TINY)[:, None, None]
    shown = (w > 0.0)[:, :, None] & (w > 0.0)[:, None]
    return np.array(np.where(shown, 1.0 - expected / objective, 0.0))


def _usual(solver: MarkerFit, fit: Fit, seen: Seen) -> Array:
    """Poses between those of frames that fit well, shape (N, nq)."""
    good = fit.objective <= _POOR * np.median(fit.objective)
    if fit.q.shape[1] != solver.cost.ancestry.shape[0]:  # turns of free bodies are not mixed
        return np.repeat(fit.q[[int(np.argmin(fit.objective))]], len(fit.q), axis=0)
    known = seen.times[good]
    between = [np.interp(seen.times, known, column[good]) for column in fit.q.T]
    return solver.cost.coupled(np.column_stack(between))


def _runs(frames: Indices) -> list[Indices]:
    """Return runs of successive frames, without short ones."""
    parts = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return [part for part in parts if len(part) >= _SHORTEST]


def _without_copies(exchanges: list[Exchange]) -> list[Exchange]:
    """Among simultaneous exchanges that share a marker, keep the one that reduces most."""
    distinct: list[Exchange] = []
    for exchange in sorted(exchanges, key=lambda each: each.after / each.before):
        clash = any(
            {exchange.first, exchange.second} & {other.first, other.second}
            and exchange.frames[0] <= other.frames[1]
            and other.frames[0] <= exchange.frames[1]
            for other in distinct
        )
        if not clash:
            distinct.append(exchange)
    return sorted(distinct, key=lambda each: each.frames)
