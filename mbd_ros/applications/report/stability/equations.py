"""Whether a scene obeys mechanics along its reference motion, of any origin."""

import math

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.stability.cases import (
    CLOSED,
    CONVERGED,
    STOPPED,
    WRONG,
    Case,
    Verdict,
    is_named,
    raised,
)
from mbd_ros.applications.report.stability.motion import Grid
from mbd_ros.applications.report.stability.reference_motion import FINE, first
from mbd_ros.core.projection.assembly import assemble
from mbd_ros.core.state import State

_BALANCED = 1.0e-5  # of the energies that change hands
_FINER = 8
_QUADRATURE = 10.0  # how many times its estimate an error of the work may be
_STATES = 3


def equations(case: Case, tiers: list[str], stops: str | None = None) -> Verdict:
    """Equations of motion, rows and energy along the reference motion, in some tiers.

    Args:
        case: The case.
        tiers: Solver types.
        stops: As that of `unexpected`.
    """
    found = _equations(case, tiers)
    reason = case.reference.reason
    if found.kind == CONVERGED and reason:
        found = Verdict(STOPPED, math.inf, f"the reference stops: {reason}")
    if found.kind == STOPPED and not is_named(case, found.text):
        return Verdict(WRONG, math.inf, f"stopped without saying where: {found.text}")
    return unexpected(found, stops)


def unexpected(found: Verdict, stops: str | None) -> Verdict:
    """Judge a stop: wrong in a scene of this package that must not stop.

    Args:
        found: A verdict.
        stops: Text of the expected stop, empty if none is; None for a scene of a user.
    """
    if found.kind != STOPPED or stops is None or (stops and stops in found.text):
        return found
    return Verdict(WRONG, found.error, f"must not stop: {found.text}")


def _equations(case: Case, tiers: list[str]) -> Verdict:
    try:
        for x in case.reference.states:
            if not case.oracle.violation(x) <= CLOSED * (1.0 + float(np.abs(x.q).max())):
                open_by = case.oracle.violation(x)
                return Verdict(WRONG, math.inf, f"constraints {open_by:.3g} open at {x.t:.6g} s")
        for tier in tiers:
            found = _complaints(case, tier)
            if found:
                return Verdict(WRONG, math.inf, f"tier {tier}: {'; '.join(found)}")
        if not _is_finite_beyond(case):
            t = case.reference.fine[-1].t
            return Verdict(WRONG, math.inf, f"accelerations beyond t = {t:.6g} s are not finite")
        lost, allowed = imbalance(case)
        if not lost <= allowed:  # a stop or friction may begin between two points
            lost, allowed = imbalance(case, _FINER)
    except Exception as error:  # noqa: BLE001 - every exception is a verdict
        return raised(error)
    if not lost <= allowed:
        text = f"energy changes by {lost:.3g} J more than work explains, {allowed:.2g} J allowed"
        return Verdict(WRONG, math.inf, text)
    return Verdict(CONVERGED, lost / case.swing)


def _complaints(case: Case, tier: str) -> list[str]:
    states = case.reference.states
    system = case.scene.system(solver={"type": tier})
    for x in states[:: max(1, len(states) // _STATES)]:
        found = case.oracle.complaints(system, assemble(system, system.reduce(x)))
        if found:
            return found
    return []


def _is_finite_beyond(case: Case) -> bool:
    """Whether there are accelerations where the reference would go next."""
    x, ahead = case.reference.fine[-1], case.reference.grid.interval
    q = pin.integrate(case.scene.robot.model, x.q, ahead * x.v)
    system = case.scene.system()
    a = system.evaluate(State(x.t + ahead, q, x.v)).a
    return bool(np.isfinite(a).all())


def imbalance(case: Case, finer: int = 1) -> tuple[float, float]:
    """Change of energy without its reason [J], and how much the quadrature may err [J].

    Args:
        case: The case.
        finer: How many times as many points as those of the reference.
    """
    grid, fine = case.reference.grid, case.reference.fine
    if finer > 1:
        fine = first(
            case.scene, Grid(grid.interval / FINE / finer, FINE * finer * grid.count)
        ).states
    count = (len(fine) - 1) // 4 * 4
    if count == 0:
        return 0.0, 0.0
    system, step = case.scene.system(), grid.interval / FINE / finer
    power = [case.oracle.power(system, system.reduce(x)) for x in fine[: count + 1]]
    work, rough = _simpson(power, step), _simpson(power[::2], 2.0 * step)
    before, after = (sum(case.oracle.energy(x)) for x in (fine[0], fine[count]))
    size = case.swing + step * float(np.abs(power).sum())
    return abs(after - before - work), _BALANCED * size + _QUADRATURE * abs(work - rough)


def _simpson(values: list[float], step: float) -> float:
    """Integral over an even number of intervals."""
    inner = 4.0 * sum(values[1:-1:2]) + 2.0 * sum(values[2:-1:2])
    return step / 3.0 * (values[0] + inner + values[-1])
