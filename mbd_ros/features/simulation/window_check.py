"""What `simulate` says of contacts that give way: the window of their stiffness, and depths."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.integration.contact_motion import pressed_motion
from mbd_ros.core.integration.linear_motion import is_bounded
from mbd_ros.core.integration.stiffness_window import longest
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError
from mbd_ros.scene.describe.window_lines import (
    depth_doubts,
    window_doubts,
    window_text,
    windows_at,
)

_LOOKS = 8  # states whose window is found
_DEPTHS = 2_000  # states whose depths are looked at


def window_words(
    simulation: Simulation, parts: Sequence[Any], states: Sequence[State]
) -> Iterator[str]:
    """The window of each contact at the start, and warnings of what was outside on the way.

    Args:
        simulation: The simulation.
        parts: Its contacts that give way.
        states: States of all joints.
    """
    system, method, dt = simulation.system, simulation.integrator, simulation.dt
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        begin = windows_at(system, parts, method, dt, states[0])
        yield from (f"window of {window_text(window, method, dt)}" for window in begin)
        warned = set()
        for window in begin:
            for text in window_doubts(window, method, dt):
                warned.add(window.part)
                yield f"warning: {text}"
        yield from (f"warning: {t}" for t in _outside(simulation, parts, states, warned))
        looked = states[:: 1 + len(states) // _DEPTHS]
        yield from (f"warning: {text}" for text in depth_doubts(system, parts, looked))


def _outside(
    simulation: Simulation, parts: Sequence[Any], states: Sequence[State], known: set[Any]
) -> Iterator[str]:
    """Contacts that were too stiff for a step on the way, each once."""
    method, dt = simulation.integrator, simulation.dt
    for x in (*states[:: max(1, len(states) // _LOOKS)], states[-1]):
        if known.issuperset(parts) or not method.is_explicit or method.stable == math.inf:
            return
        try:
            motion = pressed_motion(simulation.system, parts, x)
        except SolveError:
            continue
        if motion is None or not np.isfinite(motion.A).all():
            continue
        for group in motion.parted():
            new = {feature.part for feature in group.features} - known
            if new and not is_bounded(method, group.linear(), dt):
                known.update(new)
                names = ", ".join(part.name for part in parts if part in new)
                yield (
                    f"{names}: too stiff at t = {x.t:.6g} s for steps of {method.title} "
                    f"at dt {dt:g} s: they need dt < {longest(group, method, 1.0):.3g} s there"
                )
