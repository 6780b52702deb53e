"""Parts of a manifold that no motion along the rows joins: chains that never meet."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.ensembles.ensemble import Ensemble
from mbd_ros.core.ensembles.metropolis import Metropolis
from mbd_ros.core.ensembles.observables import Observable
from mbd_ros.core.ensembles.random_streams import stream
from mbd_ros.core.state import Array

_PROBES, _SWEEPS, _STEPS = 24, 200, 4
_ACCEPTED = 0.8
_TRIES = 60  # of corrections towards the rows
_NEAR = 3.0  # times the usual distance to the next sample of the same chain: they have met
_KEPT = 150  # samples of a chain that are compared
_STREAM = 2**62  # of probes, apart from those of chains


class Components(NamedTuple):
    """Components of a manifold, modulo what the features do not see.

    Attributes:
        of_probe: Number of the component of each random start, 0 that of the scene's start.
        count: How many there are.
        walls: What tells pairs of components apart, for people.
    """

    of_probe: Array
    count: int
    walls: tuple[str, ...]


class _Flat:
    """A space without energies, where walls stay."""

    def __init__(self, ensemble: Ensemble) -> None:
        space = ensemble.space
        self.names, self.size, self.mass = space.names, space.size, space.mass
        self.blocks, self.scale, self._space = space.blocks, space.scale, space
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


def random_starts(ensemble: Ensemble, q: Array, count: int, seed: int) -> Array:
    """Configurations on the rows, far from a given one, shape (size, at most count).

    Args:
        ensemble: The ensemble.
        q: The given one, shape (size,).
        count: How many are looked for.
        seed: Of the random numbers.
    """
    random, space = stream(seed, _STREAM, 0), ensemble.space
    far = q[:, None] + 2.0 * space.scale * random.standard_normal((space.size, count))
    found = np.zeros(count, dtype=np.bool_)
    with np.errstate(all="ignore"):
        for _ in range(_TRIES):
            places = ensemble.manifold.at(far)
            far, found = ensemble.manifold.close(places, far)
            if found.all():
                break
            again = q[:, None] + 2.0 * space.scale * random.standard_normal((space.size, count))
            far = np.where(found, far, again)
        found &= np.isfinite(space.potential(far))
    return far[:, found]


def components(
    ensemble: Ensemble, q: Array, features: Sequence[Observable], seed: int
) -> Components:
    """Components of the manifold, as far as random starts find them.

    Chains without energies go out from random starts; chains that come near each other are in the
    same component.

    Args:
        ensemble: The ensemble; its walls count, its energies do not.
        q: Start of the scene, shape (size,).
        features: Quantities that are the same for configurations that are taken as one.
        seed: Of the random numbers.
    """
    flat = Ensemble(_Flat(ensemble), 1.0)
    starts = np.column_stack((q, random_starts(ensemble, q, _PROBES, seed)))
    clouds = _clouds(flat, starts, features, seed)
    group = _groups(clouds)
    numbers = np.unique(group)
    walls = tuple(
        _wall(clouds, group, int(numbers[0]), int(other), features) for other in numbers[1:]
    )
    return Components(np.searchsorted(numbers, group), len(numbers), walls)


def _clouds(
    flat: Ensemble, starts: Array, features: Sequence[Observable], seed: int
) -> Array:
    """Features of samples, shape (probes, samples, features)."""
    chains = starts.shape[1]
    at = flat.at(starts, np.zeros(starts.shape))
    method = Metropolis(flat, 0.05 * flat.space.scale * float(np.sqrt(flat.space.mass.min())))
    found = []
    for k in range(_SWEEPS):
        at, accepted = method.sweep(at, stream(seed, _STREAM, k + 1), _STEPS)
        method.dt *= np.exp((accepted.mean() - _ACCEPTED) / (1.0 + k) ** 0.6)
        found.append([feature.value(at.q) for feature in features])
    return np.array(found).transpose(2, 0, 1).reshape(chains, _SWEEPS, -1)


def _groups(clouds: Array) -> Array:
    """Smallest number of a probe that is in the same component, for each probe."""
    spread = clouds.reshape(-1, clouds.shape[2]).std(axis=0)
    used = spread > 1.0e-9 * max(float(spread.max()), 1.0e-300)
    scaled = (clouds / np.where(used, spread, 1.0))[:, :, used]
    few = scaled[:, -_KEPT:]
    usual = np.array([_usual_gap(cloud) for cloud in few])
    group = np.arange(len(clouds))
    for i in range(len(few)):
        for j in range(i + 1, len(few)):
            if group[i] == group[j]:
                continue
            nearest = np.sqrt(_apart(few[i], few[j]).min())
            if nearest <= _NEAR * max(usual[i], usual[j], 1.0e-6):
                group[group == max(group[i], group[j])] = min(group[i], group[j])
    return group


def _usual_gap(cloud: Array) -> float:
    """Usual distance from a sample to the next one of the same chain."""
    apart = _apart(cloud, cloud)
    np.fill_diagonal(apart, np.inf)
    return float(np.sqrt(np.quantile(apart.min(axis=1), 0.9)))


def _apart(a: Array, b: Array) -> Array:
    """Squares of distances of all samples, shape (len(a), len(b))."""
    squares = (a * a).sum(axis=1)[:, None] + (b * b).sum(axis=1)[None, :] - 2.0 * a.dot(b.T)
    apart: Array = np.maximum(squares, 0.0)
    return apart


def _wall(
    clouds: Array, group: Array, one: int, other: int, features: Sequence[Observable]
) -> str:
    """What tells two components apart."""
    a = clouds[group == one].reshape(-1, clouds.shape[2])
    b = clouds[group == other].reshape(-1, clouds.shape[2])
    spread = np.maximum(np.concatenate((a, b)).std(axis=0), 1.0e-300)
    above, below = (a.min(axis=0) - b.max(axis=0)) / spread, (b.min(axis=0) - a.max(axis=0)) / spread
    gap = np.maximum(above, below)
    k = int(np.argmax(gap))
    ends = [f"{cloud[:, k].min():.4g} .. {cloud[:, k].max():.4g}" for cloud in (a, b)]
    if gap[k] <= 0.0:
        return "no single quantity tells them apart"
    unit = f" {features[k].unit}" if features[k].unit else ""
    return f"{features[k].name} is {ends[0]}{unit} in one and {ends[1]}{unit} in the other"
