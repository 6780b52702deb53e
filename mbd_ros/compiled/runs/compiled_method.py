"""Methods of integration whose steps run in native code."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.compiled.build.library import Library, load
from mbd_ros.compiled.build.verify import verify
from mbd_ros.compiled.code.emit import emitted
from mbd_ros.compiled.runs.native_run import NativeRun, Sizes, Status, with_integrators
from mbd_ros.compiled.runs.native_stepper import ModeStepper, NativeStepper
from mbd_ros.compiled.symbols.trace import Traced, trace
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.contact_modes.row_distances import Reach
from mbd_ros.core.contracts import type_name
from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.core.state import Array, Memory, State, copied, is_same
from mbd_ros.methods.events.event_steps import EventSteps
from mbd_ros.methods.events.mode_field import ModeField
from mbd_ros.methods.integration.adapted_steps import TurnedSteps
from mbd_ros.methods.integration.linear_motion import LinearMotion
from mbd_ros.methods.integration.stepping import BlockStepper, HeldTable, Integrator, SampleBlock
from mbd_ros.methods.projection.assembly import Stabilization
from mbd_ros.methods.simulation.checked_steps import happenings, prepared

# Native runs between events, which plain Python locates.

_WENT_ON = (Status.DONE, Status.PAUSED, Status.NO_INPUTS)


class EventStepper(EventSteps, BlockStepper):
    """Steps from event to event, many at a time while the mode goes on.

    Native code looks at the mode after every step. It stops behind the step in which the mode may
    have ended; that step is searched as `EventSteps` does, with native steps of other lengths.

    Args:
        field: The system in its modes.
        inner: Native steps of that system.
        dt: Step of a fixed-step method, and interval of the output [s].
    """

    spans_samples = True

    def __init__(self, field: ModeField, inner: ModeStepper, dt: float) -> None:
        super().__init__(field, inner, dt)
        self._native, self._run = inner, inner.run
        self._run.ends_at_samples = self.ends_at_samples
        self._has_clearance = False  # native code looks after every step
        self._is_behind = False  # the native state is behind a step that is to be searched
        self._is_new = False  # the native state is newer than the last one known here
        self.stride = self._strides

    @property
    def evaluations(self) -> int:
        """How often compiled accelerations were computed."""
        return self._run.evaluations

    @property
    def newest(self) -> int:
        """Number of the newest sample."""
        return self._run.sample

    @property
    def is_within(self) -> bool:
        """Whether the last step has samples inside that are still to come."""
        return self._run.is_within

    @property
    def taken(self) -> int:
        """Steps taken since it was made."""
        return self._run.steps + self._native.handed_over

    @property
    def handed_over(self) -> int:  # type: ignore[override]
        """Steps that plain Python has taken."""
        return self._native.handed_over

    @property
    def plain_steps(self) -> int:
        """As `BlockStepper.plain_steps`; others were native ones that Python has searched."""
        return self._native.integrated_plainly

    @property
    def state(self) -> State:
        """What is integrated, before a step that is to be searched."""
        if self._is_new:
            self._is_new = False
            mode = self.field.mode
            if self._is_behind:
                self._last = self._run.began()._replace(mode=mode)
            else:
                self._last = self._native.newest_state()
        assert self._last is not None
        return self._last

    def begin_samples(self, y: State, sample: int, *, is_within: bool) -> None:
        """Say where the samples go on."""
        if self._last is None:
            self._last = y
        self._native.enter(y)
        self._run.begin_samples(sample, is_within=is_within)

    def samples(self, times: Any, held: HeldTable, steps: int, most: int) -> SampleBlock:
        """The samples after the newest one."""
        if self.is_within:
            before = self._within_plain_step(times, most)
            if len(before) == most:
                return SampleBlock(before, 0, False)
            rows, _ = self._run.samples(times, held, 0, most - len(before))
            return SampleBlock(np.concatenate((before, rows)), self._run.interval, False)
        if not self._is_ready(self.state, held.values[0]):
            return SampleBlock(np.zeros((0, self._run.row)), 0, True)
        if self.field.on or self.field.drives:  # which inputs that jump decide anew
            held = HeldTable(*(column[:1] for column in held))
        self._native.enter(self.state)
        rows, status = self._run.samples(times, held, steps, most)
        self._came_back(status)
        last = min(self._run.interval, len(held.values) - 1)
        self._u = held.values[last].copy()
        return SampleBlock(rows, self._run.interval, status not in _WENT_ON)

    def _within_plain_step(self, times: Any, most: int) -> Array:
        """Samples inside the last step where that was a plain one, as rows."""
        rows: list[Array] = []
        run, end = self._run, self._run.t - times.slack
        while self._native.is_plain and run.sample < times.end and len(rows) < most:
            due = times.due(run.sample + 1)
            if not due < end:
                break
            x = self.system.expand(self.interpolate(due))
            rows.append(np.concatenate(([due], *x[1:4])))
            run.begin_samples(run.sample + 1, is_within=True)
        return np.array(rows).reshape(-1, run.row)

    def whole(
        self, y: State, first: Array, times: Any, held: HeldTable, steps: int
    ) -> Callable[[], Array | None]:
        """Nothing: events are located by Python."""
        return lambda: None

    def step(self, x: State, u: Array | None, end: float = math.inf) -> State:
        """Advance by one step, corrected, or to the next event."""
        x = self._known(x)
        if self._is_behind:
            self._is_behind = False
            self._native.handed_over += 1
            after = self._searched(x, u, end, self._native.newest_state())
        else:
            after = super().step(x, u, end)
        if after is x or not np.isfinite(after.v).all():
            return after
        corrected = self._native.correct(after)
        if corrected is not after:
            super().continue_from(corrected)
        return corrected

    def _strides(self, x: State, u: Array | None, end: float, most: int) -> tuple[State, int]:
        """Several steps at once, as far as the mode goes on."""
        x = self._known(x)
        if self._is_behind or not x.t < end or not self._is_ready(x, u):
            return self.step(x, u, end), 1
        self._native.enter(self.state)
        before = self._run.steps
        status = self._run.advance(self._native.filled(u), end, most)
        count = self._run.steps - before
        self._came_back(status)
        return (self.state, count) if count else (self.step(self.state, u, end), 1)

    def restart(self) -> None:
        """Forget mode, events and earlier steps."""
        super().restart()
        self._is_behind = self._is_new = False

    def continue_from(self, x: State) -> None:
        """Continue in the same mode from a corrected state."""
        self._is_behind = self._is_new = False
        super().continue_from(x)

    def interpolate(self, t: float) -> State:
        """State at a time inside the last step, corrected."""
        return self._native.correct(super().interpolate(t))

    def memory(self) -> Memory:
        """Beside that of `EventSteps` whether the last step is to be searched."""
        last = copied(self.state)
        return {**super().memory(), "last": last, "is_behind": self._is_behind}

    def recall(self, memory: Memory, x: State) -> None:
        """Go on as after the step at which a memory was taken, with the same bits."""
        super().recall(memory, x)
        self._is_behind, self._is_new = memory["is_behind"], False

    def _is_ready(self, x: State, u: Array | None) -> bool:
        """Whether native code goes on from the state after the last step."""
        if self._is_behind:
            return False
        self._last = self._settled(x, u)
        happens, left = self._transitions, self._run.left
        left[:] = 0.0
        left[[*happens.left]] = 1.0
        return self._native.is_compiled and not happens.rests

    def _came_back(self, status: Status) -> None:
        self._is_behind, self._is_new = status is Status.GUARD, True
        self._transitions.left = frozenset(np.flatnonzero(self._run.left).tolist())

    def _known(self, x: State) -> State:
        """The state itself where it is that of the last step."""
        last = self.state if self._last is not None or self._is_new else None
        return last if last is not None and is_same(last, x) else x


Say = Callable[[str], None]


def silent(line: str) -> None:
    """Nobody is told."""


class Built(NamedTuple):
    """A system in native code.

    Attributes:
        traced: Its symbolic form.
        sizes: What the integrators are compiled for.
        library: What it was compiled to.
    """

    traced: Traced
    sizes: Sizes
    library: Library


class CompiledMethod(Integrator):
    """The steps of another method, and the projection after them, in native code.

    Args:
        method: The method.
        stabilization: What keeps the rows.
        say: Is told what takes time.
        kept: What was built for a system of the same parts, and takes what is built here; another
            dict for every system.

    Attributes:
        method: As given.
        traced: The symbolic form of the system that was prepared last.
        library: What it was compiled to.
    """

    keeps_constraints = True
    event_steps = EventStepper
    moves_internal = True
    turns = True

    def __init__(
        self,
        method: Integrator,
        stabilization: Stabilization,
        say: Say = silent,
        kept: dict[Any, Built] | None = None,
    ) -> None:
        self.method, self._stabilization, self._say = method, stabilization, say
        self._kept = {} if kept is None else kept
        self.order, self.stable = method.order, method.stable
        self.event_driven, self.finds_surfaces = method.event_driven, method.finds_surfaces
        self.traced: Traced | None = None
        self.library: Library | None = None

    @property
    def title(self) -> str:
        """That of the method, and that it is compiled."""
        return f"compiled {self.method.title}"

    def growth(self, motion: LinearMotion, dt: float) -> float:
        """Factor by which a step multiplies a linear motion at most."""
        return self.method.growth(motion, dt)

    def refuse(self, system: Any) -> None:
        """Refuse what native runs do not do.

        Raises:
            Untraceable: Names it.
        """
        if not self.method.native:
            name = type_name(type(self.method))
            raise Untraceable(f"integrator {name} takes no compiled steps")
        rows, guards = happenings(system)
        if guards or (rows and not self.method.event_driven):
            raise Untraceable(f"steps stop at events of {', '.join((*rows, *guards))}")
        stabilization = type(self._stabilization)
        corrects = stabilization.correct is not Stabilization.correct
        if system.held.rows and corrects and not self._stabilization.projects:
            raise Untraceable(f"stabilization {type_name(stabilization)} has no compiled form")
        for at, source in system.loads.sources.smooth:
            if source.pieces() is None:
                name = type_name(type(source))
                raise Untraceable(
                    f"{name} gives u[{at.start}:{at.stop}] within steps, from Python"
                )

    def prepare(self, system: Any, dt: float) -> NativeStepper:
        """The stepper for one system and one step size [s].

        Raises:
            Untraceable: Something in the system or the method has no compiled form; names it.
            BuildError: It cannot be compiled.
            ModelError: The method does not serve the system.
        """
        self.refuse(system)
        plain, form = prepared(self.method, system, dt), None
        if isinstance(system, InWorldAxes):
            plain, form = TurnedSteps(system, plain), system
        self.traced, sizes, self.library = built = self._built(system, dt)
        internals = system.internals
        widths = np.minimum(internals.upper - internals.lower, 1.0)
        bounds = np.array([internals.lower, internals.upper, widths]).reshape(3, -1)
        pairs = ((at, source.pieces()) for at, source in system.loads.sources.smooth)
        smooth = [(at, pieces) for at, pieces in pairs if pieces is not None]
        run = NativeRun(
            *(self.library, sizes, self.method, dt, bounds, np.ones(sizes.modes)),
            least_health=built.traced.least_health,
            smooth=smooth,
            form=form,
        )
        given = run, plain, self._corrects(system), system.loads.idle
        if not sizes.modes:
            return NativeStepper(*given)
        gaps = [i for i, reach in enumerate(system.exact.reach) if reach is Reach.GAP]
        return ModeStepper(*given, self.traced.keys, gaps)

    def _built(self, system: Any, dt: float) -> Built:
        """The native code of a system, made once."""
        key = self.method.native, self._is_projected(system), self._stabilization.gains(dt)
        if key not in self._kept:
            in_world = isinstance(system, InWorldAxes)
            own, mode = system.system if in_world else system, None if system.exact else ()
            traced = trace(own, mode=mode, in_world=in_world)
            sizes = self.sizes(system, traced)
            source = with_integrators(emitted(traced, sizes.functions), sizes)
            library = load(source, self._say, lambda found: verify(found, traced, system))
            self._kept[key] = Built(traced, sizes, library)
        return self._kept[key]

    def sizes(self, system: Any, traced: Traced) -> Sizes:
        """What native steps are compiled for."""
        is_projected = self._is_projected(system)
        rows = traced.mg, traced.mh
        return Sizes(
            *(traced.nq, traced.nv, traced.nz, traced.nu, *rows, traced.nq_all, traced.nv_all),
            is_flat=system.chart.is_flat,
            is_whole=system.nv == system.model.nv and not isinstance(system, InWorldAxes),
            is_projected=is_projected,
            is_rattle=self.method.native == "rattle",
            np=traced.np,
            **_modes(system, traced),
        )

    def _is_projected(self, system: Any) -> bool:
        is_held = bool(system.held.rows) and not self.method.keeps_constraints
        return is_held and self._stabilization.projects

    def _corrects(self, system: Any) -> Any:
        if not self._is_projected(system):
            return lambda y: y
        own = system.system if isinstance(system, InWorldAxes) else system
        return lambda y: self._stabilization.correct(own, y)


def _modes(system: Any, traced: Traced) -> dict[str, int]:
    """What a source has to know of rows that give way at events."""
    if not traced.switches:
        return {}
    reach = system.exact.reach
    counts = {kind: reach.count(kind) for kind in Reach}
    slips, demands = counts[Reach.SLIP], counts[Reach.DEMAND]
    return {
        "modes": traced.switches,
        "answers": int(traced.function("answers").size1_out(0)),
        "gaps": counts[Reach.GAP],
        "stays": counts[Reach.GAP] + slips + counts[Reach.FRICTION],
        "contacts": counts[Reach.FRICTION] // 2,
        "has_demands": demands > 0,
        "asks_always": slips + demands > 0,
    }
