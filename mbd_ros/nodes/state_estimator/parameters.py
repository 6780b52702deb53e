"""Parameters of the node `state_estimator`."""

import math
from collections.abc import Sequence
from typing import Any

from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import Tracker
from mbd_ros.nodes.shell.parameters import (
    Parameter,
    ParameterError,
    constructor_parameters,
    stream_parameters,
)
from mbd_ros.parts.estimators.moving_horizon import MovingHorizon

_TASK = (
    *("model_noise", "disturbance_noise", "position_noise", "velocity_noise"),
    *("position_deviation", "velocity_deviation", "parameter_time", "limits"),
)
TRACKER = ("memory", "patience", "max_age", "gate", "agility")
_HORIZON = ("samples", "iterations")
ESTIMATION = (
    *stream_parameters("scene", "allow_code", "timeout", "clock_tolerance"),
    Parameter(
        "estimator",
        str,
        "How states are estimated.",
        "extended_kalman",
        choices=("extended_kalman", "moving_horizon"),
    ),
    Parameter(
        "inputs",
        str,
        "What moves the mechanism: efforts that joint states carry, commands of its actuators on "
        "`joint_commands`, or nothing.",
        "efforts",
        choices=("efforts", "commands", "none"),
    ),
    Parameter(
        "measured",
        list[str],
        "Joints whose positions count; empty for all that joint states carry.",
        (),
    ),
    Parameter(
        "velocities",
        bool,
        "Whether velocities of joint states count as measured, beside positions.",
        False,
    ),
    Parameter(
        "disturbances",
        bool,
        "Whether there are unknown efforts on as many joints as can be told apart.",
        True,
    ),
    Parameter(
        "parameters",
        list[str],
        "Numbers of the scene that are estimated, and how well each is known: "
        "`<name>=<deviation>`, such as `hand.payload=1.0`, `knee_friction.viscous=0.1` or "
        "`crank_encoder.offset=0.01`.",
        (),
    ),
    Parameter(
        "covariance",
        bool,
        "Whether the whole covariance is published on `~/covariance`.",
        False,
    ),
    *constructor_parameters(EstimateTask, {name: name for name in _TASK}),
    *constructor_parameters(Tracker, {name: name for name in TRACKER}, skip=2),
    *constructor_parameters(MovingHorizon, {name: f"horizon.{name}" for name in _HORIZON}, skip=1),
    Parameter(
        "wrench_max_age",
        float,
        "Time for which the newest external wrench stands for later samples [s].",
        0.1,
        low=0.0,
        high=10.0,
    ),
    Parameter(
        "deadline",
        float,
        "Time that answers may lag behind the samples before the horizon gives way to the filter, "
        "and answers are flagged [s].",
        0.02,
        low=0.0,
        high=10.0,
        read_only=False,
    ),
    Parameter(
        "failures",
        int,
        "Joint states in a row without an estimate after which the node deactivates.",
        1000,
        low=1,
        high=1_000_000,
        read_only=False,
    ),
)
PARAMETERS = (
    *ESTIMATION,
    Parameter(
        "lag",
        float,
        "Time after a sample during which measurements still count for its estimate, which comes "
        "that much later; with extended_kalman [s].",
        0.0,
        low=0.0,
        high=10.0,
    ),
)


def task_of(values: Any) -> EstimateTask:
    """The estimation task that the parameters describe.

    Raises:
        ParameterError: A text of another form.
    """
    estimator: dict[str, Any] = {"type": values.estimator}
    if values.estimator == "moving_horizon":
        estimator |= {name: getattr(values, f"horizon_{name}") for name in _HORIZON}
    return EstimateTask(
        estimator,
        values.inputs,
        None if values.disturbances else (),
        parameters=_deviations(values.parameters),
        **{name: getattr(values, name) for name in _TASK},
    )


def _deviations(texts: Sequence[str]) -> dict[str, float]:
    deviations = dict[str, float]()
    for text in texts:
        name, _, given = text.rpartition("=")
        try:
            deviations[name.strip()] = deviation = float(given)
        except ValueError:
            deviation = math.nan
        if not name.strip() or not 0.0 < deviation < math.inf:
            raise ParameterError(f"parameters: '{text}', accepted: <name>=<deviation>, > 0")
    return deviations
