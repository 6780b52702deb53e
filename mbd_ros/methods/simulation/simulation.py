"""A run: a system, an integrator and a stabilization at work."""

import math
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contact_modes.slip_directions import begun
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.state import Array, Mode, State
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.integration.stepping import BlockStepper, Integrator
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.methods.simulation.checked_steps import (
    PATIENCE,
    WINDOW,
    CheckedSteps,
    Notice,
    StallWatch,
    refuse_crawl,
)
from mbd_ros.methods.simulation.sample_blocks import (
    Checkpoint,
    HeldInputs,
    Progress,
    RunTable,
    SampleBlocks,
    refuse_other,
    sample_times,
    step_end,
)

if TYPE_CHECKING:
    from mbd_ros.core.rows.constraint_rows import Cone


# ---- simulation -------------------------------------------------------------------------------
# A system, an integrator and a stabilization at work.


_STRIDE = 16  # steps after which a state must be finite


class Simulation(CheckedSteps):
    """Predicts motion from forces and commands.

    Args:
        system: The system; its rows are corrected as the stabilization demands.
        integrator: The method.
        stabilization: What keeps the rows; idle where the integrator keeps them itself.
        dt: Step of a fixed-step method, and interval of the output [s], > 0.

    Attributes:
        how: What code takes the steps, for people; empty where nobody asked for other code.
    """

    def __init__(
        self, system: System, integrator: Integrator, stabilization: Stabilization, dt: float
    ) -> None:
        super().__init__(system, integrator, stabilization, dt)
        self.how = ""
        self._progress: Progress | None = None
        self._blocks: SampleBlocks | None = None
        self._table: RunTable | None = None

    def start(self, x: State, u: Array | None = None) -> State:
        """The nearest consistent state of the integrated coordinates to a state of all joints.

        Args:
            x: State of all joints.
            u: Inputs there, which may decide in which mode it goes on.

        Raises:
            SolveError: The mechanism cannot be assembled near it, its mass matrix is singular, or
                internal states have no equilibrium there; or bodies of contacts overlap.
            ModelError: An internal state starts outside its bounds.
        """
        self.stepper.restart()
        self._blocks = None
        y = self._assembled(x)
        if self.overshoots is not None:
            self.overshoots.begin(y)
        if self._nz:
            from mbd_ros.core.dynamics.internal_dynamics import settled

            y = settled(self.system, y, u)
        y = self.stepper.settle(y, u)
        self._progress = Progress(y.t, 0, y, False, y.t)
        return y

    def run(
        self,
        x: State | Checkpoint,
        duration: float,
        notice: Notice | None = None,
    ) -> Iterator[State]:
        """States of all joints every dt, the first one included; steps end where inputs jump.

        Args:
            x: State of all joints; moved onto the constraints first. Or a checkpoint of a run: the
                samples after it follow.
            duration: [s], >= 0, from the first time of the run on; a last shorter interval ends
                exactly there.
            notice: Is called once where steps are so short that the end is far away.

        Raises:
            DivergedError: The state is no longer finite, or steps are too short to get to the end.
            SolveError: The mechanism cannot be assembled, or equations contradict one another.
            ModelError: The checkpoint is one of another scene, method or dt.
        """
        if isinstance(x, Checkpoint):
            self.resume(x)
        else:
            u = self.system.loads.sources.held(x.t)
            yield self.system.expand(self.start(x, u))
        yield from self._samples(self._progressed(), duration, notice)

    def _samples(self, at: Progress, duration: float, notice: Notice | None) -> Iterator[State]:
        """States of all joints at the samples after the newest one."""
        times, (origin, k, y, is_within, now) = sample_times(at.origin, duration, self.dt), at
        stepper = self.stepper
        if isinstance(stepper, BlockStepper) and stepper.takes_blocks:
            self._blocks = SampleBlocks(stepper, self.system, times, at, self._step)
            for x in self._blocks.states(StallWatch(self.system, self.dt, notice)):
                self.steps = stepper.taken
                yield x
            self._progress, self._blocks = self._blocks.progress, None
            return
        watch, look_at = StallWatch(self.system, self.dt, notice), self.steps + WINDOW
        watch.begin(y.t)
        inputs = HeldInputs(self.system.loads.sources, times, now)
        while k < times.end:
            due = times.due(k + 1)
            if not is_within:
                end = times.due(k + 1)
                if not self.stepper.ends_at_samples:
                    end = step_end(y, k, times, inputs.now, self.stepper.is_fixed)
                y = self._step(y, inputs.u, min(end, inputs.end))
                if self.steps >= look_at:
                    watch.look(y, inputs.u, times.last)
                    look_at = self.steps + WINDOW
                if 0.0 < abs(y.t - due) <= times.resolution == times.slack:  # times are coarse
                    y = y._replace(t=due)
                    self.stepper.continue_from(y)
            while k < times.end and due < y.t - times.slack:
                x, k = self.system.expand(self._corrected(self.stepper.interpolate(due))), k + 1
                self._progress = Progress(origin, k, y, True, inputs.now)
                yield x
                due = times.due(k + 1)
            is_within, y_next, y = False, y, self._corrected(y)
            if y is not y_next:
                self.stepper.continue_from(y)
            inputs.reach(y.t)
            if k < times.end and due <= y.t + times.slack:
                k += 1
                self._progress = Progress(origin, k, y, False, inputs.now)
                yield self.system.expand(y)

    def sampled(self, x: State, duration: float) -> Array:
        """The states of `run` as rows: time, positions, velocities, internal states.

        Args:
            x: As for `run`.
            duration: As for `run`.

        Returns:
            Shape (samples, 1 + nq + nv + nz), of all joints.

        Raises:
            DivergedError: As `run`.
            SolveError: As `run`.
        """
        stepper = self.stepper
        if self._table is None or not self._table.serves(x, duration):
            first = self.start(x, self.system.loads.sources.held(x.t))
            if not (isinstance(stepper, BlockStepper) and stepper.takes_blocks):
                return np.array([np.concatenate(([s.t], *s[1:4])) for s in self.run(x, duration)])
            times, at = sample_times(first.t, duration, self.dt), self._progressed()
            begin = partial(SampleBlocks, stepper, self.system, times, at, self._step)
            self._table = RunTable(x, duration, self.system.expand(first), begin)
        rows = self._table.rows(StallWatch(self.system, self.dt))
        self._blocks = self._table.blocks
        self.steps = self._blocks.stepper.taken
        return rows

    def checkpoint(self) -> Checkpoint:
        """All that the samples after the newest one depend on, beside the scene and its inputs.

        Raises:
            ModelError: Nothing was started yet.
        """
        stops = {} if self.overshoots is None else self.overshoots.memory()
        if self._blocks is not None:
            progress, steps, memory = self._blocks.remembered()
        else:
            progress, steps, memory = self._progressed(), self.steps, self.stepper.memory()
        return Checkpoint(self._made_by, progress, steps, self.worst, stops, memory)

    def resume(self, checkpoint: Checkpoint) -> State:
        """Go back to a checkpoint; returns the state of the integrated coordinates there.

        Raises:
            ModelError: It is one of another scene, method or dt.
        """
        refuse_other(checkpoint, self._made_by)
        self._progress, self.steps, self.worst = checkpoint[1:4]
        y, self._blocks = checkpoint.progress.y, None
        self.stepper.restart()
        self.stepper.recall(checkpoint.memory, y)
        if self.overshoots is not None:
            self.overshoots.recall(checkpoint.stops, y)
        return y

    def advance(self, y: State, u: Array | None, due: float) -> State:
        """State of the integrated coordinates at a time, in as many steps as the method needs.

        Args:
            y: What `start` or the last `advance` returned.
            u: Commands, held until then.
            due: [s]; y itself at or after it.

        Raises:
            DivergedError: The state is no longer finite.
            SolveError: Equations contradict one another.
        """
        is_looked_at = self._is_corrected or self.overshoots is not None
        nearly = due - max(SAME_TIME * self.dt, 2.0 * math.ulp(due))
        begin, first, look_at = y.t, self.steps, self.steps + PATIENCE * WINDOW
        while y.t < nearly:
            if self.steps >= look_at:
                refuse_crawl(self.system, y, u, (y.t - begin) / (self.steps - first), self.dt, due)
                look_at = self.steps + WINDOW
            y_next = self._step(y, u, due, 1 if is_looked_at else _STRIDE)
            y = self._corrected(y_next)
            if y is not y_next:
                self.stepper.continue_from(y)
        self._progress = self._progressed()._replace(y=y)
        return y

    def _progressed(self) -> Progress:
        if self._blocks is not None:
            self._progress, self._blocks = self._blocks.progress, None
        if self._progress is None:
            raise ModelError("a simulation that has not started has no checkpoint")
        return self._progress


