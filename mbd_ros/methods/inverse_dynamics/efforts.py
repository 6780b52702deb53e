"""Unknowns of inverse dynamics: efforts within limits, their order and their cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import Load
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.loads.inputs import bound
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.optimization.least_norm import Limits
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import ModelError
from mbd_ros.methods.inverse_dynamics.force_split import Wish

Columns = Callable[[Kinematics, State], Array]
_NAMED = 0.3  # share of a joint in a direction, of the largest, to be named
_SHOWN = 4  # joints in a message
_DIGITS = 9  # of shares that differ; beyond them is rounding
_LISTED = 12  # names in a message
Mask = NDArray[np.bool_]


class Efforts(NamedTuple):
    """Inputs u that exert B u + rest on the joints.

    Where a motion does not determine them, those with the least sum of
    (weight (u - target))^2 are taken.

    Attributes:
        names: One a column; of efforts of joints the joints.
        columns: B at a state, shape (nv, n).
        lower: Smallest values, -inf without, shape (n,).
        upper: Largest values, inf without, shape (n,).
        weight: Of the cost [1 per unit of u], > 0, shape (n,).
        target: Of the cost, shape (n,).
        reads: What `columns` and `rest` read of k.
        rest: What they exert at u = 0, at a state, shape (nv,); None for nothing.
    """

    names: tuple[str, ...]
    columns: Columns
    lower: Array
    upper: Array
    weight: Array
    target: Array
    reads: Reads = Reads.NOTHING
    rest: Columns | None = None


def joint_efforts(
    robot: Robot, joints: Sequence[str], limits: Sequence[float] | None = None
) -> Efforts:
    """Efforts of joints [N·m or N], of smallest Euclidean norm in SI numbers.

    Args:
        joints: Different joints of it.
        limits: Largest effort of each [N·m or N], > 0; without it there is none.

    Raises:
        ModelError: Unknown or repeated joint, or a limit that is not positive.
    """
    names, n = tuple(joints), len(joints)
    if len(set(names)) < n:
        raise ModelError(f"actuated joints {', '.join(names)} must be different joints")
    B = np.zeros((int(robot.model.nv), n))
    B[[robot.joint(name).v for name in names], range(n)] = 1.0
    upper = np.full(n, np.inf) if limits is None else np.array(limits, dtype=np.float64)
    if upper.shape != (n,) or not (upper > 0.0).all():
        raise ModelError(f"limits {upper.tolist()} must be one number > 0 for each of {n} joints")
    return Efforts(names, lambda k, x: B, -upper, upper, np.ones(n), np.zeros(n))


def input_efforts(robot: Robot, loads: Sequence[Load]) -> Efforts:
    """Inputs of loads that are affine in them, within the bounds of their channels.

    Args:
        loads: Actuators and other loads with inputs; they are no force terms of the problem then.

    Raises:
        ModelError: A load that is not affine in its inputs, or that has internal states.
    """
    parts, inputs = bound(loads)
    affine = [part for part in parts if isinstance(part, Load)]
    k, neutral = Kinematics(robot), State(0.0, robot.neutral(), np.zeros(int(robot.model.nv)))
    reads = max((part.reads for part in affine), default=Reads.NOTHING)
    k.refresh(neutral.q, neutral.v, reads)
    for part in affine:
        name = part.name or type(part).__name__
        if part.internal:
            raise ModelError(f"{name} has internal states, which a motion does not show")
        if part.columns(k, neutral) is None:
            raise ModelError(f"the force of {name} is not affine in its inputs")
    idle, n = np.zeros(len(inputs.names)), len(inputs.names)

    def columns(k: Kinematics, x: State) -> Array:
        none = np.zeros((len(x.v), 0))
        return np.concatenate([none, *(part.columns(k, x) for part in affine)], axis=1)

    def rest(k: Kinematics, x: State) -> Array:
        return np.sum([np.zeros(len(x.v)), *(part.force(k, x, idle) for part in affine)], axis=0)

    lower = np.array([channel.lower for channel in inputs.channels], dtype=np.float64)
    upper = np.array([channel.upper for channel in inputs.channels], dtype=np.float64)
    return Efforts(inputs.names, columns, lower, upper, np.ones(n), np.zeros(n), reads, rest)


class Unknowns:
    """Efforts, multipliers of drives, then those of all other rows.

    A solver finds y = weight (x - target), whose norm is the cost.

    Args:
        efforts: The unknown inputs.
        is_drive: Which rows are drives, shape (m,).
        with_bounds: Whether efforts and drives keep their bounds.

    Attributes:
        labels: `<effort>.effort` and names of rows, shape (n,).
        place: Where each stands among efforts, then multipliers, shape (n,).
        efforts: How many come before the rows: inputs and drives.
        weight: Shape (n,), 1 but for inputs.
        target: Shape (n,), 0 but for inputs.
    """

    def __init__(
        self,
        efforts: Efforts,
        constraints: ConstraintRows,
        is_drive: Mask,
        *,
        with_bounds: bool = True,
    ) -> None:
        na, m = len(efforts.names), len(constraints.rows)
        names = [*(f"{name}.effort" for name in efforts.names)]
        names += [row.name for row in constraints.rows]
        order = np.concatenate((np.zeros(na), np.where(is_drive, 1, 2)))
        self.place = np.argsort(order, kind="stable")
        self.efforts = na + int(is_drive.sum())
        self.labels = tuple(names[i] for i in self.place)
        self.weight = np.concatenate((efforts.weight, np.ones(m)))[self.place]
        self.target = np.concatenate((efforts.target, np.zeros(m)))[self.place]
        self._lower = efforts.lower, constraints.lower  # the latter change with the state
        self._upper = efforts.upper, constraints.upper
        self._bounded = slice(None if with_bounds else self.efforts, None)
        found = np.argsort(self.place)[na:]
        slots = [found[cone.slots] for cone in constraints.cones]
        self._cones = np.array(slots, dtype=np.intp).reshape(-1, 3)
        self._mu = np.array([cone.mu for cone in constraints.cones])

    def limits(self, asked: Mask) -> Limits:
        """Bounds and cones of the y of those that are asked for, as the rows are limited now."""
        n, mine = len(self.place), self._bounded
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
        for ends, of in ((lower, self._lower), (upper, self._upper)):
            whole = self.weight * (np.concatenate(of)[self.place] - self.target)
            ends[mine] = whole[mine]
        stands = asked[self._cones[:, 0]] if len(self._cones) else np.zeros(0, np.bool_)
        at = np.cumsum(asked) - 1
        cones = at[self._cones[stands]].reshape(-1, 3)
        return Limits(lower[asked], upper[asked], cones, self._mu[stands])

    @property
    def of_contacts(self) -> Mask:
        """Which are forces of contacts, shape (n,)."""
        are = np.zeros(len(self.place), np.bool_)
        are[self._cones.ravel()] = True
        return are

    def wished(self, asked: Mask, wish: Wish) -> Wish:
        """A wish of the forces of all contacts as one of those that are asked for."""
        S = np.zeros((len(wish.S), len(self.place)))
        S[:, self._cones.ravel()] = wish.S
        return Wish(S[:, asked], wish.target)

    def filled(self, known: Array, asked: Mask, y: Array) -> Array:
        """Efforts, then multipliers, shape (na + m,).

        Args:
            known: Those that are not asked for, 0 elsewhere, shape (na + m,).
            asked: Which unknowns y has, shape (n,).
        """
        forces = known.copy()
        forces[self.place[asked]] = self.target[asked] + y / self.weight[asked]
        return forces

    def basis(self, asked: Mask, null: Array) -> Array:
        """Directions of y as those of efforts, then multipliers, shape (na + m, k)."""
        directions = np.zeros((len(self.place), null.shape[1]))
        directions[self.place[asked]] = null / self.weight[asked, None]
        return directions

    def named(self, asked: Mask, chosen: Mask) -> tuple[str, ...]:
        """Labels of some of those that are asked for, which `chosen` has one entry for."""
        return tuple(self.labels[i] for i in asked.nonzero()[0][chosen])


def unreachable(
    labels: Sequence[str], joints: Sequence[str], share: float, at_toggle: bool
) -> str:
    """Message for a motion that efforts cannot produce.

    Args:
        labels: `<effort>.effort` of all.
        joints: Those that move in what is left.
        share: Of the forces at work that is left.
        at_toggle: Whether the mechanism is at a toggle.
    """
    by = ", ".join(label.rpartition(".")[0] for label in labels) or "none"
    toggle = "; the mechanism is at a toggle" if at_toggle else ""
    return (
        f"the actuators ({by}) cannot produce this motion: {share:.2g} of the forces at work are "
        f"without an actuator, along {', '.join(joints)}; these need an actuator, or the motion "
        f"better derivatives{toggle}"
    )


def movers(robot: Robot, directions: Array, M: Array) -> tuple[str, ...]:
    """Joints that carry most of some motions by kinetic energy, equal ones in the robot's order.

    Args:
        directions: Motions, one a column, shape (nv, k).
        M: Mass matrix, shape (nv, nv).
    """
    names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
    share: Any = np.sqrt(M.diagonal()) * np.linalg.norm(directions, axis=1)
    share = np.round(share / max(share.max(), TINY), _DIGITS)
    order = np.argsort(-share, kind="stable")
    chosen = [int(i) for i in order if share[i] > _NAMED * share.max() > 0.0]
    return tuple(dict.fromkeys(names[i] for i in chosen))[:_SHOWN]


class Reach(NamedTuple):
    """The reach of the actuators at a state.

    Attributes:
        freedom: Motions that the rows allow.
        driven: How many of them the efforts reach.
        undriven: Joints that move in the others.
        null_space: As in `Torques`.
        undetermined: As in `Torques`.
    """

    freedom: int
    driven: int
    undriven: tuple[str, ...]
    null_space: int
    undetermined: tuple[str, ...]


def listed(names: Sequence[str]) -> str:
    """Names for a message, the first ones of many."""
    rest = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {rest} more" if rest > 0 else "")
