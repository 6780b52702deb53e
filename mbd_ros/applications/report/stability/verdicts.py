"""Verdicts on methods: their motion judged against a reference and the laws of mechanics."""

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
    Motion,
    Reference,
    distance,
    motion,
    reference,
    starting_motion,
)
from mbd_ros.applications.report.stability.scene_text import Entry, LoadedScene
from mbd_ros.core.rows.constraint_rows import labelled
from mbd_ros.core.state import State
from mbd_ros.errors import MbdError
from mbd_ros.features.simulation.checks import step_warnings
from mbd_ros.methods.integration.linear_motion import longest_step as linear_motion_longest_step
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
ASKED = 1.0e-3  # error relative to the size of the motion
_SLOW = 1.0e-7  # the same of rates, relative to the fastest joint
_ENERGY = 10.0  # how many times the energy of the motion an error of it may be
COARSE = 0.5  # rate times step from which on an implicit method does not resolve the motion
_HALVINGS = 8
_AT_ONCE, _IN_THE_END = 0.6, 0.1  # what shorter steps must leave of the error


def judge(
    case: Case,
    method: str,
    factor: float = 1.0,
    tier: str = "plain",
    dt: float = 0.0,
    **others: Any,
) -> Verdict:
    """The verdict on one run.

    Args:
        method: Key of `METHODS`.
        factor: Step, as a multiple of the longest one that `check` does not warn of; nothing to
            a method that chooses its steps.
        dt: Step instead of the factor [s], if > 0.
        **others: As those of `motion`.
    """
    return _Run(case, method, tier, others).verdict(step_on(case, method, factor, dt))


