"""Forces that muscles and reserves can exert, in each of many frames.

With the lengths l_i of paths, J_i = dl_i/dq and G of the couplings, a tension F_i exerts
-G' J_i' F_i on the independent coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.paths.paths import PathBatch
from mbd_ros.core.model.couplings import Couplings, Slopes
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.muscles.rigid_tendons import RigidTendons
from mbd_ros.core.state import Array, State
from mbd_ros.methods.inverse_dynamics.reserves import (
    BodyReserve,
    CoordinateReserve,
    InputReserve,
    Reserve,
)

_FEW_FRAMES = 4  # up to which frames cost less one by one, unless paths are searched


class MuscleFrames:
    """Forces of the muscles and reserves of a robot on its independent coordinates.

    An instance owns one Pinocchio `Data`, so it must not be shared by threads.

    Args:
        couplings: Dependent joints of the robot.
        muscles: At least one muscle.
        reserves: Reserve actuators that help the muscles.
        search: Search for wrapping paths in many frames, as `PathBatch` takes it.
        quick: Factory of native code that evaluates all paths at one state
            (`compiled.runs.paths`); it returns None for paths that it cannot evaluate.
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        muscles: Sequence[Muscle],
        reserves: Sequence[Reserve] = (),
        search: Any = None,
        quick: Callable[..., Any] | None = None,
    ) -> None:
        self._couplings, self._muscles = couplings, tuple(muscles)
        self._tendons = RigidTendons([muscle.contraction for muscle in muscles])
        paths = {part.name: part.path for part in muscles}
        self._batch = PathBatch(robot, couplings, paths, search)
        wraps = any(getattr(path, "wraps", ()) for path in paths.values())
        self._few = 0 if wraps and search is not None else _FEW_FRAMES
        self._nv, data = int(robot.model.nv), pin.Data(robot.model)
        self._k = Kinematics(robot, data)
        self._fixed = np.zeros((len(couplings.v_index), len(reserves)))
        self._varying: list[tuple[int, BodyReserve | InputReserve]] = []
        for i, reserve in enumerate(reserves):
            if isinstance(reserve, CoordinateReserve):
                self._fixed[:, i] = couplings.v_index == reserve.at
            else:
                self._varying.append((i, reserve))
        read = [muscle.path.reads for muscle in muscles]
        reserved = [part.reads for _, part in self._varying]
        self._reads = max([Reads.POSITION, *read, *reserved])
        self._reads_of_reserves = max([Reads.POSITION, *reserved])
        count = len(muscles) + len(reserves)
        self._quick: Any = None
        if quick is not None:
            self._quick = quick(robot, data, couplings, tuple(paths.values()), count)
        if self._quick is not None:
            self._quick.columns[:, len(muscles) :] = self._fixed

    def at(self, y: Array, w: Array, q: Array, v: Array, slopes: Slopes) -> Frames:
        """Evaluate muscles and reserves in frames.

        Args:
            y: Independent coordinates, shape (frames, ny).
            w: Velocities of the independent coordinates, shape (frames, nv_y).
            q: Configurations, shape (nq, frames).
            v: Velocities, shape (nv, frames).
            slopes: Slopes of the couplings, from `Couplings.expand`.
        """
        if self._quick is not None and len(y) == 1:
            frame = self._at_once(q[:, 0], v[:, 0], slopes)
            if frame is not None:
                return self._frames(*frame)
        if len(y) < self._few:
            length, speed, arms, reserve_rows = self._one_by_one(q, v, slopes)
        else:
            length, speed, arms = self._batch.evaluate(y, w)
            reserve_rows = self._reserved(q, v, slopes)
        columns = np.concatenate((arms.transpose(0, 2, 1), reserve_rows), axis=2)
        return self._frames(length, speed, columns)

    def _frames(self, length: Array, speed: Array, columns: Array) -> Frames:
        forces = self._tendons.at(length, speed)
        return Frames(length, speed, forces.active, forces.passive, forces.fiber_velocity, columns)

    def _at_once(self, q: Array, v: Array, slopes: Slopes) -> tuple[Array, Array, Array] | None:
        """Return lengths, speeds and columns of one frame; None if a path is not found."""
        self._k.refresh(q, v, self._reads)
        if not self._quick(q, v, slopes):
            return None
        columns = self._quick.columns[None].copy()
        if self._varying:
            reserve_rows = np.array(
                [[r.column(self._k, State(0.0, q, v)) for _, r in self._varying]]
            )
            columns[:, :, len(self._muscles) :] = self._filled(reserve_rows, slopes)
        return self._quick.length[None].copy(), self._quick.speed[None].copy(), columns

    def _one_by_one(self, q: Array, v: Array, slopes: Slopes) -> tuple[Array, ...]:
        """Return lengths, speeds, moment arms and columns of reserves of few frames."""
        count, n = q.shape[1], len(self._muscles)
        length, full = np.empty((count, n)), np.empty((count, n, self._nv))
        reserve_rows = np.empty((count, len(self._varying), self._nv))
        for frame, (q_now, v_now) in enumerate(zip(q.T, v.T, strict=True)):
            self._k.refresh(q_now, v_now, self._reads)
            x = State(0.0, q_now, v_now)
            for i, muscle in enumerate(self._muscles):
                length[frame, i], full[frame, i] = muscle.path.measured(self._k, x)
            for i, (_, reserve) in enumerate(self._varying):
                reserve_rows[frame, i] = reserve.column(self._k, x)
        speed = np.einsum("tij,jt->ti", full, v)
        arms = -self._reduced(full, slopes)
        return length, speed, arms, self._filled(reserve_rows, slopes)

    def _reserved(self, q: Array, v: Array, slopes: Slopes) -> Array:
        """Return the columns of the reserves, shape (frames, nv_y, r)."""
        reserve_rows = np.empty((q.shape[1], len(self._varying), self._nv))
        for frame, (q_now, v_now) in enumerate(zip(q.T, v.T, strict=True)):
            if not self._varying:
                break
            self._k.refresh(q_now, v_now, self._reads_of_reserves)
            x = State(0.0, q_now, v_now)
            for i, (_, reserve) in enumerate(self._varying):
                reserve_rows[frame, i] = reserve.column(self._k, x)
        return self._filled(reserve_rows, slopes)

    def _filled(self, reserve_rows: Array, slopes: Slopes) -> Array:
        """Return the columns of all reserves, given those that vary."""
        columns = np.tile(self._fixed, (len(reserve_rows), 1, 1))
        if self._varying:
            places = [i for i, _ in self._varying]
            columns[:, :, places] = self._reduced(reserve_rows, slopes).transpose(0, 2, 1)
        return columns

    def _reduced(self, full: Array, slopes: Slopes) -> Array:
        """Multiply every row by G', shape (frames, n, nv_y)."""
        count, n, nv = full.shape
        every = slopes
        if count > 1:
            every = [np.repeat(np.broadcast_to(slope, count), n) for slope in slopes]
        tau, _ = self._couplings.reduce(np.ascontiguousarray(full.reshape(-1, nv).T), every)
        return tau.T.reshape(count, n, len(tau))


class Frames(NamedTuple):
    """Muscles and reserves in frames, one row per frame.

    Attributes:
        length: Path lengths [m], shape (frames, n).
        speed: Rates of the path lengths [m/s], shape (frames, n).
        active: Force along the tendon at full activation [N], shape (frames, n).
        passive: Elastic force of the fibres along the tendon [N], shape (frames, n).
        fiber_speed: Rate of the fibre lengths [m/s], shape (frames, n).
        columns: Force on the independent coordinates by a tension of 1 N, and by a reserve of
            1 N or 1 N·m, shape (frames, nv_y, n + r).
    """

    length: Array
    speed: Array
    active: Array
    passive: Array
    fiber_speed: Array
    columns: Array
