"""What contacts that a phase holds leave to the efforts of a motion."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from mbd_ros.core.events.crossings import Crossing
from mbd_ros.core.state import Array, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.features.regulator.contact_margins import held_room
from mbd_ros.scene.built_scene import Scene

_STEP = 1.0e-4  # of the largest effort: forces are straight lines of efforts, cones have an apex
_SHARE = 0.05  # of the room: several inputs act at once, and positions are off besides


def crossings_of(scene: Scene) -> tuple[Crossing, ...]:
    """Numbers of the forces of held contacts, positive while they push and stick."""
    if not scene.phases:
        return ()
    return tuple(one.crossing for one in scene.phased_system().phases[0].demands)


def tolerated_efforts(
    system: Any, crossings: Sequence[Crossing], states: Sequence[State], u: Array
) -> Array:
    """Deviations of each effort that use up a small share of the room, shape (k,); inf without.

    Args:
        system: Of the phase.
        crossings: Of its contacts.
        states: Of what it integrates.
        u: Efforts, shape (n, k).
    """
    found = np.full(u.shape[1], np.inf)
    step = _STEP * (float(np.abs(u).max()) or 1.0)
    for y, now in zip(states, u, strict=True) if crossings else ():
        room = np.maximum(held_room(system, crossings, y, now), 0.0)
        for i, way in enumerate(step * np.eye(len(found))):
            sides = [held_room(system, crossings, y, now + sign * way) for sign in (1.0, -1.0)]
            slopes = np.max([np.abs(one - room) for one in sides], axis=0) / step
            found[i] = min(found[i], _SHARE * float((room / np.maximum(slopes, TINY)).min()))
    return found
