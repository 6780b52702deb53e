"""Lines of `mbd-ros check` about the step: rates that are too fast, contacts too stiff for it."""

import math
from collections.abc import Iterator

from mbd_ros.core.dynamics.system import System
from mbd_ros.core.integration.linear_motion import linear_motion, longest_step
from mbd_ros.core.state import State
from mbd_ros.scene.built_scene import DEFAULT_STABLE, Scene
from mbd_ros.scene.describe.part_lines import line, type_name


def step_lines(scene: Scene, system: System, x: State) -> Iterator[str]:
    """Windows of contacts that give way, and warnings of a step that is too long.

    Args:
        scene: The scene.
        system: Its system.
        x: Consistent start of what it integrates.
    """
    yield from _windows(scene, system, x)
    motion, method = linear_motion(system, x), scene.integrator
    name = scene.default_integrator["type"]
    if method is not None:
        name = type_name(method)
    elif motion.rate * scene.dt > DEFAULT_STABLE:
        method = scene.method
    longest = math.inf if method is None else longest_step(method, motion, scene.dt)
    if not math.isfinite(motion.rate):
        yield line("warning", f"stiff: forces change too steeply for any step of {name}")
    elif longest < math.inf:
        limit = f"steps of {name} need dt < {longest:.2g} s, gauss_legendre does not"
        stiff = f"stiff: fastest rate {motion.rate:.3g} 1/s at dt {scene.dt:g} s"
        yield line("warning", f"{stiff}; {limit}")


def _windows(scene: Scene, system: System, x: State) -> Iterator[str]:
    parts = [part for part in scene.parts.get("contacts", ()) if hasattr(part, "slopes")]
    if not parts:
        return
    from mbd_ros.scene.describe.window_lines import (
        depth_doubts,
        window_doubts,
        window_text,
        windows_at,
    )

    method = scene.method
    start = system.expand(x)
    found = windows_at(system, parts, method, scene.dt, start)
    for window in found:
        yield line("window", window_text(window, method, scene.dt))
    for window in found:
        yield from (line("warning", text) for text in window_doubts(window, method, scene.dt))
    yield from (line("warning", text) for text in depth_doubts(system, parts, [start]))
