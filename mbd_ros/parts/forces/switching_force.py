"""Forces that switch at a surface in positions, velocities and time."""

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.coupling_functions import Polynomial
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError
from mbd_ros.methods.events.switching_surfaces import DiscontinuousForce


class SwitchingForce(DiscontinuousForce):
    """Constant forces that switch where h changes its sign (a relay).

        h = sum p_j(q_j) + sum r_j(v_j) + w(t)

    For example, velocity {joint: [0, 1]}, above {joint: -K} and below {joint: K} is dry friction.

    Args:
        above: Joint -> force where h > 0.
        below: Joint -> force where h < 0.
        velocity: Joint -> coefficients c0, c1, .. of the polynomial r_j in its velocity.
        position: Joint -> coefficients of the polynomial p_j in its position.
        time: Coefficients of the polynomial w in time.

    Raises:
        ModelError: Unknown joint, or a polynomial without coefficients.
    """

    example = {
        "velocity": {"ankle": [0.0, 1.0]},
        "above": {"ankle": -0.4},
        "below": {"ankle": 0.4},
    }

    def __init__(
        self,
        robot: Robot,
        *,
        above: Annotated[Mapping[str, float], Unit("N·m or N")],
        below: Annotated[Mapping[str, float], Unit("N·m or N")],
        velocity: Annotated[
            Mapping[str, Sequence[float]] | None, Unit("h per power of rad/s or m/s")
        ] = None,
        position: Annotated[
            Mapping[str, Sequence[float]] | None, Unit("h per power of rad or m")
        ] = None,
        time: Annotated[Sequence[float] | None, Unit("h per power of s")] = None,
    ) -> None:
        velocity, position, time = velocity or {}, position or {}, time or [0.0]
        self._velocity_terms = [
            (robot.joint(name).v, Polynomial(c)) for name, c in velocity.items()
        ]
        joints = {name: robot.joint(name) for name in position}
        self._position_terms = [
            (joints[n].q, joints[n].v, Polynomial(c)) for n, c in position.items()
        ]
        self._time = Polynomial(time)
        upper, lower = (_generalized_force(robot, side) for side in (above, below))
        self._middle = 0.5 * (upper + lower)
        self._half = 0.5 * (upper - lower)
        self.joints = tuple(robot.joint(name) for name in {**above, **below})
        self.surfaces = ("h of " + ", ".join(dict.fromkeys([*velocity, *position])),)

    @staticmethod
    def check(
        above: Mapping[str, float],
        below: Mapping[str, float],
        velocity: Mapping[str, Sequence[float]] | None,
        position: Mapping[str, Sequence[float]] | None,
    ) -> None:
        """Refuse an entry without a surface, or without a force that switches."""
        if not velocity and not position:
            raise ModelError("velocity and position are missing; give coefficients for a joint")
        if all(above.get(name, 0.0) == below.get(name, 0.0) for name in {**above, **below}):
            raise ModelError("above and below are the same, so no force switches")

    def heights(self, k: Kinematics, x: State) -> Array:
        """Return h at a state, shape (1,)."""
        h = self._time(x.t)[0]
        h += sum(function(x.v.item(v))[0] for v, function in self._velocity_terms)
        h += sum(function(x.q.item(q))[0] for q, _, function in self._position_terms)
        return np.array([h])

    def rates(self, k: Kinematics, x: State, a: Array) -> Array:
        """Return dh/dt = w' + sum p_j' v_j + sum r_j' a_j, shape (1,)."""
        rate = self._time(x.t)[1]
        rate += sum(function(x.v.item(v))[1] * a.item(v) for v, function in self._velocity_terms)
        rate += sum(
            function(x.q.item(q))[1] * x.v.item(v) for q, v, function in self._position_terms
        )
        return np.array([rate])

    def blend(self, k: Kinematics, x: State, signs: Array) -> Array:
        """Return (1 + s) / 2 above + (1 - s) / 2 below, shape (nv,)."""
        tau: Array = self._middle + signs.item(0) * self._half
        return tau


def _generalized_force(robot: Robot, forces: Mapping[str, float]) -> Array:
    tau = [0.0] * int(robot.model.nv)  # a list, since it can also contain symbols
    for name, force in forces.items():
        tau[robot.joint(name).v] = force
    return np.array(tau)
