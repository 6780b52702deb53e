"""Joint-state samples -> torques: the causal estimate, live and offline alike."""

import math
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.estimation.joint_observer import JointObserver
from mbd_ros.core.estimation.joint_observer import Observation as Observation
from mbd_ros.core.estimation.joint_observer import Tuning as Tuning
from mbd_ros.core.inverse_dynamics import InverseDynamics, Torques
from mbd_ros.core.loops.observed_loops import ObservedLoops
from mbd_ros.core.robot import Robot
from mbd_ros.core.state import Array


class TorqueEstimator(JointObserver):
    """Causal inverse dynamics on a stream of joint samples.

    Args:
        robot: The robot; fixed base.
        inverse: Solver, owned by the estimator from now on.
        tuning: How samples are judged and filtered.
    """

    def __init__(
        self, robot: Robot, inverse: InverseDynamics | ObservedLoops, tuning: Tuning
    ) -> None:
        super().__init__(robot, inverse.couplings, tuning)
        self._inverse = inverse
        self._dependent_q = [robot.joint(name).q for name in inverse.couplings.dependent]
        self._ones = np.ones(len(inverse.couplings.independent))

    def solve(self, x: Observation, wrenches: Sequence[Array] = ()) -> Torques | None:
        """Torques of an observation; None if they are not finite, after which the filters restart.

        Args:
            x: What `observe` returned.
            wrenches: One (6,) array for every load of the scene.
        """
        torques = self._inverse.solve(x.position, x.velocity, x.acceleration, wrenches)
        if math.isfinite(torques.tau.dot(self._ones)):
            return torques
        self.reset()
        return None

    def violation(self, x: Observation) -> Array:
        """Measured minus coupled position of the dependent joints, of the newest `solve`.

        Returns:
            [rad or m], 0 where a joint was not measured, shape (n_d,).
        """
        off = x.dependent - self._inverse.configuration[self._dependent_q]
        return np.where(np.isfinite(off), off, 0.0)