class _Run:
    def __init__(self, case: Case, method: str, tier: str, others: Entry) -> None:
        self._case, self._tier, self._others = case, tier, dict(others)
        self._entry, self._method = METHODS[method], integrator(method)
        self._is_adaptive = self._method.stable == math.inf

    def verdict(self, dt: float) -> Verdict:
        try:
            motion, error = self._attempt(dt)
        except Exception as mistake:  # noqa: BLE001 - any other exception is what is looked for
            return Verdict(WRONG, math.inf, f"{type(mistake).__name__}: {mistake}")
        unfit = self._unfit(motion)
        if unfit:
            return Verdict(WRONG, error, unfit)
        if motion.reason:
            return Verdict(STOPPED, error, motion.reason)
        opened = self._opened(motion.states)
        if error <= ASKED and not opened:
            return Verdict(CONVERGED, error)
        is_bounded = not opened and self._is_bounded(motion.states)
        if self._is_warned(motion, dt):
            return Verdict(BOUNDED if is_bounded else WARNED, error, opened)
        if opened:
            return Verdict(WRONG, error, opened)
        if is_bounded and not self._method.is_explicit and dt * self._rate() > COARSE:
            return Verdict(BOUNDED, error)
        if error == math.inf:
            if not is_bounded:
                return Verdict(WRONG, error, "energy out of bounds without a warning")
            return Verdict(UNKNOWN, error, "no time after the start can be compared")
        return self._smaller_steps(dt, error, is_bounded)

    def _rate(self) -> float:
        return self._case.reference.rates[1]

    def _is_warned(self, motion: Motion, dt: float) -> bool:
        """Whether `check` or `simulate` warns of this step."""
        scene = self._case.scene
        if linear_motion_longest_step(self._method, starting_motion(scene), dt) < math.inf:
            return True
        system = scene.system(solver={"type": self._tier})
        return any(step_warnings(system, self._method, dt, motion.every))

    def _smaller_steps(self, dt: float, error: float, is_bounded: bool) -> Verdict:
        """Whether shorter steps lead to the reference: at once, or in the end."""
        worst, stop = error, ""
        for halving in range(0 if self._is_adaptive else _HALVINGS):
            dt = fitted(self._case.reference.grid, 0.5 * dt)
            try:
                motion, after = self._attempt(dt)
            except Exception as mistake:  # noqa: BLE001 - as above
                return Verdict(WRONG, math.inf, f"{type(mistake).__name__}: {mistake}")
            if self._ends_early(motion):  # which asks for steps that are shorter still
                stop = f"; with steps of {dt:.3g} s: {motion.reason}"
                continue
            if after == math.inf:
                continue
            worst = max(worst, after)
            if after <= max(ASKED, (_AT_ONCE if halving == 0 else _IN_THE_END) * worst):
                if is_bounded:
                    return Verdict(BOUNDED, error)
                return Verdict(WRONG, error, "energy out of bounds without a warning")
        text = f"off by {error:.3g}, and shorter steps do not help{stop}"
        return Verdict(UNKNOWN if stop and self._case.reference.reason else WRONG, error, text)

    def _ends_early(self, motion: Motion) -> bool:
        """Whether a run stopped before all that is known of the motion."""
        return bool(motion.reason) and (
            not motion.states or motion.states[-1].t < self._case.reference.known[-1].t
        )

    def _attempt(self, dt: float) -> tuple[Motion, float]:
        """A run, and its largest error after the start; inf if no time can be compared."""
        case = self._case
        grid, known, size = case.reference.grid, case.reference.known, case.reference.size
        found = motion(case.scene, self._entry, dt, grid, self._tier, **self._others)
        places = [(case.reference.quarter(x), x) for x in found.states[1:]]
        pairs = [(known[k], x) for k, x in places if k is not None and k < len(known)]
        return found, max((distance(case.scene, a, b, size) for a, b in pairs), default=math.inf)

    def _unfit(self, motion: Motion) -> str:
        """Return a fault that nothing excuses: numbers that are not finite, an unnamed stop."""
        if motion.reason and not is_named(self._case, motion.reason):
            return f"stopped without saying where: {motion.reason}"
        for x in motion.states:
            if not (np.isfinite(x.q).all() and np.isfinite(x.v).all()):
                return f"a state at t = {x.t:.6g} s is not finite"
        return ""

    def _opened(self, states: list[State]) -> str:
        """Return a fault that only a warning excuses: constraints that are violated."""
        oracle = self._case.oracle
        for x in [] if self._others.get("stabilization") else states:
            open_by = oracle.violation(x)
            if not open_by <= CLOSED * (1.0 + float(np.abs(x.q).max())):
                return f"constraints are {open_by:.3g} open at t = {x.t:.6g} s"
            if self._entry["type"] == "generalized_alpha":
                continue  # whose velocities keep the constraints to O(h^2) only
            rate = oracle.rate(x)
            if not rate <= _SLOW * (1.0 + float(np.abs(x.v).max())):
                return f"constraints open with {rate:.3g} per second at t = {x.t:.6g} s"
        return ""

    def _is_bounded(self, states: list[State]) -> bool:
        """Whether the energy stays near that of the reference, or what that had in the end."""
        case, last = self._case, len(self._case.energies) - 1
        for x in states:
            k = case.reference.quarter(x)
            if k is not None:
                energy = sum(case.oracle.energy(x))
                if not abs(energy - case.energies[min(k, last)]) <= _ENERGY * case.swing:
                    return False
        return True


def integrator(method: str) -> Any:
    """The integrator of a key of `METHODS`."""
    return build_part("integrators", METHODS[method], "stability")


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


class Case:
    """A scene with its true motion.

    Args:
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


def step_on(case: Case, method: str, factor: float, dt: float = 0.0) -> float:
    """The step of a run [s]: the nearest to what `judge` is asked for that meets the times."""
    wanted = asked_step(method, case.reference.rates[0], factor, dt)
    return fitted(case.reference.grid, wanted, is_longest=dt > 0.0 or factor <= 1.0)


def asked_step(method: str, rate: float, factor: float, dt: float = 0.0) -> float:
    """Return the step of a run [s]; 0 for a method that chooses its steps.

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


def longest_step(method: str, rate: float) -> float:
    """Longest step without a warning of `check` [s]; inf where the method chooses its steps."""
    return integrator(method).stable / rate


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
    names = ["plain"]
    if has_couplings and not scene.constraints:
        names.append("kkt")
    keeps_rows = method in ("rattle", "generalized_alpha")
    if (has_couplings or scene.has_loops) and not keeps_rows:
        names.append("qp")
    return names


def chooses_steps(method: str) -> bool:
    """Whether a method chooses its steps, so that no step is recommended."""
    return integrator(method).stable == math.inf


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


def is_another(factor: float, ran: float) -> bool:
    """Whether a run was not at the multiple of the recommended step that its label names."""
    return 0.0 < ran < math.inf and not factor / _OFF <= ran <= factor * _OFF
