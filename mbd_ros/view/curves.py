"""What is plotted of a motion: curves by joint, with a cursor, and the values of a joint."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.motion import ViewedMotion

MOST_POINTS = 1000  # of a curve: more is not to be seen
ALL = "all joints"
QUANTITIES = ("position", "velocity", "acceleration", "effort", "multipliers")


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


class MotionCurves:
    """Curves of a motion by joint and quantity.

    Args:
        scene: The scene.
        motion: Its motion.
        rows: Names of the multipliers.
    """

    def __init__(self, scene: Scene, motion: ViewedMotion, rows: tuple[str, ...]) -> None:
        joints = scene.robot.joints
        self._joints, self._motion = joints, motion
        count, at_v = len(motion.times), [j.v for j in joints]
        q = np.array([x.q for x in motion.states]).reshape(count, -1)[:, [j.q for j in joints]]
        v = np.array([x.v for x in motion.states]).reshape(count, -1)[:, at_v]
        self._of_joints = {
            "position": q,
            "velocity": v,
            "acceleration": motion.accelerations[:, at_v],
            "effort": motion.efforts,
        }
        self._rows = rows if motion.multipliers is not None else ()

    def of(self, joint: str, quantity: str) -> Curves:
        """Curves of one quantity, of `ALL` joints or of one.

        Args:
            joint: A joint, or `ALL`; multipliers are those of all rows.
            quantity: One of `QUANTITIES`.
        """
        every = max(1, -(-len(self._motion.times) // MOST_POINTS))
        times = self._motion.times[::every]
        if quantity == "multipliers":
            values = self._motion.multipliers
            values = np.zeros((len(self._motion.times), 0)) if values is None else values
            return Curves(times, self._rows, values[::every])
        columns = [i for i, j in enumerate(self._joints) if joint in (ALL, j.name)]
        values = np.nan_to_num(self._of_joints[quantity][::every][:, columns])
        return Curves(times, tuple(self._joints[i].name for i in columns), values)

    def values(self, joint: str, row: int) -> list[str]:
        """Lines on a joint at a sample: each quantity with its unit."""
        found = next((i for i, j in enumerate(self._joints) if j.name == joint), None)
        if found is None:
            return []
        one = self._joints[found]
        unit = one.position_unit
        units = (unit, f"{unit}/s", f"{unit}/s²", one.effort_unit)
        numbers = ((name, values[row, found]) for name, values in self._of_joints.items())
        return [
            f"{name} {number:.6g} {unit}" if np.isfinite(number) else f"{name} unknown"
            for (name, number), unit in zip(numbers, units, strict=True)
        ]


def cursor(curves: Curves, now: float) -> Array:
    """A curve that stands upright at a time: at the lower edge before it, at the upper one after.

    Args:
        curves: What it is drawn beside.
        now: The time [s].
    """
    low = float(curves.values.min(initial=0.0))
    high = float(curves.values.max(initial=0.0))
    return np.where(curves.times <= now, low, high if high > low else low + 1.0)
