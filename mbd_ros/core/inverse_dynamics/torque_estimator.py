"""Joint-state samples -> torques: the causal estimate, live and offline alike."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.inverse_dynamics.joint_observer import JointObserver
from mbd_ros.core.inverse_dynamics.joint_observer import Observation as Observation
from mbd_ros.core.inverse_dynamics.joint_observer import Observations as Observations
from mbd_ros.core.inverse_dynamics.joint_observer import Tuning as Tuning
from mbd_ros.core.inverse_dynamics.torques import SampleSolver, Torques
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.signals.differentiation import SampleStatus
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError


class TorqueEstimator(JointObserver):
    """Causal inverse dynamics on a stream of joint samples.

    Args:
        robot: The robot.
        inverse: Solver, owned by the estimator from now on.
        tuning: How samples are judged and filtered.
    """

    def __init__(self, robot: Robot, inverse: SampleSolver, tuning: Tuning) -> None:
        self._inverse = inverse
        super().__init__(robot, inverse.couplings, tuning)
        self._dependent_q = [robot.joint(name).q for name in inverse.couplings.dependent]
        self._ones = np.ones(len(inverse.couplings.v_index))

    def solve(self, x: Observation, wrenches: Sequence[Array] = ()) -> Torques | None:
        """Torques of an observation; None if they are not finite.

        An observation without torques leaves nothing behind: the next sample is judged and solved
        as if it had not been there. Where later samples were observed before it was solved, it
        stays in the filters, or they begin anew if its torques are not finite.

        Args:
            x: What `observe` returned.
            wrenches: One (6,) array for every load of the scene.

        Raises:
            SolveError: There are none.
        """
        try:
            torques = self._inverse.solve(x.position, x.velocity, x.acceleration, wrenches)
            if math.isfinite(torques.tau.dot(self._ones)):
                return torques
        except SolveError:
            self._give_up(x)
            raise
        is_newest = x is self._newest
        self._give_up(x)
        if not is_newest:
            self.reset()
        return None

    def reset(self) -> None:
        """Forget the past."""
        super().reset()
        self._newest: Observation | None = None

    def observe(
        self,
        stamp: int,
        position: Array,
        velocity: Array,
        present: NDArray[np.bool_],
        bodies: tuple[Array, Array] | None = None,
    ) -> Observation | SampleStatus:
        """As `JointObserver.observe`."""
        before = self.memory
        found = super().observe(stamp, position, velocity, present, bodies)
        if isinstance(found, Observation):
            self._newest, self._before = found, before
        return found

    def observe_all(
        self, stamps: NDArray[np.int64], position: Array, velocity: Array
    ) -> Observations | None:
        """As `JointObserver.observe_all`."""
        found = super().observe_all(stamps, position, velocity)
        if found is not None:
            self._newest = None
        return found

    def _give_up(self, x: Observation) -> None:
        """Put back the state before an observation."""
        if x is self._newest:
            self.memory, self._newest = self._before, None

    def violation(self, x: Observation) -> Array:
        """Measured minus coupled position of the dependent joints, of the newest `solve`.

        Returns:
            [rad or m], 0 where a joint was not measured, shape (n_d,).
        """
        off = x.dependent - self._inverse.configuration[self._dependent_q]
        return np.where(np.isfinite(off), off, 0.0)
