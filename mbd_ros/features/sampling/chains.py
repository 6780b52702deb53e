"""Markov chains in blocks: a block depends only on scene, task and its number.

A block gives the same bits in any process. A checkpoint holds the states of the chains of a block,
from which the block continues with the same bits.
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
from mbd_ros.features.sampling.space import FixedCoordinateSpace, WeightedSpace
from mbd_ros.features.sampling.task import SampleTask
from mbd_ros.files.text_file import replacing
from mbd_ros.jobs.progress import progress
from mbd_ros.jobs.workers.task import pack, unpack
from mbd_ros.npz_file import read_arrays

_KEYS = ("q", "v", "sweeps", "dt")  # arrays of a checkpoint file, before the number of a block
_MOST_SWEEPS = 2**62  # of a block; more cannot be counted
_LARGEST_BLOCK = 256  # chains
_FEWEST_BLOCKS = 2
_ACCEPTANCE = 0.9  # target of the step
_STEP = 0.05  # step over the time that a particle of energy kT takes for the scale of the space
_FIRST_STEP = 0.1  # the same for the first step of the warm-up
_FRICTION = 0.025  # friction times the step
_GAIN = 1.0  # gain of the step adaptation
_GAIN_DECAY = 0.6  # exponent with which the gain falls
Measure = Callable[[Walkers], Array]  # shape (quantities, chains)
_STEPS_OF_POINTS = 5  # from sample to sample
_STEPS_OF_JOINTS = 20  # from sample to sample
_PATH_STEPS = 40  # from the start of the scene to a value of the coordinate


class SamplingProblem:
    """A scene and a task, with the space, the quantities and the plan that they define.

    Args:
        scene: The scene.
        task: The task.
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
                f"{where}.method: langevin needs constant masses, but those of a mechanism "
                "depend on its configuration; accepted: metropolis"
            )
        if task.kinetics and not self.sampled.points:
            raise SceneError(f"{where}.kinetics: is accepted for particles only")
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
        """Names of the energies of a sample, which come before its quantities."""
        names = ["energy.potential", "energy.kinetic"]
        if self.task.kinetics:
            parts = ("translation", "rotation", "internal")
            kinds = [kind.name for kind in self.sampled.space.kinds]
            names += [f"{kind}.{part}" for kind in kinds for part in parts]
            names += ["energy.kinetic_rattle", "energy.kinetic_shake"]
        return tuple(names)

    @property
    def columns(self) -> list[tuple[str, str]]:
        """Names and units of all values of a sample."""
        columns = [(name, self.sampled.energy) for name in self.energies]
        columns += [(quantity.name, quantity.unit) for quantity in self.quantities]
        if not self.sampled.points:
            positions = self.sampled.defaults
            columns += [
                (f"{name}.velocity", f"{position.unit}/s")
                for name, position in zip(self.sampled.space.names, positions, strict=True)
            ]
        return columns

    def _quantities(self) -> tuple[Observable, ...]:
        observe = self.task.observe
        if not observe:
            return self.sampled.defaults
        where = f"{self.where}.observe"
        return tuple(
            quantity(text, self.sampled, f"{where}.{name}", name) for name, text in observe.items()
        )

    def _coordinate(self, text: str) -> Observable:
        where = f"{self.where}.coordinate"
        if self.sampled.points:
            swept = row_swept(self.sampled.space, text, self.sampled.length)
            if swept is not None:
                row, space = swept
                self.sampled = replace(self.sampled, space=space)
                return row
        observable = quantity(text, self.sampled, where)
        if text.split()[0] not in DRIVEN and len(text.split()) > 1:
            raise SceneError(f"{where}: '{text}', accepted: {', '.join(DRIVEN)}")
        if self.sampled.points:
            return observable
        stops = [part.name for part in self.scene.constraints if not part.law.is_rigid]
        if stops:
            raise SceneError(
                f"{where}: stops would add to the mean force; accepted: a scene without "
                f"{', '.join(stops)}"
            )
        (number,) = observable.coordinates
        return coordinate(observable.name, observable.unit, number)  # beyond one turn, too

    def ensemble(self, level: float | None) -> Ensemble:
        """Return the ensemble, with the coordinate fixed if a value is given."""
        if level is None:
            return Ensemble(self.sampled.space, self.kT, fixman=self.task.fixman)
        assert self.coordinate is not None
        return Ensemble(FixedCoordinateSpace(self._swept, self.coordinate, level), self.kT)

    def _instant(self, ensemble: Ensemble, at: Walkers) -> Array:
        space, fixman = self._swept, self.task.fixman
        if isinstance(space, WeightedSpace):
            return np.array(instant(ensemble, at, space.gradient(at.q), fixman=False))
        return np.array(instant(ensemble, at, -space.force(at.q), fixman=fixman))

    def sample_block(self, order: BlockOrder) -> SampledBlock:
        """Sample a block of chains.

        Raises:
            DivergedError: A step does not end on the constraints.
            SceneError: A value of the coordinate cannot be reached.
        """
        ensemble = self.ensemble(order.level)
        start = order.start
        if start is None:
            chains = blocks_of(self.plan.chains)[order.number]
            q = self._starts(ensemble, order, chains.stop - chains.start)
            start = warm_up(ensemble, self.plan, order.number, q)

        h = default_step(ensemble) if self.plan.dt is None else self.plan.dt

        def measure(at: Walkers) -> Array:
            if order.level is not None:
                return self._instant(ensemble, at)
            values = [ensemble.space.potential(at.q), ensemble.kinetic(at.v)]
            if self.task.kinetics:
                values += [*self.sampled.space.kinetic_parts(at.q, at.v)]
                values += [*kinetic_after_step(ensemble, at, h)]
            values += [quantity.value(at.q) for quantity in self.quantities]
            if not self.sampled.points:
                values += [*self.sampled.space.velocities(at.q, at.v)]
            return np.array(values)

        block = continue_chains(ensemble, self.plan, order.number, start, measure, _with_progress)
        finite = np.isfinite(block.values).all(axis=(1, 2))
        if not finite.all():
            names = [name for name, _ in self.columns]
            odd = names[int(np.argmin(finite))] if order.level is None else "the mean force"
            raise DivergedError(f"{self.where}: {odd} of a sample is not finite")
        return block

    def _starts(self, ensemble: Ensemble, order: BlockOrder, count: int) -> Array:
        q = self.sampled.start
        if order.level is not None:
            q = self._start_at(ensemble, order.level)
        elif self.task.starts == "random":
            seed = (self.plan.seed + 7919 * (order.number + 1)) % 2**63
            starts = random_starts(ensemble, q, count, seed)
            if not starts.shape[1]:
                raise SceneError(
                    f"{self.where}.starts: no random configuration satisfies the constraints"
                )
            return starts[:, np.arange(count) % starts.shape[1]]
        return np.repeat(q[:, None], count, axis=1)

    def _start_at(self, ensemble: Ensemble, level: float) -> Array:
        """Return a configuration with a value of the coordinate, from the start of the scene."""
        assert self.coordinate is not None
        q = self.sampled.start[:, None]
        (rows,) = ensemble.space.blocks
        if len(independent(rows.jacobian(q)[:, :, 0])) < len(rows.rows):
            raise SceneError(
                f"{self.where}.coordinate: constraints of the scene fix {self.coordinate.name}; "
                f"accepted: another quantity, or one of them: {', '.join(rows.rows[:-1])}"
            )
        first = float(self.coordinate.value(q)[0])
        for share in np.linspace(0.0, 1.0, _PATH_STEPS + 1)[1:]:
            rows.level = first + share * (level - first)
            with np.errstate(all="ignore"):
                q, is_closed = ensemble.manifold.close(ensemble.manifold.at(q), q)
            if not is_closed.all():
                raise SceneError(
                    f"{self.where}.at: {self.coordinate.name} cannot move from {first:g} to "
                    f"{level:g}; it stops near {rows.level:g}"
                )
        return q[:, 0]


