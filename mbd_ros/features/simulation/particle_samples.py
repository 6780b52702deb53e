"""Samples of the motion of particles, and their table."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.particles.particle_system import ParticleSystem
from mbd_ros.core.particles.units import Units
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError
from mbd_ros.files.table import Column, Table
from mbd_ros.files.times import TIME
from mbd_ros.scene.particles.particle_scene import ParticleScene
from mbd_ros.scene.particles.particles_entry import QUANTITIES

MANY = 100  # particles from which on they have no columns of their own
_AXES = "xyz"


class ParticleSample(NamedTuple):
    """What is kept of a state; arrays that nobody asked for are empty."""

    balance: tuple[float, ...]
    positions: Array
    velocities: Array
    multipliers: Array


def wanted_quantities(scene: ParticleScene) -> Sequence[str]:
    """Quantities that samples hold, beside energies."""
    if scene.record.quantities is not None:
        return scene.record.quantities
    return QUANTITIES if len(scene.system().masses) <= MANY else ()


def sample_of(system: ParticleSystem, x: State, wanted: Sequence[str]) -> ParticleSample:
    """What is kept of a state.

    Raises:
        DivergedError: Its energy is not finite.
    """
    none = np.zeros(0)
    force, of_pairs = system.force_and_energy(x.q)
    kinetic, potential = system.kinetic(x.v), system.potential_of_molecules(x.q) + of_pairs
    drifts = (system.residual(x.t, x.q), system.rate_of_rows(x.q, x.v))
    worst = (float(np.abs(drift).max(initial=0.0)) for drift in drifts)
    if not math.isfinite(kinetic + potential):
        raise DivergedError(f"energy is not finite at t = {x.t:.9g}")
    return ParticleSample(
        (x.t, kinetic + potential, kinetic, potential, *worst),
        x.q if "positions" in wanted else none,
        x.v if "velocities" in wanted else none,
        system.multipliers(x.q, x.v, force) if "multipliers" in wanted else none,
    )


def sample_table(scene: ParticleScene, samples: Sequence[ParticleSample]) -> Table:
    """Samples as a table, a row each."""
    units, rows = scene.units, len(samples)
    balance = np.array([sample.balance for sample in samples])
    names = {
        TIME: units.time,
        "energy": units.energy,
        "energy.kinetic": units.energy,
        "energy.potential": units.energy,
        "drift.position": units.length,
        "drift.velocity": units.velocity,
    }
    columns = [Column(n, balance[:, i], unit) for i, (n, unit) in enumerate(names.items())]
    arrays = [np.array([sample[k] for sample in samples]).reshape(rows, -1) for k in (1, 2, 3)]
    return Table([columns[0], *_state_columns(scene, units, arrays), *columns[1:]])


def _state_columns(
    scene: ParticleScene, units: Units, arrays: Sequence[Array]
) -> Iterator[Column]:
    """Columns of the particles: scalars of a few, arrays of many."""
    system = scene.system()
    kinds = zip(("position", "velocity"), (units.length, units.velocity), arrays[:2], strict=True)
    for word, unit, values in kinds:
        if not values.shape[1]:
            continue
        if len(system.masses) > MANY:
            shaped = values.reshape(len(values), -1, 3)
            yield Column(
                {"position": QUANTITIES[0], "velocity": QUANTITIES[1]}[word], shaped, unit
            )
            continue
        labels = (f"{name}.{word}.{axis}" for name in system.names for axis in _AXES)
        yield from (Column(label, values[:, i], unit) for i, label in enumerate(labels))
    lam = arrays[2]
    if lam.shape[1] and len(system.masses) > MANY:
        yield Column(QUANTITIES[2], lam, units.force)
    elif lam.shape[1]:
        yield from (Column(row.name, lam[:, i], row.unit) for i, row in enumerate(system.rows))
