"""Particles as what is sampled."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from mbd_ros.core.particles.elastic import ElasticBond
from mbd_ros.core.particles.molecules import Molecules
from mbd_ros.core.particles.row_geometry import DistanceRow, SurfaceRow
from mbd_ros.core.state import Array
from mbd_ros.features.sampling import observables
from mbd_ros.features.sampling.observables import Observable
from mbd_ros.features.sampling.particle_space import ParticleSpace
from mbd_ros.features.sampling.sampled_scene import SampledScene

_COMPARED = 7  # points of a molecule of which all pairs are compared


def sampled_particles(scene: Any) -> SampledScene:
    """What of a scene of particles is sampled."""
    system, units = scene.system(), scene.units
    space = ParticleSpace(system.kinds, system.pairs)
    firsts = list(_firsts(system.kinds))
    bends = [one for kind, first in firsts for one in _bends(kind, first)]
    features = [one for kind, first in firsts for one in _features(kind, first, units.length)]
    return SampledScene(
        scene.name,
        space,
        scene.initial.q,
        units.boltzmann,
        units.energy,
        system.names,
        units.length,
        tuple(bends),
        tuple(features),
    )


def _firsts(kinds: tuple[Molecules, ...]) -> Iterator[tuple[Molecules, int]]:
    """Each kind with the number of its first point."""
    first = 0
    for kind in kinds:
        yield kind, first
        first += kind.size


def _bends(kind: Molecules, first: int) -> Iterator[Observable]:
    """Cosines between bonds of the first molecule that share a point."""
    every = (*kind.rows, *kind.terms)
    bonds = [(b.i, b.j) for b in every if isinstance(b, DistanceRow | ElasticBond)]
    bonds = [(min(pair), max(pair)) for pair in bonds]
    for one, other in itertools.combinations(sorted(set(bonds)), 2):
        shared = set(one) & set(other)
        if len(shared) == 1:
            (b,) = shared
            (a,), (c,) = set(one) - shared, set(other) - shared
            if (min(a, c), max(a, c)) not in bonds:
                names = kind.labels
                name = f"cosine_{names[a]}_{names[b]}_{names[c]}"
                yield observables.cosine(name, first + a, first + b, first + c)


def _features(kind: Molecules, first: int, unit: str) -> Iterator[Observable]:
    """What stays when molecules move as rigid bodies; all coordinates of those on surfaces."""
    names, n = kind.labels, len(kind.atoms)
    surfaces = [row for row in kind.rows if isinstance(row, SurfaceRow)]
    normal = _plane(surfaces, n)
    if surfaces and normal is None:
        for i in range(n):
            for k, axis in enumerate("xyz"):
                yield observables.coordinate(f"{names[i]}.{axis}", unit, 3 * (first + i) + k)
        return
    numbers = range(n)
    near = numbers if n <= _COMPARED else range(0)
    for pair in itertools.combinations(near, 2):
        label = "_".join(names[i] for i in pair)
        yield observables.distance(f"distance_{label}", unit, *(first + i for i in pair))
    size = 4 if normal is None else 3
    every = itertools.combinations(numbers, size)
    runs = (tuple(range(i, i + size)) for i in range(n - size + 1))
    for group in every if n <= _COMPARED else runs:
        label, points = "_".join(names[i] for i in group), [first + i for i in group]
        if normal is None:
            yield observables.volume(f"volume_{label}", f"{unit}^3", points)
        else:
            yield observables.area(f"area_{label}", f"{unit}^2", points, normal)


def _plane(surfaces: list[SurfaceRow], atoms: int) -> Array | None:
    """Normal of the plane that holds all atoms; None where none does."""
    planes = [row for row in surfaces if not row.squares.any()]
    if len(planes) < len(surfaces) or {row.i for row in planes} != set(range(atoms)):
        return None
    normals = np.array([row.normal / np.linalg.norm(row.normal) for row in planes])
    is_one = len(planes) == atoms and np.allclose(np.abs(normals.dot(normals[0])), 1.0)
    return normals[0] if is_one else None
