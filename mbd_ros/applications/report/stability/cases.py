"""A scene with its true motion, and the verdict on a method."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.oracle import Oracle
from mbd_ros.applications.report.stability.reference_motion import (
    FINE,
    Grid,
    Known,
    Reference,
    reference,
)
from mbd_ros.applications.report.stability.scene_text import Entry, LoadedScene
from mbd_ros.core.rows.constraint_rows import labelled
from mbd_ros.errors import MbdError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.part_entries import build_part

CONVERGED, BOUNDED, STOPPED = "converged", "bounded", "stopped"
WARNED, WRONG, UNKNOWN = "warned", "WRONG", "not comparable"
VERDICTS = (CONVERGED, BOUNDED, STOPPED, WARNED, UNKNOWN, WRONG)
CLOSED = 1.0e-8  # m or rad, relative above 1: violation that projection leaves at most
METHODS: Mapping[str, Entry] = {
    "semi_implicit_euler": {"type": "semi_implicit_euler"},
    "rk4": {"type": "rk4"},
    "adams": {"type": "adams"},
    "dopri5": {"type": "dopri5"},
    "dop853": {"type": "dop853", "tolerance": 1.0e-8},
    "gauss_legendre": {"type": "gauss_legendre"},
    "generalized_alpha": {"type": "generalized_alpha"},
    "rattle": {"type": "rattle"},
}
TIME_STEPPING = "moreau_jean"  # on contacts
EQUATIONS = "equations"
COLUMNS = (EQUATIONS, *METHODS, TIME_STEPPING)  # of the map
FITTING = 2  # steps that a motion lasts at least
LATEST = 10.0  # [s]: later a mechanism that falls is too far off for differences of places
_MOST = 48  # intervals of a motion that is made longer for its step
_OFF = 1.2  # ratio of two steps from which on they are different ones
_ROUNDING = 1.0e-9


class Case:
    """A scene with its true motion.

    Args:
        loaded: The scene.
        grid: Times of the comparison.
        known: Gives the motion by other equations than those of the scene.

    Attributes:
        energies: Of the reference, at every quarter of an interval [J].
        swing: Energy that changes between its forms [J].

    Raises:
        MbdError: The scene cannot even begin.
    """

    def __init__(self, loaded: LoadedScene, grid: Grid, known: Known | None = None) -> None:
        self.scene, self.oracle = loaded.scene, Oracle(loaded)
        self.reference: Reference = reference(self.scene, grid, known)
        stored = [self.oracle.energy(x) for x in self.reference.fine]
        kinetic = np.array([k for k, _ in stored])
        potential = np.array([p for _, p in stored])
        swing = float(np.ptp(potential)) + float(kinetic.max())
        self.energies, self.swing = kinetic + potential, max(swing, 1.0e-9)


class Verdict(NamedTuple):
    """One cell of the map.

    Attributes:
        kind: One of `VERDICTS`.
        error: Relative to the size of the motion; inf where it cannot be told.
        text: Reason of a stop, or the fault.
    """

    kind: str
    error: float
    text: str = ""


def raised(error: Exception) -> Verdict:
    """A stop where it is an error of this package; any other exception is a finding."""
    kind = STOPPED if isinstance(error, MbdError) else WRONG
    return Verdict(kind, math.inf, f"{type(error).__name__}: {error}")


def applicable(scene: Scene) -> list[str]:
    """Methods that take a scene."""
    bounded = any(not part.law.is_rigid for part in scene.constraints)
    refused = {"rattle", "generalized_alpha"} if bounded else set()
    if scene.robot.floating:
        refused.add("adams")
    return [name for name in METHODS if name not in refused]


def tiers(scene: Scene, method: str) -> list[str]:
    """Tiers that serve a scene with a method, and differ."""
    has_couplings = bool(scene.couplings.dependent)
    found = ["plain"]
    if has_couplings and not scene.constraints:
        found.append("kkt")
    keeps_rows = method in ("rattle", "generalized_alpha")
    if (has_couplings or scene.has_loops) and not keeps_rows:
        found.append("qp")
    return found


def longest_step(method: str, rate: float) -> float:
    """Longest step without a warning of `check` [s]; inf where the method chooses its steps."""
    return integrator(method).stable / rate


def chooses_steps(method: str) -> bool:
    """Whether a method chooses its steps, so that no step is recommended."""
    return integrator(method).stable == math.inf


def integrator(method: str) -> Any:
    """The integrator of a key of `METHODS`."""
    return build_part("integrators", METHODS[method], "stability")


def asked_step(method: str, rate: float, factor: float, dt: float = 0.0) -> float:
    """What a run is asked for [s]; 0 for a method that chooses its steps.

    Args:
        method: Key of `METHODS`.
        rate: Fastest rate at the start [1/s].
        factor: Multiple of the longest step that `check` does not warn of.
        dt: Step instead of the factor [s], if > 0.
    """
    longest = longest_step(method, rate)
    if longest == math.inf:
        return 0.0
    return dt if dt > 0.0 else factor * longest


def room(grid: Grid, dt: float) -> Grid:
    """The times themselves, or later ones if a few steps would not fit.

    Args:
        grid: Times of a comparison.
        dt: Longest step of all runs [s]; 0 if none is recommended.
    """
    span = min(FITTING * dt, LATEST)
    if span <= grid.span:
        return grid
    count = max(grid.count, min(_MOST, math.ceil(span / grid.interval)))
    return Grid(span / count, count)


def fitted(grid: Grid, dt: float, is_longest: bool = True) -> float:
    """The nearest step that meets the times of a comparison [s].

    That is a whole fraction of an interval, or a whole number of quarters of it from three on.

    Args:
        grid: Times of the comparison.
        dt: Step that is asked for [s]; 0 for a method that chooses its steps.
        is_longest: Whether a longer one will not do.
    """
    if dt <= 0.0:
        return grid.interval
    quarter = grid.interval / FINE
    dt = min(dt, grid.span)
    below, parts = math.floor(dt / quarter + _ROUNDING), math.ceil(grid.interval / dt - _ROUNDING)
    steps = [grid.interval / k for k in (parts - 1, parts) if k > 0]
    steps += [m * quarter for m in (below, below + 1) if FINE - 1 <= m <= FINE * grid.count]
    if is_longest:
        steps = [step for step in steps if step <= dt * (1.0 + _ROUNDING)]
    return min(steps, key=lambda step: abs(math.log(step / dt)))


def is_named(case: Case, reason: str) -> bool:
    """Whether a message names a time, a joint, a link or a row."""
    robot = case.scene.robot
    links = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
    rows = [row.name for row in labelled(case.scene.constraints)]
    names = (*(joint.name for joint in robot.joints), *links, *rows)
    return "t = " in reason or any(re.search(rf"\b{re.escape(n)}\b", reason) for n in names)


def is_another(factor: float, ran: float) -> bool:
    """Whether a run was not at the multiple of the recommended step that its label names."""
    return 0.0 < ran < math.inf and not factor / _OFF <= ran <= factor * _OFF
