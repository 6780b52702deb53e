"""Muscle model of De Groote and Fregly (2016)."""

from typing import Annotated, Literal

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.muscles.contraction import Angle, check_sizes, contraction_of
from mbd_ros.core.muscles.degroote_fregly_curves import DeGrooteFreglyCurves
from mbd_ros.core.muscles.muscle import Muscle, SmoothFirstOrder
from mbd_ros.core.ranges import NotNegative, Positive, Unit, Within

_SHARE = Within(1.0e-6, 0.999)


class DegrooteFregly(Muscle):
    """Hill-type muscle whose curves are smooth to any order, for optimal control.

    The page docs/muscles.md states the equations. Fatigue and history dependence are left out.

    Source: F. De Groote, A. L. Kinney, A. V. Rao, B. J. Fregly, Evaluation of direct collocation
    optimal control problem formulations for solving the muscle redundancy problem, Ann. Biomed.
    Eng. 44, 2016, 2922-2936, doi:10.1007/s10439-016-1591-9.

    Args:
        path: Path of the muscle: the name of a path of the scene, or the entry of a path.
        max_isometric_force: Largest active force of the fibres at constant length (peak force).
        optimal_fiber_length: Fibre length at which the fibres exert the peak force.
        tendon_slack_length: Length up to which the tendon is slack.
        pennation_angle: Angle between tendon and fibres of optimal length.
        maximum_pennation_angle: Pennation angle at which the fibres stop shortening.
        max_contraction_velocity: Largest speed of shortening [optimal fibre lengths per second].
        activation_time: Time constant of rising activation.
        deactivation_time: Time constant of falling activation.
        minimum_activation: Lower bound of the activation.
        tendon: `elastic`, with the fibre length as an internal state, or `rigid`.
        active_width: Factor on the width of the active force-length curve.
        passive_shape: Exponent of the passive force-length curve.
        passive_strain: Fibre strain at which the passive force equals the peak force.
        tendon_strain: Tendon strain at which the tendon force equals the peak force.
        damping: Damping of the fibres, relative to peak force over largest speed.
        activation_steepness: Steepness of the transition between the two time constants.
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
