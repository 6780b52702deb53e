"""Inputs u of a scene: their channels, and sources that prescribe them over time.

`Inputs` names the channels of u. `Sources` evaluates u at a time from one `Source` per part: a
table, polynomials, or a sampled function.
"""

from __future__ import annotations

import heapq
import itertools
import math
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from copy import copy
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import Actuator, Channel, Part, Slots
from mbd_ros.core.state import NANOSECOND, Array, is_symbol
from mbd_ros.errors import ModelError


class Inputs(NamedTuple):
    """The channels of u.

    Attributes:
        names: `<part>`, or `<part>.<channel>` where a part has several, in the order of u.
        channels: Channels that the parts declare, in the same order.
        slots: Name of a part -> slice of its inputs in u.
    """

    names: tuple[str, ...]
    channels: tuple[Channel, ...]
    slots: Mapping[str, slice]

    @property
    def safe(self) -> Array:
        """Safe values of u, for inputs without a source; a new array, shape (nu,)."""
        return np.array([channel.safe for channel in self.channels], dtype=np.float64)

    def sources(self, by_part: Mapping[str, Source]) -> Sources:
        """Return the sources of u from those of parts, by name; other parts have safe values.

        Raises:
            ModelError: There is no such part, or it has no inputs.
        """
        unknown = [name for name in by_part if name not in self.slots]
        if unknown:
            accepted = ", ".join(self.slots) or "none"
            raise ModelError(f"no part '{unknown[0]}' has inputs; accepted: {accepted}")
        return Sources(self.safe, [(self.slots[name], s) for name, s in by_part.items()])


class Sources:
    """Inputs u of a scene over time.

    `hold` returns u for the steps after a jump. In it, the entries of smooth sources contain the
    time of the last jump instead of a value, and `complete` evaluates them at every stage. So a
    stage knows on which side of a jump it is, and steppers notice that u has changed.

    Args:
        idle: Values of u without a source, shape (nu,).
        entries: Slice of u and source, for every source.

    Attributes:
        idle: Values of u without a source, read-only.
        smooth: Entries whose source is evaluated at every stage.
    """

    def __init__(self, idle: Array, entries: Sequence[tuple[slice, Source]] = ()) -> None:
        self.idle = idle
        self.entries = tuple(entries)
        self.smooth = tuple((slot, source) for slot, source in entries if source.is_smooth)

    def at(self, t: float) -> Array:
        """Return u at a time [s], a new array, shape (nu,)."""
        u = self.idle.copy()
        for slot, source in self.entries:
            u[slot] = source.at(t)
        return u

    def hold(self, jump: float) -> Array | None:
        """Return the u that steps after a jump [s] hold, a new array; None without sources."""
        if not self.entries:
            return None
        u = self.idle.copy()
        for slot, source in self.entries:
            u[slot] = jump if source.is_smooth else source.at(jump)
        return u

    def complete(self, u: Array, t: float) -> Array:
        """Return u at a time [s] from the result of `hold`, a new array, shape (nu,)."""
        complete_u = u.copy()
        for slot, source in self.smooth:
            complete_u[slot] = source.since(float(u[slot.start]), t)
        return complete_u

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Return the times between two others at which u jumps [s], increasing."""
        return heapq.merge(*(source.jumps(begin, end) for _, source in self.entries))


def bound(parts: Sequence[Part]) -> tuple[tuple[Part, ...], Inputs]:
    """Bind parts to the slots of their inputs and internal states.

    A part that another scene has bound to other slots is copied.

    Args:
        parts: Parts with inputs or internal states.

    Returns:
        The bound parts in the same order, and the inputs.
    """
    bound_parts: list[Part] = []
    names: list[str] = []
    channels: list[Channel] = []
    states = 0
    for part in parts:
        begin, first = len(channels), states
        channels += part.inputs
        names += input_names(part)
        states += len(part.internal)
        z = slice(first, states) if part.internal else part.z
        bound_parts.append(_bind(part, Slots(slice(begin, len(channels)), z)))
    slots = {part.name: part.u for part in bound_parts if part.inputs}
    return tuple(bound_parts), Inputs(tuple(names), tuple(channels), slots)


def _bind(part: Part, slots: Slots) -> Part:
    if (part.u, part.z) == slots:
        return part
    if (part.u, part.z) != (Part.u, Part.z):
        part = copy(part)
    part.bind(slots)
    return part


def input_names(part: Part) -> tuple[str, ...]:
    """Return `<part>`, or `<part>.<channel>` for a part with several inputs."""
    return tuple(".".join(filter(None, (part.name, c.name))) for c in part.inputs)


def command_names(actuators: Sequence[Actuator]) -> list[tuple[str, ...]]:
    """Return the names of the inputs of each actuator in files and on topics.

    If an actuator is the only one of its joints and has one input per joint, the inputs have the
    names of the joints; otherwise they have the names of `input_names`.

    Args:
        actuators: All actuators of a scene.
    """
    driven = Counter(joint for part in actuators for joint in part.joints)
    all_names = []
    for part in actuators:
        names = input_names(part)
        if len(names) == len(part.joints):
            pairs = zip(part.joints, names, strict=True)
            names = tuple(joint if driven[joint] == 1 else name for joint, name in pairs)
        all_names.append(names)
    return all_names


class Source:
    """Values of some inputs over time.

    Attributes:
        is_smooth: Whether it is evaluated at every stage of a step; otherwise its value is held
            from jump to jump.
    """

    is_smooth: ClassVar[bool] = False

    def at(self, t: float) -> Array:
        """Return the values at a time [s], shape (n,)."""
        raise NotImplementedError

    def since(self, jump: float, t: float) -> Array:
        """Return the values of a smooth source on the smooth branch after a jump, shape (n,).

        Args:
            jump: Time of the last jump, or the start of the run [s].
            t: Time [s]; rounding may put it slightly beyond the end of the branch.
        """
        return self.at(t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Return the times between two others at which the values jump [s], increasing."""
        return iter(())

    def pieces(self) -> Pieces | None:
        """Return a smooth source as polynomial pieces, for compiled runs; None if it has none.

        Between two jumps, `since` evaluates the piece that has started last.
        """
        return None


