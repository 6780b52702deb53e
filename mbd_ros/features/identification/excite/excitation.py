"""Motions that show masses: Fourier series within limits."""

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.regressor import expanded, limits_of
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.scene.built_scene import Scene

_USUAL_SPEED = 2.0  # rad/s, where a description has no velocity limit
_SLIDING_SPEED = 0.5  # m/s, the same of prismatic joints
_SHARE = 0.9  # of every limit is used
_STEPS = 40  # of the amplitude, each smaller
_SMALLER = 0.93  # factor of the amplitude, a step
_POSTURES = 50  # random ones that tell which links always touch


class Fourier(NamedTuple):
    """A periodic motion of joints that begins and ends at rest: a Fourier series of velocities.

        v = sum_l A_l cos(l w t) + B_l sin(l w t),   sum A_l = 0,   sum l B_l = 0

    so that velocity and acceleration are 0 at t = 0 and after every period.

    Source: J. Swevers et al., IEEE Trans. Robot. Autom. 13, 1997, 730.

    Attributes:
        centre: Mean position [rad or m], shape (n,).
        A: Cosines of the velocity [rad/s or m/s], shape (harmonics, n).
        B: Sines of the velocity, same shape.
        period: [s].
    """

    centre: Array
    A: Array
    B: Array
    period: float

    @classmethod
    def at_rest(cls, centre: Array, A: Array, B: Array, period: float) -> "Fourier":
        """The nearest motion that begins at rest."""
        harmonic = np.arange(1.0, len(A) + 1.0)[:, None]
        B = B - harmonic * (harmonic * B).sum(axis=0) / np.square(harmonic).sum()
        return cls(centre, A - A.mean(axis=0), B, period)

    def scaled(self, share: Array) -> "Fourier":
        """With other amplitudes of each joint, about the same centre."""
        return self._replace(A=self.A * share, B=self.B * share)

    def at(self, t: Array) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at times [s] of shape (k,), shape (k, n) each."""
        w = 2.0 * np.pi / self.period * np.arange(1.0, len(self.A) + 1.0)
        s, c = np.sin(np.outer(t, w)), np.cos(np.outer(t, w))
        position = self.centre + (s / w) @ self.A - (c / w) @ self.B
        return position, c @ self.A + s @ self.B, (c * w) @ self.B - (s * w) @ self.A


class Limits:
    """What a motion must keep: positions, velocities and torques of joints, distance of links.

    Args:
        scene: The scene, without loops and free bases.
        share: Of limits that is used.

    Attributes:
        remarks: What is assumed, for people.
    """

    def __init__(self, scene: Scene, share: float = _SHARE) -> None:
        self._scene, self._model = scene, scene.robot.model
        solver = scene.inverse_dynamics()
        assert isinstance(solver, InverseDynamics)
        self._solver, self._couplings = solver, scene.couplings
        joints = scene.robot.joints
        own = np.array([limits_of(scene.robot, joint.name) for joint in joints])
        middle, half = own.mean(axis=1), 0.5 * share * np.ptp(own, axis=1)
        self._lower, self._upper = middle - half, middle + half
        speeds = [_speed(joint.kind, joint.max_velocity) for joint in joints]
        self._speed = share * np.array(speeds)
        self._effort = share * np.array([joint.max_effort or np.inf for joint in joints])
        self._q = np.array([joint.q for joint in joints])
        self._v = np.array([joint.v for joint in joints])
        names = scene.couplings.independent
        self._independent = [i for i, joint in enumerate(joints) if joint.name in names]
        self.remarks = [
            f"{joint.name}: no velocity limit, {speed:g} per s is taken"
            for joint, speed in zip(joints, speeds, strict=True)
            if not np.isfinite(joint.max_velocity)
        ]
        self._near = SelfCollision(scene)
        self.remarks += self._near.remarks

    @property
    def room(self) -> tuple[Array, Array]:
        """Positions of the independent joints, lowest and highest."""
        return self._lower[self._independent], self._upper[self._independent]

    def largest(self, shape: Fourier, share: Array, t: Array) -> Fourier | None:
        """A motion of a shape, as large as it may be; None where even a small one may not be.

        Args:
            shape: The shape; its centre is in the room.
            share: Of the amplitude that positions and velocities of each joint let, shape (n,).
            t: Times at which limits are looked at [s].
        """
        low, high = self.room
        y, v, _ = shape.at(t)
        away = np.abs(y - shape.centre).max(axis=0)
        beside = np.minimum(shape.centre - low, high - shape.centre)
        fast = np.abs(v).max(axis=0)
        most = np.minimum(beside / away, self._speed[self._independent] / fast)
        motion = shape.scaled(share * most)
        if not self.keeps(motion.scaled(np.full(len(share), _SMALLER**_STEPS)), t):
            return None
        for _ in range(_STEPS):
            if self.keeps(motion, t):
                return motion
            motion = motion.scaled(np.full(len(share), _SMALLER))
        return None

    def keeps(self, motion: Fourier, t: Array, collisions: bool = False) -> bool:
        """Whether all joints keep positions, velocities and torques, and links their distance."""
        y, v, a = motion.at(t)
        q, rate, _, _ = expanded(self._model, self._couplings, y, v, a)
        position, speed = q[self._q], np.abs(rate[self._v])
        slack = 1e-9
        if (position < self._lower[:, None] - slack).any():
            return False
        if (position > self._upper[:, None] + slack).any():
            return False
        if (speed > self._speed[:, None] + slack).any():
            return False
        tau = np.abs(self._solver.batch(y, v, a, []).tau)
        if (tau > self._effort[self._independent] + slack).any():
            return False
        return not (collisions and self._near.touches(q))


def _speed(kind: str, limit: float) -> float:
    usual = _SLIDING_SPEED if kind == "prismatic" else _USUAL_SPEED
    return limit if np.isfinite(limit) else usual


class SelfCollision:
    """Whether links of a robot touch, by the collision shapes of its description.

    Links that touch in each of many postures, such as neighbours, are left aside.

    Attributes:
        remarks: Why it is not looked at, where that is so.
    """

    def __init__(self, scene: Scene) -> None:
        self.remarks: list[str] = []
        self._model, self._pairs = scene.robot.model, 0
        recipe = scene.robot.recipes[0]
        if len(scene.robot.recipes) > 1 or "<collision" not in recipe.text:
            self.remarks.append("no collision shapes: distances of links are not looked at")
            return
        try:
            geometry = pin.buildGeomFromUrdfString(
                self._model, recipe.text, pin.GeometryType.COLLISION
            )
        except (ValueError, RuntimeError) as error:
            self.remarks.append(f"distances of links are not looked at: {error}")
            return
        geometry.addAllCollisionPairs()
        self._data, self._geometry = self._model.createData(), geometry
        self._leave_aside(scene)
        self._pairs = len(geometry.collisionPairs)
        self._found = pin.GeometryData(geometry)

    def _leave_aside(self, scene: Scene) -> None:
        random, geometry, always = np.random.default_rng(0), self._geometry, None
        q = scene.robot.neutral()
        found = pin.GeometryData(geometry)
        for _ in range(_POSTURES):
            for joint in scene.robot.joints:
                q[joint.q] = random.uniform(*limits_of(scene.robot, joint.name))
            pin.computeCollisions(self._model, self._data, geometry, found, q, False)
            touch = np.array([result.isCollision() for result in found.collisionResults])
            always = touch if always is None else always & touch
        parents = [int(one.parentJoint) for one in geometry.geometryObjects]
        for k in reversed(range(len(geometry.collisionPairs))):
            pair: Any = geometry.collisionPairs[k]
            a, b = parents[pair.first], parents[pair.second]
            beside = a == b or self._model.parents[max(a, b)] == min(a, b)
            if beside or (always is not None and always[k]):
                geometry.removeCollisionPair(pair)

    def touches(self, q: Array) -> bool:
        """Whether any two links touch in any of the configurations, shape (nq, n)."""
        if not self._pairs:
            return False
        model, data, geometry, found = self._model, self._data, self._geometry, self._found
        return any(
            pin.computeCollisions(model, data, geometry, found, np.ascontiguousarray(one), True)
            for one in q.T
        )


def refuse(scene: Scene) -> None:
    """Refuse scenes whose motion cannot be chosen joint by joint.

    Raises:
        DataError: Says why.
    """
    if scene.has_loops:
        raise DataError(
            f"{scene.name}: excite serves scenes without loops. Drive the motors by different "
            "slow and fast sines within their limits; identify takes recordings of loops"
        )
    if scene.robot.floating:
        raise DataError(
            f"{scene.name}: excite serves scenes without free bases. Hold the base and say "
            "`robot: {base: fixed}`, or record any lively motion with the wrench that carries "
            "it: identify takes that"
        )
    if not scene.couplings.independent:
        raise DataError(f"{scene.name}: no joint moves")
