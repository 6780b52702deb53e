"""Contract of integrators: a method is a value, its stepper owns the workspace."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, ClassVar, NamedTuple

from mbd_ros.core.state import Array, Memory, Mode, State, copied, recognised
from mbd_ros.core.thresholds import SAME_TIME
from mbd_ros.errors import ModelError

NEAR = 1.0 + 1.0e-6  # in dt: no step needs `clip` that starts farther than this from the end


class Integrator:
    """A method of numerical integration.

    Attributes:
        order: Order of convergence for smooth motion.
        dense: Whether its steppers can interpolate.
        keeps_constraints: Whether the method itself keeps the constraints, so that no
            stabilization acts.
        keeps_internal: Whether the method integrates internal states as further velocities, as
            `core/dynamics/internal_dynamics.py` describes.
        moves_internal: Whether its steppers take states with internal states as they are.
        is_explicit: Whether stiff forces limit the step.
        event_driven: Whether its steps can be taken again with another length, so that they end
            at events; other methods refuse event-driven rows, and guards.
        event_steps: Class that takes its steppers from event to event; None for `EventSteps`.
        turns: Whether its steppers turn the velocities of a system in the axes of the world, and
            back, themselves.
        at_velocity_level: Whether its steps solve for unilateral and bounded rows with their rates
            at the end of the step, impacts included, and for internal states.
        finds_surfaces: Whether surfaces of switching forces are events, too.
        native: What compiled runs call its steps: `runge_kutta`, which have a `tableau` and may
            have a `tolerance`, `adams`, `rattle` or `semi_implicit_euler`; empty where they know
            no such steps.
        compiled_functions: Functions of a compiled scene that its steps in Python gain by, as
            `compiled/symbols/trace.py` names them; empty where they gain nothing.
        stable: Largest rate times dt, with the rate of `linear_motion.fastest_rate`, at which no
            oscillation and no decay grows, however it is damped; beyond it `growth` decides. inf
            where the method chooses its steps.
    """

    order: int
    dense: ClassVar[bool] = False
    keeps_constraints: bool = False
    keeps_internal: ClassVar[bool] = True
    moves_internal: ClassVar[bool] = False
    is_explicit: ClassVar[bool] = True
    event_driven: bool = False
    event_steps: Any = None
    turns: ClassVar[bool] = False
    at_velocity_level: ClassVar[bool] = False
    finds_surfaces: bool = False
    native: str = ""
    compiled_functions: tuple[str, ...] = ()
    stable: float = 2.5

    @property
    def title(self) -> str:
        """Name of the method for people."""
        return type(self).__name__

    def growth(self, motion: Any, dt: float) -> float:
        """Factor by which a step multiplies a linear motion at most, inf where it is not known.

        Args:
            motion: A `linear_motion.LinearMotion`.
            dt: Length of the step [s].
        """
        return math.inf

    def prepare(self, system: Any, dt: float) -> Stepper:
        """Return a stepper for one system and one step size [s]."""
        raise NotImplementedError

    def prepare_particles(self, system: Any, dt: float) -> Any:
        """Return the stepper for a system of particles and one step size [s].

        Raises:
            ModelError: The method has no steps for particles.
        """
        raise ModelError(f"{self.title} has no steps for particles; accepted: rattle, shake")


class Stepper:
    """A method at work on one system with one step size.

    Attributes:
        checkpoint_fields: Names of the attributes on which later steps depend, for checkpoints.
        system: The system that the steps follow, where it is not the one they were prepared for.
        is_fixed: Whether steps are as long as dt, those apart that end early.
        ends_at_samples: Whether a step that follows one which ended early ends at the next sample,
            as ticks of a live simulation have it; otherwise samples are interpolated until then.
        can_stride: Whether `stride` takes several steps at once faster than one by one.
        guards: Names of the guards whose events may fall together.
        switches: Names of those that a mode has an entry for, in that order.
    """

    can_stride: bool = False
    system: Any = None
    checkpoint_fields: ClassVar[tuple[str, ...]] = ()
    is_fixed: bool = True
    ends_at_samples: bool = False
    guards: tuple[str, ...] = ()
    switches: tuple[str, ...] = ()

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step.

        Args:
            x: State to start from; normally what the last step returned.
            u: Commands, held over the step; None without actuators.
            end: Time that the step does not go beyond [s].

        Raises:
            DivergedError: The state is no longer finite, or an iteration does not converge.
        """
        raise NotImplementedError

    def stride(
        self,
        x: State,
        u: Array | None,
        end: float,
        most: int,
        watch: Callable[[Array], bool] | None = None,
    ) -> tuple[State, int]:
        """Advance by several full steps, without the states in between; see `can_stride`.

        Args:
            x: State to start from; normally what the last step returned.
            u: Commands, held over the steps; None without actuators.
            end: Time that the steps do not go beyond [s].
            most: Largest number of steps that are taken.
            watch: Called with the velocity after each step; the steps stop where it returns True.

        Returns:
            The last state, and the number of steps that were taken.
        """
        return self.step(x, u, end), 1

    def settle(self, x: State, u: Array | None) -> State:
        """Return the first state with the mode in which it goes on.

        Args:
            x: State from which the first step starts.
            u: Inputs there; None without any.
        """
        return x

    def restart(self) -> None:
        """Forget all earlier steps."""

    @property
    def events(self) -> Sequence[Any]:
        """Events so far."""
        return ()

    def take_events(self) -> Sequence[Any]:
        """Return what has happened since the start or the last call; it is forgotten."""
        return ()

    @property
    def residuals(self) -> Any:
        """Worst `Residuals` of contacts since the last `reset_residuals`; None without any."""
        return None

    @property
    def forces(self) -> Array | None:
        """Mean forces of unilateral and bounded rows in the last step; None for most methods."""
        return None

    @property
    def ended(self) -> tuple[str, ...]:
        """Names of the guards that ended a phase in the last step; empty while it goes on."""
        return ()

    def reset_residuals(self) -> None:
        """Set the worst residuals to 0."""

    def checkpoint(self) -> Memory:
        """Return what later steps depend on beside their arguments, as a value of its own."""
        return {name: copied(getattr(self, name)) for name in self.checkpoint_fields}

    def restore(self, checkpoint: Memory, x: State) -> None:
        """Go on as after the step at which a checkpoint was taken, with the same bits.

        Args:
            checkpoint: What `checkpoint` gave, of a stepper for the same system and step size.
            x: State from which the next step starts.
        """
        for name, value in checkpoint.items():
            setattr(self, name, recognised(copied(value), x))

    def again(self, h: float, t: float) -> State:
        """Return the last step taken again from its start, with the order of the method.

        Args:
            h: Another length [s].
            t: Time that it leads to [s].

        Raises:
            DivergedError: An iteration does not converge.
        """
        raise NotImplementedError

    def follow(self, accelerate: Any, mode: Mode = ()) -> None:
        """Follow other accelerations from the next step on; what was kept of the old is forgotten.

        Args:
            accelerate: An `Accelerator`.
            mode: What the states of the steps have from then on.
        """
        raise NotImplementedError

    def continue_from(self, x: State) -> None:
        """Go on from a state that stabilization has made of the last one, history kept."""

    def interpolate(self, t: float) -> State:
        """Return the state at a time inside the last step, for methods with dense output."""
        raise NotImplementedError

    @property
    def pace(self) -> tuple[float, ...]:
        """Length of the next step [s] and last error, where the method chooses its steps."""
        return ()

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        """Go on with the pace of other steps of the same method."""

    def margin_within(self, which: tuple[int, int]) -> Callable[[float], float] | None:
        """A margin of the mode by the time inside the last step; None where nobody knows it so.

        Args:
            which: As `ModeField.margin`.
        """
        return None

    def margin_again(self, which: tuple[int, int]) -> Callable[[float, float], float] | None:
        """Return a margin after the last step taken again, by length and time; None if unknown.

        The margin is nan where the step fails.
        """
        return None

    def first_event(self, left: Collection[int]) -> tuple[float, int] | None:
        """Return when a gap closes in the last step before anything else happens.

        Args:
            left: Switches that the motion is just leaving.

        Returns:
            Length of the step until then [s], inf where nothing happens in it, and the number of
            the switch; None where nobody knows it so.
        """
        return None


