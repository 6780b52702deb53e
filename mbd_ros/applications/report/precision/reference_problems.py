"""Published mechanisms with known motion: their scenes, outputs and scores."""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array, State
from mbd_ros.errors import MbdError

Outputs = Callable[[Robot, State], Array]
SCENES = "package://mbd_ros/config/scenes/benchmark"
_TIME_TOLERANCE = 1e-9  # s; sums of steps are no further from a sample


class Reference(NamedTuple):
    """Known motion of a problem.

    Attributes:
        source: Where the problem and the numbers come from.
        times: Samples, the last at the end [s], shape (n,).
        values: Outputs at the samples, shape (n, outputs).
        low: Largest error of low precision.
        high: Largest error of high precision.
        energy: Energy at the start [J], springs included; None where none is given.
    """

    source: str
    times: Array
    values: Array
    low: float
    high: float
    energy: float | None


class Problem(NamedTuple):
    """One scene and how its motion is scored.

    Attributes:
        name: Name of the scene file, without `.yaml`.
        reference: Key of its reference; several scenes may share one.
        outputs: State of all joints -> outputs of the reference.
        relative: Whether the error is the largest one relative to the reference at the last sample
            (10^-scd of the Test Set for IVP Solvers) instead of the largest absolute one of all.
    """

    name: str
    reference: str
    outputs: Outputs
    relative: bool = False

    @property
    def scene(self) -> str:
        """The scene file, for `load_scene`."""
        return f"{SCENES}/{self.name}.yaml"


def reference(key: str) -> Reference:
    """Reference of that key in `reference_values.json`."""
    entry = _entries()[key]
    return Reference(
        source=entry["source"],
        times=np.array(entry["times"], dtype=np.float64),
        values=np.array(entry["values"], dtype=np.float64),
        low=entry["low"],
        high=entry["high"],
        energy=entry.get("energy"),
    )


def at_times(states: Iterable[State], times: Sequence[float] | Array) -> list[State]:
    """Those of a run whose time is a sample.

    Args:
        states: A run, in the order of time.
        times: Samples [s], increasing.

    Raises:
        MbdError: The run has no state at a sample; the message names it.
    """
    wanted = list(times)
    samples: list[State] = []
    for x in states:
        if len(samples) < len(wanted) and abs(x.t - wanted[len(samples)]) <= _TIME_TOLERANCE:
            samples.append(x)
    if len(samples) < len(wanted):
        raise MbdError(f"the run has no state at {wanted[len(samples)]:g} s")
    return samples


def error(problem: Problem, robot: Robot, states: Sequence[State]) -> float:
    """Error of a run, to be compared with `low` and `high` of the reference.

    Args:
        robot: Robot of its scene.
        states: States of all joints at the first samples of the reference (or at all).
    """
    values = reference(problem.reference).values[: len(states)]
    computed = np.array([problem.outputs(robot, x) for x in states])
    if problem.relative:
        return float(np.max(np.abs(computed[-1] / values[-1] - 1)))
    return float(np.max(np.abs(computed - values)))


@cache
def _entries() -> dict[str, dict[str, Any]]:
    text = Path(__file__).with_name("reference_values.json").read_text(encoding="utf-8")
    entries: dict[str, dict[str, Any]] = json.loads(text)
    return entries


def _sums(*groups: str) -> Outputs:
    """Sums of joint positions, each as `joint + joint`: absolute angles [rad] or positions [m]."""
    names = [group.split(" + ") for group in groups]

    def outputs(robot: Robot, x: State) -> Array:
        return np.array([sum(x.q[robot.joint(name).q] for name in group) for group in names])

    return outputs


def _rates(*names: str) -> Outputs:
    """Velocities of joints [m/s or rad/s]."""

    def outputs(robot: Robot, x: State) -> Array:
        return np.array([x.v[robot.joint(name).v] for name in names])

    return outputs


def _with_rates(*names: str) -> Outputs:
    """Positions and then velocities of joints [m, m/s]."""
    positions, rates = _sums(*names), _rates(*names)
    return lambda robot, x: np.concatenate([positions(robot, x), rates(robot, x)])


def _points(axes: str, *points: tuple[str, tuple[float, float, float]]) -> Outputs:
    """World coordinates `axes` of points (link, place in its axes) [m]."""
    chosen = ["xyz".index(axis) for axis in axes]

    def outputs(robot: Robot, x: State) -> Array:
        model, data = robot.model, robot.model.createData()
        pin.framesForwardKinematics(model, data, x.q)
        places = [
            data.oMf[robot.frame(link)].act(np.array(place)) + robot.origin
            for link, place in points
        ]
        return np.concatenate([place[chosen] for place in places])

    return outputs


def _crank_angle(offset: float) -> Outputs:
    """Angle of the middle crank of the platform from the downward vertical [rad]."""
    tip = _points("xy", ("platform_link", (-offset, 0.0, 0.0)))

    def outputs(robot: Robot, x: State) -> Array:
        right, up = tip(robot, x)
        return np.array([math.atan2(right, -up)])

    return outputs


_TWO = ("joint_1", "joint_1 + joint_2")
_FOUR_BAR = _sums("crank", "crank + coupler", "crank + coupler + rocker")
_CHAIN_ENDS = (("link_100", (0.0, -0.01, 0.0)), ("link_50", (0.0, -0.01, 0.0)))

PROBLEMS = (
    Problem("a01_pendulum", "a01", _points("xy", ("bar", (0.0, -1.0, 0.0)))),
    Problem("a01_pendulum_maximal", "a01", _sums("x", "y")),
    Problem("a02_four_bars_2", "a02_2", _points("xy", ("crank_link_0", (0.0, 1.0, 0.0)))),
    Problem("a02_four_bars_40", "a02_40", _points("xy", ("crank_link_0", (0.0, 1.0, 0.0)))),
    Problem("a03_andrews", "a03", _points("xy", ("crank", (0.007, 0.0, 0.0)))),
    Problem("ts_andrews", "ts_andrews", _sums(*(f"q{i}" for i in range(1, 8))), relative=True),
    Problem("a04_bricard", "a04", _points("xyz", ("rod_3", (0.0, 0.0, 0.0)))),
    Problem("a05_governor", "a05", _sums("slider")),
    Problem(
        "ts_car_axis",
        "ts_car_axis",
        _with_rates("left_x", "left_y", "right_x", "right_y"),
        relative=True,
    ),
    Problem("p01_spherical_pendulum", "p01", _sums("x", "y", "z")),
    Problem("x01_light_outer", "x01a", _sums(*_TWO)),
    Problem("x01_light_inner", "x01b", _sums(*_TWO)),
    *(Problem(f"x02_four_bar_{k}", f"x02_{k}", _FOUR_BAR) for k in ("1e-2", "1e-4", "1e-6")),
    Problem("x06_chain", "x06", _points("xy", *_CHAIN_ENDS)),
    Problem("x07_light_tip", "x07", _sums(*_TWO, "joint_1 + joint_2 + joint_3")),
    *(Problem(f"x08_elastic_{k}", f"x08_{k}", _sums("hinge")) for k in ("1e4", "1e6", "1e8")),
    Problem("x09_cranks", "x09", _crank_angle(0.0)),
    Problem("x09_cranks_offset", "x09", _crank_angle(0.25)),
    Problem("x11_fast_pendulum", "x11_pendulum", _sums("hinge")),
    Problem("x11_fast_arm", "x11_arm", _sums(*_TWO)),
    Problem("s01_parabola", "s01", _rates("x", "y")),
)
