"""A scene and a task for it: what a block of chains needs."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.rows.independent_rows import independent
from mbd_ros.core.state import Array
from mbd_ros.errors import SceneError
from mbd_ros.features.sampling.chains import (
    Checkpoint,
    Plan,
    Sampled,
    begun,
    blocks_of,
    gone_on,
    usual_step,
)
from mbd_ros.features.sampling.components import random_starts
from mbd_ros.features.sampling.counting import kinetic_after_step
from mbd_ros.features.sampling.ensemble import Ensemble, Walkers
from mbd_ros.features.sampling.held_space import HeldSpace
from mbd_ros.features.sampling.mean_force import instant
from mbd_ros.features.sampling.observables import Observable, coordinate
from mbd_ros.features.sampling.quantities import DRIVEN, quantity
from mbd_ros.features.sampling.row_swept import row_swept
from mbd_ros.features.sampling.sampled_scene import SampledScene, sampled_scene
from mbd_ros.features.sampling.task import SampleTask
from mbd_ros.features.sampling.weighted_space import WeightedSpace
from mbd_ros.jobs.progress import progress

_STEPS_OF_POINTS, _STEPS_OF_JOINTS = 5, 20  # from sample to sample
_WAY = 40  # steps in which a held quantity is brought to its value


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


class Asked:
    """A scene, a task for it, and all that both give.

    Args:
        scene: The scene.
        task: The task.
        where: File and key of the task, for messages.

    Raises:
        SceneError: The task does not fit the scene.
    """

    def __init__(self, scene: Any, task: SampleTask, where: str) -> None:
        self.scene, self.task, self.where = scene, task, where
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

        return gone_on(ensemble, self.plan, order.number, start, measure, _shown)

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
