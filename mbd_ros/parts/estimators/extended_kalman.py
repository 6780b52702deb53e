"""Extended Kalman filter."""

from typing import Annotated

from mbd_ros.core.ranges import Unit, Within
from mbd_ros.methods.estimation.kalman_filter import KalmanFilter
from mbd_ros.methods.estimation.process import Process


class ExtendedKalman(KalmanFilter):
    """Extended Kalman filter: a `KalmanFilter` that linearises the mechanism at every sample.

    Args:
        iterations: Number of linearisations per measurement.
    """

    example = {"iterations": 1}

    def __init__(
        self, process: Process, *, iterations: Annotated[int, Within(1, 20), Unit("-")] = 1
    ) -> None:
        super().__init__(process, iterations)
