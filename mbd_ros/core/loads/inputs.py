"""u: the numbers that a scene takes from outside, where each stands, and what gives it over time.

`Inputs` names the channels of u, `Sources` gives u at a time from a `Source` of each part: tables,
polynomials, or sampled functions.
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
        channels: As the parts declare them, in the same order.
        slots: Name of a part -> where its inputs stand.
    """

    names: tuple[str, ...]
    channels: tuple[Channel, ...]
    slots: Mapping[str, slice]

    @property
    def safe(self) -> Array:
        """The u that no source gives, fresh, shape (nu,)."""
        return np.array([channel.safe for channel in self.channels], dtype=np.float64)

    def sources(self, given: Mapping[str, Source]) -> Sources:
        """What gives u, from the sources of parts by name; the others have safe values.

        Raises:
            ModelError: A part that is not there or has no inputs.
        """
        unknown = [name for name in given if name not in self.slots]
        if unknown:
            accepted = ", ".join(self.slots) or "none"
            raise ModelError(f"no part '{unknown[0]}' has inputs; accepted: {accepted}")
        return Sources(self.safe, [(self.slots[name], one) for name, one in given.items()])


class Sources:
    """The u of a scene over time.

    What is smooth is added at every stage: until then its places in u hold the time of its last
    jump, which says on which side of a jump a stage is, and by which steppers see that u changed.

    Args:
        idle: The u that no source gives, shape (nu,).
        given: Where in u the values of each source stand.

    Attributes:
        idle: As given, not to be written to.
        smooth: The sources that are asked at every stage.
    """

    def __init__(self, idle: Array, given: Sequence[tuple[slice, Source]] = ()) -> None:
        self.idle = idle
        self.given = tuple(given)
        self.smooth = tuple((at, source) for at, source in given if source.is_smooth)

    def at(self, t: float) -> Array:
        """The whole u at a time [s], fresh, shape (nu,)."""
        u = self.idle.copy()
        for at, source in self.given:
            u[at] = source.at(t)
        return u

    def held(self, jump: float) -> Array | None:
        """What steps from a jump [s] on hold, fresh; None where there is no source."""
        if not self.given:
            return None
        u = self.idle.copy()
        for at, source in self.given:
            u[at] = jump if source.is_smooth else source.at(jump)
        return u

    def complete(self, u: Array, t: float) -> Array:
        """The whole u at a time [s], fresh, shape (nu,), from what `held` gave."""
        whole = u.copy()
        for at, source in self.smooth:
            whole[at] = source.since(float(u[at.start]), t)
        return whole

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Times between two others at which u jumps [s], increasing."""
        return heapq.merge(*(source.jumps(begin, end) for _, source in self.given))


def bound(parts: Sequence[Part]) -> tuple[tuple[Part, ...], Inputs]:
    """Parts that know where their inputs and internal states stand, and all inputs.

    A part that another scene has bound to other places is copied: parts hold constants.

    Args:
        parts: Parts with inputs or internal states.

    Returns:
        The parts in the order given, and the inputs.
    """
    found: list[Part] = []
    names: list[str] = []
    channels: list[Channel] = []
    states = 0
    for part in parts:
        begin, first = len(channels), states
        channels += part.inputs
        names += input_names(part)
        states += len(part.internal)
        z = slice(first, states) if part.internal else part.z
        found.append(_at(part, Slots(slice(begin, len(channels)), z)))
    slots = {part.name: part.u for part in found if part.inputs}
    return tuple(found), Inputs(tuple(names), tuple(channels), slots)


def _at(part: Part, slots: Slots) -> Part:
    if (part.u, part.z) == slots:
        return part
    if (part.u, part.z) != (Part.u, Part.z):
        part = copy(part)
    part.bind(slots)
    return part


def input_names(part: Part) -> tuple[str, ...]:
    """`<part>`, or `<part>.<channel>` where a part has several inputs."""
    return tuple(".".join(filter(None, (part.name, one.name))) for one in part.inputs)


def command_names(actuators: Sequence[Actuator]) -> list[tuple[str, ...]]:
    """What files and topics call the inputs of each actuator.

    A joint stands for its only actuator, where that has one input a joint; all other inputs go by
    their own names.

    Args:
        actuators: All actuators of a scene.
    """
    driven = Counter(joint for part in actuators for joint in part.joints)
    found = []
    for part in actuators:
        names = input_names(part)
        if len(names) == len(part.joints):
            pairs = zip(part.joints, names, strict=True)
            names = tuple(joint if driven[joint] == 1 else name for joint, name in pairs)
        found.append(names)
    return found


class Source:
    """Values of some inputs over time.

    Attributes:
        is_smooth: Whether it is asked at every stage of a step. Otherwise its value is held from
            jump to jump.
    """

    is_smooth: ClassVar[bool] = False

    def at(self, t: float) -> Array:
        """Values at a time [s], shape (n,)."""
        raise NotImplementedError

    def since(self, jump: float, t: float) -> Array:
        """Values of what is smooth from a jump on, and a rounding beyond its end, shape (n,).

        Args:
            jump: The last jump, or the start of the run [s].
            t: [s].
        """
        return self.at(t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Times between two others at which it jumps [s], increasing."""
        return iter(())

    def pieces(self) -> Pieces | None:
        """What a smooth source is made of, for compiled runs; None where it is made of none.

        Between two jumps, `since` is the polynomial that has begun last, of those in between.
        """
        return None


