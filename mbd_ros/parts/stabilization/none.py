"""No stabilization: g'' = 0 and nothing else."""

from mbd_ros.methods.projection.assembly import Stabilization


class NoStabilization(Stabilization):
    """Leaves violations to the integrator: they grow with time, quadratically in position."""

    example: dict[str, float] = {}
