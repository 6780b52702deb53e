"""Muscle model of Millard et al. (2013)."""

from collections.abc import Sequence
from typing import Annotated, Literal

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.muscles.contraction import Angle, check_sizes, contraction_of
from mbd_ros.core.muscles.millard_curves import (
    MillardCurves,
    active_curve,
    passive_curve,
    tendon_curve,
    velocity_curve,
)
from mbd_ros.core.muscles.muscle import FirstOrder, Muscle
from mbd_ros.core.ranges import SMALLEST, Length, NotNegative, Positive, Unit, Within
from mbd_ros.errors import ModelError

_SHARE = Within(1.0e-6, 0.999)
_MORE = Within(1.001, 100.0)
_CURVINESS = Within(0.0, 1.0)
_POSITIVE = Within(SMALLEST, 1.0e30)


class Millard(Muscle):
    """Hill-type muscle with Bezier curves and a damper in parallel with the fibres.

    The page docs/muscles.md states the equations. The active force vanishes at both ends of its
    curve, as in OpenSim with damping. Fatigue and history dependence are left out.

    Source: M. Millard, T. Uchida, A. Seth, S. L. Delp, Flexing computational muscle: modeling and
    simulation of musculotendon dynamics, J. Biomech. Eng. 135, 2013, 021005,
    doi:10.1115/1.4023390.

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
        damping: Damping of the fibres, relative to peak force over largest speed.
        active_lengths: Fibre lengths, in optimal lengths, at which the active force-length
            curve starts, where its ascent becomes shallow, and where it ends.
        active_slope: Slope of the shallow ascent of that curve.
        passive_zero_strain: Fibre strain at which the passive force starts.
        passive_strain: Fibre strain at which the passive force equals the peak force.
        passive_low_stiffness: Slope of the passive force at the end of its toe region.
        passive_stiffness: Slope of the passive force at the peak force; by default
            2 / (passive_strain - passive_zero_strain).
        passive_curviness: Curviness of the passive force-length curve, 0 .. 1.
        tendon_strain: Tendon strain at which the tendon force equals the peak force.
        tendon_stiffness: Slope of the tendon force beyond its toe region; by default
            1.375 / tendon_strain.
        tendon_toe_force: Tendon force at the end of its toe region, relative to the peak force.
        tendon_curviness: Curviness of the tendon curve, 0 .. 1.
        shortening_slope: Slope of the force-velocity curve near the largest speed of shortening.
        shortening_curviness: Curviness of the shortening half of that curve, 0 .. 1.
        isometric_slope: Slope of the force-velocity curve at velocity 0.
        lengthening_force: Largest force of lengthening fibres, relative to the isometric force.
        lengthening_slope: Slope of the force-velocity curve near the largest speed of lengthening.
        lengthening_curviness: Curviness of the lengthening half of that curve, 0 .. 1.
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
        activation_time: Annotated[Positive, Unit("s")] = 0.01,
        deactivation_time: Annotated[Positive, Unit("s")] = 0.04,
        minimum_activation: Annotated[float, _SHARE, Unit("-")] = 0.01,
        tendon: Literal["elastic", "rigid"] = "elastic",
        damping: Annotated[NotNegative, Unit("-")] = 0.1,
        active_lengths: Annotated[Sequence[float], Length(3), Unit("-")] = (0.4441, 0.73, 1.8123),
        active_slope: Annotated[Positive, Unit("-")] = 0.8616,
        passive_zero_strain: Annotated[float, Unit("-")] = 0.0,
        passive_strain: Annotated[Positive, Unit("-")] = 0.7,
        passive_low_stiffness: Annotated[Positive, Unit("-")] = 0.2,
        passive_stiffness: Annotated[float | None, _POSITIVE, Unit("-")] = None,
        passive_curviness: Annotated[float, _CURVINESS, Unit("-")] = 0.75,
        tendon_strain: Annotated[Positive, Unit("-")] = 0.049,
        tendon_stiffness: Annotated[float | None, _POSITIVE, Unit("-")] = None,
        tendon_toe_force: Annotated[float, _SHARE, Unit("-")] = 2.0 / 3.0,
        tendon_curviness: Annotated[float, _CURVINESS, Unit("-")] = 0.5,
        shortening_slope: Annotated[Positive, Unit("-")] = 0.25,
        shortening_curviness: Annotated[float, _CURVINESS, Unit("-")] = 0.6,
        isometric_slope: Annotated[Positive, Unit("-")] = 5.0,
        lengthening_force: Annotated[float, _MORE, Unit("-")] = 1.4,
        lengthening_slope: Annotated[Positive, Unit("-")] = 0.15,
        lengthening_curviness: Annotated[float, _CURVINESS, Unit("-")] = 0.9,
    ) -> None:
        curves = MillardCurves(
            active_curve(*active_lengths, active_slope),
            passive_curve(
                passive_zero_strain,
                passive_strain,
                passive_low_stiffness,
                passive_stiffness,
                passive_curviness,
            ),
            tendon_curve(tendon_strain, tendon_stiffness, tendon_toe_force, tendon_curviness),
            velocity_curve(
                (shortening_slope, shortening_curviness),
                isometric_slope,
                (lengthening_force, lengthening_slope, lengthening_curviness),
            ),
            damping,
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
        dynamics = FirstOrder(activation_time, deactivation_time, minimum_activation)
        super().__init__(path, contraction, dynamics, tendon)

    @staticmethod
    def check(
        tendon: str,
        tendon_slack_length: float,
        pennation_angle: float,
        maximum_pennation_angle: float,
        damping: float,
        active_lengths: Sequence[float],
        passive_zero_strain: float,
        passive_strain: float,
    ) -> None:
        """Refuse sizes and curves that contradict each other."""
        check_sizes(tendon, tendon_slack_length, pennation_angle, maximum_pennation_angle)
        if tendon == "elastic" and damping <= 0.0:
            raise ModelError("damping is 0, but must be positive with an elastic tendon")
        first, bend, last = active_lengths
        if not 0.0 <= first < bend < 0.95 or not last > 1.1:
            raise ModelError(
                f"active_lengths {list(active_lengths)} must increase, with the second below 0.95 "
                "and the last above 1.1"
            )
        if passive_strain <= passive_zero_strain:
            raise ModelError(
                f"passive_strain {passive_strain:g} must be above passive_zero_strain "
                f"{passive_zero_strain:g}"
            )
