"""Kalman filter of a linear process."""

from mbd_ros.errors import ModelError
from mbd_ros.methods.estimation.kalman_filter import KalmanFilter
from mbd_ros.methods.estimation.process import LinearProcess


class Kalman(KalmanFilter):
    """Kalman filter: minimum-variance estimate of a linear process.

        x_k+1 = A x_k + B u_k + G w_k,   y_k = C x_k + n_k

    Source: R. E. Kalman, J. Basic Engineering 82 (1960).

    Raises:
        ModelError: The process is not linear.
    """

    example: dict[str, float] = {}

    def __init__(self, process: LinearProcess) -> None:
        if not isinstance(process, LinearProcess):
            raise ModelError(
                "kalman needs a LinearProcess; use extended_kalman for other processes"
            )
        super().__init__(process)
