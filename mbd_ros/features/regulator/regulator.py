"""The linear quadratic regulator along a recorded or predicted motion."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.control.contract import EffortBox
from mbd_ros.core.control.independent_slopes import IndependentSlopes
from mbd_ros.core.control.tracking_plan import TrackingPlan
from mbd_ros.core.events.crossings import Crossing
from mbd_ros.core.kinematics.free_bases import IndependentCoordinates
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.regulator.contact_margins import held_room
from mbd_ros.features.regulator.repeated import repeating_cost, strike_slope
from mbd_ros.features.regulator.riccati import riccati_backwards, riccati_steady
from mbd_ros.features.regulator.tracking_tube import DisturbedMotion
from mbd_ros.motion.recordings import Source, read_motion
from mbd_ros.scene.built_scene import Scene

# What contacts that a phase holds leave to the efforts of a motion.

_STEP = 1.0e-4  # of the largest effort: forces are straight lines of efforts, cones have an apex
_SHARE = 0.05  # of the room: several inputs act at once, and positions are off besides


def crossings_of(scene: Scene) -> tuple[Crossing, ...]:
    """Numbers of the forces of held contacts, positive while they push and stick."""
    if not scene.phases:
        return ()
    return tuple(one.crossing for one in scene.phased_system().phases[0].demands)


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
    step = _STEP * (float(np.abs(u).max()) or 1.0)
    for y, now in zip(states, u, strict=True) if crossings else ():
        room = np.maximum(held_room(system, crossings, y, now), 0.0)
        for i, way in enumerate(step * np.eye(len(found))):
            sides = [held_room(system, crossings, y, now + sign * way) for sign in (1.0, -1.0)]
            slopes = np.max([np.abs(one - room) for one in sides], axis=0) / step
            found[i] = min(found[i], _SHARE * float((room / np.maximum(slopes, TINY)).min()))
    return found


_STILL = 1.0e-3  # velocity of a plan that ends at rest, over its largest
_SOON = 1.0e-3  # s, after the end of a motion until its last state is held
_WIDEST = 10.0  # times the tolerated deviations, where the search of a tube begins
_SMALL = 1.0e-6  # share of the largest effort that an input is taken to have at least


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


class Recorded(NamedTuple):
    """A motion in what the system integrates, at times [s], with its efforts."""

    times: Array
    states: list[State]
    u: Array


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


def _system(scene: Scene) -> Any:
    """With exact derivatives where these can be compiled; that of its phase, where it has one."""
    from mbd_ros.scene.runs.compiled_system import compiled_system

    if scene.phases:
        return scene.phased_system().systems[0]
    try:
        return compiled_system(scene)
    except ModelError:
        return scene.system()


def recorded(scene: Scene, motion: Source) -> Recorded:
    """The motion of a file, in what the system of a scene integrates.

    Raises:
        DataError: It lacks positions, velocities or efforts.
    """
    robot, couplings = scene.robot, scene.couplings
    names, driven = couplings.independent, scene.actuated
    every = tuple(dict.fromkeys((*names, *driven)))
    found = read_motion(motion, every, required=names, sliding=robot.sliding).motion
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


def regulated(scene: Scene, motion: Recorded, tolerated: Tolerated) -> Regulated:
    """Gains along a motion, see `follow`.

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


def _usual_efforts(u: Array, limits: Array) -> Array:
    """The limit of each input, or else its largest effort."""
    used = np.abs(u).max(axis=0)
    used = np.maximum(used, _SMALL * used.max()) if used.any() else np.ones(len(used))
    return np.where(np.isfinite(limits), limits, used)


def _costs(d: int, efforts: Array, tolerated: Tolerated) -> tuple[Array, Array]:
    """Costs of states and efforts: one over the squares of what is tolerated."""
    sizes = np.repeat([tolerated.position, tolerated.velocity], d)
    if tolerated.effort is not None:
        efforts = np.full(len(efforts), tolerated.effort)
    return np.diag(sizes**-2.0), np.diag(efforts**-2.0)


def _held(system: Any, motion: Recorded) -> tuple[Recorded, bool]:
    """The motion with its last state held once more, where efforts can, and whether they can."""
    last, u = motion.states[-1], motion.u[-1]
    speeds = np.abs(np.stack([y.v for y in motion.states]))
    if np.abs(last.v).max() > _STILL * speeds.max():
        return motion, False
    a = np.zeros(system.nv)
    last = last._replace(t=last.t + _SOON, v=0.0 * last.v)
    system.accelerator()(last.t, last.q, last.v, u, a)
    by_u = system.derivatives(last, u).u
    change = np.linalg.lstsq(by_u, -a, rcond=None)[0]
    if np.abs(by_u.dot(change) + a).max() > _STILL * max(1.0, float(np.abs(a).max())):
        return motion, False
    held = np.concatenate([motion.u, [u + change]])
    return Recorded(np.append(motion.times, last.t), [*motion.states, last], held), True


def _names(scene: Scene) -> list[str]:
    """Independent joints in the order of what the system integrates."""
    names = scene.couplings.independent
    places = IndependentCoordinates(scene.robot, scene.couplings).joint_w
    return [names[i] for i in np.argsort(places)]


def _unit_level(S: Array, costs: Array) -> float:
    """Mean cost to go of one tolerated deviation."""
    return float((np.einsum("nii->ni", S) / costs).mean())
