"""The window of the stiffness of compliant contacts, in words, and steps that are too long.

A contact that is softer than its window goes deeper than it may; a stiffer one makes explicit
steps grow. `methods.integration.stiffness_window` computes both ends.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from mbd_ros.core.contracts import Load
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Reads
from mbd_ros.core.state import State
from mbd_ros.methods.integration.linear_motion import linear_motion, longest_step
from mbd_ros.methods.integration.stepping import Integrator
from mbd_ros.methods.integration.stiffness_window import GAIN, Window, touching_motion, windows
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.runs.simulation import DEFAULT_STABLE, default_integrator, integrator_of

Line = tuple[str, str]  # label, text
_SLACK = 1.0e-9  # relative


def step_lines(scene: Scene, system: System, x: State) -> Iterator[Line]:
    """Windows of contacts that give way, and warnings of a step that is too long.

    Args:
        x: Consistent start of what it integrates.
    """
    yield from _windows(scene, system, x)
    motion, method = linear_motion(system, x), scene.integrator
    name = default_integrator(scene)["type"]
    if method is not None:
        name = type(method).__name__
    elif motion.rate * scene.dt > DEFAULT_STABLE:
        method = integrator_of(scene)
    longest = math.inf if method is None else longest_step(method, motion, scene.dt)
    if not math.isfinite(motion.rate):
        yield "warning", f"stiff: forces change too steeply for any step of {name}"
    elif longest < math.inf:
        limit = f"steps of {name} need dt < {longest:.2g} s, gauss_legendre does not"
        stiff = f"stiff: fastest rate {motion.rate:.3g} 1/s at dt {scene.dt:g} s"
        yield "warning", f"{stiff}; {limit}"


def _windows(scene: Scene, system: System, x: State) -> Iterator[Line]:
    contacts = scene.parts.get("contacts", ())
    parts = [part for part in contacts if isinstance(part, Load) and part.is_compliant_contact]
    if not parts:
        return
    method = integrator_of(scene)
    start = system.expand(x)
    found = windows_at(system, parts, method, scene.dt, start)
    for window in found:
        yield "window", window_text(window, method, scene.dt)
    for window in found:
        yield from (("warning", text) for text in window_doubts(window, method, scene.dt))
    yield from (("warning", text) for text in depth_doubts(system, parts, [start]))


def windows_at(
    system: System, parts: Sequence[Any], method: Integrator, dt: float, x: State
) -> list[Window]:
    """The windows of contacts at a state, as if each touched with its nearest features.

    Args:
        parts: Contacts that give way.
        dt: Its step [s].
        x: State of all joints.
    """
    return windows(touching_motion(system, parts, x), method, dt)


def window_text(window: Window, method: Integrator, dt: float) -> str:
    """Both ends of a window, and what they are made for."""
    part, name = window.part, type(method).__name__
    unit = _unit(part)
    many = f" on one of {window.features} features" if window.features > 1 else ""
    pressed = f"{window.load:.3g} N at most{many}"
    deep = f", {part.max_penetration:.3g} m deep" if part.max_penetration else ""
    if method.stable == math.inf:
        upper = f"to any, which steps of {name} adapt to"
    elif not method.is_explicit:
        upper = f"to any, which {name} follows"
    elif window.upper == math.inf:
        upper = f"to any ({name} at dt {dt:g} s)"
    else:
        upper = f"to {window.upper:.4g} ({name} at dt {dt:g} s)"
    if not math.isnan(window.impacts):
        upper += f", for impacts to {window.impacts:.3g} (rebounds at most {GAIN:.0%} faster)"
    stiffness = f"stiffness {part.normal.stiffness:.4g} {unit}"
    return f"{part.name}: {stiffness}, from {window.lower:.4g} ({pressed}{deep}) {upper}"


def window_doubts(window: Window, method: Integrator, dt: float) -> Iterator[str]:
    """Warnings of a stiffness outside its window, with the step that opens it."""
    part, name = window.part, type(method).__name__
    k, unit = part.normal.stiffness, _unit(part)
    here = f"{part.name}: stiffness {k:.4g} {unit}"
    ends = f"{window.lower:.4g} .. {window.upper:.4g} {unit} at dt {dt:g} s"
    if window.upper == 0.0:
        yield (
            f"{part.name}: no stiffness is within its window at dt {dt:g} s: its dampers and its "
            f"friction alone need steps of {name} with dt < {window.longest:.3g} s"
        )
    elif k > window.upper * (1.0 + _SLACK):
        yield (
            f"{here} is above its window, {ends}: steps of {name} need dt < {window.longest:.3g} s"
        )
    if k < window.lower * (1.0 - _SLACK):
        yield (
            f"{here} is below its window, {ends}: {window.load:.3g} N press a feature "
            f"{part.normal.depth(window.load):.3g} m deep, max_penetration is "
            f"{part.max_penetration:.3g} m"
        )
    if 0.0 < window.upper < window.lower:
        yield (
            f"{part.name}: its window is empty at dt {dt:g} s; steps of {name} with dt < "
            f"{window.opening:.3g} s open it"
        )


def depth_doubts(system: System, parts: Sequence[Any], states: Sequence[State]) -> Iterator[str]:
    """Warnings of contacts that go deeper than they may, where they are deepest.

    Args:
        parts: Contacts that give way.
        states: States of all joints.
    """
    k, deepest = system.k, {part: (0.0, 0.0) for part in parts if part.max_penetration}
    for x in states:
        k.refresh(x.q, x.v, Reads.POSITION)
        for part, most in deepest.items():
            deepest[part] = max(most, (-float(part.pair.gaps(k).min()), x.t))
    for part, (depth, t) in deepest.items():
        if depth > part.max_penetration:
            needed = part.normal.least(part.normal.force(depth, 0.0), part.max_penetration)
            yield (
                f"{part.name}: {depth:.3g} m deep at t = {t:.6g} s, max_penetration is "
                f"{part.max_penetration:.3g} m: its force there takes a stiffness of {needed:.3g}"
            )


def _unit(part: Any) -> str:
    power = getattr(part.normal, "exponent", 1.0)
    return "N/m" if power == 1.0 else f"N/m^{power:g}"
