"""Muscle of De Groote and Fregly 2016."""

from typing import Annotated, Literal

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.muscles.contraction import Angle, check_sizes, contraction_of
from mbd_ros.core.muscles.degroote_fregly_curves import DeGrooteFreglyCurves
from mbd_ros.core.muscles.muscle import Muscle, SmoothFirstOrder
from mbd_ros.core.ranges import NotNegative, Positive, Unit, Within

_SHARE = Within(1.0e-6, 0.999)


class DegrooteFregly(Muscle):
    """Muscle whose curves have derivatives of any order, for optimal control.

    Equations are in docs/muscles.md. Fatigue and history of force are left out.

    Source: F. De Groote, A. L. Kinney, A. V. Rao, B. J. Fregly, Evaluation of direct collocation
    optimal control problem formulations for solving the muscle redundancy problem, Ann. Biomed.
    Eng. 44, 2016, 2922-2936, doi:10.1007/s10439-016-1591-9.

    Args:
        path: What it goes over: the name of a path of the scene, or a path of its own.
        max_isometric_force: Largest force of the active fibres at rest.
        optimal_fiber_length: Fibre length at which they have it.
        tendon_slack_length: Length at which the tendon begins to pull.
        pennation_angle: Between fibres of optimal length and the tendon.
        maximum_pennation_angle: Angle beyond which fibres do not shorten.
        max_contraction_velocity: Largest speed of shortening, in optimal fibre lengths.
        activation_time: Time constant of rising activation.
        deactivation_time: Time constant of falling activation.
        minimum_activation: Least activation.
        tendon: elastic, with fibre length as a state, or rigid.
        active_width: Widens the active force-length curve.
        passive_shape: Exponent of the passive force-length curve.
        passive_strain: Strain of the fibres at which their passive force is the peak force.
        tendon_strain: Strain of the tendon at which its force is the peak force.
        damping: Of the fibres, in peak forces per largest speed.
        activation_steepness: Of the change between the two time constants.
    """

    example = {
        "path": {"points": [{"frame": "world", "xyz": [0.1, 0.0, 1.0]}, {"frame": "foot"}]},
        "max_isometric_force": 600.0,
        "optimal_fiber_length": 0.4,
        "tendon_slack_length": 0.5,
        "pennation_angle": 0.2,
    }

    def __init__(
        self,
        robot: Robot,
        *,
        path: Path,
        max_isometric_force: Annotated[Positive, Unit("N")],
        optimal_fiber_length: Annotated[Positive, Unit("m")],
        tendon_slack_length: Annotated[NotNegative, Unit("m")],
        pennation_angle: Annotated[float, Angle, Unit("rad")] = 0.0,
        maximum_pennation_angle: Annotated[float, Angle, Unit("rad")] = 1.4706289056333368,
        max_contraction_velocity: Annotated[Positive, Unit("1/s")] = 10.0,
        activation_time: Annotated[Positive, Unit("s")] = 0.015,
        deactivation_time: Annotated[Positive, Unit("s")] = 0.06,
        minimum_activation: Annotated[float, _SHARE, Unit("-")] = 0.01,
        tendon: Literal["elastic", "rigid"] = "elastic",
        active_width: Annotated[Positive, Unit("-")] = 1.0,
        passive_shape: Annotated[Positive, Unit("-")] = 4.0,
        passive_strain: Annotated[Positive, Unit("-")] = 0.6,
        tendon_strain: Annotated[Positive, Unit("-")] = 0.049,
        damping: Annotated[NotNegative, Unit("-")] = 0.01,
        activation_steepness: Annotated[Positive, Unit("-")] = 0.1,
    ) -> None:
        curves = DeGrooteFreglyCurves(
            passive_shape, passive_strain, tendon_strain, active_width, damping
        )
        contraction = contraction_of(
            curves,
            max_isometric_force=max_isometric_force,
            optimal_fiber_length=optimal_fiber_length,
            tendon_slack_length=tendon_slack_length,
            max_contraction_velocity=max_contraction_velocity,
            pennation_angle=pennation_angle,
            maximum_pennation_angle=maximum_pennation_angle,
        )
        times = (activation_time, deactivation_time, minimum_activation)
        super().__init__(path, contraction, SmoothFirstOrder(*times, activation_steepness), tendon)

    check = staticmethod(check_sizes)
