"""What a method makes of a scene, judged against a reference and the laws of mechanics."""

import math
from typing import Any

import numpy as np

from mbd_ros.core.state import State
from mbd_ros.report.stability.cases import (
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
    integrator,
    longest_step,
)
from mbd_ros.report.stability.motion import Grid, Motion, motion
from mbd_ros.report.stability.reference_motion import distance
from mbd_ros.report.stability.scene_text import Entry
from mbd_ros.step_check import step_warnings

ASKED = 1.0e-3  # error relative to the size of the motion
_SLOW = 1.0e-7  # the same of rates, relative to the fastest joint
_ENERGY = 10.0  # how many times the energy of the motion an error of it may be
_COARSE = 0.5  # rate times step from which on an implicit method does not resolve the motion
_HALVINGS = 8
_AT_ONCE, _IN_THE_END = 0.6, 0.1  # what shorter steps must leave of the error


def judge(
    case: Case,
    method: str,
    factor: float = 1.0,
    tier: str = "auto",
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
    grid, rate = case.reference.grid, case.reference.rates[0]
    wanted = dt if dt > 0.0 else factor * longest_step(method, rate)
    if longest_step(method, rate) == math.inf:
        wanted = grid.interval
    return _Run(case, method, tier, others).verdict(_on(grid, wanted))


def _on(grid: Grid, dt: float) -> float:
    """The nearest step that meets the grid, not longer."""
    if dt < grid.interval:
        return grid.interval / math.ceil(grid.interval / dt - 1.0e-9)
    return grid.interval * min(math.floor(dt / grid.interval + 1.0e-9), grid.count)


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
        drift = self._drift(found.states)
        is_known = self._case.reference.horizon > 1
        if error <= ASKED and is_known and not drift:
            return Verdict(CONVERGED, error)
        is_bounded = not drift and self._is_bounded(found.states, dt)
        if self._is_warned(found, dt):
            return Verdict(BOUNDED if is_bounded else WARNED, error, drift)
        if drift:
            return Verdict(WRONG, error, drift)
        if is_bounded and not self._method.is_explicit and dt * self._rate() > _COARSE:
            return Verdict(BOUNDED, error)
        if not is_known:
            return Verdict(UNKNOWN, math.inf, "the motion is not known well enough to compare")
        return self._smaller_steps(dt, error, is_bounded)

    def _rate(self) -> float:
        return self._case.reference.rates[1]

    def _is_warned(self, found: Motion, dt: float) -> bool:
        """Whether `check` or `simulate` warns of this step."""
        method, rate = self._method, self._case.reference.rates[0]
        if method.is_explicit and rate * dt > method.stable * (1.0 + 1.0e-9):
            return True
        system = self._case.scene.system(solver={"type": self._tier})
        return any(step_warnings(system, method, dt, found.every))

    def _smaller_steps(self, dt: float, error: float, is_bounded: bool) -> Verdict:
        """Whether shorter steps lead to the reference: at once, or in the end."""
        worst = error
        for halving in range(0 if self._is_adaptive else _HALVINGS):
            dt = _on(self._case.reference.grid, 0.5 * dt)
            try:
                found, after = self._attempt(dt)
            except Exception as mistake:  # noqa: BLE001 - as above
                return Verdict(WRONG, math.inf, f"{type(mistake).__name__}: {mistake}")
            if found.reason:
                return Verdict(STOPPED, error, found.reason)
            worst = max(worst, after)
            if after <= max(ASKED, (_AT_ONCE if halving == 0 else _IN_THE_END) * worst):
                if is_bounded:
                    return Verdict(BOUNDED, error)
                return Verdict(WRONG, error, "energy out of bounds without a warning")
        return Verdict(WRONG, error, f"off by {error:.3g}, and shorter steps do not help")

    def _attempt(self, dt: float) -> tuple[Motion, float]:
        case = self._case
        grid = case.reference.grid
        found = motion(case.scene, self._entry, dt, grid, self._tier, **self._others)
        every = max(1, round(dt / grid.interval))
        known = case.reference.states[: case.reference.horizon][::every]
        pairs = zip(known, found.states, strict=False)
        size = case.reference.size
        return found, max((distance(case.scene, a, b, size) for a, b in pairs), default=math.inf)

    def _unfit(self, found: Motion) -> str:
        """What nothing excuses: numbers that are not finite, a stop that does not say where."""
        if found.reason and not _is_named(self._case, found.reason):
            return f"stopped without saying where: {found.reason}"
        for x in found.states:
            if not (np.isfinite(x.q).all() and np.isfinite(x.v).all()):
                return f"a state at t = {x.t:.6g} s is not finite"
        return ""

    def _drift(self, states: list[State]) -> str:
        """What only a warning excuses: constraints that do not hold."""
        witness = self._case.witness
        for x in [] if self._others.get("stabilization") else states:
            open_by = witness.violation(x)
            if not open_by <= CLOSED * (1.0 + float(np.abs(x.q).max())):
                return f"constraints are {open_by:.3g} open at t = {x.t:.6g} s"
            if self._entry["type"] == "generalized_alpha":
                continue  # whose velocities keep the constraints to O(h^2) only
            rate = witness.rate(x)
            if not rate <= _SLOW * (1.0 + float(np.abs(x.v).max())):
                return f"constraints open with {rate:.3g} per second at t = {x.t:.6g} s"
        return ""

    def _is_bounded(self, states: list[State], dt: float) -> bool:
        case = self._case
        every = max(1, round(dt / case.reference.grid.interval))
        energies = np.array([sum(case.witness.energy(x)) for x in states])
        known = case.energies[::every][: len(energies)]
        away = np.abs(energies[: len(known)] - known).max(initial=0.0)
        return bool(away <= _ENERGY * case.swing)


def _is_named(case: Case, reason: str) -> bool:
    """Whether a message names a time, a joint or a row."""
    names = [joint.name for joint in case.scene.robot.joints]
    rows = [row.name for part in case.scene.constraints for row in part.rows]
    return "t = " in reason or any(name in reason for name in (*names, *rows))