# ---- shown accelerations ----------------------------------------------------------------------
# Accelerations and multipliers at a state, as people see them beside a motion.
#
# A method that solves for accelerations has them. One that solves for velocities knows which
# contacts press, stick and slip in a step; at the end of it gaps and slips are 0 to the order of
# the
# method only, so that the state alone does not say it. Accelerations follow from equations with
# the
# modes of the step. Where there are none (Painlevé's paradox), the mean forces of the step are
# seen.
#
# Source: F. Génot, B. Brogliato, New results on Painlevé paradoxes, European Journal of Mechanics
# A/Solids 18, 1999, sec. 2.


class Seen(NamedTuple):
    """What the equations of motion say at a state.

    Attributes:
        a: Accelerations of all joints, shape (nv,).
        lam: Multipliers of all rows, shape (m,).
        is_mean: Whether no accelerations exist there: these belong to the mean forces of a step.
    """

    a: Array
    lam: Array
    is_mean: bool = False


def seen_at(
    simulation: "Simulation", x: State, u: Array | None = None, forces: Array | None = None
) -> Seen:
    """Accelerations and multipliers of a simulation at a state of all joints.

    Args:
        simulation: The simulation; its next step is the same afterwards, to the bit.
        x: The state.
        u: Inputs there; None for those of the sources.
        forces: `Stepper.forces` of the step that led to the state; None where there was none.

    Raises:
        SolveError: There are none, and the method solves for accelerations.
    """
    if forces is not None:
        return seen_with(simulation, x, u, forces)
    try:
        _, a, _, lam, _ = simulation.system.evaluate(x, u)
    except SolveError:
        if not (simulation.integrator.at_velocity_level and simulation.system.layout.cones):
            raise

        return seen_ahead(simulation, x, u)
    return Seen(a, lam)


