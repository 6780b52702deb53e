"""Parts of a manifold that no motion along the rows joins."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.ensemble import Ensemble, Metropolis, stream
from mbd_ros.features.sampling.observables import Observable
from mbd_ros.features.sampling.space import Marks

_WALK_STEPS = 200  # of a walk, at most
_LONGEST = 0.02  # of the scale: change of a coordinate in a step of a walk
_STRAIGHT = 0.2  # of a step: how far the rows may bend it; more is a jump to another branch
_WEAK = 1.0e-6  # singular values beside the largest that count as none
_ARRIVED = 0.03  # of the spread of features
_PROBES = 24  # random starts
_SWEEPS = 130  # samples of the chain from each start
_STEPS = 5  # from sample to sample
_SHORT = 0.03  # of the scale: a step of a chain, too short to jump from one branch to another
_TRIES = 60  # of corrections towards the rows
_KEPT = 100  # samples of a chain from which walks begin and at which they end
_WALKS = 8  # from a chain to a component
_STREAM = 2**62  # of probes, apart from those of chains


def components(
    ensemble: Ensemble, q: Array, features: Sequence[Observable], seed: int
) -> Components:
    """Components of the manifold, as far as random starts find them.

    Chains without energies go out from random starts. Two of them are in the same component where
    a walk along the rows leads from one to the other.

    Args:
        ensemble: The ensemble; its walls count, its energies do not.
        q: Start of the scene, shape (size,).
        features: Quantities that are the same for configurations that are taken as one.
        seed: Of the random numbers.
    """
    flat = Ensemble(_Flat(ensemble), 1.0)
    starts = np.column_stack((q, random_starts(ensemble, q, _PROBES, seed)))
    clouds, at = _clouds(flat, starts, features, seed)
    group = _groups(flat, clouds, at, features)
    numbers = np.unique(group)
    walls = tuple(
        _wall(clouds, group, int(numbers[0]), int(other), features) for other in numbers[1:]
    )
    return Components(np.searchsorted(numbers, group), len(numbers), walls)


class _Flat:
    """A space without energies, where walls stay."""

    def __init__(self, ensemble: Ensemble) -> None:
        space = ensemble.space
        self.names = space.names
        self.size = space.size
        self.mass = space.mass
        self.blocks = space.blocks
        self.scale = space.scale
        self._space = space
        self.has_constant_masses = True

    def potential(self, q: Array) -> Array:
        """0, or infinite beyond a wall."""
        energy = self._space.potential(q)
        return np.where(np.isinf(energy), np.inf, 0.0)

    def force(self, q: Array) -> Array:
        """None."""
        return np.zeros(q.shape)

    def volume(self, q: Array, *, fixman: bool) -> Array:
        """None."""
        return np.zeros(q.shape[1])


def _clouds(
    flat: Ensemble, starts: Array, features: Sequence[Observable], seed: int
) -> tuple[Array, Array]:
    """Features of samples, (probes, samples, features), and these, (samples, size, probes)."""
    chains = starts.shape[1]
    at = flat.at(starts, np.zeros(starts.shape))
    step = _SHORT * flat.space.scale * float(np.sqrt(flat.space.mass.min()))
    method = Metropolis(flat, step)
    values, visited = [], []
    for k in range(_SWEEPS):
        at, _ = method.sweep(at, stream(seed, _STREAM, k + 1), _STEPS)
        if k >= _SWEEPS - _KEPT:
            values.append([feature.value(at.q) for feature in features])
            visited.append(at.q)
    return np.array(values).transpose(2, 0, 1).reshape(chains, _KEPT, -1), np.array(visited)


def _groups(
    flat: Ensemble, clouds: Array, at: Array, features: Sequence[Observable]
) -> NDArray[np.intp]:
    """Smallest number of a probe that is in the same component, for each probe.

    A component grows by the probes from which a walk arrives at a sample of it.
    """
    spread = clouds.reshape(-1, clouds.shape[2]).std(axis=0)
    used = spread > 1.0e-9 * max(float(spread.max()), 1.0e-300)
    informative, spread = [f for f, use in zip(features, used, strict=True) if use], spread[used]
    scaled = clouds[:, :, used] / spread
    group = np.full(len(clouds), -1)
    while (group < 0).any():
        first = int(np.flatnonzero(group < 0)[0])
        group[first], grown = first, [first]
        while grown and (group < 0).any():
            others = np.flatnonzero(group < 0)
            pairs = [_nearest(scaled, int(other), grown) for other in others]
            a, b = np.concatenate(pairs, axis=1)
            start, end = (at[i % _KEPT, :, i // _KEPT].T for i in (a, b))
            joins = (
                arrives(flat, start, end, informative, spread).reshape(len(others), -1).any(axis=1)
            )
            group[others[joins]] = first
            grown = others[joins].tolist()
    return group


def _nearest(scaled: Array, probe: int, others: Sequence[int]) -> Array:
    """Pairs of samples of a probe and of others, near ones and less near ones, (2, walks)."""
    every = np.concatenate([other * _KEPT + np.arange(_KEPT) for other in others])
    flat = scaled.reshape(-1, scaled.shape[2])[every]
    apart = _apart(scaled[probe], flat)
    nearest = np.argmin(apart, axis=1)
    order = np.argsort(apart[np.arange(_KEPT), nearest])
    chosen = order[np.linspace(0, _KEPT // 2, _WALKS).astype(int)]
    return np.array([probe * _KEPT + chosen, every[nearest[chosen]]])


def _apart(a: Array, b: Array) -> Array:
    """Squares of distances of all samples, shape (len(a), len(b))."""
    squares = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None, :] - 2.0 * a.dot(b.T)
    apart: Array = np.maximum(squares, 0.0)
    return apart


def arrives(
    ensemble: Ensemble,
    start: Array,
    end: Array,
    features: Sequence[Observable],
    spread: Array,
) -> Marks:
    """Which walks come to the features of their ends, shape (walks,).

    Steps are short, end on the rows and never cross a wall, so that one that arrives is a motion.

    Args:
        ensemble: Whose rows and walls count.
        start: Configurations, shape (size, walks).
        end: Configurations with the features that are looked for.
        spread: Their usual size, > 0.
    """
    wanted = np.array([feature.value(end) for feature in features]) / spread[:, None]
    q, longest = start, _LONGEST * ensemble.space.scale
    there, walks = np.zeros(start.shape[1], dtype=np.bool_), np.arange(start.shape[1])
    with np.errstate(all="ignore"):
        for _ in range(_WALK_STEPS):
            left = wanted - np.array([feature.value(q) for feature in features]) / spread[:, None]
            is_there = np.abs(left).max(axis=0) < _ARRIVED
            there[walks[is_there]] = True
            goes = ~is_there
            q, wanted, left, walks = q[:, goes], wanted[:, goes], left[:, goes], walks[goes]
            if not len(walks):
                break
            q, is_good = _stepped(ensemble, q, left, features, spread, longest)
            q, wanted, walks = q[:, is_good], wanted[:, is_good], walks[is_good]
    return there


def _stepped(
    ensemble: Ensemble,
    q: Array,
    left: Array,
    features: Sequence[Observable],
    spread: Array,
    longest: float,
) -> tuple[Array, Marks]:
    """Take a Gauss-Newton step along the constraints; also return whether it is possible."""
    manifold = ensemble.manifold
    places = manifold.at(q)
    slopes = np.array([manifold.project(places, feature.gradient(q)) for feature in features])
    slopes /= spread[:, None, None]
    inverse = np.linalg.pinv(np.nan_to_num(slopes).transpose(2, 0, 1), rcond=_WEAK)
    step = manifold.project(places, np.einsum("bik,kb->ib", inverse, left))
    size = np.abs(step).max(axis=0)
    step *= np.minimum(1.0, longest / np.maximum(size, 1.0e-300))
    there, is_good = manifold.close(places, q + step)
    bent = np.abs(there - q - step).max(axis=0)
    is_good &= bent <= _STRAIGHT * np.minimum(size, longest)
    return there, is_good & np.isfinite(ensemble.space.potential(there))


def _wall(
    clouds: Array, group: NDArray[np.intp], probe: int, other: int, features: Sequence[Observable]
) -> str:
    """Describe the feature that separates two components."""
    a = clouds[group == probe].reshape(-1, clouds.shape[2])
    b = clouds[group == other].reshape(-1, clouds.shape[2])
    spread = np.maximum(np.concatenate((a, b)).std(axis=0), 1.0e-300)
    above, below = (
        (a.min(axis=0) - b.max(axis=0)) / spread,
        (b.min(axis=0) - a.max(axis=0)) / spread,
    )
    gap = np.maximum(above, below)
    k = int(np.argmax(gap))
    ends = [f"{cloud[:, k].min():.4g} .. {cloud[:, k].max():.4g}" for cloud in (a, b)]
    if gap[k] <= 0.0:
        return "no single quantity tells them apart"
    unit = f" {features[k].unit}" if features[k].unit else ""
    return f"{features[k].name} is {ends[0]}{unit} in one and {ends[1]}{unit} in the other"


class Components(NamedTuple):
    """Components of a manifold, modulo what the features do not see.

    Attributes:
        of_probe: Number of the component of each random start, 0 that of the scene's start.
        number: How many there are.
        walls: What tells pairs of components apart, for people.
    """

    of_probe: NDArray[np.intp]
    number: int
    walls: tuple[str, ...]


def random_starts(ensemble: Ensemble, q: Array, count: int, seed: int) -> Array:
    """Configurations on the rows, far from a given one, shape (size, at most count).

    Args:
        q: The given one, shape (size,).
        count: How many are looked for.
        seed: Of the random numbers.
    """
    random, space = stream(seed, _STREAM, 0), ensemble.space
    far = q[:, None] + 2.0 * space.scale * random.standard_normal((space.size, count))
    is_closed: Marks = np.zeros(count, dtype=np.bool_)
    with np.errstate(all="ignore"):
        for _ in range(_TRIES):
            places = ensemble.manifold.at(far)
            far, is_closed = ensemble.manifold.close(places, far)
            if is_closed.all():
                break
            again = q[:, None] + 2.0 * space.scale * random.standard_normal((space.size, count))
            far = np.where(is_closed, far, again)
        is_closed = is_closed & np.isfinite(space.potential(far))
    return far[:, is_closed]
