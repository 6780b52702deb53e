"""Checks of an initial state: within stops and limits, radians rather than degrees."""

import math
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint import Constraint, Kind
from mbd_ros.core.state import Array, State

if TYPE_CHECKING:
    from mbd_ros.core.muscles.muscle import Muscle

_SLACK = 1.0e-6  # rad or m beyond an end that is rounding


def fiber_warnings(robot: Robot, muscles: "Sequence[Muscle]", x: State, u: Array) -> Iterator[str]:
    """Warnings of muscles whose fibres may start at several lengths, in equilibrium at each.

    Args:
        muscles: Muscles of the scene.
        x: State of all joints, z NaN where nothing is given.
        u: All inputs at the start.
    """
    k = Kinematics(robot)
    if muscles:
        k.refresh(x.q, x.v, max(part.reads for part in muscles))
    for part in muscles:
        if lengths := part.choices_at_rest(k, x, u):
            several = ", ".join(f"{length:.6g}" for length in lengths)
            yield (
                f"{part.name}: its fibres rest at {several} m, on either side of their descending "
                f"limb; they start at the first: give initial.internal.{part.name}.fiber_length"
            )


def start_warnings(robot: Robot, constraints: Sequence[Constraint], x: State) -> Iterator[str]:
    """Warnings of an initial state beyond stops, or beyond the limits of the description.

    Args:
        constraints: Constraints of the scene.
        x: State of all joints.
    """
    stops = [part for part in constraints if _is_stop(part)]
    if stops:
        yield from _beyond_stops(robot, stops, x._replace(v=np.zeros_like(x.v)))
    for joint in robot.joints:
        value = float(x.q[joint.q])
        if not joint.lower - _SLACK <= value <= joint.upper + _SLACK:
            unit = joint.position_unit
            doubt = "; radians?" if unit == "rad" and abs(value) > math.pi else ""
            limits = f"{joint.lower:g} .. {joint.upper:g}"
            yield f"{joint.name} starts at {value:g} {unit}, outside its limits {limits}{doubt}"


def _beyond_stops(robot: Robot, stops: Sequence[Any], at_rest: State) -> Iterator[str]:
    k = Kinematics(robot)
    k.refresh(at_rest.q, at_rest.v, max(part.reads for part in stops))
    for part in stops:
        for name, gap in zip(part.joints, part.residual(k, at_rest), strict=True):
            if gap < -_SLACK:
                unit = robot.joint(name).position_unit
                yield f"{name} starts {-gap:.3g} {unit} beyond its {type(part).__name__}"


def _is_stop(part: Any) -> bool:
    """Whether every row of a constraint keeps one joint from an end of its range."""
    return part.law.kind is Kind.UNILATERAL and len(getattr(part, "joints", ())) == len(part.rows)
