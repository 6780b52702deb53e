"""From places of markers to the motion of a robot: what is fitted, within which limits."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.points import Point
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.multiplier_laws import Level
from mbd_ros.core.projection.independent_limits import independent_limits
from mbd_ros.core.rows.constraint import Constraint
from mbd_ros.core.rows.row_layout import rigid
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.features.markers.loop_rows import LoopRows
from mbd_ros.features.markers.marker_cost import MarkerCost, Seen
from mbd_ros.features.markers.marker_fit import Bools, Fit, MarkerFit
from mbd_ros.features.markers.marker_trial import first_frame, fit_trial

_FARTHEST = 1.0e4  # m, of a place that a motion capture system can see
_NO_TASKS: Mapping[str, float] = {}


class Mark(NamedTuple):
    """A marker as marker kinematics takes it.

    Attributes:
        label: What recordings call it.
        point: Where it is on the robot.
        weight: Of its squared distance, > 0.
    """

    label: str
    point: Point
    weight: float


class MarkerKinematics:
    """Fits the coordinates of a robot to markers.

    Joints that the markers and tasks leave open keep the values of the start.

    Args:
        robot: The robot.
        couplings: Its dependent joints.
        marks: The markers.
        constraints: Of the scene; rigid ones of positions are kept, others have no say.
        tasks: Joint -> weight of the square of its distance from a position that is asked for.
        limits: Whether the position limits of joints are kept, dependent ones included.

    Attributes:
        marks: As given.
        labels: Of the markers.
        solver: Fits frames.
        tasks: As given.

    Raises:
        ModelError: No marker and no task, or a task for a joint that there is not.
    """

    def __init__(
        self,
        robot: Robot,
        couplings: Couplings,
        marks: Sequence[Mark],
        *,
        constraints: Sequence[Constraint] = (),
        tasks: Mapping[str, float] = _NO_TASKS,
        limits: bool = True,
    ) -> None:
        if not marks and not tasks:
            raise ModelError("marker kinematics needs a marker or a coordinate task")
        self.robot, self.marks, self.tasks = robot, tuple(marks), dict(tasks)
        self.labels = tuple(mark.label for mark in marks)
        self._weights = np.array([mark.weight for mark in marks])
        self._task_v = [robot.joint(name).v for name in tasks]
        weights = np.zeros(robot.model.nv)
        weights[self._task_v] = list(tasks.values())
        cost = MarkerCost(robot, couplings, [mark.point for mark in marks], weights)
        none = np.full(len(couplings.v_index), np.inf)
        lower, upper = independent_limits(robot, couplings) if limits else (-none, none)
        held = [part for part in rigid(constraints) if part.level is Level.POSITION]
        loops = LoopRows(robot, held, cost) if held else None
        self.solver = MarkerFit(cost, lower, upper, loops)

    def seen(
        self, places: Array, times: Array, targets: Mapping[str, Array] | None = None
    ) -> Seen:
        """What was seen, as the solver takes it.

        Args:
            places: Markers in the world [m], in the order of `marks`, NaN where one was not seen,
                shape (N, n, 3); what is more than 10 km away was not seen either.
            times: [s], shape (N,).
            targets: Joint of a task -> positions that it asks for [rad or m], shape (N,); 0
                where a task has none.
        """
        is_seen: Bools = np.array((np.abs(places) < _FARTHEST).all(axis=2))
        weights = np.where(is_seen, self._weights, 0.0)
        total = weights.sum(axis=1, keepdims=True)
        weights = weights / np.where(total > 0.0, total, 1.0)
        where = np.where(is_seen[:, :, None], places - self.robot.origin, 0.0)
        asked = np.zeros((len(times), self.robot.model.nv))
        for name, v in zip(self.tasks, self._task_v, strict=True):
            asked[:, v] = (targets or {}).get(name, 0.0)
        return Seen(where, weights, asked, times)

    def trial(self, start: Array, seen: Seen) -> Fit:
        """Fit all frames of a trial, see `marker_trial`.

        Args:
            start: Default configuration, shape (nq,).
            seen: What was seen.

        Raises:
            SolveError: Loops do not close near a start.
        """
        return fit_trial(self.solver, self.robot, start, seen)

    def first(self, start: Array, seen: Seen) -> Fit:
        """Fit one frame from several starts; arguments and errors as for `trial`."""
        return first_frame(self.solver, self.robot, start, seen)
