"""Chains in blocks: a block is a function of scene, task and its number, wherever it is done.

Checkpoints say where the chains of a block stand: from there it goes on with the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from math import exp, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.ranges import LARGEST
from mbd_ros.core.rows.constraint_rows import independent
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, DivergedError, SceneError
from mbd_ros.features.sampling.components import random_starts
from mbd_ros.features.sampling.ensemble import (
    Ensemble,
    Langevin,
    Metropolis,
    Walkers,
    kinetic_after_step,
    stream,
)
from mbd_ros.features.sampling.mean_force import instant
from mbd_ros.features.sampling.observables import Observable, coordinate
from mbd_ros.features.sampling.sampled_scene import (
    DRIVEN,
    SampledScene,
    quantity,
    row_swept,
    sampled_scene,
)
from mbd_ros.features.sampling.space import HeldSpace, WeightedSpace
from mbd_ros.features.sampling.task import SampleTask
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.progress import progress
from mbd_ros.jobs.workers.task import pack, unpack
from mbd_ros.npz_file import read_arrays

_KEYS = ("q", "v", "sweeps", "dt")  # of a checkpoint in a file, beside the number of a block
_MOST_SWEEPS = 2**62  # that a block has done: more cannot be counted
_LARGEST = 256  # chains of a block
_FEWEST = 2  # blocks of a run
_WISHED = 0.9  # acceptance
_USUAL = 0.05  # step, in times that a particle of kT takes for the scale of the space
_FIRST = 0.1  # the same, where the step is looked for
_LOST = 0.025  # friction times the step
_QUICK = 1.0  # gain with which a step is changed while it is looked for
_FADING = 0.6  # exponent with which the gain falls
Measure = Callable[[Walkers], Array]  # shape (quantities, chains)
_STEPS_OF_POINTS = 5  # from sample to sample
_STEPS_OF_JOINTS = 20  # from sample to sample
_WAY = 40  # steps in which a held quantity is brought to its value


class Asked:
    """A scene, a task for it, and all that both give.

    Args:
        where: File and key of the task, for messages.

    Raises:
        SceneError: The task does not fit the scene.
    """

    def __init__(self, scene: Any, task: SampleTask, where: str) -> None:
        self.scene = scene
        self.task = task
        self.where = where
        self.sampled: SampledScene = sampled_scene(scene)
        kT = task.thermal_energy
        if kT is None:
            kT = self.sampled.boltzmann * float(task.temperature or 0.0)
        self.kT = kT
        if task.method == "langevin" and not self.sampled.space.has_constant_masses:
            raise SceneError(
                f"{where}.method: langevin needs constant masses, those of a mechanism depend on "
                "its configuration; accepted: metropolis"
            )
        if task.kinetics and not self.sampled.points:
            raise SceneError(f"{where}.kinetics: is for particles")
        self.quantities = self._quantities()
        self.coordinate = None
        if task.coordinate is not None:
            self.coordinate = self._coordinate(task.coordinate)
        self._swept = self.sampled.space  # along the coordinate
        if not self._swept.has_constant_masses:
            self._swept = WeightedSpace(self._swept, kT, fixman=task.fixman)
        names = ("method", "chains", "samples", "warmup", "steps", "dt", "friction", "seed")
        plan = {name: getattr(task, name) for name in names}
        if task.steps is None:
            plan["steps"] = _STEPS_OF_POINTS if self.sampled.points else _STEPS_OF_JOINTS
        self.plan = Plan(**plan)

    @property
    def energies(self) -> tuple[str, ...]:
        """Names of the energies of a sample, which stand before its quantities."""
        own = ["energy.potential", "energy.kinetic"]
        if self.task.kinetics:
            parts = ("translation", "rotation", "internal")
            kinds = [kind.name for kind in self.sampled.space.kinds]
            own += [f"{kind}.{part}" for kind in kinds for part in parts]
            own += ["energy.kinetic_rattle", "energy.kinetic_shake"]
        return tuple(own)

    @property
    def columns(self) -> list[tuple[str, str]]:
        """Names and units of all values of a sample."""
        own = [(name, self.sampled.energy) for name in self.energies]
        own += [(one.name, one.unit) for one in self.quantities]
        if not self.sampled.points:
            positions = self.sampled.defaults
            own += [
                (f"{name}.velocity", f"{one.unit}/s")
                for name, one in zip(self.sampled.space.names, positions, strict=True)
            ]
        return own

    def _quantities(self) -> tuple[Observable, ...]:
        given = self.task.observe
        if not given:
            return self.sampled.defaults
        where = f"{self.where}.observe"
        return tuple(
            quantity(text, self.sampled, f"{where}.{name}", name) for name, text in given.items()
        )

    def _coordinate(self, text: str) -> Observable:
        where = f"{self.where}.coordinate"
        if self.sampled.points:
            swept = row_swept(self.sampled.space, text, self.sampled.length)
            if swept is not None:
                found, space = swept
                self.sampled = replace(self.sampled, space=space)
                return found
        found = quantity(text, self.sampled, where)
        if text.split()[0] not in DRIVEN and len(text.split()) > 1:
            raise SceneError(f"{where}: '{text}', accepted: {', '.join(DRIVEN)}")
        if self.sampled.points:
            return found
        stops = [part.name for part in self.scene.constraints if not part.law.is_rigid]
        if stops:
            raise SceneError(
                f"{where}: stops push beside the mean force; accepted: a scene without "
                f"{', '.join(stops)}"
            )
        (number,) = found.coordinates
        return coordinate(found.name, found.unit, number)  # beyond one turn, too

    def ensemble(self, level: float | None) -> Ensemble:
        """The ensemble, with the coordinate held where a value is given."""
        if level is None:
            return Ensemble(self.sampled.space, self.kT, fixman=self.task.fixman)
        assert self.coordinate is not None
        return Ensemble(HeldSpace(self._swept, self.coordinate, level), self.kT)

    def _instant(self, held: Ensemble, at: Walkers) -> Array:
        space, fixman = self._swept, self.task.fixman
        if isinstance(space, WeightedSpace):
            return np.array(instant(held, at, space.gradient(at.q), fixman=False))
        return np.array(instant(held, at, -space.force(at.q), fixman=fixman))

    def done(self, order: Order) -> Sampled:
        """A block of chains.

        Raises:
            DivergedError: A step does not end on the rows.
            SceneError: A held value cannot be reached.
        """
        ensemble = self.ensemble(order.level)
        start = order.start
        if start is None:
            chains = blocks_of(self.plan.chains)[order.number]
            q = self._starts(ensemble, order, chains.stop - chains.start)
            start = begun(ensemble, self.plan, order.number, q)

        h = usual_step(ensemble) if self.plan.dt is None else self.plan.dt

        def measure(at: Walkers) -> Array:
            if order.level is not None:
                return self._instant(ensemble, at)
            own = [ensemble.space.potential(at.q), ensemble.kinetic(at.v)]
            if self.task.kinetics:
                own += [*self.sampled.space.kinetic_parts(at.q, at.v)]
                own += [*kinetic_after_step(ensemble, at, h)]
            own += [one.value(at.q) for one in self.quantities]
            if not self.sampled.points:
                own += [*self.sampled.space.velocities(at.q, at.v)]
            return np.array(own)

        found = gone_on(ensemble, self.plan, order.number, start, measure, _shown)
        finite = np.isfinite(found.values).all(axis=(1, 2))
        if not finite.all():
            names = [name for name, _ in self.columns]
            odd = names[int(np.argmin(finite))] if order.level is None else "the mean force"
            raise DivergedError(f"{self.where}: {odd} of a sample is not finite")
        return found

    def _starts(self, ensemble: Ensemble, order: Order, count: int) -> Array:
        q = self.sampled.start
        if order.level is not None:
            q = self._brought(ensemble, order.level)
        elif self.task.starts == "random":
            seed = (self.plan.seed + 7919 * (order.number + 1)) % 2**63
            found = random_starts(ensemble, q, count, seed)
            if not found.shape[1]:
                raise SceneError(f"{self.where}.starts: no random configuration closes the rows")
            return found[:, np.arange(count) % found.shape[1]]
        return np.repeat(q[:, None], count, axis=1)

    def _brought(self, ensemble: Ensemble, level: float) -> Array:
        """A configuration with a value of the held quantity, from the start of the scene."""
        assert self.coordinate is not None
        q = self.sampled.start[:, None]
        (rows,) = ensemble.space.blocks
        if len(independent(rows.jacobian(q)[:, :, 0])) < len(rows.rows):
            raise SceneError(
                f"{self.where}.coordinate: rows of the scene hold {self.coordinate.name} already; "
                f"accepted: another quantity, or one of them: {', '.join(rows.rows[:-1])}"
            )
        first = float(self.coordinate.value(q)[0])
        for share in np.linspace(0.0, 1.0, _WAY + 1)[1:]:
            rows.level = first + share * (level - first)
            with np.errstate(all="ignore"):
                q, found = ensemble.manifold.close(ensemble.manifold.at(q), q)
            if not found.all():
                raise SceneError(
                    f"{self.where}.at: {self.coordinate.name} cannot be brought from {first:g} to "
                    f"{level:g}: it stops near {rows.level:g}"
                )
        return q[:, 0]


def _shown(samples: range) -> Iterable[int]:
    return progress(samples, len(samples), "sampling")


class Order(NamedTuple):
    """A block of chains that is asked for.

    Attributes:
        number: Of the block among those of its value.
        level: Value of the held quantity; None without one.
        start: Where it goes on; None begins it.
    """

    number: int
    level: float | None = None
    start: Checkpoint | None = None


class Plan(NamedTuple):
    """How an ensemble is sampled.

    Attributes:
        method: `metropolis` or `langevin`.
        samples: Samples a chain.
        warmup: Samples a chain before them, which are not kept.
        steps: Steps between samples.
        dt: Step; None: chosen, by `metropolis` so that most proposals are accepted.
        friction: Rate of `langevin` at which velocities are forgotten; None: chosen.
        seed: Of the random numbers, >= 0.
    """

    method: str = "metropolis"
    chains: int = 64
    samples: int = 1000
    warmup: int = 200
    steps: int = 5
    dt: float | None = None
    friction: float | None = None
    seed: int = 0


def blocks_of(chains: int) -> list[slice]:
    """The chains of each block; depends on nothing but their number."""
    size = min(max(-(-chains // _FEWEST), 1), _LARGEST)
    return [slice(i, min(i + size, chains)) for i in range(0, chains, size)]


def begun(ensemble: Ensemble, plan: Plan, number: int, q: Array) -> Checkpoint:
    """A block of chains after its warm-up.

    Args:
        plan: How it is sampled.
        number: Of the block.
        q: Starts on the rows, shape (size, chains of the block).
    """
    is_tuned = plan.method == "metropolis" and plan.dt is None
    dt = usual_step(ensemble) * (_FIRST / _USUAL if is_tuned else 1.0)
    method = method_of(ensemble, plan, dt if plan.dt is None else plan.dt)
    at = ensemble.at(q, np.zeros(q.shape))
    at = at._replace(v=ensemble.drawn(stream(plan.seed, number, 0), at.places, q.shape[1]))
    steps = []
    for k in range(plan.warmup):
        at, accepted = method.sweep(at, stream(plan.seed, number, k + 1), plan.steps)
        if is_tuned:
            steps.append(method.dt)
            method.dt *= exp(_QUICK * (accepted.mean() - _WISHED) / (1.0 + k) ** _FADING)
    if len(steps) >= 2:
        method.dt = exp(np.log(steps[len(steps) // 2 :]).mean())
    return Checkpoint(at.q, at.v, plan.warmup + 1, method.dt)


def gone_on(
    ensemble: Ensemble,
    plan: Plan,
    number: int,
    start: Checkpoint,
    measure: Measure,
    watch: Callable[[range], Iterable[int]] = iter,
) -> Sampled:
    """Samples of a block of chains from where it stands.

    Args:
        plan: How it is sampled.
        number: Of the block.
        start: Where it stands.
        measure: What is kept of a sample.
        watch: Passes the numbers of samples on, for people.
    """
    method = method_of(ensemble, plan, start.dt)
    at, values = ensemble.at(start.q, start.v), []
    share = np.zeros(start.q.shape[1])
    for k in watch(range(start.sweeps, start.sweeps + plan.samples)):
        at, accepted = method.sweep(at, stream(plan.seed, number, k), plan.steps)
        values.append(measure(at))
        share += accepted
    end = Checkpoint(at.q, at.v, start.sweeps + plan.samples, start.dt)
    return Sampled(np.stack(values, axis=2), share / plan.samples, end)


def method_of(ensemble: Ensemble, plan: Plan, dt: float) -> Langevin | Metropolis:
    """The method of a plan with a step."""
    if plan.method == "metropolis":
        return Metropolis(ensemble, dt)
    friction = _LOST / dt if plan.friction is None else plan.friction
    return Langevin(ensemble, dt, friction)


def usual_step(ensemble: Ensemble) -> float:
    """A step that is short beside the time in which a particle of kT moves by the scale."""
    lightest = float(ensemble.space.mass.min())
    return _USUAL * ensemble.space.scale * sqrt(lightest / ensemble.kT)


class Sampled(NamedTuple):
    """What a block of chains gave.

    Attributes:
        values: Shape (quantities, chains, samples).
        accepted: Share of proposals, shape (chains,).
        end: Where it stands.
    """

    values: Array
    accepted: Array
    end: Checkpoint


class Checkpoint(NamedTuple):
    """Where a block of chains stands; from here it goes on with the same bits.

    Attributes:
        q: Shape (size, chains).
        v: Shape (size, chains).
        sweeps: How many were done.
        dt: The step that is taken.
    """

    q: Array
    v: Array
    sweeps: int
    dt: float


def write_checkpoint(path: Path, blocks: Sequence[Checkpoint]) -> None:
    """Write where all blocks of a run stand, as a .npz.

    Raises:
        DataError: A place that cannot be written to.
    """
    arrays = {
        f"{key}{i}": np.asarray(value)
        for i, block in enumerate(blocks)
        for key, value in zip(_KEYS, block, strict=True)
    }
    with replacing(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_checkpoint(path: Path, sizes: Sequence[tuple[int, int]]) -> list[Checkpoint]:
    """Where all blocks of a run stand.

    Args:
        sizes: Coordinates and chains of each block of the run that goes on.

    Raises:
        DataError: It cannot be read, or is that of another scene or another number of chains.
    """
    found = read_arrays(path, "a checkpoint of mbd-ros sample")
    blocks = []
    for i, size in enumerate(sizes):
        if any(f"{key}{i}" not in found for key in _KEYS):
            raise DataError(f"{path}: has no block {i + 1} of {len(sizes)}: another run's")
        q, v, sweeps, dt = (found[f"{key}{i}"] for key in _KEYS)
        if q.ndim == v.ndim == 2 and not q.shape == v.shape == size:
            raise DataError(
                f"{path}: {q.shape[0]} coordinates of {q.shape[1]} chains, this run has "
                f"{size[0]} of {size[1]}"
            )
        for key, array, shape, kinds in (
            ("q", q, size, "f"),
            ("v", v, size, "f"),
            ("sweeps", sweeps, (), "iu"),
            ("dt", dt, (), "f"),
        ):
            if array.shape != shape or array.dtype.kind not in kinds:
                raise DataError(
                    f"{path}: {key}{i} has shape {array.shape} of {array.dtype}, accepted: "
                    f"{shape} of {'whole ' if 'i' in kinds else ''}numbers"
                )
        if not (np.abs([*q.ravel(), *v.ravel(), dt]) <= LARGEST).all():
            raise DataError(
                f"{path}: block {i + 1} holds numbers that are not finite, or beyond {LARGEST:g}"
            )
        if not (dt > 0.0 and 0 <= sweeps < _MOST_SWEEPS):
            raise DataError(f"{path}: sweeps{i} is {sweeps} and dt{i} is {dt}, accepted: above 0")
        blocks.append(Checkpoint(q.astype(float), v.astype(float), int(sweeps), float(dt)))
    if len(found) != len(_KEYS) * len(sizes):
        raise DataError(f"{path}: is of a run with more chains")
    return blocks


def packed_block(done: Sampled) -> dict[str, Any]:
    """What a block of chains gave, as JSON holds it to the bit."""
    return {
        "values": pack(done.values),
        "accepted": pack(done.accepted),
        "end": packed_checkpoint(done.end),
    }


def unpacked_block(value: Mapping[str, Any]) -> Sampled:
    """What it was made of."""
    values, accepted = (unpack(value[key]) for key in ("values", "accepted"))
    return Sampled(values, accepted, unpacked_checkpoint(value["end"]))


def packed_checkpoint(one: Checkpoint) -> list[Any]:
    """Where a block of chains stands, as JSON holds it to the bit."""
    return [pack(one.q), pack(one.v), one.sweeps, one.dt]


def unpacked_checkpoint(listed: Sequence[Any]) -> Checkpoint:
    """What it was made of."""
    q, v, sweeps, dt = listed
    return Checkpoint(unpack(q), unpack(v), sweeps, dt)
