"""Cases that several tests share: compiled events."""

import numpy as np

from mbd_ros.compiled.runs.compiled_method import CompiledMethod
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.parts.stabilization.projection import Projection

ROBOTS = "package://mbd_ros/config/robots/"


def simulations(scene, method, dt):
    """The compiled one and the plain one."""
    fix = Projection()
    both = (CompiledMethod(method, fix), method)
    return [Simulation(scene.system(), each, fix, dt) for each in both]


def table(states):
    return np.array([np.concatenate(([x.t], *x[1:4])) for x in states])
