"""No stabilization: g'' = 0 and nothing else."""

from mbd_ros.core.projection.stabilizing import Stabilization


class NoStabilization(Stabilization):
    """Leaves the drift to the integrator: it grows with time, quadratically in position."""

    example: dict[str, float] = {}
