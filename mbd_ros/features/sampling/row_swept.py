"""A row of particles as the coordinate along which forces are averaged."""

from dataclasses import replace

from mbd_ros.core.particles.row_geometry import DistanceRow, PointRow
from mbd_ros.core.state import Array
from mbd_ros.features.sampling import observables
from mbd_ros.features.sampling.observables import Observable
from mbd_ros.features.sampling.particle_space import ParticleSpace


def row_swept(
    space: ParticleSpace, name: str, unit: str
) -> tuple[Observable, ParticleSpace] | None:
    """What a row holds, and the space without that row; None where no row has the name.

    Args:
        space: The space.
        name: Of a row of a molecule of which there is one.
        unit: Word for its lengths.
    """
    first = 0
    for k, kind in enumerate(space.kinds):
        for row in kind.rows:
            if kind.count == 1 and row.name == name:
                rest = replace(kind, rows=tuple(one for one in kind.rows if one is not row))
                kinds = [*space.kinds[:k], rest, *space.kinds[k + 1 :]]
                return _held(row, first, unit), ParticleSpace(kinds, space.pair_forces)
        first += kind.size
    return None


def _held(row: PointRow, first: int, unit: str) -> Observable:
    if isinstance(row, DistanceRow):
        return observables.distance(row.name, unit, first + row.i, first + row.j)
    a, n, c = (part[:, None] for part in (row.squares, row.normal, row.center))

    def of(x: Array) -> Array:
        level: Array = ((a * (x - c) + n) * (x - c)).sum(axis=0)
        return level

    return Observable(row.name, "", observables.point(first + row.i), of)
