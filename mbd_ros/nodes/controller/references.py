"""Messages with references -> targets of the guide."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.control.contract import Reference
from mbd_ros.core.control.guide import Guide
from mbd_ros.core.control.reference_map import ReferenceMap, Selection
from mbd_ros.core.control.trajectory import ReferenceTrajectory
from mbd_ros.core.model.couplings import Couplings
from msg_adapters.joint_state import JointSample
from msg_adapters.joint_trajectory import Trajectory


class Plan(NamedTuple):
    """A trajectory that was checked and is not followed yet.

    Attributes:
        trajectory: What the guide would follow; None to stop.
        begin: Time from which the times of its points count [s].
        note: What was mapped or left out, for people.
    """

    trajectory: ReferenceTrajectory | None
    begin: float
    note: str


class References:
    """Hands references of any joints to the guide of the controlled ones.

    Args:
        guide: Follows them.
        names: Controlled joints.
        couplings: Those of the scene.
    """

    def __init__(self, guide: Guide, names: Sequence[str], couplings: Couplings) -> None:
        self._guide = guide
        self._map = ReferenceMap(names, couplings)
        self._selections: dict[tuple[tuple[str, ...], bool], Selection] = {}

    def aim(self, now: float, names: tuple[str, ...], sample: JointSample) -> str:
        """Take a reference of one moment, `sample` in the order of `names`; what to tell of it.

        Raises:
            TargetError: It is refused.
        """
        selection = self._selection(names, False)
        rates = np.where(np.isfinite(sample.velocity), sample.velocity, 0.0)
        q = selection.positions(sample.position)
        self._guide.aim(now, Reference(q, selection.rates(rates), np.zeros(len(q))))
        return selection.note

    def plan(self, now: float, begin: float, trajectory: Trajectory) -> Plan:
        """What a trajectory with points that begins at `begin` [s] asks for.

        Joints that it does not give hold where the reference is.

        Raises:
            TargetError: It is refused.
        """
        selection, held = self._selection(trajectory.names, True), self._guide.at(now).q
        given, rest = selection.is_given, np.zeros(len(held))
        parts = trajectory.velocity, trajectory.acceleration
        v, a = (
            None if part is None else np.where(given, selection.rates(part), rest)
            for part in parts
        )
        q = np.where(given, selection.positions(trajectory.position), held)
        trajectory = self._guide.plan(now, begin + trajectory.times, q, v, a)
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