# ---- step forces ------------------------------------------------------------------------------
# Accelerations that belong to the modes, or to the mean forces, of a step of velocities.


OPEN: Mode = (1, 1, 1)
STICKS: Mode = (0, 0, 0)
_AT_BOUND = 1.0 - 1.0e-9  # of the largest friction: from here on it slips
_BEYOND = 1.0e-9  # of the largest force: by which a law may be passed
_NOTHING = 1.0e-12  # of the largest force: rounding
_LOOKS = 4  # at modes in which a contact passes its law


def seen_with(simulation: "Simulation", x: State, u: Array | None, forces: Array) -> Seen:
    """With the modes of the step that led to a state; arguments as for `seen_at`."""
    system = simulation.system
    lam = np.zeros(len(system.layout.rows))
    lam[_yielding(simulation)] = forces
    cones = system.layout.cones
    least = _NOTHING * float(np.abs(lam).max(initial=0.0))
    modes = [_mode(cone, lam[cone.slots], least) for cone in cones]
    try:
        for _ in range(_LOOKS):
            _, a, _, found, _ = system.evaluate(_in_modes(simulation, x, u, modes), u)
            most = _BEYOND * float(np.abs(found).max(initial=0.0))
            after = [
                _lawful(cone, mode, found[cone.slots], most)
                for cone, mode in zip(cones, modes, strict=True)
            ]
            if after == modes:
                return Seen(a, found)
            modes = after
    except SolveError:
        pass  # the mean forces are what there is
    return _with_means(simulation, x, u, forces)


