"""Which features of contacts may press, as the geometry of a motion shows it."""

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
_CLOSED = 1.0e-6  # a gap, as a multiple of L, that an impact leaves with any speed
_GRAVITY = 9.81  # m/s^2, where a scene has none


class Nearness(NamedTuple):
    """Thresholds of a contact that counts as closed.

    Attributes:
        gap: Largest gap of a contact that stands, as a multiple of the length L [-]. L is the
            distance from the mass centre of all that moves with the contact to its farthest
            feature, in the neutral configuration.
        speed: Largest speed along the normal of a contact that stands, as a multiple of
            sqrt(g L) [-].
    """

    gap: float = 1.0e-3
    speed: float = 0.02


class Standing:
    """A feature stands where its gap and its speed along the normal are small.

    Both thresholds are multiples of the size of the mechanism. What slides along the ground
    stands on it too, and so does what has just come, whatever its speed. A threshold below the
    clearance of a foot that swings tells them apart.

    One instance owns its Pinocchio data: not for two threads.

    Args:
        contacts: Constraints of the law `cone`.

    Attributes:
        features: `<contact>`, or `<contact>.<feature>` of several, in the order of the masks.
        feet: Which foot each feature is part of: links that carry one another are one foot.
        feet_names: One a foot: the link that carries the others.
    """

    def __init__(
        self, robot: Robot, contacts: Sequence[Any], near: Nearness | None = None
    ) -> None:
        near = near or Nearness()
        self._k, self._contacts = Kinematics(robot), tuple(contacts)
        counts = [len(part.features) for part in contacts]
        size = np.repeat([_size(robot, part) for part in contacts], counts)
        g = float(np.linalg.norm(robot.model.gravity.linear)) or _GRAVITY
        self._closed = np.minimum(_CLOSED, near.gap) * size
        self._gap, self._speed = near.gap * size, near.speed * np.sqrt(g * size)
        first = [robot.places.points[part.pair.points[0].number].joint for part in contacts]
        self._signs = np.repeat([1.0 if joint else -1.0 for joint in first], counts)
        self.features = tuple(
            f"{part.name}.{feature}" if len(part.features) > 1 else part.name
            for part in contacts
            for feature in part.features
        )
        joints = [_moving(robot, part) for part in contacts]
        tops = [_top(robot, joint, joints) for joint in joints]
        every = sorted(set(tops))
        self.feet: NDArray[np.intp] = np.repeat([every.index(top) for top in tops], counts)
        links = {joint: _link(robot, part) for joint, part in zip(joints, contacts, strict=True)}
        self.feet_names = tuple(links[top] for top in every)

    def at(self, x: State) -> Mask:
        """Which features may press at a state, shape (n,)."""
        k = self._k
        k.refresh(x.q, x.v, Reads.JACOBIAN)
        gaps = [part.residual(k, x)[::3] for part in self._contacts]
        speeds = [part.jacobian(k, x)[::3].dot(x.v) for part in self._contacts]
        gap, speed = np.concatenate(gaps), np.abs(np.concatenate(speeds))
        stands: Mask = (gap <= self._gap) & (speed <= self._speed) | (gap <= self._closed)
        return stands

    def of(self, contacts: Collection[str]) -> Mask:
        """Features of some contacts, shape (n,)."""
        are = [part.name in contacts for part in self._contacts for _ in part.features]
        return np.array(are, dtype=np.bool_)

    def standing_feet(self, standing: Mask) -> Mask:
        """Which feet have a feature that stands, shape (len(feet_names),)."""
        feet: Mask = np.bincount(self.feet, standing, minlength=len(self.feet_names)) > 0
        return feet

    def forces(self, x: State) -> Array:
        """From forces of all features to that on each foot in the world, shape (feet, 3, 3 n)."""
        k, n = self._k, len(self.features)
        k.refresh(x.q, x.v, Reads.POSITION)
        axes = np.concatenate([part.pair.places(k).axes for part in self._contacts])
        forces = np.zeros((len(self.feet_names), 3, n, 3))
        columns = axes[:, :, [2, 0, 1]] * self._signs[:, None, None]
        forces[self.feet, :, np.arange(n)] = columns
        return forces.reshape(len(self.feet_names), 3, 3 * n)


def carriers(robot: Robot, actuated: Sequence[str] | None) -> tuple[str, ...]:
    """Joints that stand for a free base: what they need is no effort of anybody.

    They lead from the world to the first link with mass. With actuators these are the joints
    without one; otherwise a chain that slides along two axes at least, as models of persons have.

    Args:
        actuated: Joints with an actuator; None where the scene has none.
    """
    model, names = robot.model, {joint.v: joint.name for joint in robot.joints}
    sliding, found = robot.prismatic_joints, []
    for root in range(1, model.njoints):
        if int(model.parents[root]) or model.joints[root].nv != 1:
            continue
        chain, joint = [root], root
        children = np.flatnonzero(np.array(model.parents) == joint)
        while model.inertias[joint].mass == 0.0 and len(children) == 1:
            joint = int(children[0])
            chain.append(joint)
            children = np.flatnonzero(np.array(model.parents) == joint)
        of_chain = [names[int(model.joints[i].idx_v)] for i in chain]
        if actuated is not None:
            found += [name for name in of_chain if name not in actuated]
        elif sum(name in sliding for name in of_chain) > 1:
            found += of_chain
    return tuple(found)


def _size(robot: Robot, part: Any) -> float:
    """Way of the farthest feature to the mass centre of all that moves with it [m]."""
    model, data, q = robot.model, pin.Data(robot.model), robot.neutral()
    k = Kinematics(robot, data)
    k.refresh(q, np.zeros(model.nv), Reads.POSITION)
    centre = _centre(model, data, int(model.supports[_moving(robot, part)][1]))
    size = float(np.linalg.norm(part.pair.places(k).point - centre, axis=1).max())
    return size if size > 0.0 and math.isfinite(size) else 1.0


def _centre(model: Any, data: Any, root: int) -> Array:
    """Mass centre of a joint and all that it carries, in the world [m], shape (3,)."""
    mass, total = 0.0, np.zeros(3)
    for joint in model.subtrees[root]:
        body = model.inertias[int(joint)]
        mass += body.mass
        total += body.mass * data.oMi[int(joint)].act(body.lever)
    return total / mass if mass else data.oMi[root].translation


def _moving(robot: Robot, part: Any) -> int:
    """Joint of the model that carries a contact, that of its first body where both move."""
    joints = [robot.places.points[point.number].joint for point in part.pair.points]
    return int(joints[0] or joints[1])


def _link(robot: Robot, part: Any) -> str:
    a, b = part.pair.points
    frame: str = a.frame if robot.places.points[a.number].joint else b.frame
    return frame


def _top(robot: Robot, joint: int, joints: Sequence[int]) -> int:
    """The first of the joints with contacts on the way from the world to one of them."""
    return next(int(i) for i in robot.model.supports[joint] if int(i) in joints)
