"""Systems without rows, and their accelerations as values."""

import numpy as np

from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings


def free_system(robot, forces=(), actuators=()):
    """All joints of a robot, each on its own."""
    return build_system(robot, Couplings(robot), (), Loads(robot.model.nv, forces, actuators))


def acceleration(system, t, q, v, u=None):
    """What the steppers of a system see, as a new array."""
    a = np.empty(system.nv)
    system.accelerator()(t, q, v, u, a)
    return a
