"""States that are no longer finite: what is lost, where it was last, and why."""

import numpy as np

from mbd_ros.core.dynamics.mass_check import check_mass
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, SolveError

_SHOWN = 8  # joints in a message
_COUNTED = 1.0e150  # whose squares are numbers
_IN_REACH = 1.0e6  # rad or m: where a mass matrix still says something of the robot


def divergence(system: System, y: State, after: State) -> DivergedError:
    """The error of a step from a finite state to one that is not."""
    return DivergedError(
        f"diverged at t = {after.t:.9g} s: {_lost(system, after)}; {last_finite(system, y)}; "
        f"{_advice(system, y)}"
    )


def _advice(system: System, y: State) -> str:
    try:
        if np.abs(y.q).max(initial=0.0) < _IN_REACH:  # else rounding speaks, not the robot
            check_mass(system, y.q)
    except SolveError as error:
        return str(error)
    return "try a smaller dt"


def _lost(system: System, after: State) -> str:
    lost = int(np.count_nonzero(~np.isfinite(after.v)))
    if lost:
        return f"{lost} of {len(after.v)} velocities are not finite"
    states = zip(system.internals.names, (np.abs(after.z) < _COUNTED).tolist(), strict=True)
    names = [name for name, is_counted in states if not is_counted]
    if names:
        return f"{', '.join(names[:_SHOWN])} beyond all numbers"
    return "positions or velocities are beyond all numbers"


def last_finite(system: System, y: State) -> str:
    """The fastest joint or free body, time and positions of the last finite state."""
    x, robot = system.expand(y), system.robot
    speeds = {joint.name: (float(x.v[joint.v]), "joint") for joint in robot.joints}
    places = [f"{joint.name} {x.q[joint.q]:.4g}" for joint in robot.joints[:_SHOWN]]
    for base in robot.bases:
        from mbd_ros.core.kinematics.free_bases import world_pose  # only where something flies

        fastest = max(x.v[base.v].tolist(), key=abs)
        speeds[base.name] = fastest, "free body"
        place = world_pose(robot, x.q[base.q])[:3]
        places.append(f"{base.name} {', '.join(f'{one:.4g}' for one in place.tolist())}")
    name = max(speeds, key=lambda one: abs(speeds[one][0]))
    speed, kind = speeds[name]
    more = ", .." if len(speeds) > _SHOWN else ""
    return (
        f"last finite state at t = {y.t:.9g} s: fastest {kind} {name} with {speed:.3g}/s; "
        f"positions {', '.join(places[:_SHOWN])}{more}"
    )
