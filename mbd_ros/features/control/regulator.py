"""The linear quadratic regulator along a recorded or predicted motion.

The motion is linearised, x' = A x + B u, at its samples; the cost to go S follows the matrix
Riccati equation backwards,

    -S' = A' S + S A - S B R^-1 B' S + Q,    K = R^-1 B' S

and K is the gain. At the end of the motion, S is the cost of holding the last state for ever, if
efforts can hold it. A motion of one phase that repeats has a repeating S,
S(end) = strike' S(begin) strike, where `strike` is the derivative of the state after the strike of
a foot by the state before it.

Efforts can change by the contact clearance before a closed contact of the phase opens or slips;
the costs of efforts are chosen so that they use a small share of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.couplings import IndependentCoordinates
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import DataError, ModelError, SolveError
from mbd_ros.features.control.tracking_tube import DisturbedMotion, contact_clearance
from mbd_ros.methods.control.contract import EffortBox
from mbd_ros.methods.control.tracking_plan import IndependentSlopes, TrackingPlan
from mbd_ros.methods.events.crossings import Crossing
from mbd_ros.motion.recordings import Source, read_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.phased_systems import build_phased_system
from mbd_ros.scene.runs.simulation import build_simulation

_STEP = 0.1  # length of a step times the size of the Hamiltonian matrix: errors of 1e-7
_RESIDUAL = 1.0e-6  # accepted residual of the steady equation, per Hamiltonian matrix
_MOST_STEPS = 100_000  # between two samples of a motion
BEFORE = 4  # samples before the end, from which deviations are followed through the strike
_STRIKE_STEP = 1.0e-4  # deviation of the difference quotients
_LARGEST_GAP = 1.0e-2  # between the start of a motion and its end after the strike
_HOLDS = 4  # steps with constant efforts between two samples
_LATEST_STRIKE = 1.2  # durations until a strike must have come
_SETTLED = 1.0e-6  # relative change of costs that count as repeating
_MOST_STRIDES = 200  # until costs repeat
_EFFORT_STEP = 1.0e-4  # of the largest effort: forces are linear in efforts, cones are not
_SHARE_OF_CLEARANCE = 0.05  # several inputs act at once, and positions deviate as well
_AT_REST = 1.0e-3  # velocity of a plan that ends at rest, over its largest
_HOLD_AFTER = 1.0e-3  # s, after the end of a motion until its last state is held
_WIDEST = 10.0  # times the tolerated deviations, where the search for a tube starts
_LEAST_EFFORT = 1.0e-6  # of the largest effort: smallest size of an input


def regulate(scene: Scene, motion: ReferenceMotion, tolerated: Tolerated) -> RegulatedMotion:
    """Compute the plan of a motion, with gains that lead back to it.

    Raises:
        ModelError: Loops come too near to a toggle.
        SolveError: The motion changes too fast.
    """
    system = _system(scene)
    (times, states, u), can_hold = (motion, False) if scene.phases else _hold_end(system, motion)
    slopes = IndependentSlopes(system, states)
    pairs = [slopes.at(y, efforts) for y, efforts in zip(states, u, strict=True)]
    A, B = (np.stack(list(each)) for each in zip(*pairs, strict=True))
    limits = np.concatenate([actuator.limits() for actuator in scene.actuators])
    demands = crossings_of(scene)
    usual = np.minimum(_usual_efforts(u, limits), tolerated_efforts(system, demands, states, u))
    Q, R = _costs(len(slopes.chosen), usual, tolerated)
    steady = riccati_steady(A[-1], B[-1], Q, R)
    duration = float(times[-1] - times[0])
    if scene.phases:
        S = repeating_cost(times, A, B, Q, R, strike_slope(scene, times, states, u, slopes))
    else:
        S = riccati_backwards(times, A, B, Q, R, Q * duration if steady is None else steady)
    gain = np.linalg.solve(R, np.swapaxes(B, 1, 2) @ S)
    names, chosen = _names(scene), slopes.chosen
    q, v = (np.stack([getattr(y, field)[chosen] for y in states]) for field in "qv")
    joints = tuple(names[i] for i in chosen)
    plan = TrackingPlan(joints, tuple(scene.actuated), times, q, v, u, gain, S)
    rests = steady is not None and can_hold
    box = EffortBox(-limits, limits)
    disturbed = DisturbedMotion(system, states, plan, slopes, box, duration * rests, demands)
    fastest = float(np.abs(np.linalg.eigvals(A - B @ gain)).max())
    widest = _WIDEST**2 * _unit_level(S, np.diag(Q))
    return RegulatedMotion(plan, disturbed, rests, fastest, widest)


def _system(scene: Scene) -> Any:
    """Return the system of the scene or of its phase, with exact derivatives if these compile."""
    from mbd_ros.scene.runs.compiling import compiled_system

    if scene.phases:
        return build_phased_system(scene).systems[0]
    try:
        return compiled_system(scene)
    except ModelError:
        return scene.system()


def _hold_end(system: Any, motion: ReferenceMotion) -> tuple[ReferenceMotion, bool]:
    """Append a sample at rest if efforts can hold the last state; also return whether they can."""
    last, u = motion.states[-1], motion.u[-1]
    speeds = np.abs(np.stack([y.v for y in motion.states]))
    if np.abs(last.v).max() > _AT_REST * speeds.max():
        return motion, False
    a = np.zeros(system.nv)
    last = last._replace(t=last.t + _HOLD_AFTER, v=0.0 * last.v)
    system.accelerator()(last.t, last.q, last.v, u, a)
    by_u = system.derivatives(last, u).u
    change = np.linalg.lstsq(by_u, -a, rcond=None)[0]
    if np.abs(by_u.dot(change) + a).max() > _AT_REST * max(1.0, float(np.abs(a).max())):
        return motion, False
    efforts = np.concatenate([motion.u, [u + change]])
    times = np.append(motion.times, last.t)
    return ReferenceMotion(times, [*motion.states, last], efforts), True


def crossings_of(scene: Scene) -> tuple[Crossing, ...]:
    """Return functions of the contact forces that are positive while contacts push and stick."""
    if not scene.phases:
        return ()
    return tuple(demand.crossing for demand in build_phased_system(scene).phases[0].demands)


def _usual_efforts(u: Array, limits: Array) -> Array:
    """Return the limit of each input, or its largest effort if it has no limit."""
    used = np.abs(u).max(axis=0)
    used = np.maximum(used, _LEAST_EFFORT * used.max()) if used.any() else np.ones(len(used))
    return np.where(np.isfinite(limits), limits, used)


def tolerated_efforts(
    system: Any, crossings: Sequence[Crossing], states: Sequence[State], u: Array
) -> Array:
    """Return deviations of each effort that use a small share of the contact clearance, (k,).

    Args:
        system: System of the phase.
        crossings: Functions of its contact forces; without any, deviations are inf.
        states: States that the system integrates.
        u: Efforts, shape (n, k).
    """
    deviations = np.full(u.shape[1], np.inf)
    step = _EFFORT_STEP * (float(np.abs(u).max()) or 1.0)
    for y, now in zip(states, u, strict=True) if crossings else ():
        clearance = np.maximum(contact_clearance(system, crossings, y, now), 0.0)
        for i, change in enumerate(step * np.eye(len(deviations))):
            inputs = now + change, now - change
            sides = [contact_clearance(system, crossings, y, each) for each in inputs]
            slopes = np.max([np.abs(side - clearance) for side in sides], axis=0) / step
            largest = float((clearance / np.maximum(slopes, TINY)).min())
            deviations[i] = min(deviations[i], _SHARE_OF_CLEARANCE * largest)
    return deviations


def _costs(d: int, efforts: Array, tolerated: Tolerated) -> tuple[Array, Array]:
    """Return the cost matrices: one over the squared tolerated deviations."""
    sizes = np.repeat([tolerated.position, tolerated.velocity], d)
    if tolerated.effort is not None:
        efforts = np.full(len(efforts), tolerated.effort)
    return np.diag(sizes**-2.0), np.diag(efforts**-2.0)


def repeating_cost(times: Array, A: Array, B: Array, Q: Array, R: Array, strike: Array) -> Array:
    """Compute the cost to go of a motion that repeats for ever, shape (n, 2 d, 2 d).

    It is integrated backwards from S(end) = strike' S(begin) strike until it repeats.

    Raises:
        SolveError: It does not settle, since the inputs cannot make the motion stable.
    """
    n, S_end = len(times) - BEFORE + 1, Q
    for _ in range(_MOST_STRIDES):
        S = riccati_backwards(times[:n], A[:n], B[:n], Q, R, S_end)
        before, S_end = S_end, strike.T.dot(S[0]).dot(strike)
        if np.abs(S_end - before).max() <= _SETTLED * np.abs(S_end).max():
            return np.concatenate([S, np.repeat(S[-1:], BEFORE - 1, axis=0)])
    raise SolveError("no gains make the motion stable from step to step")


def strike_slope(
    scene: Scene, times: Array, states: list[State], u: Array, slopes: IndependentSlopes
) -> Array:
    """Differentiate the state after the strike of a foot by a state shortly before it.

    The derivative, shape (2 d, 2 d), includes the change of the time of the strike. It is a
    central difference of simulations with planned efforts, from a few samples before the end.

    Raises:
        DataError: The state after the strike is not the start of the motion.
    """
    simulation, first = build_simulation(scene), states[-BEFORE]
    d = len(slopes.chosen)

    def after(e: Array) -> Array:
        x = _state_after_strike(simulation, times, u, slopes.beside(first, e))
        at = slopes.chosen
        return np.concatenate([(x.q - states[0].q)[at], (x.v - states[0].v)[at]])

    if np.abs(after(np.zeros(2 * d))).max() > _LARGEST_GAP:
        raise DataError("the motion does not repeat: its start is not the state after its end")
    steps = _STRIKE_STEP * np.eye(2 * d)
    return np.stack([(after(e) - after(-e)) / (2.0 * _STRIKE_STEP) for e in steps], axis=1)


def _state_after_strike(simulation: Any, times: Array, u: Array, y: State) -> State:
    """Simulate with planned efforts up to the strike, and return the state just after it."""
    period = float(times[-1] - times[-2]) / _HOLDS
    y = simulation.start(simulation.system.systems[0].expand(y))
    simulation.stepper.take_events()
    while y.t < _LATEST_STRIKE * times[-1]:
        middle = y.t + 0.5 * period
        efforts = np.array([np.interp(middle, times, column) for column in u.T])
        y = simulation.advance(y, efforts, y.t + period)
        for event in simulation.stepper.take_events():
            after: State = event.after
            return after
    raise DataError("the phase of the motion does not come to its end")


def _names(scene: Scene) -> list[str]:
    """Return the independent joints in the order in which the system integrates them."""
    names = scene.couplings.independent
    places = IndependentCoordinates(scene.robot, scene.couplings).joint_w
    return [names[i] for i in np.argsort(places)]


def _unit_level(S: Array, costs: Array) -> float:
    """Return the mean cost to go of one tolerated deviation."""
    return float((np.einsum("nii->ni", S) / costs).mean())


class ReferenceMotion(NamedTuple):
    """States that the system integrates, at times [s], and their efforts."""

    times: Array
    states: list[State]
    u: Array


class Tolerated(NamedTuple):
    """Tolerated deviations, which have equal costs.

    Attributes:
        position: Deviation of positions [rad or m].
        velocity: Deviation of velocities [rad/s or m/s].
        effort: Deviation of efforts [N·m or N]; None for the limit of each input, or its largest
            effort in the motion.
    """

    position: float = 0.1
    velocity: float = 1.0
    effort: float | None = None


class RegulatedMotion(NamedTuple):
    """A plan, and the quantities that the search for its tube needs.

    Attributes:
        plan: The plan, still without a tube.
        disturbed: Simulation of motions beside the plan.
        rests: Whether the motion ends at rest and can be held there.
        fastest: Fastest rate of the closed loop [1/s].
        widest: Cost to go at which the search starts.
    """

    plan: TrackingPlan
    disturbed: DisturbedMotion
    rests: bool
    fastest: float
    widest: float


def riccati_backwards(times: Array, A: Array, B: Array, Q: Array, R: Array, S_end: Array) -> Array:
    """Integrate the cost to go of a linear motion from its end to its start.

        -S' = A' S + S A - S B R^-1 B' S + Q,   S(end) = S_end

    for x' = A x + B u, linear between samples, with the cost x'Q x + u'R u. S = Y X^-1, where X
    and Y follow the linear Hamiltonian system, so that a large S needs no short steps.

    Source: H. Kwakernaak, R. Sivan, Linear Optimal Control Systems, 1972, sec. 3.3.

    Args:
        times: Increasing times [s], shape (n,).
        A: Derivatives by the states, shape (n, m, m).
        B: Derivatives by the inputs, shape (n, m, k).
        Q: Cost of states, symmetric, shape (m, m).
        R: Cost of inputs, symmetric, positive definite, shape (k, k).
        S_end: Cost of the last state, shape (m, m).

    Returns:
        S, symmetric, shape (n, m, m).

    Raises:
        SolveError: The equation needs too many steps.
    """
    scale = _balance(B, Q, R)
    H = np.stack([_hamiltonian(a, b, Q, R, scale) for a, b in zip(A, B, strict=True)])
    S = np.empty_like(A)
    S[-1] = 0.5 * (S_end + S_end.T)
    m = A.shape[1]
    for i in range(len(times) - 1, 0, -1):
        begin = np.concatenate([np.eye(m), S[i] / scale])
        Z = _integrate_back(begin, H[i], H[i - 1], float(times[i] - times[i - 1]))
        unsymmetric = scale * np.linalg.solve(Z[:m].T, Z[m:].T)
        S[i - 1] = 0.5 * (unsymmetric + unsymmetric.T)
    return S


def _balance(B: Array, Q: Array, R: Array) -> float:
    """Return the unit of costates for which both parts of the Hamiltonian matrix have one size."""
    pushes = np.abs(B @ np.linalg.solve(R, np.swapaxes(B, 1, 2))).max()
    return math.sqrt(float(np.abs(Q).max() / pushes)) if pushes > 0.0 else 1.0


def _hamiltonian(A: Array, B: Array, Q: Array, R: Array, scale: float) -> Array:
    pushes = B.dot(np.linalg.solve(R, B.T))
    return np.block([[A, -scale * pushes], [-Q / scale, -A.T]])


def _integrate_back(Z: Array, H_late: Array, H_early: Array, length: float) -> Array:
    """Integrate Z' = H Z backwards through an interval by the classical Runge-Kutta method.

    Raises:
        SolveError: The interval needs too many steps.
    """
    size = max(np.abs(H_late).sum(axis=1).max(), np.abs(H_early).sum(axis=1).max())
    count = max(1, math.ceil(length * size / _STEP))
    if count > _MOST_STEPS:
        raise SolveError(f"the Riccati equation changes too fast: {count} steps in {length:g} s")
    h, slope = -length / count, (H_early - H_late) / count
    m = Z.shape[1]
    for j in range(count):
        begin = H_late + j * slope
        middle, end = begin + 0.5 * slope, begin + slope
        k1 = begin.dot(Z)
        k2 = middle.dot(Z + 0.5 * h * k1)
        k3 = middle.dot(Z + 0.5 * h * k2)
        k4 = end.dot(Z + h * k3)
        Z = Z + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
        Z = Z / np.abs(Z[:m]).max()  # S = Y X^-1 does not depend on the length of Z
    return Z


def riccati_steady(A: Array, B: Array, Q: Array, R: Array) -> Array | None:
    """Solve A' S + S A - S B R^-1 B' S + Q = 0 for the S that makes the closed loop stable.

    S follows from the stable subspace of the Hamiltonian matrix.

    Source: J. E. Potter, SIAM J. Appl. Math. 14, 1966, 496-501.

    Args:
        A: Derivative by the state, shape (m, m).
        B: Derivative by the inputs, shape (m, k).
        Q: Cost of states, symmetric, shape (m, m).
        R: Cost of inputs, symmetric, positive definite, shape (k, k).

    Returns:
        S, shape (m, m); None if the inputs cannot make the motion stable.
    """
    m, scale = len(A), _balance(B[None], Q, R)
    H = _hamiltonian(A, B, Q, R, scale)
    values, vectors = np.linalg.eig(H)
    stable = vectors[:, np.argsort(values.real)[:m]]
    try:
        S = np.real(np.linalg.solve(stable[:m].T, stable[m:].T))
    except np.linalg.LinAlgError:
        return None
    S = 0.5 * scale * (S + S.T)
    gain = np.linalg.solve(R, B.T.dot(S))
    residual = A.T.dot(S) + S.dot(A) - gain.T.dot(R).dot(gain) + Q
    is_solved = np.abs(residual).max() <= _RESIDUAL * (np.abs(A.T.dot(S)).max() + np.abs(Q).max())
    is_stable = bool((np.linalg.eigvals(A - B.dot(gain)).real < 0.0).all())
    return S if is_solved and is_stable and np.linalg.eigvalsh(S)[0] >= 0.0 else None


def check_scene(scene: Scene) -> None:
    """Refuse scenes that the regulator does not cover.

    Raises:
        DataError: The scene has a free base, internal states, several phases, or an actuator that
            does not take the torque of its joint.
    """
    if scene.robot.floating or scene.internals.names or len(scene.phases or ()) > 1:
        raise DataError(
            f"{scene.name}: follow needs fixed bases, no internal states and at most one phase"
        )
    others = [actuator.name for actuator in scene.actuators if actuator.takes]
    if others or not scene.actuators:
        reason = f"{', '.join(others)} do not" if others else "the scene has none"
        raise DataError(
            f"{scene.name}: follow needs actuators that take the torque of their joint; {reason}"
        )


def read_reference(scene: Scene, motion: Source) -> ReferenceMotion:
    """Read a motion as states that the system of a scene integrates.

    Raises:
        DataError: Positions, velocities or efforts are missing.
    """
    robot, couplings = scene.robot, scene.couplings
    names, driven = couplings.independent, scene.actuated
    every = tuple(dict.fromkeys((*names, *driven)))
    recording = read_motion(motion, every, required=names, sliding=robot.prismatic_joints).motion
    if recording.velocity is None or np.isnan(recording.velocity[:, : len(names)]).any():
        raise DataError(f"the motion has no velocities of {', '.join(names)}")
    places = [every.index(name) for name in driven]
    columns = [e[:, places] for e in (recording.command, recording.effort) if e is not None]
    complete = [efforts for efforts in columns if np.isfinite(efforts).all()]
    if not complete or len(recording.stamps) < 2:
        raise DataError(
            f"the motion needs two or more samples with efforts of {', '.join(driven)}"
        )
    at = IndependentCoordinates(robot, couplings)
    y, w = np.zeros((2, len(recording.stamps), len(names)))
    y[:, at.joint_y] = recording.position[:, : len(names)]
    w[:, at.joint_w] = recording.velocity[:, : len(names)]
    times = recording.stamps * NANOSECOND
    states = [State(float(t), *pair) for t, *pair in zip(times, y, w, strict=True)]
    return ReferenceMotion(times, states, complete[0])
