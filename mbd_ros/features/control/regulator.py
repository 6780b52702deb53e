"""The linear quadratic regulator along a recorded or predicted motion.

The motion is linearised, x' = A x + B u, at its samples; the cost to go S follows the matrix
Riccati equation backwards,

    -S' = A' S + S A - S B R^-1 B' S + Q,    K = R^-1 B' S

and K is the gain. At the end of the motion S is that of holding the last state for ever, where
efforts can. A motion of one phase that repeats has the S that repeats with it,
S(end) = strike' S(begin) strike, with the derivative `strike` of the state after a strike by the
one before it.

Contacts that a phase holds leave efforts a room before they open or slip; the costs of efforts
keep to a small share of it.
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
from mbd_ros.features.control.tracking_tube import DisturbedMotion, held_room
from mbd_ros.methods.control.contract import EffortBox
from mbd_ros.methods.control.tracking_plan import IndependentSlopes, TrackingPlan
from mbd_ros.methods.events.crossings import Crossing
from mbd_ros.motion.recordings import Source, read_motion
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.phased_systems import build_phased_system
from mbd_ros.scene.runs.simulation import build_simulation

_STEP = 0.1  # length of a step times the size of the Hamiltonian matrix: errors of 1e-7
_RESIDUAL = 1.0e-6  # share of the Hamiltonian matrix that the steady equation may leave
_MOST_STEPS = 100_000  # between two samples of a motion
BEFORE = 4  # samples before the end, from which deviations are followed through the strike
_STRIKE_STEP = 1.0e-4  # of a deviation
_LARGEST_GAP = 1.0e-2  # deviation with which a motion counts as one that begins anew
_HOLDS = 4  # of an interval between samples, in each of which efforts are held
_LATEST_STRIKE = 1.2  # durations until a strike must have come
_SETTLED = 1.0e-6  # relative change of costs that repeat
_MOST_STRIDES = 200  # until they do
_EFFORT_STEP = 1.0e-4  # of the largest effort: forces are linear in efforts, cones are not
_SHARE_OF_ROOM = 0.05  # of the room: several inputs act at once, and positions are off besides
_AT_REST = 1.0e-3  # velocity of a plan that ends at rest, over its largest
_HOLD_AFTER = 1.0e-3  # s, after the end of a motion until its last state is held
_WIDEST = 10.0  # times the tolerated deviations, where the search of a tube begins
_LEAST_EFFORT = 1.0e-6  # share of the largest effort that an input is taken to have at least


def regulated(scene: Scene, motion: Recorded, tolerated: Tolerated) -> Regulated:
    """The plan of a motion with gains that lead back to it.

    Raises:
        ModelError: Loops come too near to a toggle.
        SolveError: The motion changes too fast.
    """
    system = _system(scene)
    (times, states, u), can_hold = (motion, False) if scene.phases else _held(system, motion)
    slopes = IndependentSlopes(system, states)
    pairs = [slopes.at(y, one) for y, one in zip(states, u, strict=True)]
    A, B = (np.stack(list(each)) for each in zip(*pairs, strict=True))
    limits = np.concatenate([one.limits() for one in scene.actuators])
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
    given = system, states, plan, slopes, EffortBox(-limits, limits), duration * rests
    fastest = float(np.abs(np.linalg.eigvals(A - B @ gain)).max())
    widest = _WIDEST**2 * _unit_level(S, np.diag(Q))
    return Regulated(plan, DisturbedMotion(*given, demands), rests, fastest, widest)


def _system(scene: Scene) -> Any:
    """With exact derivatives where these can be compiled; that of its phase, where it has one."""
    from mbd_ros.scene.runs.compiling import compiled_system

    if scene.phases:
        return build_phased_system(scene).systems[0]
    try:
        return compiled_system(scene)
    except ModelError:
        return scene.system()


def _held(system: Any, motion: Recorded) -> tuple[Recorded, bool]:
    """The motion with its last state held once more, where efforts can, and whether they can."""
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
    held = np.concatenate([motion.u, [u + change]])
    return Recorded(np.append(motion.times, last.t), [*motion.states, last], held), True


def crossings_of(scene: Scene) -> tuple[Crossing, ...]:
    """Numbers of the forces of held contacts, positive while they push and stick."""
    if not scene.phases:
        return ()
    return tuple(one.crossing for one in build_phased_system(scene).phases[0].demands)


def _usual_efforts(u: Array, limits: Array) -> Array:
    """The limit of each input, or else its largest effort."""
    used = np.abs(u).max(axis=0)
    used = np.maximum(used, _LEAST_EFFORT * used.max()) if used.any() else np.ones(len(used))
    return np.where(np.isfinite(limits), limits, used)


def tolerated_efforts(
    system: Any, crossings: Sequence[Crossing], states: Sequence[State], u: Array
) -> Array:
    """Deviations of each effort that use up a small share of the room, shape (k,); inf without.

    Args:
        system: Of the phase.
        crossings: Of its contacts.
        states: Of what it integrates.
        u: Efforts, shape (n, k).
    """
    found = np.full(u.shape[1], np.inf)
    step = _EFFORT_STEP * (float(np.abs(u).max()) or 1.0)
    for y, now in zip(states, u, strict=True) if crossings else ():
        room = np.maximum(held_room(system, crossings, y, now), 0.0)
        for i, way in enumerate(step * np.eye(len(found))):
            sides = [held_room(system, crossings, y, now + sign * way) for sign in (1.0, -1.0)]
            slopes = np.max([np.abs(one - room) for one in sides], axis=0) / step
            found[i] = min(
                found[i], _SHARE_OF_ROOM * float((room / np.maximum(slopes, TINY)).min())
            )
    return found


def _costs(d: int, efforts: Array, tolerated: Tolerated) -> tuple[Array, Array]:
    """Costs of states and efforts: one over the squares of what is tolerated."""
    sizes = np.repeat([tolerated.position, tolerated.velocity], d)
    if tolerated.effort is not None:
        efforts = np.full(len(efforts), tolerated.effort)
    return np.diag(sizes**-2.0), np.diag(efforts**-2.0)


def repeating_cost(times: Array, A: Array, B: Array, Q: Array, R: Array, strike: Array) -> Array:
    """Cost to go of a motion that repeats for ever, shape (n, 2 d, 2 d).

    Backwards from S(end) = strike' S(begin) strike, until it repeats too.

    Raises:
        SolveError: It does not settle: the inputs cannot make the motion stable.
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
    """Deviations with which a step begins by those near the end of the one before.

    The step begins when the foot strikes, whenever that is: shape (2 d, 2 d), by central
    differences of simulations from a few samples before the end, efforts as planned.

    Raises:
        DataError: The motion does not begin anew at its end.
    """
    simulation, first = build_simulation(scene), states[-BEFORE]
    d = len(slopes.chosen)

    def after(e: Array) -> Array:
        x = _struck(simulation, times, u, slopes.beside(first, e))
        at = slopes.chosen
        return np.concatenate([(x.q - states[0].q)[at], (x.v - states[0].v)[at]])

    if np.abs(after(np.zeros(2 * d))).max() > _LARGEST_GAP:
        raise DataError("the motion does not begin anew where its phase ends")
    ways = _STRIKE_STEP * np.eye(2 * d)
    return np.stack([(after(e) - after(-e)) / (2.0 * _STRIKE_STEP) for e in ways], axis=1)


