"""The `estimate` section of a task file: what is estimated of a scene, and from what."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from mbd_ros.core.ranges import LARGEST, SMALLEST, NotNegative, Positive, Unit, Within
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema

Inputs = Literal["efforts", "commands", "none"]


@dataclass(frozen=True)
class EstimateTask:
    """What is estimated, and from what.

    Args:
        estimator: `type` and arguments of an estimator.
        inputs: What moves the mechanism: measured efforts on its joints, commands of its
            actuators, or nothing.
        disturbance: Joints with an unknown effort; None for all that can be told apart, empty for
            none.
        model_noise: Density of the accelerations that the model leaves out.
        disturbance_noise: Density of the change of unknown efforts, as accelerations that they
            cause; of the change of their rates, where they drift.
        drifting: Whether unknown efforts have rates, which are estimated too.
        lag: How long after a sample measurements still count for its estimate, offline and with
            the Kalman filter: None for all that follow, 0 for none.
        position_noise: Deviation of positions of joint states without a sensor in the scene.
        velocity_noise: Of their velocities.
        position_deviation: Of positions at the start.
        velocity_deviation: Of velocities at the start.
        parameters: Numbers of the scene that are estimated, and the deviation with which each is
            known: `<force>.<argument>`, `<link>.mass`, `<frame>.payload` for a mass that it
            carries, `<sensor>.offset`.
        parameter_time: In which such a number may change by its deviation.
        limits: Whether joints keep their limits, where an estimator has bounds.
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


def build_task(site: Site, given: Any) -> EstimateTask:
    """The `estimate` section of a task file.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    task: EstimateTask = schema.call(EstimateTask, given, site.where)
    return task
