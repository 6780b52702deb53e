"""The molecules of the section `particles`."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from mbd_ros.core.particles.fields import Field
from mbd_ros.core.particles.molecules import Molecules
from mbd_ros.core.ranges import NotNegative, Positive, Vector, Within
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError, SolveError
from mbd_ros.scene.particles.molecule_rows import Template, joined, surfaces
from mbd_ros.scene.reading.part_names import checked_name
from mbd_ros.scene.schema import schema

MOST = 3_000_000  # points
_WHOLE = 1.0e-6  # what weights may miss to 1, as they are rounded in files
Count = Annotated[int, Within(1, MOST)]


@dataclass(frozen=True)
class Atom:
    """One point of a molecule.

    Attributes:
        mass: Its mass.
        at: Its position in the template.
        charge: Its charge.
        sigma: Diameter of its Lennard-Jones force.
        epsilon: Depth of it.
    """

    mass: Positive
    at: Vector
    charge: float = 0.0
    sigma: NotNegative = 0.0
    epsilon: NotNegative = 0.0


@dataclass(frozen=True)
class Site:
    """A point without mass, a weighted mean of the atoms of its molecule.

    Attributes:
        weights: Of atoms, by name; they sum to 1.
        charge: Its charge.
        sigma: Diameter of its Lennard-Jones force.
        epsilon: Depth of it.
    """

    weights: Mapping[str, float]
    charge: float = 0.0
    sigma: NotNegative = 0.0
    epsilon: NotNegative = 0.0


@dataclass(frozen=True)
class _Molecule:
    """An entry of `molecules`."""

    atoms: Mapping[str, Any]
    bonds: Any = None
    angles: Any = None
    torsions: Any = None
    surfaces: Any = None
    sites: Any = None
    count: Count = 1
    placement: Any = None


class MoleculeEntry(NamedTuple):
    """A kind of molecules, as read.

    Attributes:
        where: File and key, for the messages.
        kind: The molecules.
        atoms: Of one of them.
        sites: Of one of them.
        weights: Of the atoms in the sites, shape (sites, atoms).
        placement: Where they stand, as given.
    """

    where: str
    kind: Molecules
    atoms: tuple[Atom, ...]
    sites: tuple[Site, ...]
    weights: Array
    placement: Any


def read_molecule(name: str, given: Any, where: str, fields: tuple[Field, ...]) -> MoleculeEntry:
    """A kind of molecules.

    Args:
        name: Its key.
        given: What the file holds.
        where: File and key, for the messages.
        fields: What acts on its atoms.

    Raises:
        SceneError: Names file, key and atom.
    """
    checked_name(name, where)
    entry: _Molecule = schema.call(_Molecule, given, where)
    if not entry.atoms:
        raise SceneError(f"{where}.atoms: there is none")
    atoms = tuple(
        schema.call(Atom, one, f"{where}.atoms.{checked_name(key, f'{where}.atoms')}")
        for key, one in entry.atoms.items()
    )
    template = Template(where, tuple(entry.atoms), np.array([atom.at for atom in atoms]))
    _refuse_same_places(template)
    rows, terms = joined(template, entry.bonds, entry.angles, entry.torsions)
    rows += surfaces(template, entry.surfaces, _extent(template.at))
    masses = np.array([atom.mass for atom in atoms])
    parts = tuple(rows), tuple(terms), fields
    loose = Molecules(name, template.names, masses, template.at, entry.count, *parts)
    at = _assembled(loose, where)
    kind = Molecules(name, template.names, masses, at, entry.count, *parts)
    return MoleculeEntry(where, kind, atoms, *_sites(template, entry.sites), entry.placement)


def _sites(template: Template, given: Any) -> tuple[tuple[Site, ...], Array]:
    """Sites of a molecule, and the weights of its atoms.

    Raises:
        SceneError: Names file, key and atom.
    """
    where, sites = f"{template.where}.sites", []
    if given is not None and not isinstance(given, Mapping):
        raise SceneError(f"{where}: expected a mapping, got {given!r}")
    weights = np.zeros((len(given or ()), len(template.names)))
    for row, (name, one) in zip(weights, (given or {}).items(), strict=True):
        place = f"{where}.{checked_name(name, where)}"
        site: Site = schema.call(Site, one, place)
        for atom, weight in site.weights.items():
            row[template.number(atom, f"{place}.weights")] = weight
        if abs(row.sum() - 1.0) > _WHOLE:
            raise SceneError(f"{place}.weights: sum to {row.sum():.9g}, accepted: 1")
        sites.append(site)
    return tuple(sites), weights


def _assembled(kind: Molecules, where: str) -> Array:
    """The template on its rows.

    Raises:
        SceneError: They cannot all hold.
    """
    at = kind.at[:, :, None].copy()
    try:
        with np.errstate(all="ignore"):
            for cluster in kind.clusters:
                cluster.assemble(at)
    except SolveError as error:
        raise SceneError(
            f"{where}: its bonds, angles and surfaces cannot all hold: {error}; accepted: "
            "lengths that fit together, and atoms near such places"
        ) from error
    return at[:, :, 0]


def _refuse_same_places(template: Template) -> None:
    """Refuse two atoms of a template at one place."""
    for i, name in enumerate(template.names):
        same = np.flatnonzero((template.at[:i] == template.at[i]).all(axis=1))
        if len(same):
            other = template.names[int(same[0])]
            raise SceneError(f"{template.where}.atoms: {other} and {name} are at the same place")


def _extent(at: Array) -> float:
    """A length of the molecule; 1 for one point."""
    extent = float(np.ptp(at, axis=0).max())
    return extent or float(np.abs(at).max()) or 1.0
