"""Robots and control laws of the demo, and how each robot is moved and controlled."""

from typing import NamedTuple


class DemoRobot(NamedTuple):
    """A robot of the demo; sequences have one value an actuated joint, in their order.

    Attributes:
        title: For people.
        scene: Scene with actuators.
        size: Amplitude of the reference [rad].
        speed: Angular frequency of the reference [rad/s].
        gain: Reaching gain of sliding_mode [rad/s^2]: above what a wrong model and the
            disturbance accelerate, see `docs/demo.md`.
        disturbance_rate: L of super_twisting [rad/s^3].
    """

    title: str
    scene: str
    size: tuple[float, ...]
    speed: tuple[float, ...]
    gain: tuple[float, ...]
    disturbance_rate: tuple[float, ...]


WALKING = "swing of a leg with nine muscles, from markers to the load of the knee"
TWIN = "press with one encoder, its digital twin, and faults that are named"
LAWS = {  # law -> node that has it
    "sliding_mode": "sliding_mode_controller",
    "super_twisting": "sliding_mode_controller",
    "computed_torque": "sliding_mode_controller",
    "gravity_compensation": "sliding_mode_controller",
    "qp_tracking": "qp_controller",
}
_SCENES = "package://mbd_ros/config/scenes"
ROBOTS = {
    "arm": DemoRobot(
        "prosthetic arm with a tendon-coupled elbow",
        f"{_SCENES}/controlled_arm.yaml",
        size=(0.35, 0.3, 0.5, 0.4),
        speed=(1.6, 1.2, 2.0, 2.4),
        gain=(30.0, 30.0, 200.0, 200.0),
        disturbance_rate=(100.0, 100.0, 600.0, 600.0),
    ),
    "leg": DemoRobot(
        "above-knee prosthesis with a sliding knee centre",
        f"{_SCENES}/controlled_leg.yaml",
        size=(0.3, 0.45, 0.2),
        speed=(2.0, 2.4, 2.8),
        gain=(40.0, 100.0, 200.0),
        disturbance_rate=(200.0, 400.0, 600.0),
    ),
    "four_bar": DemoRobot(
        "above-knee prosthesis with a four-bar knee",
        f"{_SCENES}/controlled_four_bar.yaml",
        size=(0.3, 0.35, 0.2),
        speed=(2.0, 2.4, 2.8),
        gain=(60.0, 150.0, 200.0),
        disturbance_rate=(200.0, 500.0, 600.0),
    ),
    "panda": DemoRobot(
        "7-joint arm",
        f"{_SCENES}/controlled_arm7.yaml",
        size=(0.6, 0.4, 0.5, 0.5, 0.6, 0.5, 0.6),
        speed=(1.2, 1.0, 1.4, 1.3, 1.6, 1.5, 1.8),
        gain=(80.0, 50.0, 80.0, 120.0, 100.0, 300.0, 100.0),
        disturbance_rate=(200.0, 200.0, 200.0, 400.0, 300.0, 900.0, 300.0),
    ),
}
