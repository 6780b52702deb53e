"""Mass, mass centre and moments -> geometry_msgs/InertiaStamped."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from msg_adapters.errors import require_finite
from msg_adapters.time import write_time


def write_inertia(
    msg: Any,
    stamp: int,
    frame_id: str,
    mass: float,
    centre: Sequence[float],
    moments: Sequence[float],
) -> Any:
    """Fill an InertiaStamped and return it.

    Args:
        stamp: Header stamp [ns].
        frame_id: Link in whose axes the numbers are.
        mass: [kg].
        centre: Mass centre [m], shape (3,).
        moments: About the mass centre: xx, xy, xz, yy, yz, zz [kg·m^2], shape (6,).

    Raises:
        MessageError: A number is NaN or infinite.
    """
    require_finite(inertia=np.array([mass, *centre, *moments]))
    write_time(msg.header.stamp, stamp)
    msg.header.frame_id = frame_id
    inertia = msg.inertia
    inertia.m = float(mass)
    inertia.com.x, inertia.com.y, inertia.com.z = centre
    inertia.ixx, inertia.ixy, inertia.ixz = moments[:3]
    inertia.iyy, inertia.iyz, inertia.izz = moments[3:]
    return msg
