"""Shortest paths between two points over surfaces in a row, by Newton's method.

A path is a chain of straight lines e_0, e_1, .. and geodesics between them. It is as short as
paths beside it where every line is tangent to what it ends on, in the direction of the geodesic:
at both ends of every geodesic e . n = 0 and e . b = 0. The unknowns of a geodesic are shifts of
its start along t and b, a turn about n and a change of length; they move its end by Jacobi fields.

Source: A. Scholz, M. Sherman, I. Stavness, S. Delp, A. Kecskeméthy, A fast multi-obstacle muscle
wrapping method using natural geodesic variations, Multibody Syst. Dyn. 36, 2016, 195.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.kinematics.paths.ellipsoid import Ellipsoid
from mbd_ros.core.kinematics.paths.wrap_surface import Arc, Flow, Mask, Numbers, Placed, Surface
from mbd_ros.core.kinematics.poses import cross, dot, unit
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

_STEPS = 30
_LEAST = 2.0**-8  # share of a step that is taken whatever it does
_TOLERANCE = 1.0e-13  # of the sine of the angle between lines and tangents
_REGULAR = 1.0e-12  # keeps slopes regular where a geodesic has no length
_LONGEST = 20.0  # arc, in sizes of its surface
_ROUNDING = 1.0e-10  # what is accepted where steps no longer make it smaller
_GROWTH_STEPS = 24  # from a sphere to an ellipsoid
_LONGER = 1.0e-9  # of the size of the surface: by how much a path must be longer than another


def shortest_path(
    a: Array, b: Array, over: Sequence[Placed], guess: tuple[Arc, ...]
) -> tuple[Arc, ...]:
    """Geodesics between two points, on the side that each surface asks for.

    Where Newton's method leads from the guess to none, or off the side that is asked for, the
    guess on the nearer side is tried, and at last an ellipsoid that grows from a sphere.

    Args:
        a: Begin in common axes [m], shape (n, 3).
        b: End [m], shape (n, 3).
        over: Surfaces in order.
        guess: Their geodesics, about.

    Raises:
        SolveError: A geodesic is not found.
    """
    arcs = newton_path(a, b, over, guess)
    for retry in (_plain, _grown):
        again = np.flatnonzero(_astray(a, b, over, (arcs, guess), retry is _plain))
        if again.size:
            there = [one.of(again) for one in over]
            before = tuple(arc.of(again) for arc in guess)
            _replace(arcs, again, retry(a[again], b[again], there, before))
    lost = int(np.isnan(arcs[0].length).sum())
    if lost:
        raise SolveError(f"no shortest path over the surface in {lost} of {len(a)} samples")
    return arcs


def _plain(a: Array, b: Array, over: Sequence[Placed], arcs: tuple[Arc, ...]) -> tuple[Arc, ...]:
    """From guesses on the nearer side, between what is on either side of a surface."""
    lasts = [touched.outwards(arc.end) for touched, arc in zip(over, arcs, strict=True)]
    firsts = [touched.outwards(arc.start) for touched, arc in zip(over, arcs, strict=True)]
    ends = zip(over, (a, *lasts[:-1]), (*firsts[1:], b), strict=True)
    starts = tuple(
        Arc.along(
            touched.surface,
            *touched.surface.plain(touched.inwards(begin), touched.inwards(end))[1:],
        )
        for touched, begin, end in ends
    )
    return newton_path(a, b, over, starts)


def _grown(a: Array, b: Array, over: Sequence[Placed], arcs: tuple[Arc, ...]) -> tuple[Arc, ...]:
    """From the great circle of a sphere that becomes the ellipsoid, ends stretched along."""
    if len(over) > 1 or not isinstance(over[0].surface, Ellipsoid):
        return tuple(Arc(*arc[:2], arc.length * np.nan, *arc[3:]) for arc in arcs)
    goal, n = over[0].surface, len(a)
    begin, end = (over[0].inwards(x) / goal.half_axes for x in (a, b))
    turn, origin = np.broadcast_to(np.eye(3), (n, 3, 3)), np.zeros((n, 3))
    size = float(np.prod(goal.half_axes)) ** (1.0 / 3.0)
    before = np.full(3, size)
    guess = Arc(*Ellipsoid(before.tolist()).plain(begin * size, end * size)[1:], begin, end)
    for share in np.linspace(1.0 / _GROWTH_STEPS, 1.0, _GROWTH_STEPS):
        axes = size * (goal.half_axes / size) ** share
        start, along = (value * (axes / before) for value in guess[:2])
        length = guess.length * np.sqrt(dot(along, along))
        place = Placed(Ellipsoid(axes.tolist()), turn, origin)
        stretched = Arc(start, unit(along), length, start, start)
        (guess,) = newton_path(begin * axes, end * axes, [place], [stretched])
        before = axes
    return (guess,)


def _astray(
    a: Array,
    b: Array,
    over: Sequence[Placed],
    solution: tuple[Sequence[Arc], Sequence[Arc]],
    checks_side: bool,
) -> Mask:
    """Samples without a path, off its side, or with a longer one than the guess, shape (n,)."""
    arcs, guess = solution
    away: Mask = np.isnan(arcs[0].length)
    for one, arc in zip(over, arcs, strict=True):
        if one.surface.sign and not one.surface.is_closed_form and checks_side:
            away |= ~one.surface.on_side(arc.middle)
    if len(over) == 1 and isinstance(over[0].surface, Ellipsoid) and not over[0].surface.sign:
        longer = _length(a, b, over[0], arcs[0]) - _length(a, b, over[0], guess[0])
        away |= longer > _LONGER * over[0].surface.size
    return away


def _length(a: Array, b: Array, place: Placed, arc: Arc) -> Array:
    """Whole length of a path over one surface [m], shape (n,)."""
    first, last = place.outwards(arc.start) - a, b - place.outwards(arc.end)
    return np.asarray(np.sqrt(dot(first, first)) + arc.length + np.sqrt(dot(last, last)))


def _replace(arcs: tuple[Arc, ...], again: Numbers, better: tuple[Arc, ...]) -> None:
    """Put what is found in place of what was."""
    found = np.isfinite(better[0].length)
    for to, arc in zip(arcs, better, strict=True):
        for whole, part in zip(to, arc, strict=True):
            whole[again[found]] = part[found]


def newton_path(
    a: Array, b: Array, over: Sequence[Placed], starts: Sequence[Arc]
) -> tuple[Arc, ...]:
    """The path from a to b over surfaces, beginning at a guess.

    Steps are halved until they make the conditions better, sample by sample.

    Args:
        a: Begin in common axes [m], shape (n, 3).
        b: End [m], shape (n, 3).
        over: Surfaces in order.
        starts: Guesses of their geodesics.

    Returns:
        The geodesics; their length is NaN where Newton's method does not get there.
    """
    path_arcs = [Arc(*(value.copy() for value in arc)) for arc in starts]
    left = np.arange(len(a))
    arcs, share = tuple(starts), np.ones(len(a))
    steps, best = np.zeros((len(a), 4 * len(over))), np.full(len(a), np.inf)
    for _ in range(_STEPS):
        tried = _stepped(over, arcs, steps * share[:, None])
        chain, errors = link(a, b, over, tried)
        worst = np.sqrt((errors * errors).sum(axis=-1))
        better = (worst < best) | (share <= _LEAST)
        stuck = ~better & (best < _ROUNDING)
        arcs = tuple(_either(better, *pair) for pair in zip(chain.arcs, arcs, strict=True))
        best, share = np.where(better, worst, best), np.where(better, 1.0, share / 2.0)
        regular = chain.slopes[better] + _REGULAR * np.eye(errors.shape[1])
        new = np.linalg.solve(regular, errors[better][..., None])[..., 0]
        steps[better] = -new
        done = (best < _TOLERANCE) | stuck
        if done.any():
            for to, arc in zip(path_arcs, arcs, strict=True):
                for whole, part in zip(to, arc, strict=True):
                    whole[left[done]] = part[done]
            if done.all():
                return tuple(path_arcs)
            on = ~done
            left, a, b, steps, best, share = (v[on] for v in (left, a, b, steps, best, share))
            over = [one.of(on) for one in over]
            arcs = tuple(arc.of(on) for arc in arcs)
    for arc in path_arcs:
        arc.length[left] = np.nan
    return tuple(path_arcs)


def _stepped(over: Sequence[Placed], arcs: Sequence[Arc], steps: Array) -> tuple[Arc, ...]:
    return tuple(
        _moved(one.surface, arc, steps[:, 4 * i : 4 * i + 4])
        for i, (one, arc) in enumerate(zip(over, arcs, strict=True))
    )


def _moved(surface: Surface, arc: Arc, step: Array) -> Arc:
    """A geodesic after a step of its unknowns, kept on the surface."""
    largest = np.maximum(np.abs(step[:, :2]).max(axis=-1), np.abs(step[:, 3])) / surface.size
    reach = np.maximum(np.maximum(largest, np.abs(step[:, 2])) / 0.5, 1.0)[:, None]
    along, aside, spin, longer = (step / reach).T
    t, n = arc.direction, surface.normal(arc.start)
    b = cross(t, n)
    start = surface.nearest(arc.start + along[:, None] * t + aside[:, None] * b)
    n, ahead = surface.normal(start), t + spin[:, None] * b
    ahead = unit(ahead - dot(ahead, n)[:, None] * n)
    longest = _LONGEST * surface.size
    length = np.clip(arc.length + longer, -longest, longest)
    return Arc(start, ahead, length, start, start)


def _either(first: Mask, a: Arc, b: Arc) -> Arc:
    if first.all():
        return a
    pairs = zip(a, b, strict=True)
    return Arc(*(np.where(first[:, None] if x.ndim > 1 else first, x, y) for x, y in pairs))


def link(a: Array, b: Array, over: Sequence[Placed], arcs: tuple[Arc, ...]) -> tuple[Chain, Array]:
    """The path with given geodesics, and what its conditions lack, shape (n, 4 m)."""
    flows = [one.surface.flow(*arc[:3]) for one, arc in zip(over, arcs, strict=True)]
    arcs = tuple(
        Arc(*arc[:3], flow.middle, flow.end) for arc, flow in zip(arcs, flows, strict=True)
    )
    ends = tuple(_ends(*each) for each in zip(over, arcs, flows, strict=True))
    begins = (a, *(last.point for _, last in ends))
    finishes = (*(first.point for first, _ in ends), b)
    lines = tuple(_line(p, q) for p, q in zip(begins, finishes, strict=True))
    size = 4 * len(over)
    errors, slopes = np.zeros((len(a), size)), np.zeros((len(a), size, size))
    for i, (first, last) in enumerate(ends):
        columns = slice(4 * i, 4 * i + 4)
        before, after = lines[i], lines[i + 1]
        for rows, contact, line, sign in (
            (slice(4 * i, 4 * i + 2), first, before, 1.0),
            (slice(4 * i + 2, 4 * i + 4), last, after, -1.0),
        ):
            errors[:, rows] = np.einsum("nfi,ni->nf", contact.frame, line.direction)
            flat = _flat(contact.frame, line)
            slopes[:, rows, columns] += sign * flat @ contact.moves
            slopes[:, rows, columns] += np.einsum("nfik,ni->nfk", contact.turns, line.direction)
            j = i - 1 if sign > 0.0 else i + 1
            if 0 <= j < len(over):
                other = ends[j][1] if sign > 0.0 else ends[j][0]
                slopes[:, rows, 4 * j : 4 * j + 4] -= sign * flat @ other.moves
    length = sum(line.length for line in lines) + sum(arc.length for arc in arcs)
    return Chain(np.asarray(length), lines, arcs, ends, slopes), errors


class Chain(NamedTuple):
    """A path between two points.

    Attributes:
        length: Whole length [m], shape (n,).
        lines: Straight lines, one more than arcs.
        ends: Both ends of every geodesic.
        slopes: Change of the conditions with the unknowns, shape (n, 4 m, 4 m).
    """

    length: Array
    lines: tuple[Line, ...]
    arcs: tuple[Arc, ...]
    ends: tuple[tuple[Contact, Contact], ...]
    slopes: Array


class Line(NamedTuple):
    """A straight line: its unit direction, shape (n, 3), and its length [m], shape (n,)."""

    direction: Array
    length: Array


class Contact(NamedTuple):
    """One end of a geodesic, in common axes, and how it changes with the unknowns.

    Attributes:
        point: [m], shape (n, 3).
        frame: Normal and binormal, shape (n, 2, 3).
        moves: Change of the point with shift along t, shift along b, turn and length, (n, 3, 4).
        turns: Change of normal and binormal with them, shape (n, 2, 3, 4).
    """

    point: Array
    frame: Array
    moves: Array
    turns: Array


def _ends(placed: Placed, arc: Arc, flow: Flow) -> tuple[Contact, Contact]:
    surface, turn, count = placed.surface, placed.rotation, len(arc.length)
    begin, finish = np.zeros((2, 3, count, 4))  # along t, along b, about n, with the unknowns
    begin[(0, 1, 2), :, (0, 1, 2)] = 1.0
    finish[0, :, (0, 3)] = 1.0
    for row in (0, 1):
        finish[row + 1, :, 1], finish[row + 1, :, 2] = flow.shifted[:, row], flow.turned[:, row]
    first = _contact(surface, arc.start, arc.direction, *begin)
    last = _contact(surface, flow.end, flow.direction, *finish)
    return _outwards(first, turn, placed.origin), _outwards(last, turn, placed.origin)


def _contact(
    surface: Surface, point: Array, t: Array, along: Array, aside: Array, spin: Array
) -> Contact:
    """A point of a geodesic, in the axes of the surface.

    Args:
        point: The point, shape (n, 3).
        t: Unit tangent, shape (n, 3).
        along: Shift along t with every unknown, shape (n, 4).
        aside: Shift along b, shape (n, 4).
        spin: Turn about n, shape (n, 4).
    """
    n = surface.normal(point)
    b = cross(t, n)
    by_t, by_b = surface.bend(point, t), surface.bend(point, b)
    moves = t[..., None] * along[:, None, :] + b[..., None] * aside[:, None, :]
    turn_n = by_t[..., None] * along[:, None, :] + by_b[..., None] * aside[:, None, :]
    turn_b = -n[..., None] * np.einsum("nik,ni->nk", turn_n, b)[:, None, :]
    turn_b = turn_b - t[..., None] * spin[:, None, :]
    return Contact(point, np.stack((n, b), axis=1), moves, np.stack((turn_n, turn_b), axis=1))


def _outwards(contact: Contact, turn: Array, origin: Array) -> Contact:
    """A contact in common axes."""
    return Contact(
        np.einsum("nij,nj->ni", turn, contact.point) + origin,
        np.einsum("nij,nfj->nfi", turn, contact.frame),
        turn @ contact.moves,
        turn[:, None] @ contact.turns,
    )


def _line(begin: Array, end: Array) -> Line:
    way = end - begin
    length = np.maximum(np.sqrt(dot(way, way)), 1.0e-300)
    return Line(way / length[:, None], length)


def _flat(frame: Array, line: Line) -> Array:
    """Normal and binormal times de for a change of the end of a line, shape (n, 2, 3)."""
    along = np.einsum("nfi,ni->nf", frame, line.direction)
    return np.asarray(
        (frame - along[..., None] * line.direction[:, None, :]) / line.length[:, None, None]
    )
