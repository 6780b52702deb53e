"""What is read from and written to tables and bags."""

from collections import Counter
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import Array, Motion
from mbd_ros.errors import DivergedError


class Recording(NamedTuple):
    """A motion and what was left out of it.

    Attributes:
        motion: The samples that can be used.
        dropped: Messages left out, counted by reason.
        by_log_time: Header stamps were zero, so stamps are the log times of the bag.
    """

    motion: Motion
    dropped: Counter[str]
    by_log_time: bool = False


class TorqueRecord(NamedTuple):
    """Result of inverse dynamics over a motion of n samples.

    Attributes:
        stamps: [ns], shape (n,), int64.
        joints: Names of the independent joints; of all joints of a scene with loops.
        position: [rad or m], shape (n, len(joints)).
        velocity: [rad/s or m/s], same shape.
        acceleration: [rad/s^2 or m/s^2], same shape.
        effort: Torque or force of `joints`, or of `driven` [N·m or N], shape (n, len(..)).
        dependent: Names of the dependent joints, or of the constraint rows.
        multiplier: Their torque or force [N·m or N], shape (n, len(dependent)).
        parts: Shares of `effort` by name (gravity, coriolis, ...), each of its shape.
        driven: Joints that `effort` belongs to; None: `joints`.
        commanded: Joints whose actuators take something else than the torque of the joint.
        command: What these actuators take, shape (n, len(commanded)); None without any.
    """

    stamps: NDArray[np.int64]
    joints: tuple[str, ...]
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    dependent: tuple[str, ...]
    multiplier: Array
    parts: Mapping[str, Array] = MappingProxyType({})
    driven: tuple[str, ...] | None = None
    commanded: tuple[str, ...] = ()
    command: Array | None = None


class SimulationRecord(NamedTuple):
    """A simulated motion of n samples.

    Attributes:
        stamps: [ns], shape (n,), int64.
        times: The same [s], not rounded.
        joints: Names of all joints.
        position: [rad or m], shape (n, len(joints)).
        velocity: [rad/s or m/s], same shape.
        acceleration: [rad/s^2 or m/s^2], same shape.
        effort: What the actuators exert [N·m or N], same shape.
        rows: Names of the constraint rows.
        multiplier: Their multipliers, shape (n, len(rows)).
        balance: Energy [J] and the largest violation of positions and velocities, shape (n, 3).
        commanded: Joints whose actuators take something else than the torque of the joint.
        command: What these actuators take, shape (n, len(commanded)); None without any.
    """

    stamps: NDArray[np.int64]
    times: Array
    joints: tuple[str, ...]
    position: Array
    velocity: Array
    acceleration: Array
    effort: Array
    rows: tuple[str, ...]
    multiplier: Array
    balance: Array
    commanded: tuple[str, ...] = ()
    command: Array | None = None

    def first(self, count: int) -> "SimulationRecord":
        """The first samples alone."""
        if count == len(self.times):
            return self
        cut = {f: v[:count] for f, v in self._asdict().items() if isinstance(v, np.ndarray)}
        return self._replace(**cut)


def finite_rows(record: SimulationRecord) -> tuple[int, DivergedError | None]:
    """How many samples come before the first that is not finite, and what that one lacks."""
    named = {
        **dict.fromkeys(("position", "velocity", "acceleration", "effort"), record.joints),
        "multiplier": record.rows,
        "balance": ("energy", "position violation", "velocity violation"),
    }
    found = [
        (int(rows[0]), f"{field} of {names[int(columns[0])]}")
        for field, names in named.items()
        for rows, columns in [np.nonzero(~np.isfinite(getattr(record, field)))]
        if len(rows)
    ]
    if not found:
        return len(record.times), None
    row, what = min(found)
    what = what.removeprefix("balance of ")
    return row, DivergedError(f"{what} is not finite at t = {record.times[row]:.9g} s")
