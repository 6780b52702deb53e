"""What muscles and reserves can exert in each of many frames.

With the lengths l_i of paths, J_i = dl_i/dq and G of the couplings, a tension F_i exerts
-G' J_i' F_i on the independent coordinates.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.inverse.reserves import BodyReserve, CoordinateReserve, InputReserve, Reserve
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.model.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.muscles.rigid_tendons import RigidTendons
from mbd_ros.core.state import Array, State


class Frames(NamedTuple):
    """One row a frame.

    Attributes:
        length: Of the paths [m], shape (frames, n).
        speed: Their rates [m/s], shape (frames, n).
        active: Force along the tendon at full activation [N], shape (frames, n).
        passive: Elastic force of the fibres along the tendon [N], shape (frames, n).
        fiber_speed: Rate of the length of the fibres [m/s], shape (frames, n).
        columns: Force of the independent coordinates by a tension of 1 N, and by 1 N or N·m of
            a reserve, shape (frames, nv_y, n + r).
    """

    length: Array
    speed: Array
    active: Array
    passive: Array
    fiber_speed: Array
    columns: Array


class MuscleFrames:
    """Muscles and reserves of a robot.

    One instance owns one Pinocchio `Data`: not for two threads.

    Args:
        robot: The robot.
        couplings: Its dependent joints.
        muscles: At least one.
        reserves: What helps them.
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        muscles: Sequence[Muscle],
        reserves: Sequence[Reserve] = (),
    ) -> None:
        self._couplings, self._muscles = couplings, tuple(muscles)
        self._tendons = RigidTendons([muscle.contraction for muscle in muscles])
        self._k, self._nv = Kinematics(robot), int(robot.model.nv)
        self._fixed = np.zeros((len(muscles) + len(reserves), self._nv))
        self._varying: list[tuple[int, BodyReserve | InputReserve]] = []
        for i, reserve in enumerate(reserves, len(muscles)):
            if isinstance(reserve, CoordinateReserve):
                self._fixed[i, reserve.at] = 1.0
            else:
                self._varying.append((i, reserve))
        reads = (muscle.path.reads for muscle in muscles)
        self._reads = max([Reads.POSITION, *reads, *(r.reads for _, r in self._varying)])

    def at(self, q: Array, v: Array, slopes: Slopes) -> Frames:
        """The frames.

        Args:
            q: Configurations, shape (nq, frames).
            v: Velocities, shape (nv, frames).
            slopes: What `Couplings.expand` gave for them.
        """
        count, n = q.shape[1], len(self._muscles)
        length = np.empty((count, n))
        full = np.empty((count, *self._fixed.shape))
        full[:, n:] = self._fixed[n:]
        for frame, (q_now, v_now) in enumerate(zip(q.T, v.T, strict=True)):
            self._k.refresh(q_now, v_now, self._reads)
            x = State(0.0, q_now, v_now)
            for i, muscle in enumerate(self._muscles):
                length[frame, i], full[frame, i] = muscle.path.measured(self._k, x)
            for i, reserve in self._varying:
                full[frame, i] = reserve.column(self._k, x)
        speed = np.einsum("tij,jt->ti", full[:, :n], v)
        np.negative(full[:, :n], out=full[:, :n])
        forces = self._tendons.at(length, speed)
        columns = self._reduced(full, slopes)
        return Frames(length, speed, forces.active, forces.passive, forces.fiber_velocity, columns)

    def _reduced(self, full: Array, slopes: Slopes) -> Array:
        """G' on every column, shape (frames, nv_y, n + r)."""
        count, n, nv = full.shape
        every = [np.repeat(np.broadcast_to(slope, count), n) for slope in slopes]
        tau, _ = self._couplings.reduce(np.ascontiguousarray(full.reshape(-1, nv).T), every)
        return np.ascontiguousarray(tau.reshape(len(tau), count, n).transpose(1, 0, 2))
