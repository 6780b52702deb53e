"""How contacts move and slide while the conditions of a shortest path stay met."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.points import Point
from mbd_ros.core.paths.wrapping.arcs import Placed
from mbd_ros.core.paths.wrapping.chain import Chain
from mbd_ros.core.state import Array


class SurfaceMotion(NamedTuple):
    """Velocity and acceleration of a body about a point: those of p are first + second (p)."""

    linear: tuple[Array, Array]
    turning: tuple[Array, Array]


def surface_motion(k: Kinematics, origin: Point, ends: Sequence[Point]) -> SurfaceMotion:
    """How a surface moves at zero joint acceleration, from its origin and ends of its axes."""
    v, a = k.velocity(origin), k.acceleration(origin)
    rates = np.array([k.velocity(axis) - v for axis in ends]).T
    bends = np.array([k.acceleration(axis) - a for axis in ends]).T
    return SurfaceMotion((v, a), (rates, bends))


def contact_rates(
    chain: Chain,
    places: Sequence[Placed],
    motions: Sequence[SurfaceMotion],
    speeds: tuple[Array, Array],
) -> list[tuple[Array, Array, Array]]:
    """Of every contact: velocity and its rate for what the body holds there, and its sliding."""
    if not places:
        return []
    held, turned = [speeds[0]], []
    for place, motion, ends in zip(places, motions, chain.ends, strict=True):
        rotation = place.rotation[0]
        for contact in ends:
            held.append(motion.linear[0] + motion.turning[0] @ place.inwards(contact.point)[0])
            turned.append(contact.frame[0] @ (rotation @ motion.turning[0].T))
    held.append(speeds[1])
    rates = []
    for i, contact in enumerate(contact for ends in chain.ends for contact in ends):
        straight = chain.lines[(i + 1) // 2]
        e, (a, b) = straight.direction[0], (2 * ((i + 1) // 2), 2 * ((i + 1) // 2) + 1)
        past = held[b] - held[a]
        turn = (past - e * (e @ past)) / straight.length[0]
        rates.append(contact.frame[0] @ turn + turned[i] @ e)
    unknowns = -np.linalg.solve(chain.slopes[0], np.concatenate(rates))
    contacts = []
    for i, contact in enumerate(contact for ends in chain.ends for contact in ends):
        place, motion = places[i // 2], motions[i // 2]
        slide = contact.moves[0] @ unknowns[4 * (i // 2) : 4 * (i // 2) + 4]
        inside = place.rotation[0].T @ slide
        push = motion.linear[1] + motion.turning[1] @ place.inwards(contact.point)[0]
        contacts.append((held[i + 1], push + motion.turning[0] @ inside, slide))
    return contacts