class HeldTable(Source):
    """Zero-order hold of the rows of a table; before the first time the first row applies.

    Args:
        times: Times [s], increasing, shape (m,); of equal times the last one counts.
        values: One row per time, shape (m, n).

    Raises:
        ModelError: Times or values are not valid.
    """

    def __init__(self, times: Array, values: Array) -> None:
        self._times, self._values = _table(times, values, 1)

    def at(self, t: float) -> Array:
        """Return the values at a time [s], shape (n,), read-only."""
        newest = int(np.searchsorted(self._times, t + NANOSECOND, side="right")) - 1
        row: Array = self._values[max(newest, 0)]
        return row

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Return the times of the rows [s]."""
        first = np.searchsorted(self._times, begin, side="right")
        last = np.searchsorted(self._times, end)
        return iter(self._times[first:last].tolist())


def _table(times: Array, values: Array, least: int) -> tuple[Array, Array]:
    """Check a table and return its times and rows.

    Raises:
        ModelError: Times or values are not valid.
    """
    stamps, rows = np.array(times, dtype=np.float64), np.array(values, dtype=np.float64)
    if stamps.ndim != 1 or len(stamps) < least:
        raise ModelError(f"times have shape {stamps.shape}, accepted: {least} or more numbers")
    if not (np.isfinite(stamps).all() and (np.diff(stamps) >= 0).all()):
        raise ModelError("times must be finite and increasing")
    if rows.ndim != 2 or len(rows) != len(stamps):
        raise ModelError(
            f"values have shape {rows.shape}, but must have {len(stamps)} rows, one per time"
        )
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise ModelError(f"values at {stamps[bad[0]]:g} s must be finite")
    return stamps, rows


class LinearTable(Source):
    """Linear interpolation of the rows of a table, zero before the first and after the last.

    Args:
        times: Times [s], strictly increasing, shape (m,), m >= 2.
        values: One row per time, shape (m, n).

    Raises:
        ModelError: Times or values are not valid.
    """

    is_smooth = True

    def __init__(self, times: Array, values: Array) -> None:
        stamps, self._values = _table(times, values, 2)
        _refuse_equal(stamps)
        self._times: list[float] = stamps.tolist()
        self._slopes = np.diff(self._values, axis=0) / np.diff(stamps)[:, None]
        self._zero = np.zeros(self._values.shape[1])
        first, last = self._values[0].any(), self._values[-1].any()
        self._begin = self._times[0] if first else -math.inf  # jumps
        self._end = self._times[-1] if last else math.inf

    def at(self, t: float) -> Array:
        """Return the values at a time [s], ends included, shape (n,), read-only."""
        if is_symbol(t):
            return between_samples(t, np.array(self._times), self._values)
        if not self._times[0] <= t <= self._times[-1]:
            return self._zero
        return self._between(t)

    def since(self, jump: float, t: float) -> Array:
        """Return the values at a time [s] on the branch after the last jump [s], shape (n,)."""
        if jump < self._begin or jump >= self._end:
            return self._zero
        if self._begin < t < self._end:
            return self.at(t)
        return self._between(t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Return the ends of the table at which it is not zero [s]."""
        return (t for t in (self._begin, self._end) if begin < t < end)

    def pieces(self) -> Pieces:
        """Return the linear pieces, between two pieces that are zero."""
        rising = np.stack((self._values[:-1], self._slopes), axis=1)
        zero = np.zeros((1, *rising.shape[1:]))
        times = np.array([self._times[0] - 1.0, *self._times])
        jumps = np.zeros(len(times), dtype=np.bool_)
        jumps[1], jumps[-1] = math.isfinite(self._begin), math.isfinite(self._end)
        return Pieces(times, np.concatenate((zero, rising, zero)), jumps)

    def _between(self, t: float) -> Array:
        i = min(max(bisect_right(self._times, t) - 1, 0), len(self._slopes) - 1)
        if t == self._times[-1]:
            return self._values[-1]
        between: Array = self._values[i] + (t - self._times[i]) * self._slopes[i]
        return between


