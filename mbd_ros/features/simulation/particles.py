"""Motion of the particles of a scene: `mbd-ros simulate`."""

import argparse
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.state import Array, State
from mbd_ros.errors import OK, DataError, DivergedError, MbdError
from mbd_ros.features.simulation.job import Interrupted, diverged_place, write_result
from mbd_ros.features.simulation.run import MOST_ROWS
from mbd_ros.files.formats import format_of, is_bag, suffix_of
from mbd_ros.files.table import MAIN, TIME, Column, Result, Table
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.progress import Say, Watch, say, watching
from mbd_ros.jobs.progress import progress as shown
from mbd_ros.methods.particles.particle_system import ParticleSystem
from mbd_ros.methods.particles.units import Units
from mbd_ros.methods.particles.verlet_steps import ParticleVerlet, sample_count
from mbd_ros.methods.particles.verlet_steps import run as states_of
from mbd_ros.motion.recordings import metadata_of
from mbd_ros.scene.particles.particle_scene import ParticleScene
from mbd_ros.scene.particles.particles_entry import QUANTITIES
from mbd_ros.scene.variants import with_sections

MANY = 100  # particles from which on they have no columns of their own
_AXES = "xyz"
_OF_ROBOTS = (  # options that particles do not have
    *("tolerance", "origin", "start", "efforts", "wrenches", "ensemble"),
    *("workers", "scheduler", "events", "task"),
)


def simulate(
    scene: ParticleScene,
    duration: float,
    *,
    dt: float | None = None,
    integrator: str | None = None,
    every: int | None = None,
    say: Say | None = None,
    progress: Watch = False,
) -> Result:
    """Motion of particles, with energies, violations and forces of bonds.

    Ctrl-C returns the motion so far, with the reason in `metadata["ended"]`.

    Args:
        duration: In the unit of time of the scene, as all numbers are in its units.
        dt: Step, in place of that of the scene.
        integrator: rattle or shake, in place of that of the scene.
        every: Steps from one sample to the next, in place of that of the section `record`.
        say: Is called with each line for people; without it they are `metadata["remarks"]`.
        progress: True for a line on a terminal, or a function of a label and a share.

    Returns:
        Table `samples`: `time`, `<particle>.position.x`, `.velocity.x`, `<row>.force` and so on,
        or `positions`, `velocities` and `multipliers` as arrays of many; `energy`,
        `energy.kinetic`, `energy.potential`, `drift.position`, `drift.velocity`.

    Raises:
        Interrupted: The motion diverged; its `result` is the motion so far.
        MbdError: Input that cannot be used.
    """
    remarks: list[str] = []
    tell = say or remarks.append
    step, stride = scene.dt if dt is None else dt, scene.record.every if every is None else every
    _check_times(duration, step, stride)
    entry = None if integrator is None else {"type": integrator}
    stepper = scene.stepper(dt=step, integrator=entry)
    inputs = {"duration": duration, "dt": dt, "integrator": integrator, "every": every}
    begin = time.perf_counter()
    with watching(progress):
        samples, failure = _samples(scene, stepper, (duration, step, stride))
    wall = time.perf_counter() - begin
    if not samples:
        raise type(failure)(f"{scene.name}: {failure}") from failure
    times = [sample.balance[0] for sample in samples]
    result = Result(
        {MAIN: sample_table(scene, samples)}, metadata_of("simulate", scene, inputs, {})
    )
    if failure is None:
        for text in _summary(scene, samples, wall):
            tell(text)
    else:
        result.metadata["ended"] = f"{failure}; last finite state at t = {times[-1]:.9g}"
    if say is None:
        result.metadata["remarks"] = remarks
    if isinstance(failure, MbdError):
        early = Interrupted(result.metadata["ended"])
        early.result = result
        raise early from failure
    return result


