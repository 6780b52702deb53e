"""Loads on a body over time, one slot for each load, and the instants of their peaks.

Lengths are in metres or millimetres; forces are in newtons and times in seconds in both systems of
units.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.features.loads.free_body import Balance, BodyLoad, BodyMotion, balances

CHOSEN = "chosen"
_NOTHING = 1.0e-9  # of the largest load: a peak below it is rounding


class History(NamedTuple):
    """Loads on a body over time, in axes of its link and SI units.

    Attributes:
        body: Link that names the body.
        links: All links of the body.
        joints: Joints at which it is cut.
        inertia: `pinocchio.Inertia` in the axes of the link.
        stamps: Times [ns], shape (n,).
        slots: The loads.
        point: Points of action [m], shape (n, slots, 3).
        force: Forces [N], shape (n, slots, 3).
        moment: Moments about the points [N·m], shape (n, slots, 3).
        motion: Gravity, acceleration, angular velocity and acceleration, shape (n, 3) each.
    """

    body: str
    links: tuple[str, ...]
    joints: tuple[str, ...]
    inertia: Any
    stamps: NDArray[np.int64]
    slots: tuple[Slot, ...]
    point: Array
    force: Array
    moment: Array
    motion: BodyMotion

    def time(self, row: int) -> float:
        """Return the time of a sample [s]."""
        return float(self.stamps[row] * NANOSECOND)

    def motion_at(self, row: int) -> BodyMotion:
        """Return the motion at one sample."""
        return BodyMotion(*(values[row] for values in self.motion))

    def balance(self) -> Balance:
        """Return the residual force and moment of the equations of the body in every sample."""
        return balances(self.point, self.force, self.moment, self.inertia, self.motion)


class Slot(NamedTuple):
    """A load on the body.

    Attributes:
        name: Name of the joint or part, numbered if a part acts at several points.
        kind: Kind of the load, as in `BodyLoad`.
    """

    name: str
    kind: str


def in_slots(
    samples: Sequence[Sequence[BodyLoad]],
) -> tuple[tuple[Slot, ...], Array, Array, Array]:
    """Sort the loads of samples into slots; a path that leaves a point exerts nothing there.

    Args:
        samples: Loads of each sample; those of a part are in the order of its points.

    Returns:
        Slots, points, forces and moments of a `History`.
    """
    parts = [_by_part(loads) for loads in samples]
    complete: dict[tuple[str, str], list[BodyLoad]] = {}
    for part in parts:
        for key, loads in part.items():
            if len(loads) > len(complete.get(key, ())):
                complete[key] = loads
    ends = list(itertools.accumulate(map(len, complete.values()), initial=0))
    begin = dict(zip(complete, ends[:-1], strict=True))
    slots = tuple(
        Slot(f"{name}_{i + 1}" if len(loads) > 1 else name, kind)
        for (name, kind), loads in complete.items()
        for i in range(len(loads))
    )
    at = np.array([load.point for loads in complete.values() for load in loads]).reshape(-1, 3)
    point = np.tile(at, (len(samples), 1, 1))
    force, moment = np.zeros((2, *point.shape))
    for row, part in enumerate(parts):
        for key, loads in part.items():
            for place, load in zip(_places(loads, complete[key]), loads, strict=True):
                slot = begin[key] + place
                point[row, slot], force[row, slot], moment[row, slot] = load[2:]
    return slots, point, force, moment


def _by_part(loads: Sequence[BodyLoad]) -> dict[tuple[str, str], list[BodyLoad]]:
    parts: dict[tuple[str, str], list[BodyLoad]] = {}
    for load in loads:
        parts.setdefault((load.name, load.kind), []).append(load)
    return parts


def _places(loads: Sequence[BodyLoad], complete: Sequence[BodyLoad]) -> Sequence[int]:
    """Match the points of a sample to those of a part: the nearest ones, in their order."""
    if len(loads) == len(complete):
        return range(len(loads))
    return min(
        itertools.combinations(range(len(complete)), len(loads)),
        key=lambda places: sum(
            float(np.linalg.norm(load.point - complete[i].point))
            for i, load in zip(places, loads, strict=True)
        ),
    )


class Instant(NamedTuple):
    """A marked sample.

    Attributes:
        row: Row of the history.
        name: `<load>.force` or `<load>.torque` for a peak, or `chosen`.
        value: Value of the peak [N or N·m]; 0 for a chosen instant.
    """

    row: int
    name: str
    value: float


def instants_of(history: History, chosen: Sequence[float]) -> list[Instant]:
    """Find the peaks of force and moment of every load, and add chosen instants, sorted by time.

    Args:
        chosen: Times [s], which are rounded to the nearest sample.

    Raises:
        DataError: A time is outside of the history.
    """
    instants = [Instant(_row(history, time), CHOSEN, 0.0) for time in chosen]
    for quantity, values in (("force", history.force), ("torque", history.moment)):
        sizes: Array = np.linalg.norm(values, axis=2)
        least = _NOTHING * sizes.max(initial=0.0)
        for slot, size in zip(history.slots, sizes.T, strict=True):
            row = int(size.argmax())
            if size[row] > least:
                instants.append(Instant(row, f"{slot.name}.{quantity}", float(size[row])))
    return sorted(instants, key=lambda each: (each.row, each.name))


def _row(history: History, time: float) -> int:
    times = history.stamps * NANOSECOND
    if not times[0] - 1e-9 <= time <= times[-1] + 1e-9:
        raise DataError(
            f"--at {time:g}: is outside of the motion, accepted: {times[0]:.9g} to "
            f"{times[-1]:.9g} s"
        )
    return int(np.abs(times - time).argmin())


def units_of(name: str) -> Units:
    """Return a system of units by its name.

    Raises:
        DataError: There is no such system.
    """
    if name not in SYSTEMS:
        raise DataError(f"--units {name}: accepted: m (N, m, kg, s, Pa) and mm (N, mm, t, s, MPa)")
    return SYSTEMS[name]


class Units(NamedTuple):
    """A consistent system of units.

    Attributes:
        name: Unit of length.
        per_metre: Number of these lengths in a metre.
        mass: Unit of mass.
        stress: Unit of stress.
    """

    name: str
    per_metre: float
    mass: str
    stress: str

    @property
    def moment(self) -> str:
        """Unit of moment."""
        return f"N·{self.name}"

    @property
    def acceleration(self) -> str:
        """Unit of acceleration."""
        return f"{self.name}/s^2"


SYSTEMS = {"m": Units("m", 1.0, "kg", "Pa"), "mm": Units("mm", 1000.0, "t", "MPa")}
