"""Many runs of a scene side by side, from other starts and with other numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.build.compiler import cores
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, MbdError, SceneError, SolveError
from mbd_ros.methods.simulation.samples import sample_times
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.compiling import Impossible, attempted, silent, traced
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.scene.variants import with_numbers

if TYPE_CHECKING:
    from mbd_ros.compiled.runs.lane_runs import LaneRuns


class Batch:
    """Runs of a scene side by side: in lanes of vectors where it can be, else one by one.

    Args:
        count: How many runs.
        parameters: Names of numbers that differ, as `with_numbers` takes them.
        threads: How many cores work at the same time; all by default.
        tell: Is told what takes time.
        **options: As for `build_simulation`: integrator, dt, stabilization, solver. With the
            solver `compiled` it is an error where there are no lanes; with `plain` or a tier
            there are none.

    Attributes:
        how: What code takes the steps, for people.
        is_side_by_side: Whether the runs share vectors.

    Raises:
        SceneError: Names what is wrong and what is accepted.
    """

    def __init__(
        self,
        scene: Scene,
        count: int,
        *,
        parameters: Sequence[str] = (),
        threads: int | None = None,
        tell: Callable[[str], None] | None = None,
        **options: Any,
    ) -> None:
        if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < 1:
            raise SceneError(f"{scene.name}: batch: expected a number of runs > 0, got {count!r}")
        self.scene, self.count, self.parameters = scene, int(count), tuple(parameters)
        entry = options.pop("solver", None)
        chosen = scene.chosen_solver(entry)
        plain = "plain" if chosen.tier == "auto" else chosen.tier
        self._options = {**options, "solver": {"type": plain, "backend": chosen.backend}}
        self._threads, self._tell, self._must = threads, tell or silent, chosen.must_compile
        self._lanes: LaneRuns | None = None
        self._alone: Simulation | None = None
        self._may = chosen.compiles or (entry is None and "solver" not in scene.entries)
        self.how = "plain steps, run after run"
        self._simulation = build_simulation(scene, **self._options)
        if not self.parameters:
            self._prepare(scene, np.zeros(0))

    def _prepare(self, scene: Scene, p: Array) -> None:
        """Compile, once, for a scene with these values of the parameters.

        Raises:
            SceneError: It must be, and cannot.
        """
        if not self._may:
            return
        self._may = False
        try:
            self._lanes = attempted(lambda: self._compiled(scene, p))
            self.how = f"compiled, {self._lanes.lanes} runs an instruction"
        except (Impossible, SceneError) as error:
            self._take_alone(str(error))

    def _take_alone(self, why: str) -> None:
        """Runs one by one, compiled where numbers do not differ and it can be."""
        if self.parameters:
            if self._must:
                raise SceneError(f"{self.scene.name}: solver compiled: batch: {why}")
            self.how = f"not compiled: {why}"
            return
        entry = {**self._options["solver"], "type": "compiled" if self._must else "auto"}
        self._alone = build_simulation(
            self.scene, **self._options | {"solver": entry}, tell=self._tell
        )
        self.how = f"run after run, {self._alone.how}; side by side: {why}"

    def prepare(self, parameters: Array) -> None:
        """Compile before anything runs, from values of the parameters, a row a run.

        Raises:
            SceneError: A value that a part does not take: names the run. Or it cannot be compiled
                and must be.
        """
        if self._may:
            self._prepare(self._scene(0, parameters[0]), parameters[0])

    @property
    def is_side_by_side(self) -> bool:
        """Whether the runs share vectors."""
        return self._lanes is not None

    def run(
        self,
        duration: float,
        positions: Array | None = None,
        velocities: Array | None = None,
        internals: Array | None = None,
        parameters: Array | None = None,
    ) -> Runs:
        """Samples of all runs, every dt, the start included.

        A run that diverges or cannot start ends alone.

        Args:
            duration: [s].
            positions: Configurations of all joints, shape (n, nq); those of the scene by default.
            velocities: Of all joints, shape (n, nv).
            internals: Internal states, shape (n, nz); NaN for their equilibrium.
            parameters: Values of the parameters of the batch, shape (n, number of them).

        Raises:
            SceneError: Arrays of another shape, or a value that a part does not take: names the
                run.
        """
        p = self._rows("parameters", parameters, np.zeros((self.count, len(self.parameters))))
        if parameters is None and self.parameters:
            raise SceneError(f"{self.scene.name}: batch: parameters: are missing")
        scenes = [self._scene(i, row) for i, row in enumerate(p)] if self.parameters else []
        first = [scene.initial for scene in scenes] or [self.scene.initial] * self.count
        starts = Starts(
            self._rows("positions", positions, np.array([x.q for x in first])),
            self._rows("velocities", velocities, np.array([x.v for x in first])),
            self._rows("internals", internals, np.array([x.z for x in first])),
        )
        self._prepare((scenes or [self.scene])[0], p[0])
        return self._all(duration, scenes or [self.scene] * self.count, starts, p)

    def _rows(self, name: str, values: Any, default: Array) -> Array:
        """Rows of an argument, one a run."""
        if values is None:
            return default
        rows = np.asarray(values, dtype=np.float64)
        if rows.shape != default.shape:
            raise SceneError(
                f"{self.scene.name}: batch: {name}: shape {rows.shape}, expected {default.shape}"
            )
        if name != "internals" and not np.isfinite(rows).all():
            run = int(np.flatnonzero(~np.isfinite(rows).all(axis=1))[0])
            raise SceneError(f"{self.scene.name}: batch: {name} of run {run} are not finite")
        return rows

    def _scene(self, run: int, p: Array) -> Scene:
        """The scene with the numbers of a run."""
        if not self.parameters:
            return self.scene
        try:
            return with_numbers(self.scene, dict(zip(self.parameters, p.tolist(), strict=True)))
        except MbdError as error:
            raise type(error)(f"run {run}: {error}") from error

    def _all(self, duration: float, scenes: Sequence[Scene], x: Starts, p: Array) -> Runs:
        t = self.scene.initial.t
        times = sample_times(t, duration, self._simulation.dt)
        due = [times.due(k) for k in range(times.end + 1)]
        failures = dict[int, MbdError]()
        if self._lanes is None:
            system = self._simulation.system
            width = 1 + system.model.nq + system.model.nv + system.internals.nz
            states = np.full((self.count, len(due), width), np.nan)
            known, left = np.zeros(self.count, np.int64), np.arange(self.count)
        else:
            y = self._begun(scenes, x, t, failures)
            threads = cores() if self._threads is None else self._threads
            states, known = self._lanes.samples(y, p, due, threads)
            for i in failures:
                states[i], known[i] = np.nan, 0
            left = np.flatnonzero((known < len(due)) & (known > 0))
        for i in left.tolist():  # also what left the lanes: the plain tier says why, or goes on
            simulation = self._alone or build_simulation(scenes[i], **self._options)
            known[i], failure = run_alone(simulation, x.state(i, t), duration, states[i])
            if failure is not None:
                failures[i] = failure
        return Runs(states, known, dict(sorted(failures.items())))

    def _begun(
        self, scenes: Sequence[Scene], x: Starts, t: float, failures: dict[int, MbdError]
    ) -> Array:
        """Where what is integrated starts, a row a run; NaN where a run fails."""
        simulation = self._simulation
        system = simulation.system
        is_plain = not system.bilateral.rows and not system.internals.nz
        if is_plain and system.nv == system.model.nv:
            return np.hstack((x.q, x.v))
        rows = np.full((self.count, system.nq + system.nv + system.internals.nz), np.nan)
        for i, scene in enumerate(scenes):
            try:
                if self.parameters:
                    simulation = build_simulation(scene, **self._options)
                rows[i] = np.concatenate(simulation.start(x.state(i, t))[1:4])
            except MbdError as error:
                failures[i] = error
        return rows

    def _compiled(self, scene: Scene, p: Array) -> LaneRuns:
        from mbd_ros.compiled.runs.lane_method import lane_runs

        one = build_simulation(scene, **self._options) if self.parameters else self._simulation
        return lane_runs(
            *(one.system, one.integrator, one.stabilization, one.dt),
            lambda: traced(scene, one.system, self.parameters),
            *(p, self._tell),
        )


class Runs(NamedTuple):
    """Results of a batch.

    Attributes:
        states: Time [s], positions, velocities of all joints and internal states, as the rows of
            `Simulation.sampled`; shape (n, samples, 1 + nq + nv + nz). NaN after a run has ended.
        known: How many samples each run has, shape (n,).
        failures: Run -> why it ended early.
    """

    states: Array
    known: NDArray[np.int64]
    failures: dict[int, MbdError]


class Starts(NamedTuple):
    """Configurations, velocities of all joints and internal states, a row a run."""

    q: Array
    v: Array
    z: Array

    def state(self, run: int, t: float) -> State:
        """Where a run starts, at a time [s]."""
        return State(t, *(rows[run] for rows in self))


def run_alone(
    simulation: Simulation, x: State, duration: float, out: Array
) -> tuple[int, MbdError | None]:
    """One run, taken alone; how many samples it has, and why it ended early.

    Args:
        duration: [s].
        out: Gets the samples, those of `Runs.states`.
    """
    out[...], count = np.nan, 0
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # a divergence says so itself
            for each in simulation.run(x, duration):
                out[count], count = np.concatenate(([each.t], *each[1:4])), count + 1
    except (DivergedError, SolveError) as error:
        return count, error
    return count, None
