"""Joints on an ellipsoid as chains of turns and slides that follow three coordinates."""

import math
from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from mbd_ros.core.state import Array
from mbd_ros.scene.models.functions import IDENTITY, Function, linear, sine
from mbd_ros.scene.models.motions import Motion, Step, X, Y, Z
from mbd_ros.scene.models.osim.motions import Joint

_RIGHT = math.pi / 2.0


def on_ellipsoid(joint: Joint) -> list[Step]:
    """The steps of an EllipsoidJoint."""
    return _steps(joint, joint.item.vector("radii_x_y_z", default=None))


def on_thorax(joint: Joint) -> list[Step]:
    """The steps of a ScapulothoracicJoint: an ellipsoid, then a turn about the axis of winging.

    The axes of the ellipsoid are turned by 90 degrees about z, and turned back behind it.

    Source: A. Seth, R. Matias, A. P. Veloso, S. L. Delp, PLoS ONE 11, 2016, e0141028; signs and
        order as OpenSim 4.6 has them.
    """
    item = joint.item
    x, y, z = item.vector("thoracic_ellipsoid_radii_x_y_z", default=None)
    across, up = item.vector("scapula_winging_axis_origin", default=(0.0, 0.0), length=2)
    angle = item.number("scapula_winging_axis_direction", default=0.0)
    turned = pin.SE3(pin.AngleAxis(_RIGHT, Z).toRotationMatrix(), np.zeros(3))
    origin = pin.SE3(np.eye(3), np.array((across, up, 0.0)))
    axis = np.array((-math.sin(angle), math.cos(angle), 0.0))
    winging = Motion(f"{joint.name}_r6", axis, True, IDENTITY, joint.coordinates[3].name)
    steps = _steps(joint, (y, x, z))
    return [turned, *steps, turned.inverse(), origin, winging, origin.inverse()]


def _steps(joint: Joint, radii: Sequence[float]) -> list[Step]:
    """Turns x, y, z at the point of an ellipsoid whose normal is the z axis that they give.

    That point is (a sin q1, -b sin q0 cos q1, c cos q0 cos q1) with the radii a, b and c. A slide
    along z between turns about x by q0, and one between turns by -q0, add up to any b and c.
    """
    a, b, c = radii
    q0, q1, q2 = (one.name for one in joint.coordinates[:3])
    mean, half = (b + c) / 2.0, (c - b) / 2.0

    def step(ending: str, axis: Array, turns: bool, function: Function, name: str) -> Motion:
        moves = function.constant is None
        return Motion(f"{joint.name}_{ending}", axis, turns, function, name if moves else "")

    middle = [
        step("r2", X, True, linear(-2.0), q0),
        step("tz2", Z, False, sine(half, phase=_RIGHT), q1),
        step("r3", X, True, linear(2.0), q0),
    ]
    return [
        step("tx", X, False, sine(a), q1),
        step("r1", X, True, IDENTITY, q0),
        step("tz", Z, False, sine(mean, phase=_RIGHT), q1),
        *(middle if half else ()),
        step("r4", Y, True, IDENTITY, q1),
        step("r5", Z, True, IDENTITY, q2),
    ]
