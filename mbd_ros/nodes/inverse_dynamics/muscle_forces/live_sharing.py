"""Static optimisation as the solver of a stream of samples."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.inverse_dynamics.joint_loads import JointLoads
from mbd_ros.core.inverse_dynamics.torques import Torques
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization

_LACKS = 1.0e-6  # of the largest need


class LiveSharing:
    """Shares one sample at a time; see `SampleSolver` for its attributes.

    Args:
        optimization: The solver.
        loads: Of joints; None without.
        coordinates: Names of the independent velocities.

    Attributes:
        shares: Of the newest sample.
        loads: Of the joints at the newest sample, shape (links, 6); None without.
        time: Of the next sample [s].
        measured: Activations measured for the next sample, NaN where none was, shape (n,).
    """

    moved = 0.0

    def __init__(
        self,
        optimization: StaticOptimization,
        loads: JointLoads | None,
        coordinates: Sequence[str],
    ) -> None:
        self.optimization, self._joint_loads = optimization, loads
        self._coordinates = tuple(coordinates)
        known = optimization.known
        self.couplings, self.rows, self.needed = known.couplings, known.rows, known.needed
        self.gap, self._none = known.gap, np.zeros(len(known.rows))
        self.configuration = optimization.robot.neutral()
        self.time, self.measured = 0.0, np.full(len(optimization.muscles), np.nan)
        self.shares: Shares | None = None
        self.loads: Array | None = None

    def forget(self) -> None:
        """Forget earlier samples."""
        self.optimization.forget()
        self.shares, self.loads = None, None

    def solve(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> Torques:
        """Share the forces of one sample.

        Raises:
            SolveError: Muscles and reserves cannot produce the motion, with what lacks; or the
                sample has no answer.
        """
        motion = [values[None] for values in (position, velocity, acceleration)]
        if not all(np.isfinite(values).all() for values in (*motion, *wrenches)):
            raise SolveError("motion or wrenches are not finite")
        loads = [wrench[None] for wrench in wrenches]
        times = np.array([self.time])
        shares = self.optimization.solve(times, *motion, loads, self.measured[None])
        if not shares.is_feasible[0]:
            raise SolveError(self._lacking(shares))
        q, v, a = (values[:, 0] for values in self.optimization.motion)
        self.shares, self.configuration = shares, q
        if self._joint_loads is not None:
            x, force, reserve = State(self.time, q, v), shares.force[0], shares.reserve[0]
            self.loads, _ = self._joint_loads.solve(x, a, force, reserve, wrenches)
        return Torques(shares.needed[0], self._none, len(shares.needed[0]))

    def doubts(self) -> list[str]:
        """As `SampleSolver.doubts`."""
        found: list[str] = self.optimization.known.doubts()
        return found

    def _lacking(self, shares: Shares) -> str:
        lacking = shares.lacking[0]
        most = np.argsort(-np.abs(lacking))
        scale = _LACKS * float(np.abs(shares.needed).max())
        texts = [f"{self._coordinates[i]} lacks {lacking[i]:.4g}" for i in most[:3]
                 if abs(lacking[i]) > scale]  # fmt: skip
        return f"muscles and reserves cannot produce the motion: {', '.join(texts)}"

    def details(self) -> dict[str, str]:
        """Of the newest sample, for diagnostics."""
        shares: Any = self.shares
        if shares is None:
            return {}
        names = [reserve.name for reserve in self.optimization.reserves]
        found = {
            "objective": f"{shares.objective[0]:.6g}",
            "optimality residual": f"{shares.residual[0]:.1e}",
            "free directions": str(int(shares.null_space[0])),
        }
        if names:
            i = int(np.abs(shares.reserve[0]).argmax())
            found["largest reserve"] = f"{names[i]}: {shares.reserve[0, i]:.4g}"
        return found
