"""Unknown efforts and multipliers of inverse dynamics: order, bounds and cost."""

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
from mbd_ros.methods.inverse_dynamics.force_split import ForceTarget

Columns = Callable[[Kinematics, State], Array]
_DOMINANT = 0.3  # least share of a named joint in a motion, relative to the largest share
_MAX_JOINTS = 4  # in a message
_DIGITS = 9  # shares that agree to so many digits differ by rounding
_MAX_NAMES = 12  # in a message
Mask = NDArray[np.bool_]


class Efforts(NamedTuple):
    """Inputs u that exert the generalized force B u + b0.

    Where a motion does not determine them, the inputs with the least sum of
    (weight (u - target))^2 are chosen.

    Attributes:
        names: Name of each input; for efforts of joints, that of the joint.
        columns: Function that returns B at a state, shape (nv, n).
        lower: Lower bounds, -inf where there is none, shape (n,).
        upper: Upper bounds, inf where there is none, shape (n,).
        weight: Weight of each input in the cost [1 per unit of u], > 0, shape (n,).
        target: Value of each input at which its cost is 0, shape (n,).
        reads: Level of kinematics that `columns` and `offset` read.
        offset: Function that returns b0, the force at u = 0, shape (nv,); None if that is zero.
    """

    names: tuple[str, ...]
    columns: Columns
    lower: Array
    upper: Array
    weight: Array
    target: Array
    reads: Reads = Reads.NOTHING
    offset: Columns | None = None


def joint_efforts(
    robot: Robot, joints: Sequence[str], limits: Sequence[float] | None = None
) -> Efforts:
    """Return one effort [N·m or N] for each joint, with unit weights in the cost.

    Args:
        joints: Names of the actuated joints, each at most once.
        limits: Largest effort of each joint [N·m or N], > 0; None for unbounded efforts.

    Raises:
        ModelError: Unknown or repeated joint, or a limit that is not positive.
    """
    names, n = tuple(joints), len(joints)
    if len(set(names)) < n:
        raise ModelError(f"actuated joints must differ, but are {', '.join(names)}")
    B = np.zeros((int(robot.model.nv), n))
    B[[robot.joint(name).v for name in names], range(n)] = 1.0
    upper = np.full(n, np.inf) if limits is None else np.array(limits, dtype=np.float64)
    if upper.shape != (n,) or not (upper > 0.0).all():
        raise ModelError(
            f"effort limits must be {n} numbers > 0, one a joint, but are {upper.tolist()}"
        )
    return Efforts(names, lambda k, x: B, -upper, upper, np.ones(n), np.zeros(n))


