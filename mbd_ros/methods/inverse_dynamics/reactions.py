"""Reaction wrenches of joints, and joint loads with the contribution of each muscle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.contracts import Load, Wrench
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.kinematics.poses import cross
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.loads import BodyLoads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import NONE, Array, State
from mbd_ros.errors import ModelError
from mbd_ros.methods.inverse_dynamics.reserves import CoordinateReserve, Reserve

_NEXT, _AFTER = [1, 2, 0], [2, 0, 1]
Side = Literal["child", "parent", "ground"]


class JointReactions:
    """Reaction wrenches of the joints of a tree, with loops closed by constraints.

    The backward pass of the Newton-Euler recursion yields six components a joint. Springs,
    actuators, couplings and friction of a joint act between its parent and its child, so they are
    part of its reaction.

    One instance owns its Pinocchio data and must not be shared between threads.

    Args:
        robot: The robot; reactions come in the order of its joints.
        constraints: The rows to which the multipliers belong.
        wrenches: External loads, in the order in which `solve` takes their values.
        forces: Force terms; those that act on bodies count as loads.
    """

    def __init__(
        self,
        robot: Robot,
        constraints: ConstraintRows,
        wrenches: Sequence[ExternalWrench] = (),
        forces: Sequence[Load] = (),
    ) -> None:
        self._model, self._data = robot.model, pin.Data(robot.model)
        self._constraints = constraints
        self._k, self._forces = Kinematics(robot, self._data), tuple(forces)
        self._loads = BodyLoads(robot, wrenches)
        at = {int(joint.idx_v): i for i, joint in enumerate(robot.model.joints) if i}
        self._joints = [at[joint.v] for joint in robot.joints]

    def solve(
        self,
        x: State,
        a: Array,
        multipliers: Array,
        wrenches: Sequence[Array] = (),
        u: Array = NONE,
    ) -> Reactions:
        """Return the reactions of a motion that satisfies the equation of motion.

        Args:
            x: State of all joints.
            a: Acceleration of all joints [rad/s^2 or m/s^2], shape (nv,).
            multipliers: One a row of the constraints, shape (m,).
            wrenches: One (6,) array [N, N·m] for every load; none means unloaded.
            u: All inputs; may be empty if no force reads them.
        """
        model, data = self._model, self._data
        self._k.refresh(x.q, x.v)
        closures = self._constraints.wrenches(self._k, x, multipliers)
        self._loads.set(self._k, wrenches)
        exerted = (w for force in self._forces for w in force.wrenches(self._k, x, u))
        for wrench in (*closures, *exerted):
            self._loads.add(self._k, wrench)
        pin.rnea(model, data, x.q, x.v, a, self._loads.forces)
        local = np.array([data.f[i].vector for i in self._joints]).reshape(-1, 6)
        rotations = np.array([data.oMi[i].rotation for i in self._joints]).reshape(-1, 3, 3)
        world = np.einsum("nij,nkj->nki", rotations, local.reshape(-1, 2, 3)).reshape(-1, 6)
        return Reactions(local, world, closures)


class Reactions(NamedTuple):
    """Wrenches between bodies.

    Attributes:
        local: Wrench of the parent of every joint on its child: force [N], then torque [N·m]
            about the origin of the joint, in the axes of the joint on the child, shape (n, 6).
            Its component along the axis of the joint is the sum of actuator (without the torque
            that accelerates its rotor, the armature), springs, friction and tendons.
        world: These wrenches in world axes, about the same points, shape (n, 6).
        closures: Wrenches of constraints on bodies.
    """

    local: Array
    world: Array
    closures: tuple[Wrench, ...]


class SystemReactions:
    """Reactions of the joints of a system, with all its forces and constraints."""

    def __init__(self, system: System) -> None:
        rows = ConstraintRows(system.layout.blocks, int(system.robot.model.nv))
        self._slots, self._loads = rows.slots, system.loads
        self._solver = JointReactions(system.robot, rows, (), system.loads.forces)

    def at(self, x: State, u: Array | None, a: Array, lam: Array) -> Array:
        """Return the reactions of all joints in their own axes, shape (n, 6).

        Args:
            x: State of all joints.
            u: Inputs; None for the values of the input sources.
            a: Accelerations of all joints, shape (nv,).
            lam: Multipliers of all rows of the system.
        """
        inputs = np.asarray(self._loads.inputs(x, u))
        return self._solver.solve(x, a, lam[self._slots], u=inputs).local


class JointLoads:
    """Joint loads of a model with muscles: the total, and the contribution of each muscle.

    The load on a link is the wrench that its joint transmits to it from its parent: inertia minus
    gravity, external loads and muscle forces of all bodies distal to the joint. A muscle i of
    tension F_i that pulls at the points r_k of distal bodies with forces F_i n_k contributes to
    the load about a point o

        -F_i sum_k (n_k, (r_k - o) x n_k)

    Generalized forces of muscles through moving path points act on coordinates, not on bodies, and
    do not contribute. Sources: K. M. Steele, M. S. DeMers, M. H. Schwartz, S. L. Delp, Gait
    Posture 35 (2012) 556, on loads of the knee; R. Featherstone, Rigid Body Dynamics Algorithms,
    2008, 5.3.

    One instance owns Pinocchio data and must not be shared between threads.

    Args:
        reactions: Joint reactions of the robot without muscles, with its external loads.
        muscles: Muscles, in the order of their contributions.
        reserves: Reserve actuators.
        links: Links whose joint loads are computed; empty for all links with mass and a joint.
        side: `child` is the load on the link in its axes, `ground` this load in world axes, both
            about the origin of the joint; `parent` is the load on the parent in its axes, about
            the location of the joint on the parent.

    Attributes:
        joint_links: The links, in the order of the loads.

    Raises:
        ModelError: Unknown link, or one that no joint carries.
    """

    def __init__(
        self,
        robot: Robot,
        reactions: JointReactions,
        muscles: Sequence[Muscle],
        reserves: Sequence[Reserve] = (),
        links: Sequence[str] = (),
        side: Side = "child",
    ) -> None:
        self._robot, self._reactions, self.side = robot, reactions, side
        self._k = Kinematics(robot)
        self._muscles = tuple(muscles)
        self._reserves = [
            (i, r) for i, r in enumerate(reserves) if not isinstance(r, CoordinateReserve)
        ]
        self.joint_links = find_joint_links(robot, links)
        count = int(robot.model.njoints)
        self._is_distal = np.zeros((len(self.joint_links), count))  # 1 for bodies beyond a joint
        for row, link in enumerate(self.joint_links):
            for joint in robot.model.subtrees[link.joint]:
                self._is_distal[row, joint] = 1.0
        self._carrier: dict[str, int] = {}
        read = [muscle.path.reads for muscle in muscles]
        self._reads = max([Reads.POSITION, *read, *(part.reads for _, part in self._reserves)])

    def solve(
        self,
        x: State,
        a: Array,
        tension: Array,
        reserve: Array,
        wrenches: Sequence[Array] = (),
        multipliers: Array | None = None,
    ) -> tuple[Array, Array]:
        """Compute the joint loads at one instant.

        Args:
            x: State of all joints.
            a: Acceleration of all joints, shape (nv,).
            tension: Tension of the muscles [N], shape (n,).
            reserve: Force of the reserves [N or N·m], shape (r,).
            wrenches: One (6,) array for every external load; none means unloaded.
            multipliers: Multipliers of the rows of `reactions`; None if it has no rows.

        Returns:
            Force [N], then moment [N·m], on each link, shape (links, 6), and the contribution of
            each muscle to them, shape (n, links, 6).
        """
        none = np.zeros(0) if multipliers is None else multipliers
        bare = self._reactions.solve(x, a, none, wrenches).world[[j.row for j in self.joint_links]]
        self._k.refresh(x.q, x.v, self._reads)
        origins = np.array([self._k.position(link.ground) for link in self.joint_links])
        by_muscle = -self._sum_distal(self._muscle_wrenches(x, tension), origins)
        total = bare + by_muscle.sum(axis=0)
        if self._reserves:
            total -= self._sum_distal(self._reserve_wrenches(x, reserve), origins)[0]
        return self._to_side(total, origins), self._to_side(by_muscle, origins)

    def _muscle_wrenches(self, x: State, tension: Array) -> Array:
        """Return the wrench of each muscle on each body about the origin, (n, bodies, 6)."""
        on = np.zeros((len(self._muscles), self._is_distal.shape[1], 6))
        owners, bodies, points, forces = [], [], [], []
        for i, muscle in enumerate(self._muscles):
            for pull in muscle.path.pulls(self._k, x):
                owners.append(i)
                bodies.append(self._body(pull.frame))
                points.append(pull.point)
                forces.append(pull.force)
        at, force = np.array(points).reshape(-1, 3), np.array(forces).reshape(-1, 3)
        np.add.at(on, (owners, bodies), np.concatenate((force, cross(at, force)), axis=1))
        scaled: Array = on * tension[:, None, None]
        return scaled

    def _reserve_wrenches(self, x: State, reserve: Array) -> Array:
        """Return the wrench of all reserves on each body about the origin, (1, bodies, 6)."""
        on = np.zeros((1, self._is_distal.shape[1], 6))
        for i, part in self._reserves:
            for wrench in part.wrenches(self._k, x, float(reserve[i])):
                body = self._body(wrench.frame)
                on[0, body, :3] += wrench.force
                on[0, body, 3:] += wrench.torque + cross(wrench.point, wrench.force)
        return on

    def _body(self, frame: str) -> int:
        if frame not in self._carrier:
            index = self._robot.frame(frame)
            self._carrier[frame] = int(self._robot.model.frames[index].parentJoint)
        return self._carrier[frame]

    def _sum_distal(self, on: Array, origins: Array) -> Array:
        """Return the sums over the bodies beyond each joint, about its origin, (.., links, 6)."""
        summed = np.einsum("lb,mbk->mlk", self._is_distal, on)
        summed[..., 3:] -= cross(origins, summed[..., :3])
        return summed

    def _to_side(self, loads: Array, origins: Array) -> Array:
        """Convert loads on the links in world axes to the chosen side, same shape."""
        if self.side == "ground":
            return loads
        if self.side == "parent":
            places = np.array([self._k.position(link.parent) for link in self.joint_links])
            force = -loads[..., :3]
            loads = np.concatenate(
                (force, cross(origins - places, force) - loads[..., 3:]), axis=-1
            )
        ends = [link.child if self.side == "child" else link.parent for link in self.joint_links]
        R = np.array([self._k.rotation(end) for end in ends])
        split = loads.reshape(*loads.shape[:-1], 2, 3)
        return np.asarray((split @ R).reshape(loads.shape))


def find_joint_links(robot: Robot, links: Sequence[str] = ()) -> tuple[JointLink, ...]:
    """Return the given links with their joints, in the order of the joints.

    Args:
        links: Names of links; empty for all links with mass that a joint carries.

    Raises:
        ModelError: Unknown link, or one that no joint carries.
    """
    masses = {name: float(inertia.mass) for name, inertia in robot.inertias().items()}
    heavy: dict[int, str] = {}
    for name in masses:
        joint = int(robot.model.frames[robot.frame(name)].parentJoint)
        if masses[name] > masses.get(heavy.get(joint, ""), 0.0):
            heavy[joint] = name
    rows = {int(j.idx_v): i for i, j in enumerate(robot.model.joints) if i}
    places = {rows[joint.v]: row for row, joint in enumerate(robot.joints)}
    if not links:
        pairs = [(joint, heavy[joint]) for joint in places if joint in heavy]
    else:
        pairs = [(int(robot.model.frames[robot.frame(name)].parentJoint), name) for name in links]
    joint_links = []
    for joint, name in sorted(pairs):
        if joint not in places:
            names = ", ".join(heavy[j] for j in places if j in heavy)
            raise ModelError(f"no joint carries link '{name}'; accepted: {names}")
        joint_links.append(_joint_link(robot, name, joint, places[joint], heavy))
    return tuple(joint_links)


class JointLink(NamedTuple):
    """A link and its connection to its parent: one joint, or several with massless links between.

    Attributes:
        link: Name of the link.
        row: Index of its last joint among the joints of the robot.
        joint: Index of that joint in the model; moments are about its origin.
        child: Point of the link, in its axes.
        ground: Point at the origin of the last joint.
        parent: Point of the parent at the origin of the first joint, in axes of the parent.
        parent_link: Name of the parent link.
    """

    link: str
    row: int
    joint: int
    child: Any
    ground: Any
    parent: Any
    parent_link: str


def _joint_link(robot: Robot, name: str, joint: int, row: int, heavy: dict[int, str]) -> JointLink:
    """Return a link with the chain of massless links that leads to it."""
    model, first = robot.model, joint
    while int(model.parents[first]) and int(model.parents[first]) not in heavy:
        first = int(model.parents[first])
    above = int(model.parents[first])
    parent = heavy.get(above, "universe")
    axes = model.frames[robot.frame(parent)].placement
    at = axes.inverse() * model.jointPlacements[first]
    place = robot.shifted(robot.point(parent), at.translation)
    return JointLink(name, row, joint, robot.point(name), robot.carrier(name), place, parent)
