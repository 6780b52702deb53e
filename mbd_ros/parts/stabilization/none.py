"""Constraints without stabilization: g'' = 0."""

from mbd_ros.methods.projection.assembly import Stabilization


class NoStabilization(Stabilization):
    """No stabilization: violations grow with time, those of positions quadratically."""

    example: dict[str, float] = {}