def seen_ahead(simulation: "Simulation", x: State, u: Array | None) -> Seen:
    """With the mean forces of the step that begins at a state; arguments as for `seen_at`."""
    system, stepper = simulation.system, simulation.stepper
    y, memory = system.reduce(x), stepper.memory()
    held = system.loads.sources.held(x.t) if u is None else u
    stepper.step(y, held, y.t + simulation.dt)
    forces = stepper.forces
    stepper.restart()
    stepper.recall(memory, y)
    assert forces is not None
    return _with_means(simulation, x, u, forces)


def _yielding(simulation: "Simulation") -> list[int]:
    """Slots of the rows that give way."""
    blocks = simulation.system.layout.yielding
    return [i for block in blocks for i in range(block.slots.start, block.slots.stop)]


def _mode(cone: "Cone", force: Array, least: float) -> Mode:
    """The mode of a contact by its mean force in a step, where the least is none."""
    normal, x, y = force.tolist()
    if normal <= least:
        return OPEN
    if math.hypot(x, y) < _AT_BOUND * cone.mu * normal:
        return STICKS
    return 0, *begun(-force[1:])


def _lawful(cone: "Cone", mode: Mode, force: Array, most: float) -> Mode:
    """The mode of a contact whose force passes its law no more; the same where it keeps it."""
    normal, x, y = force.tolist()
    if mode[0]:
        return mode
    if normal < -most:
        return OPEN
    if not any(mode) and math.hypot(x, y) > cone.mu * normal + most:
        return 0, *begun(-force[1:])
    return mode


def _in_modes(simulation: "Simulation", x: State, u: Array | None, modes: list[Mode]) -> State:
    """The state with these modes of contacts, and of other rows those that it decides."""
    system = simulation.system
    exact = system.exact
    assert exact is not None
    assert exact.contacts is not None
    y, cones, slots = system.reduce(x), system.layout.cones, exact.slots.tolist()
    ways, free = exact.ways(y) if len(slots) > 3 * len(cones) else ((1,) * len(slots), [])
    slips = np.zeros((len(cones), 2))
    if any(any(mode) and not mode[0] for mode in modes):
        system.k.refresh(x.q, x.v, Reads.JACOBIAN)
        slips = exact.contacts.slips(system.k, x)
    whole, mine = list(ways), set[int]()
    for cone, mode, slip in zip(cones, modes, slips, strict=True):
        first = slots.index(cone.slots.start)
        goes_on = not mode[0] and any(mode) and slip.dot(mode[1:]) > 0.0
        whole[first : first + 3] = (0, *begun(slip)) if goes_on else mode
        mine.update(range(first, first + 3))
    others = [row for row in free if row not in mine]
    if others:
        exact.solve(y, u, tuple(whole), others)
        for row in others:
            lam, ends = float(exact.lam[row]), (float(exact.lower[row]), float(exact.upper[row]))
            whole[row] = 1 if lam <= ends[0] else -1 if lam >= ends[1] else 0
    return x._replace(mode=tuple(whole))


def _with_means(simulation: "Simulation", x: State, u: Array | None, forces: Array) -> Seen:
    """Accelerations under given forces of the rows that give way."""
    system, slots = simulation.system, _yielding(simulation)
    assert system.exact is not None
    now = system.evaluate(x._replace(mode=(1,) * len(system.exact.names)), u)
    lam = now.lam.copy()
    lam[slots] = forces
    J = np.concatenate([block.part.jacobian(system.k, x) for block in system.layout.yielding])
    force = (forces - now.lam[slots]).dot(J)
    change = now.respond(force[:, None])[:, 0]
    rigid = system.layout.rigid
    if rigid:  # they answer to it
        M = pin.crba(system.model, system.model.createData(), x.q)
        hold = np.concatenate([block.part.jacobian(system.k, x) for block in rigid])
        own = [i for block in rigid for i in range(block.slots.start, block.slots.stop)]
        lam[own] += np.linalg.lstsq(hold.T, M.dot(change) - force, rcond=None)[0]
    return Seen(now.a + change, lam, is_mean=True)
