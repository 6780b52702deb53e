"""The space in which a scene is sampled, its start, its quantities and their units."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.errors import SceneError
from mbd_ros.features.sampling import observables
from mbd_ros.features.sampling.joint_space import JointSpace
from mbd_ros.features.sampling.observables import Observable, coordinate
from mbd_ros.features.sampling.particle_space import ParticleSpace
from mbd_ros.methods.particles.molecules import ElasticBond, Molecules
from mbd_ros.methods.particles.rigid_bonds import DistanceRow, PointRow, SurfaceRow
from mbd_ros.methods.particles.units import BOLTZMANN
from mbd_ros.methods.projection.assembly import assemble
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reader import is_of_particles
from mbd_ros.scene.schema.nearest import nearest

_POINTS = {"distance": 2, "cosine": 3, "angle": 3, "dihedral": 4, "quadratic": 1}
_FORMS = (
    "distance A B, cosine A B C, angle A B C, dihedral A B C D, quadratic A wx wy wz, "
    "A.x of particles"
)
DRIVEN = ("distance", "cosine", "angle", "quadratic")  # forces are averaged along these
_MOST = 60  # coordinates of a scene whose components are looked for unasked
_COMPARED = 7  # points of a molecule of which all pairs are compared


def sampled_scene(scene: Any) -> SampledScene:
    """The sampled coordinates of a scene.

    Raises:
        SceneError: The scene has what an ensemble does not serve; says what.
    """
    if is_of_particles(scene):
        return sampled_particles(scene)
    return _mechanism(scene)


@dataclass(frozen=True)
class SampledScene:
    """A scene as what is sampled.

    Attributes:
        name: Of the scene, for messages.
        start: A configuration on the rows, shape (size,).
        boltzmann: Boltzmann's constant in its units.
        energy: Word for its unit of energy.
        points: Names of particles; empty for a mechanism.
        length: Word for its unit of length.
        defaults: Quantities that are kept where a task names none.
        features: Quantities by which components of the manifold are told apart.
    """

    name: str
    space: Any
    start: Array
    boltzmann: float
    energy: str
    points: Sequence[str]
    length: str
    defaults: tuple[Observable, ...]
    features: tuple[Observable, ...]

    @property
    def is_small(self) -> bool:
        """Whether components are looked for unasked."""
        return bool(self.space.blocks) and self.space.size <= _MOST


def _mechanism(scene: Scene) -> SampledScene:
    _refuse(scene)
    system = scene.system()
    if not system.chart.is_flat or system.nq != system.nv:
        raise SceneError(f"{scene.name}: a free body is nowhere held: it has no ensemble")
    if not system.nv:
        raise SceneError(f"{scene.name}: no joint moves, there is nothing to sample")
    if len(system.bilateral.rows) != len(system.rows):
        raise SceneError(f"{scene.name}: rows of velocities have no ensemble of configurations")
    y = assemble(system, system.reduce(scene.initial))
    names = scene.couplings.independent
    kinds = {joint.name: joint.kind for joint in scene.robot.joints}
    walls = _walls(scene, system)
    space = JointSpace(system, y, names, walls)
    units = ["m" if kinds[name] == "prismatic" else "rad" for name in names]
    positions = tuple(
        _position(name, unit, i) for i, (name, unit) in enumerate(zip(names, units, strict=True))
    )
    features = [one for p in positions for one in _circular(p)]
    if not np.isfinite(space.potential(y.q[:, None])).all():
        raise SceneError(f"{scene.name}: initial: lies beyond a stop")
    return SampledScene(
        scene.name, space, y.q, BOLTZMANN, "J", (), "m", positions, tuple(features)
    )


def _refuse(scene: Scene) -> None:
    wrong = {
        "phases": scene.phases,
        "contacts": scene.parts.get("contacts"),
        "muscles": scene.muscles,
        "external_wrenches": scene.wrenches,
    }
    for key, there in wrong.items():
        if there:
            raise SceneError(f"{scene.name}: {key}: an ensemble does not serve them")
    for part in (*scene.actuators, *scene.forces):
        if part.internal:
            raise SceneError(f"{scene.name}: {part.name}: internal states have no ensemble")


def _walls(scene: Scene, system: Any) -> list[Any]:
    """Stops of one side."""
    k, walls = system.k, []
    for part in scene.constraints:
        if part.law.is_rigid:
            continue
        if part.law.kind.name != "UNILATERAL":
            raise SceneError(
                f"{scene.name}: {part.name}: an ensemble serves bilateral rows and stops"
            )

        def is_within(x: State, part: Any = part) -> bool:
            k.refresh(x.q, x.v, part.reads)
            return bool((part.residual(k, x) >= 0.0).all())

        walls.append(is_within)
    return walls


def _position(name: str, unit: str, number: int) -> Observable:
    """A position; that of an angle lies between -pi and pi."""
    position = coordinate(f"{name}.position", unit, number)
    if unit != "rad":
        return position
    return position._replace(of=lambda x: (x[0] + np.pi) % (2.0 * np.pi) - np.pi)


def _circular(position: Observable) -> tuple[Observable, ...]:
    """A position, or cosine and sine of an angle."""
    if position.unit != "rad":
        return (position,)
    at, name = position.coordinates, position.name.removesuffix(".position")
    return (
        Observable(f"cos {name}", "", at, lambda x: np.cos(x[0])),
        Observable(f"sin {name}", "", at, lambda x: np.sin(x[0])),
    )


def sampled_particles(scene: Any) -> SampledScene:
    """The sampled coordinates of a scene of particles."""
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
    for bond, other in itertools.combinations(sorted(set(bonds)), 2):
        shared = set(bond) & set(other)
        if len(shared) == 1:
            (b,) = shared
            (a,), (c,) = set(bond) - shared, set(other) - shared
            if (min(a, c), max(a, c)) not in bonds:
                names = kind.labels
                name = f"cosine_{names[a]}_{names[b]}_{names[c]}"
                yield observables.cosine(name, first + a, first + b, first + c)


def _features(kind: Molecules, first: int, unit: str) -> Iterator[Observable]:
    """Return the coordinates that stay when molecules move rigidly; all of those on surfaces."""
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


def quantity(text: str, scene: SampledScene, where: str, name: str = "") -> Observable:
    """Return the quantity of a text such as `distance a b`, `cosine a b c`, or a joint.

    Args:
        text: The text.
        scene: The sampled scene.
        where: File and key, for messages.
        name: Name in columns; by default it follows from the text.

    Raises:
        SceneError: The text is not a quantity; the message says what is accepted.
    """
    parts = text.split()
    if len(parts) == 1:
        return _coordinate(parts[0], scene, where, name)
    kind, arguments = parts[0] if parts else "", parts[1:]
    if not scene.points or kind not in _POINTS:
        accepted = _FORMS if scene.points else ", ".join(scene.space.names)
        raise SceneError(f"{where}: '{text}' is not a quantity, accepted: {accepted}")
    count = _POINTS[kind]
    numbers = arguments[count:]
    if len(arguments) < count or len(numbers) != (3 if kind == "quadratic" else 0):
        raise SceneError(f"{where}: '{text}', accepted: {_FORMS}")
    points = [_point(word, scene, where) for word in arguments[:count]]
    if len(set(points)) < count:
        raise SceneError(f"{where}: '{text}' names a particle twice")
    label, unit = name or "_".join([kind, *arguments[:count]]), scene.length
    if kind == "distance":
        return observables.distance(label, unit, *points)
    if kind == "cosine":
        return observables.cosine(label, *points)
    if kind == "angle":
        return observables.angle(label, *points)
    if kind == "dihedral":
        return observables.dihedral(label, points)
    weights = [_number(word, text, where) for word in numbers]
    return observables.quadratic(label, f"{unit}^2", points[0], weights)


def _coordinate(word: str, scene: SampledScene, where: str, name: str) -> Observable:
    names = list(scene.space.names)
    if word not in names:
        close = ", ".join(nearest(word, names) or names[:6])
        raise SceneError(f"{where}: '{word}' is not a quantity, the nearest: {close}")
    if scene.points:
        return observables.coordinate(name or word, scene.length, names.index(word))
    return scene.defaults[names.index(word)]._replace(name=name or f"{word}.position")


def _point(word: str, scene: SampledScene, where: str) -> int:
    if word not in scene.points:
        close = ", ".join(nearest(word, list(scene.points)) or scene.points[:6])
        raise SceneError(f"{where}: there is no particle '{word}', the nearest: {close}")
    return list(scene.points).index(word)


def _number(word: str, text: str, where: str) -> float:
    try:
        number = float(word)
    except ValueError:
        number = float("nan")
    if not abs(number) < 1.0e30:
        raise SceneError(f"{where}: '{text}': '{word}' is not a number")
    return number


def row_swept(
    space: ParticleSpace, name: str, unit: str
) -> tuple[Observable, ParticleSpace] | None:
    """Take a constraint of particles as the coordinate of a mean force.

    Returns:
        The coordinate, and the space without the constraint; None if no constraint has the name.

    Args:
        space: The space.
        name: Name of a constraint of a molecule that has one copy.
        unit: Unit of lengths.
    """
    first = 0
    for k, kind in enumerate(space.kinds):
        for row in kind.rows:
            if kind.count == 1 and row.name == name:
                without = replace(kind, rows=tuple(each for each in kind.rows if each is not row))
                kinds = [*space.kinds[:k], without, *space.kinds[k + 1 :]]
                return _coordinate_of(row, first, unit), ParticleSpace(kinds, space.pair_forces)
        first += kind.size
    return None


def _coordinate_of(row: PointRow, first: int, unit: str) -> Observable:
    if isinstance(row, DistanceRow):
        return observables.distance(row.name, unit, first + row.i, first + row.j)
    a, n, c = (part[:, None] for part in (row.squares, row.normal, row.center))

    def of(x: Array) -> Array:
        level: Array = ((a * (x - c) + n) * (x - c)).sum(axis=0)
        return level

    return Observable(row.name, "", observables.point(first + row.i), of)
