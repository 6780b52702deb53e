"""What `simulate` says of contacts that give way: the window of their stiffness, and depths."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.integration.contact_motion import pressed_motion
from mbd_ros.core.integration.contact_window import Window, windows
from mbd_ros.core.model.kinematics import Reads
from mbd_ros.core.simulation.simulation import Simulation
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError
from mbd_ros.scene.window_lines import window_doubts, window_text, windows_at

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
        for window, t in _outside(simulation, parts, states, warned):
            for text in window_doubts(window, method, dt):
                yield f"warning: at t = {t:.6g} s {text}"
        yield from (f"warning: {text}" for text in _depths(simulation, parts, states))


def _outside(
    simulation: Simulation, parts: Sequence[Any], states: Sequence[State], known: set[Any]
) -> Iterator[tuple[Window, float]]:
    """Windows that a stiffness was above of, with their times; each contact once."""
    for x in (*states[:: max(1, len(states) // _LOOKS)], states[-1]):
        try:
            motion = pressed_motion(simulation.system, parts, x)
        except SolveError:
            continue
        if motion is None or not np.isfinite(motion.A).all():
            continue
        for window in windows(motion, simulation.integrator, simulation.dt):
            part = window.part
            if part not in known and part.normal.stiffness > window.upper:
                known.add(part)
                yield window._replace(lower=0.0), x.t


def _depths(
    simulation: Simulation, parts: Sequence[Any], states: Sequence[State]
) -> Iterator[str]:
    """Contacts that went deeper than they may."""
    k, most = simulation.system.k, {part: (0.0, 0.0) for part in parts if part.max_penetration}
    for x in states[:: 1 + len(states) // _DEPTHS]:
        k.refresh(x.q, x.v, Reads.POSITION)
        for part, deepest in most.items():
            most[part] = max(deepest, (-float(part.pair.gaps(k).min()), x.t))
    for part, (depth, t) in most.items():
        if depth > part.max_penetration:
            needed = part.normal.least(part.normal.force(depth, 0.0), part.max_penetration)
            yield (
                f"{part.name}: {depth:.3g} m deep at t = {t:.6g} s, max_penetration is "
                f"{part.max_penetration:.3g} m: its force there takes a stiffness of {needed:.3g}"
            )