def clip(t: float, dt: float, end: float) -> tuple[float, float]:
    """Length of a step of at most dt that does not go beyond `end`, and the time it leads to.

    A step that would end within rounding of `end` ends there with its full length, so that no
    sliver of a step follows it.

    Args:
        t: Time at its start [s].
        dt: Full length [s].
        end: [s]

    Returns:
        Length, <= 0 at or after `end`, and time after it [s].
    """
    left = end - t
    if abs(left - dt) <= SAME_TIME * dt + 4.0 * math.ulp(t):
        return dt, end
    return (left, end) if left < dt else (dt, t + dt)


class BlockStepper(Stepper):
    """A stepper that takes many samples at a time, corrections after steps included.

    Attributes:
        handed_over: Steps that were taken otherwise, since it could not.
        takes_blocks: Whether it does so in this run, or steps have to be taken one by one.
        spans_samples: Whether samples follow that are inside a step which was taken alone.
    """

    can_stride = True
    handed_over: int = 0
    takes_blocks: bool = True
    spans_samples: bool = False

    @property
    def plain_steps(self) -> int:
        """Number of steps in `handed_over` that other code has also integrated."""
        return self.handed_over

    @property
    def evaluations(self) -> int:
        """How often accelerations were computed, those of the system apart."""
        raise NotImplementedError

    @property
    def newest(self) -> int:
        """Number of the newest sample."""
        raise NotImplementedError

    @property
    def is_within(self) -> bool:
        """Whether the last step has samples inside that are still to come."""
        raise NotImplementedError

    @property
    def steps_taken(self) -> int:
        """Steps taken since it was made."""
        raise NotImplementedError

    @property
    def state(self) -> State:
        """State of the integrated coordinates after the last step."""
        raise NotImplementedError

    def begin_samples(self, y: State, sample: int, *, is_within: bool) -> None:
        """Say where the samples go on.

        Args:
            y: What is integrated, after the last step.
            sample: Number of the newest sample.
            is_within: Whether the last step has samples inside that are still to come.
        """
        raise NotImplementedError

    def samples(self, times: Any, hold: HeldTable, steps: int, most: int) -> SampleBlock:
        """Return the samples after the newest one.

        Args:
            times: The `SampleTimes` of the run.
            hold: Inputs from where the run stands on.
            steps: How many steps may be taken.
            most: How many samples may be taken.
        """
        raise NotImplementedError

    def full_run(
        self, y: State, first: Array, times: Any, hold: HeldTable, steps: int
    ) -> Callable[[], Array | None]:
        """Return what takes a run from its start to its end at once, again and again.

        Its rows are those of a `SampleBlock`; None where the run stopped earlier.

        Args:
            y: What is integrated at the start.
            first: The first row.
            times: The `SampleTimes` of the run.
            hold: Inputs of the whole run.
            steps: How many steps may be taken.
        """
        raise NotImplementedError


class SampleBlock(NamedTuple):
    """Samples of one call.

    Attributes:
        rows: A sample a row: time, positions and velocities of all joints, internal states.
        intervals: Rows of the held inputs that lie behind.
        is_stuck: Whether the next step has to be taken alone, by `Stepper.step`.
    """

    rows: Array
    intervals: int
    is_stuck: bool


class HeldTable(NamedTuple):
    """Inputs that are held from jump to jump.

    Attributes:
        until: Time at which each row ends, where a step ends too [s], shape (m,).
        values: The whole u of each, shape (m, nu).
        now: Time at which each row began [s], shape (m,).
    """

    until: Array
    values: Array
    now: Array