def input_efforts(robot: Robot, loads: Sequence[Load]) -> Efforts:
    """Return the inputs of loads whose force is affine in them, bounded as their channels are.

    Args:
        loads: Actuators and other loads with inputs. They must not appear again among the force
            terms of the problem.

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
            raise ModelError(
                f"{name} has internal states, which inverse dynamics cannot find from a motion"
            )
        if part.columns(k, neutral) is None:
            raise ModelError(
                f"the force of {name} is not affine in its inputs, as inverse dynamics needs it"
            )
    idle, n = np.zeros(len(inputs.names)), len(inputs.names)

    def columns(k: Kinematics, x: State) -> Array:
        none = np.zeros((len(x.v), 0))
        return np.concatenate([none, *(part.columns(k, x) for part in affine)], axis=1)

    def offset(k: Kinematics, x: State) -> Array:
        return np.sum([np.zeros(len(x.v)), *(part.force(k, x, idle) for part in affine)], axis=0)

    lower = np.array([channel.lower for channel in inputs.channels], dtype=np.float64)
    upper = np.array([channel.upper for channel in inputs.channels], dtype=np.float64)
    return Efforts(inputs.names, columns, lower, upper, np.ones(n), np.zeros(n), reads, offset)


class Unknowns:
    """Order of the unknowns: inputs, multipliers of drives, then multipliers of all other rows.

    A solver works with the scaled unknowns y = weight (value - target), whose norm is the cost.
    Methods take a mask, shape (n,): which of the unknowns y contains.

    Args:
        efforts: The unknown inputs.
        is_drive: Which rows are drives, shape (m,).
        with_bounds: Whether efforts and drives keep their bounds.

    Attributes:
        labels: `<effort>.effort` or the name of the row, shape (n,).
        place: Index of each among the inputs followed by the multipliers, shape (n,).
        efforts: Number of inputs and drives, which come first.
        weight: Weight of each in the cost, 1 for multipliers, shape (n,).
        target: Value of each at which its cost is 0; 0 for multipliers, shape (n,).
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
        index_of_row = np.argsort(self.place)[na:]
        slots = [index_of_row[cone.slots] for cone in constraints.cones]
        self._cones = np.array(slots, dtype=np.intp).reshape(-1, 3)
        self._mu = np.array([cone.mu for cone in constraints.cones])

    def limits(self, mask: Mask) -> Limits:
        """Return bounds and friction cones of y, with the present limits of the rows."""
        n, mine = len(self.place), self._bounded
        lower, upper = np.full(n, -np.inf), np.full(n, np.inf)
        for ends, of in ((lower, self._lower), (upper, self._upper)):
            scaled = self.weight * (np.concatenate(of)[self.place] - self.target)
            ends[mine] = scaled[mine]
        stands = mask[self._cones[:, 0]] if len(self._cones) else np.zeros(0, np.bool_)
        at = np.cumsum(mask) - 1
        cones = at[self._cones[stands]].reshape(-1, 3)
        return Limits(lower[mask], upper[mask], cones, self._mu[stands])

    @property
    def of_contacts(self) -> Mask:
        """Which unknowns are forces of contacts, shape (n,)."""
        are = np.zeros(len(self.place), np.bool_)
        are[self._cones.ravel()] = True
        return are

    def expand_target(self, mask: Mask, target: ForceTarget) -> ForceTarget:
        """Express a target for the forces of all contacts as one for y."""
        S = np.zeros((len(target.S), len(self.place)))
        S[:, self._cones.ravel()] = target.S
        return ForceTarget(S[:, mask], target.values)

    def fill(self, known: Array, mask: Mask, y: Array) -> Array:
        """Return all inputs, then all multipliers, shape (na + m,).

        Args:
            known: Values of those that y does not contain, 0 elsewhere, shape (na + m,).
            mask: Which unknowns y contains, shape (n,).
            y: Scaled unknowns, shape (mask.sum(),).
        """
        forces = known.copy()
        forces[self.place[mask]] = self.target[mask] + y / self.weight[mask]
        return forces

    def basis(self, mask: Mask, null: Array) -> Array:
        """Convert directions of y to directions of inputs and multipliers, shape (na + m, k)."""
        directions = np.zeros((len(self.place), null.shape[1]))
        directions[self.place[mask]] = null / self.weight[mask, None]
        return directions

    def select_labels(self, mask: Mask, chosen: Mask) -> tuple[str, ...]:
        """Return the labels of the entries of y that `chosen` selects."""
        return tuple(self.labels[i] for i in mask.nonzero()[0][chosen])


def unreachable_message(
    labels: Sequence[str], joints: Sequence[str], share: float, at_toggle: bool
) -> str:
    """Return the error message for a motion that the actuators cannot produce.

    Args:
        labels: `<effort>.effort` of all actuators.
        joints: Joints that the residual force accelerates most.
        share: Norm of the residual force relative to all forces of the motion.
        at_toggle: Whether the mechanism is at a toggle.
    """
    by = ", ".join(label.rpartition(".")[0] for label in labels) or "none"
    toggle = "; the mechanism is at a toggle" if at_toggle else ""
    return (
        f"the actuators ({by}) cannot produce this motion: a share of {share:.2g} of the forces "
        f"at work is left without an actuator, along {', '.join(joints)}; add an actuator there "
        f"or improve the derivatives of the motion{toggle}"
    )


def dominant_joints(robot: Robot, directions: Array, M: Array) -> tuple[str, ...]:
    """Return the joints with the largest share in the kinetic energy of some motions.

    Joints with equal shares come in the order of the robot.

    Args:
        directions: Motions, one a column, shape (nv, k).
        M: Mass matrix, shape (nv, nv).
    """
    names = {joint.v: joint.name for joint in robot.joints} | robot.base_titles
    share: Any = np.sqrt(M.diagonal()) * np.linalg.norm(directions, axis=1)
    share = np.round(share / max(share.max(), TINY), _DIGITS)
    order = np.argsort(-share, kind="stable")
    chosen = [int(i) for i in order if share[i] > _DOMINANT * share.max() > 0.0]
    return tuple(dict.fromkeys(names[i] for i in chosen))[:_MAX_JOINTS]


class ActuationReach(NamedTuple):
    """Which motions of a mechanism its actuators can accelerate at a state.

    Attributes:
        freedom: Number of independent motions that the constraints allow.
        driven: Number of these that the efforts can accelerate.
        undriven: Joints that move most in the others.
        null_space: Dimension of the efforts and multipliers that together exert nothing.
        undetermined: `<joint>.effort` and names of rows that take part in it.
    """

    freedom: int
    driven: int
    undriven: tuple[str, ...]
    null_space: int
    undetermined: tuple[str, ...]


def join_names(names: Sequence[str]) -> str:
    """Join names for a message; a long list is cut after the first ones."""
    more = len(names) - _MAX_NAMES
    return ", ".join(names[:_MAX_NAMES]) + (f" and {more} more" if more > 0 else "")