def _struck(simulation: Any, times: Array, u: Array, y: State) -> State:
    """The state just after the strike, of what is integrated, under planned efforts."""
    period = float(times[-1] - times[-2]) / _HOLDS
    y = simulation.start(simulation.system.systems[0].expand(y))
    simulation.stepper.take_events()
    while y.t < _LATEST_STRIKE * times[-1]:
        middle = y.t + 0.5 * period
        held = np.array([np.interp(middle, times, one) for one in u.T])
        y = simulation.advance(y, held, y.t + period)
        for event in simulation.stepper.take_events():
            after: State = event.after
            return after
    raise DataError("the phase of the motion does not come to its end")


def _names(scene: Scene) -> list[str]:
    """Independent joints in the order of what the system integrates."""
    names = scene.couplings.independent
    places = IndependentCoordinates(scene.robot, scene.couplings).joint_w
    return [names[i] for i in np.argsort(places)]


def _unit_level(S: Array, costs: Array) -> float:
    """Mean cost to go of one tolerated deviation."""
    return float((np.einsum("nii->ni", S) / costs).mean())


class Recorded(NamedTuple):
    """A motion in what the system integrates, at times [s], with its efforts."""

    times: Array
    states: list[State]
    u: Array


class Tolerated(NamedTuple):
    """Deviations that cost as much as one another.

    Attributes:
        position: [rad or m].
        velocity: [rad/s or m/s].
        effort: [N·m or N]; None for the limit of each input, or else its largest in the motion.
    """

    position: float = 0.1
    velocity: float = 1.0
    effort: float | None = None


class Regulated(NamedTuple):
    """A plan, and what a search of its tube needs.

    Attributes:
        plan: Without a tube.
        disturbed: Motion beside it.
        rests: Whether it ends at rest, where it can be held.
        fastest: Fastest rate of the loop [1/s].
        widest: Cost to go of deviations that nobody tolerates.
    """

    plan: TrackingPlan
    disturbed: DisturbedMotion
    rests: bool
    fastest: float
    widest: float