def _refuse_equal(stamps: Array) -> None:
    if not (np.diff(stamps) > 0).all():
        raise ModelError("times must be strictly increasing")


def between_samples(t: Any, times: Array, values: Array) -> Array:
    """Interpolate the rows of a table linearly at a symbolic time; zero outside of the table.

    Args:
        t: Symbolic time.
        times: Times [s], strictly increasing, shape (m,).
        values: One row per time, shape (m, n).
    """
    slopes = np.diff(values, axis=0) / np.diff(times)[:, None]
    pieces = np.column_stack((times[:-1], values[:-1], slopes))
    ends = [*times[:-1].tolist(), np.nextafter(times[-1], np.inf)]
    nothing = np.zeros((1, pieces.shape[1]))
    begin, *row = t.piecewise(ends, np.concatenate((nothing, pieces, nothing)))
    n = values.shape[1]
    at = [value + (t - begin) * slope for value, slope in zip(row[:n], row[n:], strict=True)]
    return np.array(at, dtype=object)


class Polynomials(Source):
    """Piecewise polynomials of the time since the start of each piece.

    The first piece also holds before its start, the last one has no end.

    Args:
        times: Starts of the pieces [s], strictly increasing, shape (m,).
        coefficients: Coefficients by rising power, shape (m, powers, n).

    Raises:
        ModelError: Times and coefficients do not match.
    """

    is_smooth = True

    def __init__(self, times: Array, coefficients: Array) -> None:
        rows = np.array(coefficients, dtype=np.float64)
        if rows.ndim != 3:
            raise ModelError(f"coefficients have shape {rows.shape}, accepted: (m, powers, n)")
        stamps, _ = _table(times, rows.reshape(len(rows), -1), 1)
        _refuse_equal(stamps)
        self._times: list[float] = stamps.tolist()
        self._coefficients = rows
        self._exponents = np.arange(rows.shape[1])
        last = np.diff(stamps)[:, None] ** self._exponents
        ends = np.matmul(last[:, None], rows[:-1])[:, 0]
        self._jumps = stamps[1:][(ends != rows[1:, 0]).any(axis=1)].tolist()

    def at(self, t: float) -> Array:
        """Return the values at a time [s], after a jump at that time, a new array, shape (n,)."""
        return self._piece(self._number(t), t)

    def since(self, jump: float, t: float) -> Array:
        """Return the values at a time [s] on the branch after the last jump [s], shape (n,)."""
        passed = bisect_right(self._jumps, jump)
        number = max(self._number(t), self._number(jump))
        if passed < len(self._jumps):
            number = min(number, self._number(self._jumps[passed]) - 1)
        return self._piece(number, t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Return the starts of pieces at which the values jump [s]."""
        return (t for t in self._jumps if begin < t < end)

    def pieces(self) -> Pieces:
        """Return the polynomials."""
        jumps = np.isin(self._times, self._jumps)
        return Pieces(np.array(self._times), self._coefficients, jumps)

    def _number(self, t: float) -> int:
        return max(bisect_right(self._times, t) - 1, 0)

    def _piece(self, i: int, t: float) -> Array:
        value: Array = (t - self._times[i]) ** self._exponents @ self._coefficients[i]
        return value


class Sampled(Source):
    """Zero-order hold of a function that is sampled periodically.

    Args:
        function: Time [s] -> values, shape (n,).
        period: Sampling period [s], > 0.
        origin: Time of one of the samples [s].
    """

    def __init__(
        self, function: Callable[[float], Array], period: float, origin: float = 0.0
    ) -> None:
        self._function = function
        self._period = period
        self._origin = origin

    def at(self, t: float) -> Array:
        """Return the value of the function at a time [s], shape (n,)."""
        return self._function(t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Return the times of the samples [s]."""
        first = math.floor((begin - self._origin) / self._period)
        times = (self._origin + k * self._period for k in itertools.count(first))
        return itertools.takewhile(lambda t: t < end, (t for t in times if t > begin))


class Pieces(NamedTuple):
    """Piecewise polynomials of the time since the start of each piece.

    Attributes:
        times: Starts of the pieces [s]; the first piece also holds before, shape (m,).
        coefficients: Coefficients by rising power, shape (m, powers, n).
        jumps: Whether the values jump at each start, shape (m,).
    """

    times: Array
    coefficients: Array
    jumps: NDArray[np.bool_]
