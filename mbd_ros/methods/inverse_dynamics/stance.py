"""Stance detection: which features of contacts may press, from the geometry of a motion."""

import math
from collections.abc import Collection, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State

Mask = NDArray[np.bool_]
_CLOSED = 1.0e-6  # gap, as a multiple of L, below which a feature is in stance at any speed
_GRAVITY = 9.81  # m/s^2, for scenes without gravity


class StanceThresholds(NamedTuple):
    """Thresholds below which a feature counts as on the ground.

    The length L is the distance from the mass centre of all bodies that move with the contact to
    its farthest feature, in the neutral configuration.

    Attributes:
        gap: Largest gap as a multiple of L [-].
        speed: Largest speed along the normal as a multiple of sqrt(g L) [-].
    """

    gap: float = 1.0e-3
    speed: float = 0.02


class StanceDetector:
    """Detects features of contacts whose gap and speed along the normal are small.

    A sliding feature is in stance, and so is one that has just touched down, whatever its speed.
    The threshold of the gap must be smaller than the clearance of a swinging foot.

    One instance owns its Pinocchio data and must not be shared between threads.

    Args:
        contacts: Constraints with the multiplier law `cone`.
        thresholds: Gap and speed below which a feature counts as on the ground.

    Attributes:
        features: `<contact>`, or `<contact>.<feature>` if it has several, in the order of masks.
        feet: Index of the foot of each feature; links that carry one another form one foot.
        feet_names: Name of each foot: the link that carries its other links.
    """

    def __init__(
        self, robot: Robot, contacts: Sequence[Any], thresholds: StanceThresholds | None = None
    ) -> None:
        limits = thresholds or StanceThresholds()
        self._k, self._contacts = Kinematics(robot), tuple(contacts)
        counts = [len(part.features) for part in contacts]
        size = np.repeat([_size(robot, part) for part in contacts], counts)
        g = float(np.linalg.norm(robot.model.gravity.linear)) or _GRAVITY
        self._closed = np.minimum(_CLOSED, limits.gap) * size
        self._gap = limits.gap * size
        self._speed = limits.speed * np.sqrt(g * size)
        first = [robot.places.points[part.pair.points[0].number].joint for part in contacts]
        self._signs = np.repeat([1.0 if joint else -1.0 for joint in first], counts)
        self.features = tuple(
            f"{part.name}.{feature}" if len(part.features) > 1 else part.name
            for part in contacts
            for feature in part.features
        )
        joints = [_carrying_joint(robot, part) for part in contacts]
        tops = [_top(robot, joint, joints) for joint in joints]
        every = sorted(set(tops))
        self.feet: NDArray[np.intp] = np.repeat([every.index(top) for top in tops], counts)
        links = {joint: _link(robot, part) for joint, part in zip(joints, contacts, strict=True)}
        self.feet_names = tuple(links[top] for top in every)

    def detect(self, x: State) -> Mask:
        """Return which features may press at a state, shape (n,)."""
        k = self._k
        k.refresh(x.q, x.v, Reads.JACOBIAN)
        gaps = [part.residual(k, x)[::3] for part in self._contacts]
        speeds = [part.jacobian(k, x)[::3].dot(x.v) for part in self._contacts]
        gap, speed = np.concatenate(gaps), np.abs(np.concatenate(speeds))
        stance: Mask = (gap <= self._gap) & (speed <= self._speed) | (gap <= self._closed)
        return stance

    def select(self, contacts: Collection[str]) -> Mask:
        """Return which features belong to some contacts, shape (n,)."""
        selected = [part.name in contacts for part in self._contacts for _ in part.features]
        return np.array(selected, dtype=np.bool_)

    def stance_feet(self, stance: Mask) -> Mask:
        """Return which feet have a feature in stance, shape (len(feet_names),)."""
        feet: Mask = np.bincount(self.feet, stance, minlength=len(self.feet_names)) > 0
        return feet

    def forces(self, x: State) -> Array:
        """Return the map from forces of all features to world forces on feet, (feet, 3, 3 n)."""
        k, n = self._k, len(self.features)
        k.refresh(x.q, x.v, Reads.POSITION)
        axes = np.concatenate([part.pair.places(k).axes for part in self._contacts])
        forces = np.zeros((len(self.feet_names), 3, n, 3))
        columns = axes[:, :, [2, 0, 1]] * self._signs[:, None, None]
        forces[self.feet, :, np.arange(n)] = columns
        return forces.reshape(len(self.feet_names), 3, 3 * n)


def find_root_joints(robot: Robot, actuated: Sequence[str] | None) -> tuple[str, ...]:
    """Return the joints that replace a free base, whose forces no actuator exerts.

    They connect the world to the first link with mass. In a scene with actuators these are the
    joints without an actuator; otherwise chains with at least two prismatic joints, as models of
    persons have them.

    Args:
        actuated: Joints with an actuator; None where the scene has none.
    """
    model, names = robot.model, {joint.v: joint.name for joint in robot.joints}
    sliding, roots = robot.prismatic_joints, []
    for root in range(1, model.njoints):
        if int(model.parents[root]) or model.joints[root].nv != 1:
            continue
        chain, joint = [root], root
        children = np.flatnonzero(np.array(model.parents) == joint)
        while model.inertias[joint].mass == 0.0 and len(children) == 1:
            joint = int(children[0])
            chain.append(joint)
            children = np.flatnonzero(np.array(model.parents) == joint)
        chain_names = [names[int(model.joints[i].idx_v)] for i in chain]
        if actuated is not None:
            roots += [name for name in chain_names if name not in actuated]
        elif sum(name in sliding for name in chain_names) > 1:
            roots += chain_names
    return tuple(roots)


def _size(robot: Robot, part: Any) -> float:
    """Return the distance of the farthest feature to the mass centre of all that moves with it."""
    model, data, q = robot.model, pin.Data(robot.model), robot.neutral()
    k = Kinematics(robot, data)
    k.refresh(q, np.zeros(model.nv), Reads.POSITION)
    centre = _centre(model, data, int(model.supports[_carrying_joint(robot, part)][1]))
    size = float(np.linalg.norm(part.pair.places(k).point - centre, axis=1).max())
    return size if size > 0.0 and math.isfinite(size) else 1.0


def _centre(model: Any, data: Any, root: int) -> Array:
    """Return the mass centre of a joint and its subtree in the world [m], shape (3,)."""
    mass, total = 0.0, np.zeros(3)
    for joint in model.subtrees[root]:
        body = model.inertias[int(joint)]
        mass += body.mass
        total += body.mass * data.oMi[int(joint)].act(body.lever)
    return total / mass if mass else data.oMi[root].translation


def _carrying_joint(robot: Robot, part: Any) -> int:
    """Return the joint that carries a contact, that of its first body where both move."""
    joints = [robot.places.points[point.number].joint for point in part.pair.points]
    return int(joints[0] or joints[1])


def _link(robot: Robot, part: Any) -> str:
    a, b = part.pair.points
    frame: str = a.frame if robot.places.points[a.number].joint else b.frame
    return frame


def _top(robot: Robot, joint: int, joints: Sequence[int]) -> int:
    """Return the first joint with a contact on the path from the world to a joint."""
    return next(int(i) for i in robot.model.supports[joint] if int(i) in joints)
