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
from mbd_ros.scene import schema
from mbd_ros.scene.part_names import checked_name
from mbd_ros.scene.particles.molecule_rows import Template, joined, surfaces

MOST = 3_000_000  # points
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
class _Molecule:
    """An entry of `molecules`."""

    atoms: Mapping[str, Any]
    bonds: Any = None
    angles: Any = None
    torsions: Any = None
    surfaces: Any = None
    count: Count = 1
    placement: Any = None


class MoleculeEntry(NamedTuple):
    """A kind of molecules, as read.

    Attributes:
        where: File and key, for the messages.
        kind: The molecules.
        atoms: Of one of them.
        placement: Where they stand, as given.
    """

    where: str
    kind: Molecules
    atoms: tuple[Atom, ...]
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
    return MoleculeEntry(where, kind, atoms, entry.placement)


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
