"""Loads on a body over time, a slot each that stays the same, and the instants that matter.

They are written in metres or in millimetres; forces are newtons and times seconds in both systems
of units.
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
        links: All links of the body.
        joints: Where it is cut.
        inertia: `pinocchio.Inertia` in the axes of the link.
        stamps: Times [ns], shape (n,).
        point: Where they act [m], shape (n, slots, 3).
        force: [N], shape (n, slots, 3).
        moment: About the points [N·m], shape (n, slots, 3).
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
        """Of a sample [s]."""
        return float(self.stamps[row] * NANOSECOND)

    def motion_at(self, row: int) -> BodyMotion:
        """Of one sample."""
        return BodyMotion(*(values[row] for values in self.motion))

    def balance(self) -> Balance:
        """What is left of the equations of the body in every sample."""
        return balances(self.point, self.force, self.moment, self.inertia, self.motion)


class Slot(NamedTuple):
    """A load on the body.

    Attributes:
        name: Of the joint or part; numbered where a part acts at several points.
        kind: As of a `BodyLoad`.
    """

    name: str
    kind: str


def in_slots(
    samples: Sequence[Sequence[BodyLoad]],
) -> tuple[tuple[Slot, ...], Array, Array, Array]:
    """Loads of samples in slots; a path that lets go of a point exerts nothing there.

    Args:
        samples: The loads of each sample; those of a part stand in the order of its points.

    Returns:
        Slots, points, forces and moments, as of a `History`.
    """
    parts = [_by_part(loads) for loads in samples]
    whole: dict[tuple[str, str], list[BodyLoad]] = {}
    for part in parts:
        for key, loads in part.items():
            if len(loads) > len(whole.get(key, ())):
                whole[key] = loads
    ends = list(itertools.accumulate(map(len, whole.values()), initial=0))
    begin = dict(zip(whole, ends[:-1], strict=True))
    slots = tuple(
        Slot(f"{name}_{i + 1}" if len(loads) > 1 else name, kind)
        for (name, kind), loads in whole.items()
        for i in range(len(loads))
    )
    at = np.array([load.point for loads in whole.values() for load in loads]).reshape(-1, 3)
    point = np.tile(at, (len(samples), 1, 1))
    force, moment = np.zeros((2, *point.shape))
    for row, part in enumerate(parts):
        for key, loads in part.items():
            for place, load in zip(_places(loads, whole[key]), loads, strict=True):
                slot = begin[key] + place
                point[row, slot], force[row, slot], moment[row, slot] = load[2:]
    return slots, point, force, moment


def _by_part(loads: Sequence[BodyLoad]) -> dict[tuple[str, str], list[BodyLoad]]:
    parts: dict[tuple[str, str], list[BodyLoad]] = {}
    for load in loads:
        parts.setdefault((load.name, load.kind), []).append(load)
    return parts


def _places(loads: Sequence[BodyLoad], whole: Sequence[BodyLoad]) -> Sequence[int]:
    """Which of all points of a part those of a sample are: the nearest ones, in their order."""
    if len(loads) == len(whole):
        return range(len(loads))
    return min(
        itertools.combinations(range(len(whole)), len(loads)),
        key=lambda places: sum(
            float(np.linalg.norm(load.point - whole[i].point))
            for i, load in zip(places, loads, strict=True)
        ),
    )


class Instant(NamedTuple):
    """A sample that is marked.

    Attributes:
        row: Of the history.
        name: `<load>.force` or `<load>.torque` of a peak, or `chosen`.
        value: Of the peak [N or N·m], 0 where it was chosen.
    """

    row: int
    name: str
    value: float


def instants_of(history: History, chosen: Sequence[float]) -> list[Instant]:
    """Peaks of force and moment of every load, and chosen instants, in the order of time.

    Args:
        chosen: Times [s]; the nearest sample is taken.

    Raises:
        DataError: A time outside of the history.
    """
    found = [Instant(_row(history, time), CHOSEN, 0.0) for time in chosen]
    for quantity, values in (("force", history.force), ("torque", history.moment)):
        sizes: Array = np.linalg.norm(values, axis=2)
        least = _NOTHING * sizes.max(initial=0.0)
        for slot, size in zip(history.slots, sizes.T, strict=True):
            row = int(size.argmax())
            if size[row] > least:
                found.append(Instant(row, f"{slot.name}.{quantity}", float(size[row])))
    return sorted(found, key=lambda each: (each.row, each.name))


def _row(history: History, time: float) -> int:
    times = history.stamps * NANOSECOND
    if not times[0] - 1e-9 <= time <= times[-1] + 1e-9:
        raise DataError(
            f"--at {time:g}: outside of the motion, accepted: {times[0]:.9g} to {times[-1]:.9g} s"
        )
    return int(np.abs(times - time).argmin())


def units_of(name: str) -> Units:
    """The system of a name.

    Raises:
        DataError: There is none.
    """
    if name not in SYSTEMS:
        raise DataError(f"--units {name}: accepted: m (N, m, kg, s, Pa) and mm (N, mm, t, s, MPa)")
    return SYSTEMS[name]


class Units(NamedTuple):
    """A consistent system of units.

    Attributes:
        name: Of its length.
        per_metre: Its lengths in a metre.
        mass: Of its masses.
        stress: Of its stresses.
    """

    name: str
    per_metre: float
    mass: str
    stress: str

    @property
    def moment(self) -> str:
        """Of its moments."""
        return f"N·{self.name}"

    @property
    def acceleration(self) -> str:
        """Of its accelerations."""
        return f"{self.name}/s^2"


SYSTEMS = {"m": Units("m", 1.0, "kg", "Pa"), "mm": Units("mm", 1000.0, "t", "MPa")}