def riccati_backwards(times: Array, A: Array, B: Array, Q: Array, R: Array, S_end: Array) -> Array:
    """Cost to go of a linear motion, from its end to its begin.

        -S' = A' S + S A - S B R^-1 B' S + Q,   S(end) = S_end

    of x' = A x + B u, straight lines between samples, with the cost x'Q x + u'R u. S = Y X^-1
    where X and Y follow the linear Hamiltonian system, so that large S need no short steps.
    Source: H. Kwakernaak, R. Sivan, Linear Optimal Control Systems, 1972, sec. 3.3.

    Args:
        times: [s], increasing, shape (n,).
        A: Shape (n, m, m).
        B: Shape (n, m, k).
        Q: Cost of states, symmetric, shape (m, m).
        R: Cost of inputs, symmetric, positive definite, shape (k, k).
        S_end: Cost of the last state, shape (m, m).

    Returns:
        S, symmetric, shape (n, m, m).

    Raises:
        SolveError: It takes too many steps.
    """
    scale = _balance(B, Q, R)
    H = np.stack([_hamiltonian(a, b, Q, R, scale) for a, b in zip(A, B, strict=True)])
    S = np.empty_like(A)
    S[-1] = 0.5 * (S_end + S_end.T)
    m = A.shape[1]
    for i in range(len(times) - 1, 0, -1):
        begin = np.concatenate([np.eye(m), S[i] / scale])
        Z = _carried(begin, H[i], H[i - 1], float(times[i] - times[i - 1]))
        found = scale * np.linalg.solve(Z[:m].T, Z[m:].T)
        S[i - 1] = 0.5 * (found + found.T)
    return S


def _balance(B: Array, Q: Array, R: Array) -> float:
    """Unit of costates in which both parts of the Hamiltonian matrix are of one size."""
    pushes = np.abs(B @ np.linalg.solve(R, np.swapaxes(B, 1, 2))).max()
    return math.sqrt(float(np.abs(Q).max() / pushes)) if pushes > 0.0 else 1.0


def _hamiltonian(A: Array, B: Array, Q: Array, R: Array, scale: float) -> Array:
    pushes = B.dot(np.linalg.solve(R, B.T))
    return np.block([[A, -scale * pushes], [-Q / scale, -A.T]])


def _carried(Z: Array, H_late: Array, H_early: Array, length: float) -> Array:
    """Z' = H Z by the classical Runge-Kutta method, backwards through an interval.

    Raises:
        SolveError: It takes too many steps.
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
    """The S of A' S + S A - S B R^-1 B' S + Q = 0 that makes the loop stable.

    From the stable subspace of the Hamiltonian matrix. Source: J. E. Potter, SIAM J. Appl. Math.
    14, 1966, 496-501.

    Args:
        A: Shape (m, m).
        B: Shape (m, k).
        Q: Cost of states, symmetric, shape (m, m).
        R: Cost of inputs, symmetric, positive definite, shape (k, k).

    Returns:
        Shape (m, m); None where the inputs cannot make the motion stable.
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
    left = A.T.dot(S) + S.dot(A) - gain.T.dot(R).dot(gain) + Q
    is_closed = np.abs(left).max() <= _RESIDUAL * (np.abs(A.T.dot(S)).max() + np.abs(Q).max())
    is_stable = bool((np.linalg.eigvals(A - B.dot(gain)).real < 0.0).all())
    return S if is_closed and is_stable and np.linalg.eigvalsh(S)[0] >= 0.0 else None


def check_scene(scene: Scene) -> None:
    """Refuse what no gains of torques lead.

    Raises:
        DataError: Names what is in the way.
    """
    if scene.robot.floating or scene.internals.names or len(scene.phases or ()) > 1:
        raise DataError(
            f"{scene.name}: a plan leads joints with fixed bases, without internal states, and "
            "through one phase"
        )
    others = [one.name for one in scene.actuators if one.takes]
    if others or not scene.actuators:
        named = f"{', '.join(others)} take something else" if others else "there are none"
        raise DataError(f"{scene.name}: actuators that take the torque of their joint: {named}")


def recorded(scene: Scene, motion: Source) -> Recorded:
    """The motion of a file, in what the system of a scene integrates.

    Raises:
        DataError: It lacks positions, velocities or efforts.
    """
    robot, couplings = scene.robot, scene.couplings
    names, driven = couplings.independent, scene.actuated
    every = tuple(dict.fromkeys((*names, *driven)))
    found = read_motion(motion, every, required=names, sliding=robot.prismatic_joints).motion
    if found.velocity is None or np.isnan(found.velocity[:, : len(names)]).any():
        raise DataError(f"no velocities of {', '.join(names)}")
    lists = [found.command, found.effort]
    given = [one[:, [every.index(name) for name in driven]] for one in lists if one is not None]
    whole = [one for one in given if np.isfinite(one).all()]
    if not whole or len(found.stamps) < 2:
        raise DataError(f"two or more samples with efforts of {', '.join(driven)} are missing")
    at = IndependentCoordinates(robot, couplings)
    y, w = np.zeros((2, len(found.stamps), len(names)))
    y[:, at.joint_y] = found.position[:, : len(names)]
    w[:, at.joint_w] = found.velocity[:, : len(names)]
    times = found.stamps * NANOSECOND
    states = [State(float(t), *pair) for t, *pair in zip(times, y, w, strict=True)]
    return Recorded(times, states, whole[0])
