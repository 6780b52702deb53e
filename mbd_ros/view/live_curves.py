"""The last seconds of a robot: what is plotted while it moves."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array, State
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.curves import ALL, Curves

QUANTITIES = ("position", "velocity", "effort", "torque", "multipliers", "loads")
_BY_JOINT = QUANTITIES[:4]


class LiveSample(NamedTuple):
    """What is known of a robot at a time.

    Attributes:
        time: From the first sample on [s].
        state: Of all joints; internal states are NaN where unknown.
        efforts: Measured effort of each joint, NaN where unknown, shape (joints,).
        torques: Computed torque of each joint, NaN where unknown, shape (joints,).
        multipliers: Of all rows, NaN where unknown, shape (m,).
        loads: Where measured loads act, less `Robot.origin` [m], and their forces [N], NaN where
            unknown, shape (k, 2, 3).
        points: Places of markers, less `Robot.origin` [m], shape (n, 3).
        lines: Begin and end of lines and arrows among the markers, the same, shape (m, 2, 3).
    """

    time: float
    state: State
    efforts: Array
    torques: Array
    multipliers: Array
    loads: Array
    points: Array
    lines: Array


class LiveCurves:
    """Samples of the last seconds, in a ring that is made once.

    Args:
        scene: The scene.
        rows: Names of the multipliers.
        loads: Names of the measured loads.
        count: Samples that are kept.
    """

    def __init__(
        self, scene: Scene, rows: tuple[str, ...], loads: tuple[str, ...], count: int
    ) -> None:
        robot = scene.robot
        self._joints, self._count = robot.joints, count
        self._owners = [(j.name, j.name) for j in robot.joints]
        self._owners += [(b.name, f"{b.name}.{axis}") for b in robot.bases for axis in "xyz"]
        self._q = [j.q for j in robot.joints] + [
            b.q.start + i for b in robot.bases for i in range(3)
        ]
        self._v = [j.v for j in robot.joints] + [
            b.v.start + i for b in robot.bases for i in range(3)
        ]
        self._none = np.full(3 * len(robot.bases), np.nan)
        names = tuple(name for _, name in self._owners)
        self._names = {**dict.fromkeys(_BY_JOINT, names), "multipliers": rows, "loads": loads}
        self._times = np.zeros(count)
        self._values = {name: np.zeros((count, len(of))) for name, of in self._names.items()}
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._next = self._kept = 0

    def add(self, sample: LiveSample) -> None:
        """Keep a sample of a later time; one of an earlier time begins anew."""
        if self._kept:
            last = self._times[self._next - 1]
            if sample.time == last:
                return
            if sample.time < last:
                self.clear()
        at, values = self._next, self._values
        self._times[at] = sample.time
        values["position"][at] = sample.state.q[self._q]
        values["velocity"][at] = sample.state.v[self._v]
        values["effort"][at] = np.concatenate((sample.efforts, self._none))
        values["torque"][at] = np.concatenate((sample.torques, self._none))
        values["multipliers"][at] = sample.multipliers
        values["loads"][at] = np.linalg.norm(sample.loads[:, 1], axis=1)
        self._next, self._kept = (at + 1) % self._count, min(self._kept + 1, self._count)

    def of(self, joint: str, quantity: str) -> Curves:
        """Curves of one quantity, those that are unknown left out.

        Args:
            joint: A joint, a free body or `ALL`; multipliers and loads are those of the whole.
            quantity: One of `QUANTITIES`.
        """
        names, chosen = self._names[quantity], list(range(len(self._names[quantity])))
        if quantity in _BY_JOINT:
            chosen = [i for i, (owner, _) in enumerate(self._owners) if joint in (ALL, owner)]
        at = (self._next - self._kept + np.arange(self._kept)) % self._count
        values = self._values[quantity][at][:, chosen]
        known = np.flatnonzero(np.isfinite(values).any(axis=0)) if self._kept else []
        named = tuple(names[chosen[i]] for i in known)
        return Curves(self._times[at], named, np.nan_to_num(values[:, known]))

    def values(self, joint: str) -> list[str]:
        """Lines on a joint or free body at the newest sample: each quantity with its unit."""
        found = [i for i, (owner, _) in enumerate(self._owners) if owner == joint]
        if not self._kept or not found:
            return []
        one = next((j for j in self._joints if j.name == joint), None)
        unit, effort = ("m", "N") if one is None else (one.position_unit, one.effort_unit)
        lines = []
        for name, its in zip(_BY_JOINT, (unit, f"{unit}/s", effort, effort), strict=True):
            numbers = self._values[name][self._next - 1, found]
            if np.isfinite(numbers).all():
                lines.append(f"{name} {' '.join(f'{n:.6g}' for n in numbers)} {its}")
        return lines
