"""Many runs side by side in the lanes of vectors, and on several cores."""

import ctypes
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.compiled.build.library import Library, aligned
from mbd_ros.compiled.runs.native_run import Sizes
from mbd_ros.compiled.runs.run_layout import method_options
from mbd_ros.core.state import Array
from mbd_ros.methods.integration.stepping import Integrator

_AT_ONCE = 4  # times the lanes: runs that a thread takes together


class Samples(NamedTuple):
    """Samples of many runs.

    Attributes:
        rows: Time, positions, velocities of all joints, internal states, a row a
            sample; shape (n, samples, width).
        known: How many samples of each run are right, shape (n,).
    """

    rows: Array
    known: NDArray[np.int64]


class LaneRuns:
    """Integrations of many states of one compiled scene, in steps that all of them share.

    Args:
        library: The scene with the integrators, of vectors.
        sizes: What it was compiled for.
        method: A method of fixed steps.
        dt: Its step [s].
        bounds: As for `NativeRun`.
        u: Inputs, the same in all runs.
        least_health: Of rows: below it a run stops.
    """

    def __init__(
        self,
        library: Library,
        sizes: Sizes,
        method: Integrator,
        dt: float,
        bounds: Array,
        u: Array,
        least_health: float,
    ) -> None:
        self.library, self.sizes = library, sizes
        self.width = 1 + sizes.nq_all + sizes.nv_all + sizes.nz
        self._many, self._size = _bound(library.c), int(library.c.size_of_run())
        self._bounds, self._u = np.ascontiguousarray(bounds), np.array([*u, 0.0])
        self._options = method_options(method, dt)
        options = self._options.value
        options.lower, options.upper, options.sizes = (row.ctypes.data for row in self._bounds)
        options.least_health = least_health

    @property
    def lanes(self) -> int:
        """How many runs an instruction serves."""
        return self.library.source.lanes

    def samples(self, y: Array, p: Array, times: Sequence[float], threads: int) -> Samples:
        """Samples of runs, that of the start among them.

        Args:
            y: States of what is integrated, a row a run: q, v, z.
            p: Values of the parameters, a row a run.
            times: When samples are due, the first one the start [s].
            threads: How many cores work at the same time.
        """
        y, p, due = (np.ascontiguousarray(each, np.float64) for each in (y, p, times))
        rows = np.empty((len(y), len(due), self.width))
        known = np.zeros(len(y), np.int64)
        block = self.lanes * max(1, min(_AT_ONCE, len(y) // (self.lanes * max(threads, 1))))
        starts = range(0, len(y), block)
        if threads <= 1 or len(starts) <= 1:
            self._some(y, p, due, rows, known)
            return Samples(rows, known)

        def take(first: int) -> None:
            some = slice(first, first + block)
            self._some(y[some], p[some], due, rows[some], known[some])

        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(take, starts))
        return Samples(rows, known)

    def _some(self, y: Array, p: Array, due: Array, rows: Array, known: Any) -> None:
        """Runs of one thread; the library lets others go on meanwhile."""
        run = aligned(self._size)
        self._many(
            *(ctypes.addressof(self._options.value), run.ctypes.data, len(y), y.ctypes.data),
            *(p.ctypes.data, self._u.ctypes.data, due.ctypes.data, len(due)),
            *(rows.ctypes.data, known.ctypes.data),
        )


def _bound(c: Any) -> Any:
    """The function of a library with the types of its arguments."""
    pointer, whole = ctypes.c_void_p, ctypes.c_long
    c.size_of_run.restype = whole
    c.many.argtypes = (*(pointer,) * 2, whole, *(pointer,) * 4, whole, *(pointer,) * 2)
    c.many.restype = None
    return c.many
