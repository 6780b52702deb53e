"""A run in native code, as Python calls it."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.build.library import Library, aligned
from mbd_ros.compiled.code.source import Source
from mbd_ros.compiled.runs.run_layout import (
    Field,
    InputsOfC,
    Status,
    TimesOfC,
    method_options,
    pieces_of,
)
from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.core.loads.inputs import Pieces
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.methods.integration.stepping import HeldTable, Integrator
from mbd_ros.methods.simulation.samples import SampleTimes

NATIVE = Path(__file__).parents[1] / "native"
_FILES = (
    "run.h",
    "weights.h",
    "runge_kutta.h",
    "adams.h",
    "projection.h",
    "rattle.h",
    "steps.h",
    "events.h",
)
_LAST = {False: ("run.c", "search.c"), True: ("lanes.c",)}  # by whether reals are several numbers
_MANY = 2**62


class RunMemory:
    """Where a run stands, and all that its later steps depend on.

    Args:
        c: The functions of the library, see `bound`.
        sizes: What it was compiled for.
        form: What turns states into the form that was compiled and back, in which velocities of
            free bodies stand in the axes of the world; None where there is no other.

    Attributes:
        row: Numbers of a sample.
        left: 1 where rows are just being left and rounding does not count, one entry a mode.
    """

    def __init__(self, c: Any, sizes: Sizes, form: InWorldAxes | None = None) -> None:
        self.sizes, self._c, self._form = sizes, c, form
        self._at = place = [c.place_of(field) for field in Field]
        self.row = place[Field.ROW]
        self._numbers = aligned(place[Field.SIZE])
        self._r = self._numbers.ctypes.data
        self._q = self._numbers[place[Field.Q] :][: sizes.nq]
        self._v, self._z, _ = np.split(
            self._numbers[place[Field.W] :], (sizes.nv, sizes.nv + sizes.nz)
        )
        self.left = self._numbers[place[Field.LEFT] :][: sizes.modes]
        self.restart()

    @property
    def t(self) -> float:
        """Time of the state [s]."""
        return float(self._numbers[self._at[Field.T]])

    @property
    def pace(self) -> tuple[float, ...]:
        """Length of the next step [s] and last error, where the method chooses its steps."""
        return tuple(self._numbers[self._at[Field.LENGTH] :][:2].tolist())

    @pace.setter
    def pace(self, pace: tuple[float, ...]) -> None:
        self._numbers[self._at[Field.LENGTH] :][:2] = pace

    @property
    def inputs(self) -> Array:
        """Those that are held, fresh."""
        return self._numbers[self._at[Field.U] :][: self.sizes.nu].copy()

    @property
    def steps(self) -> int:
        """Steps taken so far."""
        return int(self._numbers[self._at[Field.STEPS]])

    @property
    def sample(self) -> int:
        """Number of the newest sample."""
        return int(self._numbers[self._at[Field.SAMPLE]])

    @property
    def is_within(self) -> bool:
        """Whether the last step has samples inside that are still to come."""
        return bool(self._numbers[self._at[Field.IS_WITHIN]])

    @property
    def interval(self) -> int:
        """Rows of held inputs that the last block has left behind."""
        return int(self._numbers[self._at[Field.INTERVAL]])

    @property
    def evaluations(self) -> int:
        """How often accelerations were computed so far."""
        return int(self._numbers[self._at[Field.EVALUATIONS]])

    def state(self) -> State:
        """Where the run stands, fresh."""
        return self._turned_back(self.t, self._q.copy(), self._v.copy(), self._z.copy())

    def restart(self) -> None:
        """Forget everything that was kept from earlier steps."""
        self._c.restart(self._r)

    def load(self, x: State, *, keeps_history: bool = False) -> None:
        """Go on from a state.

        Args:
            x: State of what is integrated.
            keeps_history: Whether it is the last one but for corrections.
        """
        if self._form is not None:
            x = self._form.to_world(x)
        self._numbers[self._at[Field.T]] = x.t
        self._q[...], self._v[...] = x.q, x.v
        if self._z.size:
            self._z[...] = x.z
        (self._c.touch if keeps_history else self._c.leave)(self._r)

    def begin_samples(self, sample: int, *, is_within: bool) -> None:
        """Say which sample is the newest, and whether the last step has others inside."""
        self._numbers[self._at[Field.SAMPLE]] = sample
        self._numbers[self._at[Field.IS_WITHIN]] = is_within

    def began(self) -> State:
        """Where the last step began, fresh."""
        nq, nv, nz = self.sizes.nq, self.sizes.nv, self.sizes.nz
        q = self._numbers[self._at[Field.Q0] :][:nq].copy()
        v, z = np.split(self._numbers[self._at[Field.W0] :][: nv + nz].copy(), [nv])
        return self._turned_back(float(self._numbers[self._at[Field.T0]]), q, v, z)

    def checkpoint(self) -> Array:
        """All that later steps and samples depend on, fresh."""
        return self._numbers[: self._at[Field.MEMORY]].copy()

    def restore(self, checkpoint: Array) -> None:
        """Go on as after the step at which a checkpoint was taken."""
        self._numbers[: len(checkpoint)] = checkpoint

    def _turned_back(self, t: float, q: Array, v: Array, z: Array) -> State:
        """A state of the system from numbers of the run, which it keeps."""
        x = State(t, q, v, z if z.size else NONE)
        return x if self._form is None else self._form.from_world(x)


class NativeRun(RunMemory):
    """Integrations of one compiled scene by one method; not for two threads.

    Args:
        library: The scene with the integrators.
        sizes: What it was compiled for.
        dt: Step of a fixed-step method, and first guess of others [s].
        bounds: Least and largest internal states, and what counts as an error of one, (3, nz).
        least_health: Of rows: below it the run stops.
        smooth: What inputs that change within steps are made of, with their places in u.
        form: As for `RunMemory`.

    Attributes:
        ends_at_samples: Whether steps that follow one which ended early end at the next sample.
    """

    ends_at_samples = False

    def __init__(
        self,
        library: Library,
        sizes: Sizes,
        method: Integrator,
        dt: float,
        bounds: Array,
        p: Array = NONE,
        least_health: float = 0.0,
        smooth: Sequence[tuple[slice, Pieces]] = (),
        form: InWorldAxes | None = None,
    ) -> None:
        super().__init__(bound(library.c), sizes, form)
        self.least_health = least_health
        self._bounds, self._p = np.ascontiguousarray(bounds, np.float64), np.array(p, np.float64)
        self._options = method_options(method, dt)
        options = self._options.value
        options.lower, options.upper, options.sizes = (row.ctypes.data for row in self._bounds)
        options.p, options.least_health = self._p.ctypes.data, least_health
        self._pieces = pieces_of(smooth)
        options.smooth, options.pieces = len(smooth), ctypes.addressof(self._pieces.value)
        self._o = ctypes.addressof(options)
        self._out, self._u = np.zeros(sizes.nq + sizes.nv + sizes.nz), np.zeros(max(sizes.nu, 1))
        self._rates = np.zeros(sizes.nv + sizes.nz + 1)
        self._written = ctypes.c_long(0)

    def health(self, x: State, u: Array) -> float:
        """Smallest pivot of the rows at a state over its usual size, as runs look at it."""
        at = np.concatenate((x.q, x.v, x.z))
        self._u[: len(u)] = u
        pointers = at.ctypes.data, self._u.ctypes.data, self._rates.ctypes.data
        return float(self._c.evaluate_at(self._o, self._r, x.t, *pointers))

    def advance(self, u: Array | None, end: float, most: int = _MANY) -> Status:
        """Steps until a time [s], at most so many, with held inputs."""
        if u is not None:
            self._u[: len(u)] = u
        return Status(self._c.advance(self._o, self._r, self._u.ctypes.data, end, most))

    def step_alone(self, u: Array | None, end: float) -> Status:
        """One step that nothing looks at or corrects, with held inputs, until a time [s]."""
        if u is not None:
            self._u[: len(u)] = u
        return Status(self._c.step_alone(self._o, self._r, self._u.ctypes.data, end))

    def samples(
        self, times: SampleTimes, inputs: HeldTable, steps: int, most: int
    ) -> tuple[Array, Status]:
        """The samples after the newest one, and why there are no more.

        A row is time, positions and velocities of all joints, and internal states.

        Args:
            times: When they are due.
            inputs: Inputs from where the run stands on.
            steps: How many steps may be taken.
            most: How many samples may be written.
        """
        most = min(most, times.end - self.sample)
        rows = np.empty((most, self.row))
        fields = *times[:3], times.resolution, times.slack, times.end, self.ends_at_samples
        value = TimesOfC(*fields)
        table = InputsOfC(len(inputs.until), inputs.until.ctypes.data, inputs.values.ctypes.data)
        status = self._c.samples(
            *(self._o, self._r, ctypes.addressof(value), ctypes.addressof(table)),
            *(
                float(inputs.now[0]),
                steps,
                most,
                ctypes.addressof(self._written),
                rows.ctypes.data,
            ),
        )
        return rows[: self._written.value], Status(status)

    def full_run(
        self, y: State, first: Array, times: SampleTimes, inputs: HeldTable, steps: int
    ) -> Callable[[], Array | None]:
        """A whole run in one call of native code.

        It returns rows as `samples` does, and None where the run stopped earlier.

        Args:
            y: Where it starts.
            times: When samples are due.
            inputs: Inputs of the whole run.
            steps: How many steps may be taken.
        """
        start = np.concatenate(([y.t], y.q, y.v, y.z))
        value = TimesOfC(*times[:3], times.resolution, times.slack, times.end, 0)
        table = InputsOfC(len(inputs.until), inputs.until.ctypes.data, inputs.values.ctypes.data)
        alive, shape, after_first = (value, table, inputs), (times.end + 1, self.row), 8 * self.row
        arguments = self._o, self._r, start.ctypes.data, *map(ctypes.addressof, alive[:2]), steps
        call, written = self._c.sample_from, ctypes.addressof(self._written)

        def take() -> Array | None:
            rows = np.empty(shape)
            rows[0] = first
            place = rows.__array_interface__["data"][0] + after_first
            call(*arguments, written, place)
            return rows if self._written.value == len(rows) - 1 and alive else None

        return take

    def again(self, h: float, t: float) -> tuple[State, Status]:
        """The last step once more with another length [s], and the time it leads to [s]."""
        status = self._c.again(self._o, self._r, h, t, self._out.ctypes.data)
        return self._output_state(t), Status(status)

    def interpolate(self, t: float) -> tuple[State, Status]:
        """State inside the last step, corrected as the state after it is."""
        status = self._c.interpolate(self._o, self._r, t, self._out.ctypes.data)
        return self._output_state(t), Status(status)

    def inside(self, t: float) -> State:
        """State inside the last step, as its dense output has it."""
        self._c.state_within(self._o, self._r, t, self._out.ctypes.data)
        return self._output_state(t)

    def margin_within(self, t: float, which: int) -> float:
        """A margin of the mode inside the last step, by its number in `Traced.keys`."""
        return float(self._c.margin_within(self._o, self._r, t, which))

    def margin_again(self, h: float, t: float, which: int) -> float:
        """The same after the last step, taken once more; as `again`, nan where that fails."""
        return float(self._c.margin_again(self._o, self._r, h, t, which))

    def first_event(self, is_gap: NDArray[np.bool_], left: Collection[int]) -> tuple[float, int]:
        """Length until the first gap closes in the last step [s], and its row; inf without any.

        Args:
            is_gap: Which rows are gaps, shape (modes,).
            left: Rows that are just being left.

        Returns:
            No number where something else may happen before, or only Python can tell.
        """
        self.left[:] = 0.0
        self.left[[*left]] = 1.0
        which = ctypes.byref(self._written)
        found = float(self._c.first_event(self._o, self._r, is_gap.ctypes.data, which))
        return found, self._written.value

    def switch(self, mode: Sequence[int]) -> None:
        """Go on in another mode of unilateral rows; nothing of earlier steps holds in it."""
        self._p[len(self._p) - self.sizes.modes :] = mode[: self.sizes.modes]
        self._c.leave(self._r)

    def _output_state(self, t: float) -> State:
        nq, end = self.sizes.nq, self.sizes.nq + self.sizes.nv
        out = self._out.copy()
        return self._turned_back(t, out[:nq], out[nq:end], out[end:])


class Sizes(NamedTuple):
    """Options that the integrators are compiled for, as `native/run.h` names them.

    Attributes:
        nq: Size of a configuration of what is integrated.
        nv: Of its velocity.
        ng: Rows of positions.
        nh: Rows that velocities keep.
        nq_all: Size of a configuration of all joints.
        nv_all: Of their velocity.
        is_flat: Whether configurations are a vector space with q' = v.
        is_whole: Whether all joints are integrated.
        is_projected: Whether every step is followed by a projection onto the rows.
        is_rattle: Whether the method is RATTLE.
        modes: Unilateral rows, whose modes stand behind the parameters.
        answers: Margins of their forces.
        gaps: How many of them are gaps.
        stays: How many have a rate that is none where they are on.
        contacts: How many of them are normals of contacts with friction.
        has_demands: Whether some of them are drives, whose demands are looked at in any mode.
        asks_always: Whether accelerations are, for these or for the rates of slips.
    """

    nq: int
    nv: int
    nz: int
    nu: int
    ng: int
    nh: int
    nq_all: int
    nv_all: int
    is_flat: bool
    is_whole: bool
    is_projected: bool = False
    is_rattle: bool = False
    np: int = 0
    modes: int = 0
    answers: int = 0
    gaps: int = 0
    stays: int = 0
    contacts: int = 0
    has_demands: bool = False
    asks_always: bool = False

    @property
    def functions(self) -> tuple[str, ...]:
        """The functions that the integrators call, by the names of `Traced`."""
        names = ["accelerate"]
        if not self.is_flat:
            names += ["integrate", "rate"]
        if not self.is_whole:
            names.append("expand")
        if self.is_projected and self.ng:
            names.append("place")
        if self.is_rattle and self.ng:
            names += ["gap", "lift"]
        if (self.is_projected or self.is_rattle) and self.nh:
            names.append("settle")
        if self.modes:
            names += ["heights", "answers"]
        names += ["land"] * bool(self.gaps) + ["stay"] * bool(self.stays)
        return tuple(names)


def with_integrators(functions: Source, sizes: Sizes) -> Source:
    """The source of a library that takes whole runs.

    Args:
        functions: What `emit` made of `Sizes.functions`; of vectors for runs side by side.
    """
    work = max(one.work for one in functions.signatures.values())
    numbers = {
        **{name.upper(): int(value) for name, value in sizes._asdict().items()},
        "WORK": work,
    }
    files = (*_FILES, *_LAST[functions.lanes > 1])
    lines = [f"#define {name} {value}\n" for name, value in numbers.items()]
    texts = [(NATIVE / name).read_text(encoding="utf-8") for name in files]
    return functions._replace(text="".join((functions.text, *lines, *texts)))


def bound(c: Any) -> Any:
    """The functions of a library with the types of their arguments."""
    pointer, number, integer = ctypes.c_void_p, ctypes.c_double, ctypes.c_long
    for name, arguments in (
        ("restart", (pointer,)),
        ("leave", (pointer,)),
        ("touch", (pointer,)),
        ("place_of", (integer,)),
        ("sample_from", (*(pointer,) * 5, integer, pointer, pointer)),
        ("advance", (pointer, pointer, pointer, number, integer)),
        ("samples", (*(pointer,) * 4, number, integer, integer, pointer, pointer)),
        ("evaluate_at", (pointer, pointer, number, pointer, pointer, pointer)),
        ("again", (pointer, pointer, number, number, pointer)),
        ("step_alone", (pointer, pointer, pointer, number)),
        ("state_within", (pointer, pointer, number, pointer)),
        ("margin_within", (pointer, pointer, number, integer)),
        ("margin_again", (pointer, pointer, number, number, integer)),
        ("first_event", (pointer,) * 4),
        ("interpolate", (pointer, pointer, number, pointer)),
    ):
        getattr(c, name).argtypes = arguments
    c.place_of.restype = integer
    for name in ("evaluate_at", "margin_within", "margin_again", "first_event"):
        getattr(c, name).restype = number
    for name in ("restart", "leave", "touch"):
        getattr(c, name).restype = None
    return c


def held_inputs(u: Array | Sequence[float], now: float) -> HeldTable:
    """Inputs that never change from a time [s] on."""
    values = np.array(u, dtype=np.float64).reshape(1, -1)
    return HeldTable(np.array([math.inf]), values, np.array([now]))
