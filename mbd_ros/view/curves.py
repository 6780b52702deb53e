"""Curves of a motion by joint, of the last seconds of a robot that moves, and their panel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.motion import BALANCE, ViewedMotion

MOST_POINTS = 1000  # of a curve: more is not to be seen
ALL = "all joints"
QUANTITIES = (
    "position",
    "velocity",
    "acceleration",
    "effort",
    "power",
    "multipliers",
    "energy",
    "drift",
)
LIVE_QUANTITIES = ("position", "velocity", "effort", "torque", "multipliers", "loads")
_BY_JOINT = LIVE_QUANTITIES[:4]
_COLOURS = ("#c0392b", "#2471a3", "#1e8449", "#b9770e", "#6c3483", "#117a65", "#839192", "#d35400")
MOST = 12  # curves at once: more are not told apart
_HEIGHT = 220  # px


class MotionCurves:
    """Curves of a motion by joint or free body, and by quantity.

    Args:
        rows: Names of the multipliers.
    """

    def __init__(self, scene: Scene, motion: ViewedMotion, rows: tuple[str, ...]) -> None:
        robot, count = scene.robot, len(motion.times)
        self._motion, self._joints = motion, robot.joints
        self._names, at_q, at_v = _plotted(robot)
        v = np.array([x.v for x in motion.states]).reshape(count, -1)[:, at_v]
        none = np.full((count, 3 * len(robot.bases)), np.nan)
        efforts = np.hstack((motion.efforts, none))
        self._values = {
            "position": np.array([x.q for x in motion.states]).reshape(count, -1)[:, at_q],
            "velocity": v,
            "acceleration": motion.accelerations[:, at_v],
            "effort": efforts,
            "power": efforts * v,
        }
        lam = motion.multipliers
        self._others = {
            "multipliers": (rows, np.full((count, len(rows)), np.nan) if lam is None else lam),
            "energy": (BALANCE[:1], motion.balance[:, :1]),
            "drift": (BALANCE[1:], motion.balance[:, 1:]),
        }

    def of(self, joint: str, quantity: str) -> Curves:
        """Curves of one quantity, those that are unknown left out.

        Args:
            joint: A joint, a free body (its place and velocity) or `ALL`; multipliers, energy and
                drift are those of the whole.
            quantity: One of `QUANTITIES`.
        """
        every = max(1, -(-len(self._motion.times) // MOST_POINTS))
        if quantity in self._others:
            names, values = self._others[quantity]
        else:
            chosen = [i for i, (owner, _) in enumerate(self._names) if joint in (ALL, owner)]
            names = tuple(self._names[i][1] for i in chosen)
            values = self._values[quantity][:, chosen]
        known = [i for i in range(len(names)) if np.isfinite(values[:, i]).any()]
        curves = np.nan_to_num(values[::every][:, known])
        return Curves(self._motion.times[::every], tuple(names[i] for i in known), curves)

    def values(self, joint: str, row: int) -> list[str]:
        """Lines on a joint or free body at a sample: each quantity with its unit."""
        rows_of_joint = [i for i, (owner, _) in enumerate(self._names) if owner == joint]
        one = next((j for j in self._joints if j.name == joint), None)
        unit = "m" if one is None else one.position_unit
        units = (unit, f"{unit}/s", f"{unit}/s²", "N" if one is None else one.effort_unit, "W")
        lines = list[str]()
        for (name, values), its in zip(self._values.items(), units, strict=True):
            numbers = values[row, rows_of_joint]
            if len(numbers) and np.isfinite(numbers).all():
                lines.append(f"{name} {' '.join(f'{n:.6g}' for n in numbers)} {its}")
        return lines


def _plotted(robot: Robot) -> tuple[list[tuple[str, str]], list[int], list[int]]:
    """Joint or free body and name of each curve, and where its values stand in q and in v."""
    names = [(joint.name, joint.name) for joint in robot.joints]
    names += [(base.name, f"{base.name}.{axis}") for base in robot.bases for axis in "xyz"]
    at_q = [joint.q for joint in robot.joints]
    at_q += [base.q.start + i for base in robot.bases for i in range(3)]
    at_v = [joint.v for joint in robot.joints]
    at_v += [base.v.start + i for base in robot.bases for i in range(3)]
    return names, at_q, at_v


class Curves(NamedTuple):
    """Curves over time.

    Attributes:
        times: [s], shape (n,).
        names: One a curve.
        values: Shape (n, len(names)), finite.
    """

    times: Array
    names: tuple[str, ...]
    values: Array

    def first(self, count: int) -> Curves:
        """The first curves, so many at most."""
        return Curves(self.times, self.names[:count], self.values[:, :count])


class Plot:
    """One plot in a folder of the panel; another choice of curves draws it anew.

    Args:
        gui: The `viser.GuiApi`.
        folder: Where it stands.
    """

    def __init__(self, gui: Any, folder: Any) -> None:
        self._gui, self._folder = gui, folder
        self._plot: Any = None
        self._drawn: object = None

    def show(
        self, choice: object, curves: Curves, beside: Sequence[tuple[str, Array]] = ()
    ) -> None:
        """Show curves, or nothing where there are none.

        Args:
            choice: What they are of.
            curves: Finite, of any number of samples, at most `MOST` of them.
            beside: Names and values of grey curves.
        """
        if len(curves.times) < 2 or not curves.names:
            self.clear()
            return
        columns = [*curves.values.T, *(values for _, values in beside)]
        data = tuple(np.ascontiguousarray(one) for one in (curves.times, *columns))
        chosen = choice, curves.names
        if self._drawn == chosen and self._plot is not None:
            self._plot.data = data
            return
        self.clear()
        self._drawn = chosen
        self._draw(curves.names, [name for name, _ in beside], data)

    def clear(self) -> None:
        """Take it away."""
        if self._plot is not None:
            self._plot.remove()
            self._plot = None

    def _draw(self, names: Sequence[str], grey: Sequence[str], data: tuple[Array, ...]) -> None:
        series = [
            {"label": name, "stroke": _COLOURS[i % len(_COLOURS)], "width": 1.5}
            for i, name in enumerate(names)
        ]
        series += [{"label": name, "stroke": "#888888", "width": 1} for name in grey]
        with self._folder:
            self._plot = self._gui.add_uplot(
                data,
                ({"label": "s"}, *series),
                scales={"x": {"time": False, "auto": True}, "y": {"auto": True}},
                height=_HEIGHT,
            )


def cursor(curves: Curves, now: float) -> Array:
    """A curve that stands upright at a time: at the lower edge before it, at the upper one after.

    Args:
        curves: What it is drawn beside.
    """
    low = float(curves.values.min(initial=0.0))
    high = float(curves.values.max(initial=0.0))
    upright = np.where(curves.times <= now, low, high if high > low else low + 1.0)
    upright[0], upright[-1] = low, high if high > low else low + 1.0  # at both ends, too
    return upright


class LiveCurves:
    """Samples of the last seconds, in a ring that is made once.

    Args:
        rows: Names of the multipliers.
        loads: Names of the measured loads.
        count: Samples that are kept.
    """

    def __init__(
        self, scene: Scene, rows: tuple[str, ...], loads: tuple[str, ...], count: int
    ) -> None:
        robot = scene.robot
        self._joints, self._count = robot.joints, count
        self._owners, self._q, self._v = _plotted(robot)
        self._none = np.full(3 * len(robot.bases), np.nan)
        names = tuple(name for _, name in self._owners)
        self._names = {**dict.fromkeys(_BY_JOINT, names), "multipliers": rows, "loads": loads}
        self._times = np.zeros(count)
        self._values = {name: np.zeros((count, len(of))) for name, of in self._names.items()}
        self.clear()

    def clear(self) -> None:
        """Forget everything."""
        self._next = self._length = 0

    def add(self, sample: LiveSample) -> None:
        """Keep a sample of a later time; one of an earlier time begins anew."""
        if self._length:
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
        self._next, self._length = (at + 1) % self._count, min(self._length + 1, self._count)

    def of(self, joint: str, quantity: str) -> Curves:
        """Curves of one quantity, those that are unknown left out.

        Args:
            joint: A joint, a free body or `ALL`; multipliers and loads are those of the whole.
            quantity: One of `QUANTITIES`.
        """
        names, chosen = self._names[quantity], list(range(len(self._names[quantity])))
        if quantity in _BY_JOINT:
            chosen = [i for i, (owner, _) in enumerate(self._owners) if joint in (ALL, owner)]
        at = (self._next - self._length + np.arange(self._length)) % self._count
        values = self._values[quantity][at][:, chosen]
        known = np.flatnonzero(np.isfinite(values).any(axis=0)) if self._length else []
        named = tuple(names[chosen[i]] for i in known)
        return Curves(self._times[at], named, np.nan_to_num(values[:, known]))

    def values(self, joint: str) -> list[str]:
        """Lines on a joint or free body at the newest sample: each quantity with its unit."""
        rows_of_joint = [i for i, (owner, _) in enumerate(self._owners) if owner == joint]
        if not self._length or not rows_of_joint:
            return []
        one = next((j for j in self._joints if j.name == joint), None)
        unit, effort = ("m", "N") if one is None else (one.position_unit, one.effort_unit)
        lines = []
        for name, its in zip(_BY_JOINT, (unit, f"{unit}/s", effort, effort), strict=True):
            numbers = self._values[name][self._next - 1, rows_of_joint]
            if np.isfinite(numbers).all():
                lines.append(f"{name} {' '.join(f'{n:.6g}' for n in numbers)} {its}")
        return lines


class LiveSample(NamedTuple):
    """State and loads of a robot at one time.

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
