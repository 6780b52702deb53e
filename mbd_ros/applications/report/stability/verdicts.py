"""Verdicts on methods: their motion judged against a reference and the laws of mechanics."""

import math
from typing import Any

import numpy as np

from mbd_ros.applications.report.stability.cases import (
    BOUNDED,
    CLOSED,
    CONVERGED,
    METHODS,
    STOPPED,
    UNKNOWN,
    WARNED,
    WRONG,
    Case,
    Verdict,
    asked_step,
    fitted,
    integrator,
    is_named,
)
from mbd_ros.applications.report.stability.reference_motion import (
    Motion,
    distance,
    motion,
    starting_motion,
)
from mbd_ros.applications.report.stability.scene_text import Entry
from mbd_ros.core.state import State
from mbd_ros.features.simulation.checks import step_warnings
from mbd_ros.methods.integration.linear_motion import longest_step

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
        case: The case.
        method: Key of `METHODS`.
        factor: Step, as a multiple of the longest one that `check` does not warn of; nothing to
            a method that chooses its steps.
        tier: Solver type.
        dt: Step instead of the factor [s], if > 0.
        **others: As those of `motion`.
    """
    return _Run(case, method, tier, others).verdict(step_on(case, method, factor, dt))


def step_on(case: Case, method: str, factor: float, dt: float = 0.0) -> float:
    """The step of a run [s]: the nearest to what `judge` is asked for that meets the times."""
    wanted = asked_step(method, case.reference.rates[0], factor, dt)
    return fitted(case.reference.grid, wanted, is_longest=dt > 0.0 or factor <= 1.0)


class _Run:
    def __init__(self, case: Case, method: str, tier: str, others: Entry) -> None:
        self._case, self._tier, self._others = case, tier, dict(others)
        self._entry, self._method = METHODS[method], integrator(method)
        self._is_adaptive = self._method.stable == math.inf

    def verdict(self, dt: float) -> Verdict:
        try:
            found, error = self._attempt(dt)
        except Exception as mistake:  # noqa: BLE001 - any other exception is what is looked for
            return Verdict(WRONG, math.inf, f"{type(mistake).__name__}: {mistake}")
        unfit = self._unfit(found)
        if unfit:
            return Verdict(WRONG, error, unfit)
        if found.reason:
            return Verdict(STOPPED, error, found.reason)
        opened = self._opened(found.states)
        if error <= ASKED and not opened:
            return Verdict(CONVERGED, error)
        is_bounded = not opened and self._is_bounded(found.states)
        if self._is_warned(found, dt):
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

    def _is_warned(self, found: Motion, dt: float) -> bool:
        """Whether `check` or `simulate` warns of this step."""
        scene = self._case.scene
        if longest_step(self._method, starting_motion(scene), dt) < math.inf:
            return True
        system = scene.system(solver={"type": self._tier})
        return any(step_warnings(system, self._method, dt, found.every))

    def _smaller_steps(self, dt: float, error: float, is_bounded: bool) -> Verdict:
        """Whether shorter steps lead to the reference: at once, or in the end."""
        worst, stop = error, ""
        for halving in range(0 if self._is_adaptive else _HALVINGS):
            dt = fitted(self._case.reference.grid, 0.5 * dt)
            try:
                found, after = self._attempt(dt)
            except Exception as mistake:  # noqa: BLE001 - as above
                return Verdict(WRONG, math.inf, f"{type(mistake).__name__}: {mistake}")
            if self._ends_early(found):  # which asks for steps that are shorter still
                stop = f"; with steps of {dt:.3g} s: {found.reason}"
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

    def _ends_early(self, found: Motion) -> bool:
        """Whether a run stopped before all that is known of the motion."""
        return bool(found.reason) and (
            not found.states or found.states[-1].t < self._case.reference.known[-1].t
        )

    def _attempt(self, dt: float) -> tuple[Motion, float]:
        """A run, and its largest error after the start; inf if no time can be compared."""
        case = self._case
        grid, known, size = case.reference.grid, case.reference.known, case.reference.size
        found = motion(case.scene, self._entry, dt, grid, self._tier, **self._others)
        places = [(case.reference.quarter(x), x) for x in found.states[1:]]
        pairs = [(known[k], x) for k, x in places if k is not None and k < len(known)]
        return found, max((distance(case.scene, a, b, size) for a, b in pairs), default=math.inf)

    def _unfit(self, found: Motion) -> str:
        """What nothing excuses: numbers that are not finite, a stop that does not say where."""
        if found.reason and not is_named(self._case, found.reason):
            return f"stopped without saying where: {found.reason}"
        for x in found.states:
            if not (np.isfinite(x.q).all() and np.isfinite(x.v).all()):
                return f"a state at t = {x.t:.6g} s is not finite"
        return ""

    def _opened(self, states: list[State]) -> str:
        """What only a warning excuses: constraints that do not hold."""
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
