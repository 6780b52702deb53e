"""Messages with references -> targets of the generator."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.control.contract import Reference
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.features.control.reference_generator import ReferenceGenerator
from mbd_ros.features.control.reference_map import ReferenceMap, Selection
from mbd_ros.features.control.trajectory import ReferenceTrajectory
from msg_adapters.joint_state import JointSample
from msg_adapters.joint_trajectory import Trajectory


class Plan(NamedTuple):
    """A trajectory that was checked and is not followed yet.

    Attributes:
        trajectory: For the reference generator; None to stop.
        begin: Time from which the times of its points count [s].
        note: Joints that were mapped or left out, for people.
    """

    trajectory: ReferenceTrajectory | None
    begin: float
    note: str


class References:
    """Hands references of any joints to the reference generator of the controlled ones.

    Args:
        generator: Follows them.
        names: Controlled joints.
        couplings: Those of the scene.
    """

    def __init__(
        self, generator: ReferenceGenerator, names: Sequence[str], couplings: Couplings
    ) -> None:
        self._generator = generator
        self._map = ReferenceMap(names, couplings)
        self._selections: dict[tuple[tuple[str, ...], bool], Selection] = {}

    def aim(self, now: float, names: tuple[str, ...], sample: JointSample) -> str:
        """Take a reference of one instant, `sample` in the order of `names`; returns a remark.

        Raises:
            TargetError: It is refused.
        """
        selection = self._selection(names, False)
        rates = np.where(np.isfinite(sample.velocity), sample.velocity, 0.0)
        q = selection.positions(sample.position)
        self._generator.aim(now, Reference(q, selection.rates(rates), np.zeros(len(q))))
        return selection.note

    def plan(self, now: float, begin: float, trajectory: Trajectory) -> Plan:
        """The plan for a trajectory with points that begins at `begin` [s].

        Joints that it does not give hold their present reference.

        Raises:
            TargetError: It is refused.
        """
        selection, held = self._selection(trajectory.names, True), self._generator.at(now).q
        given, rest = selection.is_given, np.zeros(len(held))
        parts = trajectory.velocity, trajectory.acceleration
        v, a = (
            None if part is None else np.where(given, selection.rates(part), rest)
            for part in parts
        )
        q = np.where(given, selection.positions(trajectory.position), held)
        trajectory = self._generator.plan(now, begin + trajectory.times, q, v, a)
        return Plan(trajectory, begin, selection.note)

    def check(self, names: tuple[str, ...]) -> None:
        """Refuse joints of a trajectory without points that are not controlled.

        Raises:
            TargetError: Names them.
        """
        if names:
            self._selection(names, True)

    def _selection(self, names: tuple[str, ...], partial: bool) -> Selection:
        key = names, partial
        if key not in self._selections:
            self._selections = {key: self._map.select(names, partial=partial)}
        return self._selections[key]
