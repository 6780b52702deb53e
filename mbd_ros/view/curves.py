"""What is plotted of a motion: curves by joint, with a cursor, and the values of a joint."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
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

    def first(self, count: int) -> "Curves":
        """The first curves, so many at most."""
        return Curves(self.times, self.names[:count], self.values[:, :count])


class MotionCurves:
    """Curves of a motion by joint or free body, and by quantity.

    Args:
        scene: The scene.
        motion: Its motion.
        rows: Names of the multipliers.
    """

    def __init__(self, scene: Scene, motion: ViewedMotion, rows: tuple[str, ...]) -> None:
        robot, count = scene.robot, len(motion.times)
        self._motion, self._joints = motion, robot.joints
        self._names = [(j.name, j.name) for j in robot.joints]
        self._names += [(b.name, f"{b.name}.{axis}") for b in robot.bases for axis in "xyz"]
        at_q = [j.q for j in robot.joints] + [b.q.start + i for b in robot.bases for i in range(3)]
        at_v = [j.v for j in robot.joints] + [b.v.start + i for b in robot.bases for i in range(3)]
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
        found = [i for i, (owner, _) in enumerate(self._names) if owner == joint]
        one = next((j for j in self._joints if j.name == joint), None)
        unit = "m" if one is None else one.position_unit
        units = (unit, f"{unit}/s", f"{unit}/s²", "N" if one is None else one.effort_unit, "W")
        lines = list[str]()
        for (name, values), its in zip(self._values.items(), units, strict=True):
            numbers = values[row, found]
            if len(numbers) and np.isfinite(numbers).all():
                lines.append(f"{name} {' '.join(f'{n:.6g}' for n in numbers)} {its}")
        return lines


def cursor(curves: Curves, now: float) -> Array:
    """A curve that stands upright at a time: at the lower edge before it, at the upper one after.

    Args:
        curves: What it is drawn beside.
        now: The time [s].
    """
    low = float(curves.values.min(initial=0.0))
    high = float(curves.values.max(initial=0.0))
    upright = np.where(curves.times <= now, low, high if high > low else low + 1.0)
    upright[0], upright[-1] = low, high if high > low else low + 1.0  # at both ends, too
    return upright
