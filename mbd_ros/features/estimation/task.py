"""The section `estimate` of a task file: the estimator, its inputs and its unknowns."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import LARGEST, SMALLEST, NotNegative, Positive, Unit, Within
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema

Inputs = Literal["efforts", "commands", "none"]


@dataclass(frozen=True)
class EstimateTask:
    """Options of an estimation.

    Args:
        estimator: `type` and arguments of an estimator.
        inputs: Source of the inputs: measured efforts of joints, commands of actuators, or none.
        disturbance: Joints with an unknown effort; None for as many as can be distinguished, empty
            for none.
        model_noise: Density of the accelerations that the model omits.
        disturbance_noise: Density of the change of unknown efforts, as accelerations that they
            cause; of the change of their rates, if they drift.
        drifting: Whether unknown efforts have rates, which are estimated as well.
        lag: Time after a sample during which measurements improve its estimate, offline and with
            the Kalman filter: None for all later measurements, 0 for none.
        position_noise: Standard deviation of positions in joint states without a sensor in the
            scene.
        velocity_noise: Standard deviation of velocities in joint states.
        position_deviation: Standard deviation of the initial positions.
        velocity_deviation: Standard deviation of the initial velocities.
        parameters: Numbers of the scene to estimate, and their initial standard deviations:
            `<force>.<argument>`, `<link>.mass`, `<frame>.payload` for a mass that it carries,
            `<sensor>.offset`.
        parameter_time: Time in which such a number may change by its deviation.
        limits: Whether joints keep their limits, in estimators with bounds.
    """

    estimator: Mapping[str, Any] = field(default_factory=lambda: {"type": "extended_kalman"})
    inputs: Inputs = "efforts"
    disturbance: Sequence[str] | None = ()
    model_noise: Annotated[Positive, Unit("rad/s^2 s^(1/2)")] = 0.1
    disturbance_noise: Annotated[Positive, Unit("rad/s^2 s^(-1/2)")] = 3.0
    drifting: bool = False
    lag: Annotated[float | None, Within(0.0, 1.0e9), Unit("s")] = None
    position_noise: Annotated[Positive, Unit("rad or m")] = 1.0e-4
    velocity_noise: Annotated[Positive, Unit("rad/s or m/s")] = 0.01
    position_deviation: Annotated[Positive, Unit("rad or m")] = 0.1
    velocity_deviation: Annotated[NotNegative, Unit("rad/s or m/s")] = 10.0
    parameters: Mapping[str, Annotated[float, Within(SMALLEST, LARGEST)]] = field(
        default_factory=dict
    )
    parameter_time: Annotated[Positive, Unit("s")] = 100.0
    limits: bool = True


def build_task(site: Site, entry: Any) -> EstimateTask:
    """Build the `estimate` section of a task file.

    Raises:
        SceneError: An entry is wrong; the message names file, key and what is accepted.
    """
    task: EstimateTask = schema.call(EstimateTask, entry, site.where)
    return task