class HeldTable(Source):
    """Values that hold until those of the next time; those of the first time before it.

    Args:
        times: [s], increasing, shape (m,); of equal ones the last counts.
        values: One row a time, shape (m, n).

    Raises:
        ModelError: The table is none.
    """

    def __init__(self, times: Array, values: Array) -> None:
        self._times, self._values = _table(times, values, 1)

    def at(self, t: float) -> Array:
        """Values at a time [s], shape (n,), not to be written to."""
        newest = int(np.searchsorted(self._times, t + NANOSECOND, side="right")) - 1
        row: Array = self._values[max(newest, 0)]
        return row

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Times of the rows [s]."""
        first = np.searchsorted(self._times, begin, side="right")
        last = np.searchsorted(self._times, end)
        return iter(self._times[first:last].tolist())


def _table(times: Array, values: Array, least: int) -> tuple[Array, Array]:
    """Times and rows of a table.

    Raises:
        ModelError: What does not make one.
    """
    stamps, rows = np.array(times, dtype=np.float64), np.array(values, dtype=np.float64)
    if stamps.ndim != 1 or len(stamps) < least:
        raise ModelError(f"times of shape {stamps.shape}, accepted: {least} or more numbers")
    if not (np.isfinite(stamps).all() and (np.diff(stamps) >= 0).all()):
        raise ModelError("times must be finite and increasing")
    if rows.ndim != 2 or len(rows) != len(stamps):
        raise ModelError(f"values of shape {rows.shape} for {len(stamps)} times")
    bad = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(bad):
        raise ModelError(f"values at {stamps[bad[0]]:g} s must be finite")
    return stamps, rows


class LinearTable(Source):
    """Straight lines between the rows of a table, zero before the first and after the last.

    Args:
        times: [s], strictly increasing, shape (m,), m >= 2.
        values: One row a time, shape (m, n).

    Raises:
        ModelError: The table is none.
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
        """Values at a time [s], ends included, shape (n,), not to be written to."""
        if is_symbol(t):
            return between_samples(t, np.array(self._times), self._values)
        if not self._times[0] <= t <= self._times[-1]:
            return self._zero
        return self._between(t)

    def since(self, jump: float, t: float) -> Array:
        """As `at`, on the side of the last jump [s]."""
        if jump < self._begin or jump >= self._end:
            return self._zero
        if self._begin < t < self._end:
            return self.at(t)
        return self._between(t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Its ends, where the table is not zero there [s]."""
        return (t for t in (self._begin, self._end) if begin < t < end)

    def pieces(self) -> Pieces:
        """Straight lines between two pieces that are zero."""
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
    """Straight lines between the rows of a table at a time that is a symbol; zero outside.

    Args:
        times: [s], strictly increasing, shape (m,).
        values: One row a time, shape (m, n).
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
    """Polynomials of the time since their beginning, each until the next one begins.

    The first one is continued before its beginning, the last one after it.

    Args:
        times: When each begins [s], strictly increasing, shape (m,).
        coefficients: Of each, by rising power, shape (m, powers, n).

    Raises:
        ModelError: Times or coefficients that do not belong together.
    """

    is_smooth = True

    def __init__(self, times: Array, coefficients: Array) -> None:
        rows = np.array(coefficients, dtype=np.float64)
        if rows.ndim != 3:
            raise ModelError(f"coefficients of shape {rows.shape}, accepted: (m, powers, n)")
        stamps, _ = _table(times, rows.reshape(len(rows), -1), 1)
        _refuse_equal(stamps)
        self._times: list[float] = stamps.tolist()
        self._coefficients = rows
        self._exponents = np.arange(rows.shape[1])
        last = np.diff(stamps)[:, None] ** self._exponents
        ends = np.matmul(last[:, None], rows[:-1])[:, 0]
        self._jumps = stamps[1:][(ends != rows[1:, 0]).any(axis=1)].tolist()

    def at(self, t: float) -> Array:
        """Values at a time [s], after a jump there, fresh, shape (n,)."""
        return self._piece(self._number(t), t)

    def since(self, jump: float, t: float) -> Array:
        """As `at`, on the side of the last jump [s]."""
        passed = bisect_right(self._jumps, jump)
        number = max(self._number(t), self._number(jump))
        if passed < len(self._jumps):
            number = min(number, self._number(self._jumps[passed]) - 1)
        return self._piece(number, t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """Beginnings at which the piece before ends at other values [s]."""
        return (t for t in self._jumps if begin < t < end)

    def pieces(self) -> Pieces:
        """As they were given."""
        jumps = np.isin(self._times, self._jumps)
        return Pieces(np.array(self._times), self._coefficients, jumps)

    def _number(self, t: float) -> int:
        return max(bisect_right(self._times, t) - 1, 0)

    def _piece(self, i: int, t: float) -> Array:
        value: Array = (t - self._times[i]) ** self._exponents @ self._coefficients[i]
        return value


class Sampled(Source):
    """Values that a function gives at equal times, held in between.

    Args:
        function: Time [s] -> values, shape (n,).
        period: Time from sample to sample [s], > 0.
        origin: Time of one of the samples [s].
    """

    def __init__(
        self, function: Callable[[float], Array], period: float, origin: float = 0.0
    ) -> None:
        self._function = function
        self._period = period
        self._origin = origin

    def at(self, t: float) -> Array:
        """What the function gives at a time [s], shape (n,)."""
        return self._function(t)

    def jumps(self, begin: float, end: float) -> Iterator[float]:
        """The times of the samples [s]."""
        first = math.floor((begin - self._origin) / self._period)
        times = (self._origin + k * self._period for k in itertools.count(first))
        return itertools.takewhile(lambda t: t < end, (t for t in times if t > begin))


class Pieces(NamedTuple):
    """Polynomials of the time since their beginning, each until the next one begins.

    Attributes:
        times: When each begins [s]; the first is continued before its beginning, shape (m,).
        coefficients: Of each, by rising power, shape (m, powers, n).
        jumps: Whether the values jump where it begins, shape (m,).
    """

    times: Array
    coefficients: Array
    jumps: NDArray[np.bool_]
