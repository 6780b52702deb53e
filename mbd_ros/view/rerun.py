"""A scene that runs again from another start and with other numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.errors import DataError, SceneError
from mbd_ros.features.simulation.job import Interrupted, simulate
from mbd_ros.files.table import Result
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.variants import found_place, places_of, with_numbers, with_sections

_TURN = 3.14  # rad: reach of a joint without limits
_MOST = 12  # joints with a slider


class Rerun:
    """What may be changed of a scene, and the run with it.

    Args:
        scene: The scene as it is.
        named: Numbers to change, `<part>.<argument>`.

    Attributes:
        starts: Independent joint -> first position, lowest and highest [rad or m].
        numbers: Number -> value, lowest and highest.

    Raises:
        SceneError: There is no such number.
    """

    def __init__(self, scene: Scene, named: Sequence[str] = ()) -> None:
        self._scene, self._duration = scene, 2.0
        self.starts = {
            joint.name: _ranged(float(scene.initial.q[joint.q]), joint.lower, joint.upper)
            for joint in scene.robot.joints
            if joint.name in scene.couplings.independent
        }
        self.starts = dict(list(self.starts.items())[:_MOST])
        self.numbers = {name: self._number(name) for name in named}

    @property
    def duration(self) -> float:
        """Of a run [s]."""
        return self._duration

    @duration.setter
    def duration(self, value: float) -> None:
        if not 0.0 < value < np.inf:
            raise DataError(f"--time {value:g}: accepted are finite times > 0")
        self._duration = value

    def _number(self, name: str) -> tuple[float, float, float]:

        place, path = found_place(self._scene.origin.changed(), places_of(self._scene), name)
        value: Any = self._scene.entries[place.section]
        if place.at is not None:
            value = value[place.at]
        for key in path:
            value = value.get(key) if isinstance(value, Mapping) else None
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise SceneError(f"{self._scene.name}: {name} is no single number of the file")
        ends = sorted((0.0, 2.0 * value)) if value else (-1.0, 1.0)
        return float(value), *map(float, ends)

    def run(self, wishes: Mapping[str, float]) -> tuple[Scene, Result, list[str]]:
        """Run the scene with other numbers.

        Args:
            wishes: Value of each of `starts` and `numbers` that differs.

        Returns:
            The scene that ran, its result, and lines for people.

        Raises:
            MbdError: The scene does not accept the numbers, or has no consistent start.
        """
        scene = self._scene
        numbers = {name: wishes[name] for name in self.numbers if name in wishes}
        if numbers:
            scene = with_numbers(scene, numbers)
        starts = {name: wishes[name] for name in self.starts if name in wishes}
        if starts:
            initial = dict(scene.entries.get("initial") or {})
            initial["position"] = {**(initial.get("position") or {}), **starts}
            scene = with_sections(scene, initial=initial)
        said = list[str]()
        try:
            return scene, simulate(scene, self._duration, say=said.append), said
        except Interrupted as error:
            if error.result is None:
                raise
            return scene, error.result, [*said, str(error)]


def _ranged(value: float, lower: float, upper: float) -> tuple[float, float, float]:
    low = lower if np.isfinite(lower) else value - _TURN
    high = upper if np.isfinite(upper) else value + _TURN
    return value, min(low, value), max(high, value)
