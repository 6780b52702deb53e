"""Runs in native code, as Python calls them."""

import ctypes
import math
from collections.abc import Callable, Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.build.library import Library
from mbd_ros.compiled.runs.method_options import method_options
from mbd_ros.compiled.runs.native_calls import bound
from mbd_ros.compiled.runs.native_source import Sizes
from mbd_ros.compiled.runs.native_types import (
    InputsOfC,
    Status,
    TimesOfC,
    pieces_of,
)
from mbd_ros.compiled.runs.run_memory import RunMemory
from mbd_ros.core.dynamics.world_axes import InWorldAxes
from mbd_ros.core.integration.blocks import HeldTable
from mbd_ros.core.integration.stepping import Integrator
from mbd_ros.core.loads.input_sources import Pieces
from mbd_ros.core.simulation.sample_times import SampleTimes
from mbd_ros.core.state import NONE, Array, State

_MANY = 2**62


class Block(NamedTuple):
    """Samples that one call took.

    Attributes:
        rows: A sample a row: time, positions, velocities of all joints, internal states.
        status: Why there are no more.
    """

    rows: Array
    status: Status


class NativeRun(RunMemory):
    """Integrations of one compiled scene by one method; not for two threads.

    Args:
        library: The scene with the integrators.
        sizes: What it was compiled for.
        method: The method.
        dt: Step of a fixed-step method, and first guess of others [s].
        bounds: Least and largest internal states, and what counts as an error of one, (3, nz).
        p: Values of the parameters.
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

    def samples(self, times: SampleTimes, held: HeldTable, steps: int, most: int) -> Block:
        """The samples after the newest one.

        Args:
            times: When they are due.
            held: Inputs from where the run stands on.
            steps: How many steps may be taken.
            most: How many samples may be written.
        """
        most = min(most, times.end - self.sample)
        rows = np.empty((most, self.row))
        given = *times[:3], times.resolution, times.slack, times.end, self.ends_at_samples
        value = TimesOfC(*given)
        table = InputsOfC(len(held.until), held.until.ctypes.data, held.values.ctypes.data)
        status = self._c.samples(
            *(self._o, self._r, ctypes.addressof(value), ctypes.addressof(table)),
            *(float(held.now[0]), steps, most, ctypes.addressof(self._written), rows.ctypes.data),
        )
        return Block(rows[: self._written.value], Status(status))

    def whole(
        self, y: State, first: Array, times: SampleTimes, held: HeldTable, steps: int
    ) -> Callable[[], Array | None]:
        """What takes a run from its start to its end in one call, with as little else as can be.

        It returns rows as those of a `Block`, and None where the run stopped earlier.

        Args:
            y: Where it starts.
            first: The first row.
            times: When samples are due.
            held: Inputs of the whole run.
            steps: How many steps may be taken.
        """
        start = np.concatenate(([y.t], y.q, y.v, y.z))
        value = TimesOfC(*times[:3], times.resolution, times.slack, times.end, 0)
        table = InputsOfC(len(held.until), held.until.ctypes.data, held.values.ctypes.data)
        kept, shape, after_first = (value, table, held), (times.end + 1, self.row), 8 * self.row
        given = self._o, self._r, start.ctypes.data, *map(ctypes.addressof, kept[:2]), steps
        call, written = self._c.sample_from, ctypes.addressof(self._written)

        def take() -> Array | None:
            rows = np.empty(shape)
            rows[0] = first
            place = rows.__array_interface__["data"][0] + after_first
            call(*given, written, place)
            return rows if self._written.value == len(rows) - 1 and kept else None

        return take

    def again(self, h: float, t: float) -> tuple[State, Status]:
        """The last step once more with another length [s], and the time it leads to [s]."""
        status = self._c.again(self._o, self._r, h, t, self._out.ctypes.data)
        return self._given(t), Status(status)

    def interpolate(self, t: float) -> tuple[State, Status]:
        """State inside the last step, corrected as the state after it is."""
        status = self._c.interpolate(self._o, self._r, t, self._out.ctypes.data)
        return self._given(t), Status(status)

    def inside(self, t: float) -> State:
        """State inside the last step, as its dense output has it."""
        self._c.state_within(self._o, self._r, t, self._out.ctypes.data)
        return self._given(t)

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
        """Go on in another mode of rows that give way; nothing of earlier steps holds in it."""
        self._p[len(self._p) - self.sizes.modes :] = mode[: self.sizes.modes]
        self._c.leave(self._r)

    def _given(self, t: float) -> State:
        nq, end = self.sizes.nq, self.sizes.nq + self.sizes.nv
        out = self._out.copy()
        return self._turned_back(t, out[:nq], out[nq:end], out[end:])


def held_inputs(u: Array | Sequence[float], now: float) -> HeldTable:
    """Inputs that never change from a time [s] on."""
    values = np.array(u, dtype=np.float64).reshape(1, -1)
    return HeldTable(np.array([math.inf]), values, np.array([now]))
