"""Lengths of wrapped paths and their slopes, for n samples at once.

At contacts a path that is as short as possible may slide without getting longer, so that slopes
are those of straight lines between points that bodies hold: dl = sum e . (dx_end - dx_begin).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.paths.wrapping.arcs import Placed
from mbd_ros.core.paths.wrapping.routes import Reach, Route, Router
from mbd_ros.core.paths.wrapping.surface import cross, dot
from mbd_ros.core.state import Array


class Taut(NamedTuple):
    """A path of n samples, or of one without their axis.

    Attributes:
        length: [m], shape (n,).
        by_points: Change of the length with every point [-], shape (n, m, 3).
        by_wraps: With the place of every surface: with its origin [-] and with a turn about its
            origin [m], shape (n, wraps, 6).
    """

    length: Any
    by_points: Array
    by_wraps: Array


def taut(points: Array, reaches: Sequence[Reach], places: Sequence[Placed]) -> Taut:
    """The path through points and over surfaces.

    Args:
        points: In common axes [m], shape (n, m, 3).
        reaches: Its wraps.
        places: Where they are.

    Raises:
        SolveError: A geodesic is not found.
    """
    way = points[:, 1:] - points[:, :-1]
    lengths = np.sqrt((way * way).sum(axis=-1))
    e = way / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    by_begin, by_end = -e, e.copy()
    by_wraps = np.zeros((len(points), len(reaches), 6))
    if reaches:
        router = Router(points, reaches, places)
        for route in router.routes():
            for line, wraps in enumerate(route.held):
                if wraps:
                    found = _bent(router, route, line, places, by_wraps)
                    lengths[route.samples, line] = found[0]
                    by_begin[route.samples, line], by_end[route.samples, line] = found[1:]
    by_points = np.zeros(points.shape)
    by_points[:, :-1] = by_begin
    by_points[:, 1:] += by_end
    return Taut(lengths.sum(axis=-1), by_points, by_wraps)


def _bent(
    router: Router, route: Route, line: int, places: Sequence[Placed], by_wraps: Array
) -> tuple[Array, Array, Array]:
    """Length of a line over surfaces and its slopes at both points; adds those at surfaces."""
    samples, wraps = route.samples, route.held[line]
    arcs, corners = router.corners(route, line)
    length = sum(arc.length for arc in arcs)
    ends = []
    for i, (begin, end) in enumerate(zip(corners[::2], corners[1::2], strict=True)):
        way = end - begin
        distance = np.sqrt(dot(way, way))
        e = way / np.where(distance > 0.0, distance, 1.0)[:, None]
        length = length + distance
        ends.append(e)
        for j, corner, sign in ((i - 1, begin, -1.0), (i, end, 1.0)):
            if 0 <= j < len(wraps):
                w = wraps[j]
                arm = corner - places[w].origin[samples]
                by_wraps[samples, w] += sign * np.concatenate((e, cross(arm, e)), axis=-1)
    return np.asarray(length), -ends[0], ends[-1]
