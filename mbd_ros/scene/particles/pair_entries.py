"""The key `pairs` of the section `particles`: forces between molecules."""

import importlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mbd_ros.core.ranges import Positive
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.methods.particles.molecules import SiteGroup, Sites
from mbd_ros.methods.particles.pairs import PairModel, Pairs, PlainKernel
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.units import Units
from mbd_ros.scene.particles.molecules import Atom, MoleculeEntry, Site
from mbd_ros.scene.schema import schema

_TREE = "mbd_ros.scene.particles.neighbour_tree"
_OVERLAP = 0.4  # of sigma: nearer points have energies that no liquid has
_ON_ONE_PLACE = 0.1  # of the largest sigma: the same of points that only have charges


@dataclass(frozen=True)
class _PairsEntry:
    """The key `pairs`."""

    cutoff: Positive
    coulomb: Literal["reaction_field"] = "reaction_field"
    lennard_jones: Literal["force_shifted"] = "force_shifted"


def read_pairs(
    given: Any, where: str, entries: tuple[MoleculeEntry, ...], box: Array | None, units: Units
) -> Pairs:
    """Forces between the molecules.

    Raises:
        SceneError: Names file and key.
    """
    entry: _PairsEntry = schema.call(_PairsEntry, given, where)
    if box is not None and entry.cutoff > 0.5 * float(box.min()):
        raise SceneError(
            f"{where}.cutoff: {entry.cutoff:g} is more than half the shortest edge of the box, "
            f"{box.min():g}: a point would feel two images of another"
        )
    atoms: list[Atom | Site] = [
        a for one in entries for _ in range(one.kind.count) for a in one.atoms
    ]
    sites = _sites(entries, len(atoms))
    atoms += [site for one in entries for _ in range(one.kind.count) for site in one.sites]
    if not any(atom.charge or atom.epsilon for atom in atoms):
        raise SceneError(f"{where}: no atom has a charge, or sigma and epsilon")
    with np.errstate(all="ignore"):
        model = _model(entry.cutoff, box, atoms, units)
        if not np.isfinite(model.powers).all():
            raise SceneError(f"{where}: sigma and epsilon beside this cutoff overflow")
    numbers = np.arange(sum(one.kind.count for one in entries), dtype=np.int32)
    sizes = [[len(one.atoms), len(one.sites)] for one in entries for _ in range(one.kind.count)]
    molecules = np.concatenate([np.repeat(numbers, size) for size in zip(*sizes, strict=True)])
    near = importlib.import_module(_TREE).near_pairs
    return Pairs(model, molecules, near, PlainKernel(model), sites)


def _sites(entries: tuple[MoleculeEntry, ...], atoms: int) -> Sites | None:
    """The points without mass; None without any."""
    groups, first = [], 0
    for one in entries:
        if one.sites:
            groups.append(SiteGroup(first, one.kind.count, one.weights))
        first += one.kind.size
    return Sites(groups, atoms) if groups else None


def _model(
    cutoff: float, box: Array | None, atoms: Sequence[Atom | Site], units: Units
) -> PairModel:
    kinds = list(dict.fromkeys((atom.sigma, atom.epsilon) for atom in atoms))
    numbers = {kind: number for number, kind in enumerate(kinds)}
    types = np.array([numbers[atom.sigma, atom.epsilon] for atom in atoms], dtype=np.int32)
    sigma, epsilon = np.array(kinds).T
    charges = np.sqrt(units.coulomb) * np.array([atom.charge for atom in atoms])
    mixed = 0.5 * (sigma[:, None] + sigma), np.sqrt(epsilon[:, None] * epsilon)
    return PairModel(cutoff, box, charges, types, *mixed)


def refuse_overlap(system: ParticleSystem, pairs: Pairs, x: Array, where: str) -> None:
    """Refuse points of two molecules that are much nearer than they ever are.

    Args:
        system: The points.
        pairs: Their forces.
        x: Positions at the start, shape (n, 3).
        where: File and key, for the messages.

    Raises:
        SceneError: Names them and their distance.
    """
    model, names = pairs.model, system.names
    if pairs.sites is not None:
        x = pairs.sites.with_sites(x)
        names += pairs.sites.count * ("a site",)
    sigma = float(model.sigma.max()) or 0.01 * model.cutoff
    found = pairs.pairs_within(x, _OVERLAP * sigma)
    d = x[found.i] - x[found.j]
    if model.box is not None:
        d -= model.box * np.rint(d / model.box)
    of_types = model.types[found.i], model.types[found.j]
    accepted = np.maximum(
        np.where(model.epsilon[of_types] > 0.0, _OVERLAP * model.sigma[of_types], 0.0),
        _ON_ONE_PLACE * sigma,
    )
    apart = np.linalg.norm(d, axis=1)
    if not (apart < accepted).any():
        return
    worst = int(np.argmin(apart / accepted))
    both = f"{names[found.i[worst]]} and {names[found.j[worst]]}"
    raise SceneError(
        f"{where}: {np.count_nonzero(apart < accepted)} pairs of particles overlap; {both} are "
        f"{apart[worst]:.3g} apart, accepted: {accepted[worst]:.3g} or more between molecules"
    )
