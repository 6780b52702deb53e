"""Messages with references -> targets of the guide."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.control.contract import Reference
from mbd_ros.core.control.guide import Guide
from mbd_ros.core.control.reference_map import ReferenceMap, Selection
from mbd_ros.core.couplings import Couplings
from msg_adapters.joint_state import JointSample
from msg_adapters.joint_trajectory import Trajectory


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
        self._selections: dict[tuple[str, ...], Selection] = {}

    def aim(self, now: float, names: tuple[str, ...], sample: JointSample) -> str:
        """Take a reference of one moment, `sample` in the order of `names`; what to tell of it.

        Raises:
            TargetError: It is refused.
        """
        selection = self._selection(names)
        rates = np.where(np.isfinite(sample.velocity), sample.velocity, 0.0)
        q = selection.positions(sample.position)
        self._guide.aim(now, Reference(q, selection.rates(rates), np.zeros(len(q))))
        return selection.note

    def follow(self, now: float, begin: float, trajectory: Trajectory) -> str:
        """Take a trajectory that begins at `begin` [s]; what to tell of it.

        Raises:
            TargetError: It is refused.
        """
        selection = self._selection(trajectory.names)
        parts = trajectory.velocity, trajectory.acceleration
        v, a = (None if part is None else selection.rates(part) for part in parts)
        q = selection.positions(trajectory.position)
        self._guide.follow(now, begin + trajectory.times, q, v, a)
        return selection.note

    def _selection(self, names: tuple[str, ...]) -> Selection:
        if names not in self._selections:
            self._selections = {names: self._map.select(names)}
        return self._selections[names]
