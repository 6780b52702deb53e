"""Pairs of markers whose labels were exchanged, found by how much better they fit exchanged."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.estimation.marker_cost import Seen
from mbd_ros.core.estimation.marker_fit import Bools, Fit, Indices, MarkerFit, chosen
from mbd_ros.core.estimation.marker_trial import of_frames
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY

_SUSPECT = 0.15  # of the objective: what an exchange of a suspected pair should save
_BETTER = 0.9  # of the objective of a frame, once a pair is exchanged and fitted
_CONFIRMED = 0.75  # of the mean objective of such frames in a row
_SHORTEST = 3  # frames in a row
_MOST_PAIRS = 10  # that are fitted again, first in some frames
_PROBES = 3
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
    """Exchanges that lower the objective by much, in several frames in a row.

    Args:
        solver: Fits frames.
        fit: The frames as they are labelled.
        seen: What was seen.
    """
    found = []
    for pair, frames in _probed(solver, fit, seen):
        again = _fitted_again(solver, fit, seen, frames, [pair] * len(frames))
        is_better = again.objective < _BETTER * fit.objective[frames]
        for run in _runs(frames[is_better]):
            kept = np.isin(frames, run)
            before, after = fit.objective[run].mean(), again.objective[kept].mean()
            if after < _CONFIRMED * before:
                ends = int(run[0]), int(run[-1])
                found.append(Exchange(*pair, ends, float(before), float(after)))
    return _without_copies(found)


def _probed(solver: MarkerFit, fit: Fit, seen: Seen) -> list[tuple[Pair, Indices]]:
    """Suspected pairs that fit better exchanged in some of their frames."""
    suspects = _suspects(solver, fit, seen)
    if not suspects:
        return []
    some = [f[np.linspace(0, len(f) - 1, _PROBES).astype(np.intp)] for _, f in suspects]
    frames, pairs = np.concatenate(some), [pair for pair, _ in suspects for _ in range(_PROBES)]
    again = _fitted_again(solver, fit, seen, frames, pairs)
    is_better: Bools = (again.objective < _BETTER * fit.objective[frames]).reshape(-1, _PROBES)
    return [one for one, better in zip(suspects, is_better.tolist(), strict=True) if any(better)]


def _fitted_again(
    solver: MarkerFit, fit: Fit, seen: Seen, frames: Indices, pairs: Sequence[Pair]
) -> Fit:
    """Some frames with a pair exchanged in each."""
    part, at = seen.of(frames), np.arange(len(frames))[:, None]
    these = np.array(pairs)
    places = part.places.copy()
    places[at, these] = part.places[at, these[:, ::-1]]
    part = part._replace(places=places)
    own = solver.fit(fit.q[frames], part, far=True)
    best = fit.q[[int(np.argmin(fit.objective))]]  # an exchange may have turned a whole link
    other = solver.fit(np.repeat(best, len(frames), axis=0), part, far=True)
    return chosen(own, other, other.objective < own.objective)


def _suspects(solver: MarkerFit, fit: Fit, seen: Seen) -> list[tuple[Pair, Indices]]:
    """Pairs that should fit better exchanged, best first, and the frames."""
    n, saved = fit.misses.shape[1], []
    for i in range(0, len(fit.q) if n > 1 else 0, _CHUNK):
        part = slice(i, i + _CHUNK)
        saved.append(_savings(solver, of_frames(fit, part), seen.of(part)))
    if not saved:
        return []
    every = np.concatenate(saved)  # (N, n, n)
    suspected = every > _SUSPECT
    counts = suspected.sum(axis=0)
    shares = np.where(suspected, every, 0.0).sum(axis=0) / np.maximum(counts, 1)
    pairs = [pair for pair in itertools.combinations(range(n), 2) if counts[pair] >= _SHORTEST]
    pairs.sort(key=lambda pair: -float(shares[pair]))
    return [(pair, np.flatnonzero(suspected[:, pair[0], pair[1]])) for pair in pairs[:_MOST_PAIRS]]


def _savings(solver: MarkerFit, fit: Fit, seen: Seen) -> Array:
    """Share of the objective that an exchange should save, shape (N, n, n).

    That is what it changes at the same pose, and half the square of the new slope over the
    Hessian, since the pose follows.
    """
    w, places = seen.weights, seen.places
    apart = places[:, :, None] - places[:, None]  # (N, n, n, 3)
    left = fit.misses[:, :, None] + apart
    own = (fit.misses**2).sum(axis=2)
    changed = w[:, :, None] * ((left**2).sum(axis=3) - own[:, :, None])
    saved = -0.5 * (changed + changed.transpose(0, 2, 1))
    flat = solver.cost.at(fit.q, seen, np.zeros(len(fit.q))).hessian
    pull = w[:, :, None, None] * solver.cost.rows(fit.q)  # (N, n, 3, ny)
    size = np.trace(flat, axis1=1, axis2=2)[:, None, None]
    root = np.linalg.cholesky(flat + (_FLOOR * size + TINY) * np.eye(flat.shape[1]))
    by_root = np.linalg.solve(root[:, None], pull.transpose(0, 1, 3, 2))  # (N, n, ny, 3)
    each = by_root[:, :, None] @ apart[..., None]  # of one marker moved, (N, n, n, ny, 1)
    saved += 0.5 * ((each + each.transpose(0, 2, 1, 3, 4)) ** 2).sum(axis=(3, 4))
    both = (w > 0.0)[:, :, None] & (w > 0.0)[:, None]
    objective = np.maximum(fit.objective, TINY)[:, None, None]
    return np.array(np.where(both, saved / objective, 0.0))


def _runs(frames: Indices) -> list[Indices]:
    """Runs of frames that follow one another, without short ones."""
    parts = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1)
    return [part for part in parts if len(part) >= _SHORTEST]


def _without_copies(found: list[Exchange]) -> list[Exchange]:
    """Of exchanges that share a marker at the same time, the one that leaves least."""
    kept: list[Exchange] = []
    for one in sorted(found, key=lambda each: each.after / each.before):
        clash = any(
            {one.first, one.second} & {other.first, other.second}
            and one.frames[0] <= other.frames[1]
            and other.frames[0] <= one.frames[1]
            for other in kept
        )
        if not clash:
            kept.append(one)
    return sorted(kept, key=lambda each: each.frames)
