"""A plan that stands still, for control laws that follow one."""

import numpy as np

from mbd_ros.methods.control.tracking_plan import TrackingPlan


def standing(names):
    """Of joints that are all driven; its gains and costs are not 0."""
    n, still = len(names), np.zeros((2, len(names)))
    gain, cost = np.ones((2, n, 2 * n)), np.stack([np.eye(2 * n)] * 2)
    plan = np.array([0.0, 1.0]), still, still, still, gain, cost
    return TrackingPlan(tuple(names), tuple(names), *plan)