def _check_times(duration: float, dt: float, every: int) -> None:
    """Refuse times that no run has.

    Raises:
        DataError: Names the option.
    """
    for name, value in (("-t", duration), ("--dt", dt)):
        if not 0.0 < value < LARGEST:
            raise DataError(f"{name}: {value:g} must be > 0 and finite")
    if every < 1:
        raise DataError(f"every: {every}, accepted: 1 or more steps")
    if duration / (dt * every) > MOST_ROWS:
        raise DataError(
            f"--dt: {dt:g}: {duration / (dt * every):.3g} samples, accepted are {MOST_ROWS:g}; "
            "the key every of record takes fewer"
        )


class ParticleSample(NamedTuple):
    """Recorded quantities of a state; arrays that are not recorded are empty."""

    balance: tuple[float, ...]
    positions: Array
    velocities: Array
    multipliers: Array


def _samples(
    scene: ParticleScene, stepper: ParticleVerlet, times: tuple[float, float, int]
) -> tuple[list[ParticleSample], MbdError | KeyboardInterrupt | None]:
    """Samples, and why they end early."""
    samples: list[ParticleSample] = []
    system, wanted = scene.system(), wanted_quantities(scene)
    try:
        with np.errstate(all="ignore"):  # a divergence says so itself
            every = states_of(system, stepper, scene.initial, *times)
            for x in shown(every, sample_count(*times), "simulate"):
                samples.append(sample_of(system, x, wanted))
    except MbdError as error:
        return samples, error
    except KeyboardInterrupt as error:
        if not samples:
            raise
        return samples, error
    return samples, None


def sample_of(system: ParticleSystem, x: State, wanted: Sequence[str]) -> ParticleSample:
    """Return the recorded quantities of a state.

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


def _summary(
    scene: ParticleScene, samples: Sequence[ParticleSample], wall: float
) -> Iterator[str]:
    """Lines on what was kept."""
    t, energy, kinetic, _, position, velocity = np.array([s.balance for s in samples]).T
    units = scene.units
    yield f"{wall:.3f} s for {t[-1] - t[0]:g} {units.time}, {len(t)} samples"
    change = float(np.abs(energy - energy[0]).max())
    yield (
        f"energy {energy[0]:.6g} {units.energy}, largest change {change:.3g}; kinetic "
        f"{kinetic.mean():.6g} on average"
    )
    yield (
        f"largest violation: position {position.max():.2g} {units.length}, velocity "
        f"{velocity.max():.2g} {units.velocity}"
    )


def run(scene: ParticleScene, arguments: argparse.Namespace) -> int:
    """Do what the words of the command say; the exit code.

    Raises:
        MbdError: An option that particles do not have, or input that cannot be used.
    """
    for name in _OF_ROBOTS:
        if getattr(arguments, name) is not None:
            word = "from" if name == "origin" else name
            raise DataError(f"--{word}: is not for {scene.name}, which holds particles")
    solver = "compiled" if arguments.compiled else arguments.solver
    if solver is not None:
        scene = with_sections(scene, solver={"type": solver})
    if arguments.time is None:
        raise DataError("-t: is missing: give the time to simulate, in the unit of the scene")
    _check_place(arguments.out, scene)
    options = {"dt": arguments.dt, "integrator": arguments.integrator}
    write_result(
        [arguments.out],
        lambda: simulate(scene, arguments.time, say=say, progress=True, **options),
        say,
    )
    return OK


def _check_place(out: Path, scene: ParticleScene) -> None:
    """Refuse a place that cannot take the result."""
    if is_bag(out):
        raise DataError(f"-o {out}: particles have no topics; accepted: CSV, .npz and .parquet")
    format_of(out)
    if wanted_quantities(scene) and len(scene.system().masses) > MANY and ".csv" in suffix_of(out):
        raise DataError(
            f"-o {out}: holds one number a column, and {scene.name} records arrays of more than "
            f"{MANY} particles; accepted: .npz and .parquet"
        )
    for place in (out, diverged_place(out)):
        refuse_overwriting(place, *([scene.path] if scene.path else []))
    check_place(out)


def wanted_quantities(scene: ParticleScene) -> Sequence[str]:
    """Quantities that samples hold, beside energies."""
    if scene.record.quantities is not None:
        return scene.record.quantities
    return QUANTITIES if len(scene.system().masses) <= MANY else ()
