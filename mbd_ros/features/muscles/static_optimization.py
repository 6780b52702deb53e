"""Static optimisation: muscles share the forces that a motion needs, frame by frame.

    min sum w_i a_i^p + sum |e_j|^p   subject to   sum_i B_i F0_i a_i + sum_j R_j e_j = tau

F0_i is the force of muscle i at full activation beside a rigid tendon, at the length and the speed
of the frame. e_j is the effort of reserve j in optimal forces. tau is the force that inverse
dynamics computes without muscles, for all independent coordinates. The prices w_i have no unit and
are about 1 for a muscle of mean size. Activation and tendon have no dynamics here, so frames are
independent of one another unless rates of activation are limited.

Source: K. R. Kaufman, K. An, W. Litchy, E. Chao, J. Biomech. 24 (1991) 781, 793.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.couplings import Slopes
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.optimization.separable import Optimum, SeparableCost, SeparableProgram
from mbd_ros.core.state import NONE, Array
from mbd_ros.core.thresholds import SINGULAR
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.muscles.muscle_frames import Frames, MuscleFrames
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.methods.inverse_dynamics.reserves import Reserve

_LEAST_PRICE = 1.0e-6  # price of a muscle that has no force at all
EXPONENTS = {"activation": 2.0, "stress": 3.0, "volume": 2.0, "metabolic": 1.0}
MOST_WITH_TRACKING = 3.0  # exponent beside a measured activation


class Criterion(NamedTuple):
    """Cost sum w a^p of activations.

    - `activation`: w = 1. Source: K. R. Kaufman et al., J. Biomech. 24 (1991) 793.
    - `stress`: w = (F0 / F_max)^p, so that a^p w = (force / peak force)^p, which is fatigue for
      p = 3. Source: R. D. Crowninshield, R. A. Brand, J. Biomech. 14 (1981) 793.
    - `volume`: w = F_max l_opt over their mean: large muscles cost more. Source: R. Happee,
      F. C. T. van der Helm, J. Biomech. 28 (1995) 1179.
    - `metabolic`: w = F_max v_max phi over the mean of F_max v_max, phi(v / v_max) the metabolic
      rate of fibres that shorten at v; p = 1 is that rate itself. Source: A. E. Minetti,
      R. McN. Alexander, J. Theor. Biol. 186 (1997) 467.

    Attributes:
        kind: `activation`, `stress`, `volume` or `metabolic`.
        exponent: The exponent p >= 1.
    """

    kind: str = "activation"
    exponent: float = 2.0

    def prices(self, sizes: Sizes, active: Array, speed: Array) -> Array:
        """Return the prices w, shape (frames, n).

        Args:
            sizes: Sizes of the muscles.
            active: Forces F0 at full activation [N], shape (frames, n).
            speed: Lengthening speeds of the fibres [m/s], shape (frames, n).
        """
        if self.kind == "activation":
            return np.ones_like(active)
        if self.kind == "stress":
            return np.maximum((active / sizes.peak) ** self.exponent, _LEAST_PRICE)
        if self.kind == "volume":
            volume = sizes.peak * sizes.optimal
            return np.broadcast_to(volume / volume.mean(), active.shape)
        power = sizes.peak * sizes.fastest
        return power / power.mean() * shortening_rate(-speed / sizes.fastest)


DEFAULT = Criterion()


class SharingOptions(NamedTuple):
    """Objective and limits of the activations.

    Attributes:
        criterion: Cost of the activations.
        passive: Whether the elastic force of the fibres acts beside the active force.
        rise: Fastest rise of an activation [1/s]; inf without a limit.
        fall: Fastest fall of an activation [1/s]; inf without a limit.
        tracking: Price of (a - measured)^2, beside prices of about 1; 0 without tracking.
        measured_is_least: Whether measured activations are lower bounds (co-contraction).
    """

    criterion: Criterion = DEFAULT
    passive: bool = False
    rise: float = np.inf
    fall: float = np.inf
    tracking: float = 0.0
    measured_is_least: bool = False


DEFAULT_SHARING = SharingOptions()


class StaticOptimization:
    """Static optimisation of muscles on an open chain, coupled or not.

    A frame starts from the solution of the frame before. An instance owns Pinocchio data, so it
    must not be shared by threads.

    Args:
        known: Inverse dynamics of the robot without its muscles.
        muscles: At least one muscle.
        reserves: Reserve actuators that help the muscles.
        sharing: Objective and limits of the activations.
        search: Search for wrapping paths in many frames, as `PathBatch` takes it.
        quick: Factory of native code for paths, as `MuscleFrames` takes it.

    Attributes:
        names: Names of the muscles, then of the reserves.
        motion: Positions, velocities and accelerations of all joints in the frames of the latest
            `solve`, shapes (nq, frames), (nv, frames) and (nv, frames).

    Raises:
        ModelError: There is no muscle, or the options exclude one another.
    """

    def __init__(
        self,
        robot: Robot,
        known: InverseDynamics,
        muscles: Sequence[Muscle],
        reserves: Sequence[Reserve] = (),
        sharing: SharingOptions = DEFAULT_SHARING,
        search: Any = None,
        quick: Callable[..., Any] | None = None,
    ) -> None:
        check_sharing(muscles, sharing)
        self.known, self.muscles, self.reserves = known, tuple(muscles), tuple(reserves)
        self.sharing, self.robot = sharing, robot
        self.names = tuple(part.name for part in (*muscles, *reserves))
        self._frames = MuscleFrames(robot, known.couplings, muscles, reserves, search, quick)
        self._sizes, self._n = sizes_of(muscles), len(muscles)
        ends = [(muscle.inputs[0].lower, muscle.inputs[0].upper) for muscle in muscles]
        ends += [reserve.limits for reserve in reserves]
        self._lower, self._upper = np.array(ends, dtype=np.float64).T
        self._optimal = np.array([reserve.optimal for reserve in reserves])
        self._program = SeparableProgram(len(self.names), len(known.couplings.v_index))
        self._nq, self._nv = int(robot.model.nq), int(robot.model.nv)
        self.motion: tuple[Array, Array, Array] = (NONE, NONE, NONE)
        self.forget()

    def forget(self) -> None:
        """Forget earlier frames, so that they limit no rate of activation."""
        self._program.forget()
        self._last: tuple[float, Array] | None = None

    def solve(
        self,
        times: Array,
        position: Array,
        velocity: Array,
        acceleration: Array,
        wrenches: Sequence[Array] = (),
        measured: Array | None = None,
    ) -> Shares:
        """Share the forces of a motion.

        Args:
            times: Times of the frames [s], shape (frames,).
            position: Positions of the independent coordinates, shape (frames, ny).
            velocity: Velocities of the independent coordinates, shape (frames, nv_y).
            acceleration: Accelerations of the independent coordinates, shape (frames, nv_y).
            wrenches: One (frames, 6) array for every external load; empty if unloaded.
            measured: Measured activations, NaN where there is none, shape (frames, n).

        Raises:
            SolveError: The solution of a frame fails its check; the message names the time.
        """
        frames, needed = self.demand(position, velocity, acceleration, wrenches)
        gains = np.concatenate((frames.active, np.tile(self._optimal, (len(times), 1))), axis=1)
        A, b = frames.columns * gains[:, None, :], needed
        if self.sharing.passive:
            b = needed - np.einsum("tji,ti->tj", frames.columns[:, :, : self._n], frames.passive)
        prices = self.sharing.criterion.prices(self._sizes, frames.active, frames.fiber_speed)
        if measured is None:
            measured = np.full_like(frames.active, np.nan)
        optima, values = [], []
        for t, *frame in zip(times.tolist(), A, b, prices, measured, strict=True):
            optimum, value = self._share(t, *frame)
            optima.append(optimum)
            values.append(value)
        x = np.array([optimum.x for optimum in optima])
        force = x[:, : self._n] * frames.active
        if self.sharing.passive:
            force += frames.passive
        return Shares(
            *(frames, needed, x[:, : self._n], force, x[:, self._n :] * self._optimal),
            np.array([optimum.lacking for optimum in optima]),
            np.array(values),
            np.array([optimum.residual for optimum in optima]),
            np.array([optimum.is_feasible for optimum in optima]),
            A,
            tuple(optimum.movable for optimum in optima),
        )

    def demand(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array] = ()
    ) -> tuple[Frames, Array]:
        """Return the forces of muscles in frames, and the forces that the motion needs."""
        needed, slopes = self._needed(position, velocity, acceleration, wrenches)
        return self._frames.at(position, velocity, *self.motion[:2], slopes), needed

    def _needed(
        self, position: Array, velocity: Array, acceleration: Array, wrenches: Sequence[Array]
    ) -> tuple[Array, Slopes]:
        """Return the forces of the motion, shape (frames, nv_y), and slopes of the couplings."""
        if len(position) > 1:
            self.motion, slopes = self._expanded(position, velocity, acceleration)
            return self.known.batch(position, velocity, acceleration, wrenches).tau, slopes
        loads = [wrench[0] for wrench in wrenches]
        tau, q, v, a, slopes = self.known.expanded(
            position[0], velocity[0], acceleration[0], loads
        )
        self.motion = q[:, None].copy(), v[:, None].copy(), a[:, None].copy()
        return tau[None], slopes

    def _expanded(
        self, position: Array, velocity: Array, acceleration: Array
    ) -> tuple[tuple[Array, Array, Array], Slopes]:
        couplings, count = self.known.couplings, len(position)
        q, v, a = (np.zeros((size, count)) for size in (self._nq, self._nv, self._nv))
        q[couplings.q_index], v[couplings.v_index] = position.T, velocity.T
        a[couplings.v_index] = acceleration.T
        return (q, v, a), couplings.expand(q, v, a)

    def _share(
        self, t: float, A: Array, b: Array, prices: Array, measured: Array
    ) -> tuple[Optimum, float]:
        """Solve one frame; return its optimum and the value of its cost."""
        lower, upper, n = self._lower.copy(), self._upper.copy(), self._n
        known = np.isfinite(measured)
        if self.sharing.measured_is_least:
            lower[:n][known] = np.minimum(np.maximum(lower[:n], measured), upper[:n])[known]
        if self._last is not None:
            dt, before = t - self._last[0], self._last[1]
            lower[:n] = np.maximum(
                lower[:n], np.minimum(before - self.sharing.fall * dt, upper[:n])
            )
            upper[:n] = np.minimum(
                upper[:n], np.maximum(before + self.sharing.rise * dt, lower[:n])
            )
        cost = self._cost(prices, measured, known)
        try:
            optimum = self._program.solve(cost, A, b, lower, upper)
        except SolveError as error:
            raise SolveError(f"static optimisation at {t:.9g} s: {error}") from error
        if min(self.sharing.rise, self.sharing.fall) < np.inf:
            self._last = t, optimum.x[:n]
        return optimum, cost.value(optimum.x)

    def _cost(self, prices: Array, measured: Array, known: Array) -> SeparableCost:
        r, none = len(self.reserves), np.zeros(len(self.names))
        weight = np.concatenate((prices, np.ones(r)))
        stiffness, target = none, none
        if self.sharing.tracking > 0.0:
            price = np.where(known, self.sharing.tracking, 0.0)
            stiffness = np.concatenate((price, np.zeros(r)))
            target = np.concatenate((np.where(known, measured, 0.0), np.zeros(r)))
        return SeparableCost(self.sharing.criterion.exponent, weight, none, stiffness, target)


def check_sharing(muscles: Sequence[Muscle], sharing: SharingOptions) -> None:
    """Refuse options for which no optimum is defined.

    Raises:
        ModelError: There are no muscles, the exponent is too large for tracking, or a rate is
            not above 0.
    """
    if not muscles:
        raise ModelError("static optimisation: the scene has no muscles")
    exponent = sharing.criterion.exponent
    if sharing.tracking > 0.0 and exponent > MOST_WITH_TRACKING:
        raise ModelError(
            f"static optimisation: exponent {exponent:g} beside measured activations that are "
            f"tracked; accepted: 1 .. {MOST_WITH_TRACKING:g}"
        )
    if not (sharing.rise > 0.0 and sharing.fall > 0.0):
        raise ModelError("static optimisation: rates of activation must be greater than 0")


def sizes_of(muscles: Sequence[Muscle]) -> Sizes:
    """Return the sizes of muscles."""
    every = [muscle.contraction for muscle in muscles]
    rows = [[c.peak, c.optimal, c.fastest] for c in every]
    return Sizes(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)


class Sizes(NamedTuple):
    """Sizes of n muscles, shape (n,) each.

    Attributes:
        peak: Largest isometric force [N].
        optimal: Optimal fibre length, at which that force is reached [m].
        fastest: Largest shortening speed [m/s].
    """

    peak: Array
    optimal: Array
    fastest: Array


@dataclass(frozen=True)
class Shares:
    """Forces that muscles and reserves share, one row per frame.

    Attributes:
        frames: Forces that muscles and reserves can exert.
        needed: Force that the motion needs at each independent coordinate [N·m or N], shape
            (frames, nv_y).
        activation: Activations, shape (frames, n).
        force: Tension of each muscle [N], shape (frames, n).
        reserve: Force of each reserve [N·m or N], shape (frames, r).
        lacking: Residual force, which nothing can exert [N·m or N], shape (frames, nv_y).
        objective: Value of the cost, shape (frames,).
        residual: Largest violation of the optimality conditions, shape (frames,).
        is_feasible: Whether there is no residual force, shape (frames,).
        effects: Force on the independent coordinates by full activations and by efforts of 1
            [N·m or N], shape (frames, nv_y, n + r).
        movable: Indices in `names` of muscles and reserves that differ in other optima; empty
            where the optimum of the frame is unique.
    """

    frames: Frames
    needed: Array
    activation: Array
    force: Array
    reserve: Array
    lacking: Array
    objective: Array
    residual: Array
    is_feasible: Array
    effects: Array
    movable: tuple[tuple[int, ...], ...]

    @cached_property
    def rank(self) -> Array:
        """Number of independent combinations of muscles and reserves, shape (frames,)."""
        return np.asarray(np.linalg.matrix_rank(_scaled(self.effects), tol=SINGULAR))

    @property
    def null_space(self) -> Array:
        """Dimension of the combinations that exert nothing, shape (frames,)."""
        return np.asarray(self.effects.shape[2] - self.rank)


def _scaled(A: Array) -> Array:
    """Scale rows and columns to about equal size, so that ranks do not depend on units."""
    rows = np.abs(A).max(axis=2, keepdims=True, initial=0.0)
    A = A / np.where(rows > 0.0, rows, 1.0)
    columns = np.abs(A).max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(A / np.where(columns > 0.0, columns, 1.0))


def shortening_rate(shortening: Array) -> Array:
    """Return the metabolic rate of active fibres per peak force and largest speed.

    Source: A. E. Minetti, R. McN. Alexander, J. Theor. Biol. 186 (1997) 467.

    Args:
        shortening: Shortening speed per largest speed, negative for fibres that lengthen; clipped
            to -1 .. 1.
    """
    x = np.clip(shortening, -1.0, 1.0)
    above = 0.054 + x * (0.506 + 2.46 * x)
    return np.asarray(above / (1.0 + x * (-1.13 + x * (12.8 - 1.64 * x))))
