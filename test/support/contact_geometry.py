"""Where bodies touch, by their shapes alone: it shares no line with the package.

A touch is a gap [m], a point on b and a normal out of b. Slots, names and frames play no part.
"""

import itertools
from typing import NamedTuple

import numpy as np

CORNERS = np.array(list(itertools.product((-0.5, 0.5), repeat=3)))
EDGES = [(i, j) for i, j in itertools.combinations(range(8), 2) if (i ^ j) in (1, 2, 4)]
ROUND = 16  # points of a rim


class Touch(NamedTuple):
    gap: float
    point: np.ndarray
    normal: np.ndarray


class Placed(NamedTuple):
    """A shape in the world: its kind, its sizes, axes (3, 3) and origin (3,)."""

    kind: str
    size: object
    R: np.ndarray
    p: np.ndarray


def turned(rpy):
    """Rotation of fixed axes x, y, z by three angles."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(rpy), np.sin(rpy)
    x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return z @ y @ x


def balls(shape):
    """Centres in the world and radius of shapes that are the hull of balls."""
    if shape.kind == "sphere":
        return shape.p[None], shape.size
    if shape.kind == "points":
        return shape.p + np.array(shape.size) @ shape.R.T, 0.0
    if shape.kind == "box":
        return shape.p + (CORNERS * shape.size) @ shape.R.T, 0.0
    half = 0.5 * shape.size["length"] * shape.R[:, 2]
    return np.array((shape.p - half, shape.p + half)), shape.size["radius"]


def touches(a, b):
    """All places where a may touch b, far ones too."""
    if b.kind == "half_space":
        return _on_plane(a, b)
    if "box" == a.kind == b.kind:
        return _boxes(a, b)
    if a.kind == "capsule":
        return _along(a, b)
    centres, radius = balls(a)
    return [_ball(centre, radius, b) for centre in centres]


def _on_plane(a, b):
    n = b.R @ (np.array(b.size) / np.linalg.norm(b.size))
    if a.kind == "cylinder":
        centres, radius = _rims(a, n), 0.0
    else:
        centres, radius = balls(a)
    heights = (centres - b.p) @ n
    return [Touch(h - radius, c - h * n, n) for h, c in zip(heights, centres, strict=True)]


def _rims(a, n):
    """Lowest points of both rims over a plane, and points around them."""
    radius, z = a.size["radius"], a.R[:, 2]
    down = (n @ z) * z - n
    ways = [
        np.cos(t) * a.R[:, 0] + np.sin(t) * a.R[:, 1] for t in 2 * np.pi * np.arange(ROUND) / ROUND
    ]
    if np.linalg.norm(down) > 1e-9:
        ways.append(down / np.linalg.norm(down))
    half = 0.5 * a.size["length"] * z
    return np.array([a.p + side * half + radius * way for side in (-1, 1) for way in ways])


def _ball(centre, radius, b):
    """A ball and another round shape, a box or a cylinder."""
    near, out, inside = _nearest(centre, b)
    grown = b.size if b.kind == "sphere" else b.size["radius"] if b.kind == "capsule" else 0.0
    gap = (-inside if inside > 0 else np.linalg.norm(centre - near)) - radius - grown
    return Touch(gap, near + grown * out, out)


def _nearest(c, b):
    """Nearest point of a core of b, direction out of it, depth of c inside."""
    d = b.R.T @ (c - b.p)
    if b.kind == "box":
        half = 0.5 * np.array(b.size)
        near = np.clip(d, -half, half)
        if np.all(np.abs(d) < half):
            axis = int(np.argmin(half - np.abs(d)))
            out = np.sign(d[axis] or 1.0) * np.eye(3)[axis]
            return (
                b.p + b.R @ np.where(np.eye(3)[axis] > 0, out * half, d),
                b.R @ out,
                (half - np.abs(d))[axis],
            )
    elif b.kind == "cylinder":
        half, radius, r = 0.5 * b.size["length"], b.size["radius"], np.hypot(*d[:2])
        around = np.array((*(d[:2] / r if r > 0 else (1.0, 0.0)), 0.0))
        if r < radius and abs(d[2]) < half:
            if radius - r < half - abs(d[2]):
                return b.p + b.R @ (radius * around + (0, 0, d[2])), b.R @ around, radius - r
            up = np.array((0.0, 0.0, np.sign(d[2]) or 1.0))
            return b.p + b.R @ (d * (1, 1, 0) + half * up), b.R @ up, half - abs(d[2])
        near = min(r, radius) * around + (0.0, 0.0, np.clip(d[2], -half, half))
    elif b.kind == "capsule":
        half = 0.5 * b.size["length"]
        near = np.array((0.0, 0.0, np.clip(d[2], -half, half)))
    else:
        near = np.zeros(3)
    away = d - near
    length = np.linalg.norm(away)
    return (
        b.p + b.R @ near,
        b.R @ (away / length if length > 0 else np.array((0.0, 0.0, 1.0))),
        0.0,
    )


def _along(a, b):
    """A capsule: both ends, and the place of its line that is nearest to b."""
    (one, other), radius = balls(a)
    low, high = 0.0, 1.0
    for _ in range(80):  # the distance from a convex body is convex along a line
        third = (high - low) / 3.0
        gaps = [_ball(one + s * (other - one), radius, b).gap for s in (low + third, high - third)]
        low, high = (low, high - third) if gaps[0] < gaps[1] else (low + third, high)
    return [_ball(one + s * (other - one), radius, b) for s in (0.0, 0.5 * (low + high), 1.0)]


def _boxes(a, b):
    """Two boxes: the axis that separates them most, corners and crossings of edges."""
    ha, hb = 0.5 * np.array(a.size), 0.5 * np.array(b.size)
    way = a.p - b.p
    best, n = -np.inf, None
    faces = [*a.R.T, *b.R.T]
    crossed = [np.cross(i, j) for i in a.R.T for j in b.R.T]
    for axis in [*faces, *(c / np.linalg.norm(c) for c in crossed if np.linalg.norm(c) > 1e-6)]:
        reach = np.abs(axis @ a.R) @ ha + np.abs(axis @ b.R) @ hb
        gap = abs(way @ axis) - reach
        if gap > best + 1e-9 * reach:
            best, n = gap, axis * (1.0 if way @ axis >= 0 else -1.0)
    return [Touch(best, p, n) for p in _crossings(a, b, n)]


def _crossings(a, b, n):
    """Places on b where two boxes may press on one another along a normal."""
    corners = [s.p + (CORNERS * s.size) @ s.R.T for s in (a, b)]
    top = (corners[1] @ n).max()
    size = max(np.max(a.size), np.max(b.size))
    low = corners[0][corners[0] @ n <= (corners[0] @ n).min() + 1e-3 * size]
    high = corners[1][corners[1] @ n >= top - 1e-3 * size]
    found = [p + (top - p @ n) * n for p in low if _is_over(p, b, n, size)]
    found += [p for p in high if _is_over(p, a, n, size)]
    for (i, j), (k, m) in itertools.product(EDGES, EDGES):
        one, two = corners[0][[i, j]], corners[1][[k, m]]
        if not (_is_among(one, low) and _is_among(two, high)):
            continue
        d, e, w = one[1] - one[0], two[1] - two[0], one[0] - two[0]
        d, e, w = (each - (each @ n) * n for each in (d, e, w))
        A = np.array([[d @ d, -d @ e], [-d @ e, e @ e]])
        if np.linalg.det(A) > 1e-12 * d @ d * (e @ e):
            s, t = np.linalg.solve(A, (-d @ w, e @ w))
            if -1e-6 <= s <= 1 + 1e-6 and -1e-6 <= t <= 1 + 1e-6:
                found.append(two[0] + t * (two[1] - two[0]))
    return found


def _is_among(ends, some):
    return all(np.any(np.all(np.abs(some - end) < 1e-12, axis=1)) for end in ends)


def _is_over(p, box, n, size):
    """Whether a corner meets the other box along the normal."""
    d, e, half = box.R.T @ (p - box.p), box.R.T @ n, 0.5 * np.array(box.size)
    low, high = -np.inf, np.inf
    for x, way, end in zip(d, e, half + 1e-6 * size, strict=True):
        if abs(way) < 1e-9:
            if abs(x) > end:
                return False
        else:
            one, other = sorted(((-end - x) / way, (end - x) / way))
            low, high = max(low, one), min(high, other)
    return low <= high