def _with_progress(samples: range) -> Iterable[int]:
    return progress(samples, len(samples), "sampling")


class BlockOrder(NamedTuple):
    """Order of a block of chains.

    Attributes:
        number: Number of the block among those of its value.
        level: Value of the coordinate; None without one.
        start: Checkpoint from which it continues; None starts it.
    """

    number: int
    level: float | None = None
    start: Checkpoint | None = None


class Plan(NamedTuple):
    """Numbers of a sampling run.

    Attributes:
        method: `metropolis` or `langevin`.
        chains: Number of chains.
        samples: Samples of each chain.
        warmup: Samples of each chain that are discarded before the others.
        steps: Steps between samples.
        dt: Step; None chooses it, for `metropolis` so that most proposals are accepted.
        friction: Rate at which `langevin` damps velocities; None chooses it.
        seed: Seed of the random numbers, >= 0.
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
    """Return the chains of each block, which depend only on the number of chains."""
    size = min(max(-(-chains // _FEWEST_BLOCKS), 1), _LARGEST_BLOCK)
    return [slice(i, min(i + size, chains)) for i in range(0, chains, size)]


def warm_up(ensemble: Ensemble, plan: Plan, number: int, q: Array) -> Checkpoint:
    """Run the warm-up of a block of chains.

    Args:
        ensemble: The ensemble.
        plan: Numbers of the run.
        number: Number of the block.
        q: Starts on the constraints, shape (size, chains of the block).
    """
    is_tuned = plan.method == "metropolis" and plan.dt is None
    dt = default_step(ensemble) * (_FIRST_STEP / _STEP if is_tuned else 1.0)
    method = method_of(ensemble, plan, dt if plan.dt is None else plan.dt)
    at = ensemble.at(q, np.zeros(q.shape))
    at = at._replace(
        v=ensemble.draw_velocities(stream(plan.seed, number, 0), at.places, q.shape[1])
    )
    steps = []
    for k in range(plan.warmup):
        at, accepted = method.sweep(at, stream(plan.seed, number, k + 1), plan.steps)
        if is_tuned:
            steps.append(method.dt)
            method.dt *= exp(_GAIN * (accepted.mean() - _ACCEPTANCE) / (1.0 + k) ** _GAIN_DECAY)
    if len(steps) >= 2:
        method.dt = exp(np.log(steps[len(steps) // 2 :]).mean())
    return Checkpoint(at.q, at.v, plan.warmup + 1, method.dt)


def continue_chains(
    ensemble: Ensemble,
    plan: Plan,
    number: int,
    start: Checkpoint,
    measure: Measure,
    watch: Callable[[range], Iterable[int]] = iter,
) -> SampledBlock:
    """Sample a block of chains from a checkpoint on.

    Args:
        ensemble: The ensemble.
        plan: Numbers of the run.
        number: Number of the block.
        start: Checkpoint of the block.
        measure: Function that gives the values of a sample.
        watch: Function that passes the numbers of samples on, to show progress.
    """
    method = method_of(ensemble, plan, start.dt)
    at, values = ensemble.at(start.q, start.v), []
    share = np.zeros(start.q.shape[1])
    for k in watch(range(start.sweeps, start.sweeps + plan.samples)):
        at, accepted = method.sweep(at, stream(plan.seed, number, k), plan.steps)
        values.append(measure(at))
        share += accepted
    end = Checkpoint(at.q, at.v, start.sweeps + plan.samples, start.dt)
    return SampledBlock(np.stack(values, axis=2), share / plan.samples, end)


def method_of(ensemble: Ensemble, plan: Plan, dt: float) -> Langevin | Metropolis:
    """Return the sampling method of a plan, with a step."""
    if plan.method == "metropolis":
        return Metropolis(ensemble, dt)
    friction = _FRICTION / dt if plan.friction is None else plan.friction
    return Langevin(ensemble, dt, friction)


def default_step(ensemble: Ensemble) -> float:
    """Return a step much shorter than the time in which a particle of kT moves by the scale."""
    lightest = float(ensemble.space.mass.min())
    return _STEP * ensemble.space.scale * sqrt(lightest / ensemble.kT)


class SampledBlock(NamedTuple):
    """Samples of a block of chains.

    Attributes:
        values: Values of the quantities, shape (quantities, chains, samples).
        accepted: Share of accepted proposals, shape (chains,).
        end: Checkpoint at its end.
    """

    values: Array
    accepted: Array
    end: Checkpoint


class Checkpoint(NamedTuple):
    """States of a block of chains, from which it continues with the same bits.

    Attributes:
        q: Configurations, shape (size, chains).
        v: Velocities, shape (size, chains).
        sweeps: Number of sweeps so far.
        dt: Step.
    """

    q: Array
    v: Array
    sweeps: int
    dt: float


def write_checkpoint(path: Path, blocks: Sequence[Checkpoint]) -> None:
    """Write the checkpoints of all blocks of a run to a .npz.

    Raises:
        DataError: The file cannot be written.
    """
    arrays = {
        f"{key}{i}": np.asarray(value)
        for i, block in enumerate(blocks)
        for key, value in zip(_KEYS, block, strict=True)
    }
    with replacing(path) as file:
        np.savez(file, allow_pickle=False, **arrays)


def read_checkpoint(path: Path, sizes: Sequence[tuple[int, int]]) -> list[Checkpoint]:
    """Read the checkpoints of all blocks of a run.

    Args:
        path: File of the checkpoints.
        sizes: Coordinates and chains of each block of the run that continues.

    Raises:
        DataError: The file cannot be read, or belongs to another scene or number of chains.
    """
    arrays = read_arrays(path, "a checkpoint of mbd-ros sample")
    blocks = []
    for i, size in enumerate(sizes):
        if any(f"{key}{i}" not in arrays for key in _KEYS):
            raise DataError(
                f"{path}: has no block {i + 1} of {len(sizes)}; it belongs to another run"
            )
        q, v, sweeps, dt = (arrays[f"{key}{i}"] for key in _KEYS)
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
    if len(arrays) != len(_KEYS) * len(sizes):
        raise DataError(f"{path}: belongs to a run with more chains")
    return blocks


def pack_block(block: SampledBlock) -> dict[str, Any]:
    """Return a sampled block as JSON values, to the bit."""
    return {
        "values": pack(block.values),
        "accepted": pack(block.accepted),
        "end": pack_checkpoint(block.end),
    }


def unpack_block(value: Mapping[str, Any]) -> SampledBlock:
    """Return the block of `pack_block`."""
    values, accepted = (unpack(value[key]) for key in ("values", "accepted"))
    return SampledBlock(values, accepted, unpack_checkpoint(value["end"]))


def pack_checkpoint(checkpoint: Checkpoint) -> list[Any]:
    """Return a checkpoint as JSON values, to the bit."""
    return [pack(checkpoint.q), pack(checkpoint.v), checkpoint.sweeps, checkpoint.dt]


def unpack_checkpoint(values: Sequence[Any]) -> Checkpoint:
    """Return the checkpoint of `pack_checkpoint`."""
    q, v, sweeps, dt = values
    return Checkpoint(unpack(q), unpack(v), sweeps, dt)
