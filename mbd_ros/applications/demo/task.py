"""The task of the demo: robots, control laws, a reference against a disturbance."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.methods.control.efforts import MobilityFactor
from mbd_ros.methods.projection.state_projection import ObservedState
from mbd_ros.scene.built_scene import Scene

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
RATE, DISTURBANCE_RATE = 20.0, 50.0  # samples of the reference and of the disturbance [Hz]
DISTURBANCE_SHARE = 0.2  # of the largest gravity torque
MARGIN = 1.0  # s that reference and disturbance outlast the demo
_SECOND_SIZE, _SECOND_SPEED = 0.3, 2.3  # of the second sine, in those of the first


class DemoRobot(NamedTuple):
    """A robot of the demo; sequences have one value an actuated joint, in their order.

    Attributes:
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


def trajectory(robot: DemoRobot, start: Array, duration: float) -> ReferenceTrajectory:
    """Sums of two sines a joint, which begin at rest at `start` and come to speed within 1 s.

        q(t) = start + size (0.7 sin(w T) + 0.3 sin(2.3 w T)),   T' = smooth step of t

    Args:
        robot: Amplitudes and frequencies.
        start: Actuated joints [rad], shape (n,).
        duration: Of the demo [s].
    """
    t = np.arange(round((duration + MARGIN) * RATE) + 1)[:, None] / RATE
    x = np.minimum(t, 1.0)
    warped = x**6 - 3.0 * x**5 + 2.5 * x**4 + (t - x)
    rate = 6.0 * x**5 - 15.0 * x**4 + 10.0 * x**3
    rate_change = 30.0 * x**2 * (1.0 - x) ** 2
    size, w = np.array(robot.size), np.array(robot.speed)
    q, v, a = start + 0.0 * t, 0.0 * w * t, 0.0 * w * t
    for share, factor in ((1.0 - _SECOND_SIZE, 1.0), (_SECOND_SIZE, _SECOND_SPEED)):
        amplitude, speed = share * size, factor * w
        slope = amplitude * speed * np.cos(speed * warped)
        curvature = -amplitude * speed**2 * np.sin(speed * warped)
        q = q + amplitude * np.sin(speed * warped)
        v = v + slope * rate
        a = a + curvature * rate**2 + slope * rate_change
    return ReferenceTrajectory(t[:, 0], q, v, a)


class ReferenceTrajectory(NamedTuple):
    """Samples of the reference, one row a sample, one column an actuated joint.

    Attributes:
        times: [s], shape (k,).
        q: [rad], shape (k, n).
        v: [rad/s], same shape.
        a: [rad/s^2], same shape.
    """

    times: Array
    q: Array
    v: Array
    a: Array


def disturbance(scene: Scene, reference: ReferenceTrajectory) -> Disturbance:
    """Sines of a fifth of the largest torque that holds each joint along the reference."""
    size = DISTURBANCE_SHARE * np.abs(_gravity_torques(scene, reference)).max(axis=0)
    times = np.arange(round(reference.times[-1] * DISTURBANCE_RATE) + 1) / DISTURBANCE_RATE
    i = np.arange(len(size))
    torque = size * np.sin((4.0 + 0.7 * i) * times[:, None] + 0.9 * i + 0.3)
    return Disturbance(times, torque, size)


class Disturbance(NamedTuple):
    """Sinusoidal torques beside those of the actuators.

    Attributes:
        times: [s], shape (k,).
        torque: [N·m], shape (k, n).
        size: Amplitudes [N·m], shape (n,).
    """

    times: Array
    torque: Array
    size: Array


def _gravity_torques(scene: Scene, reference: ReferenceTrajectory) -> Array:
    """Torques of the actuated joints that hold the robot at rest [N·m], shape (k, n)."""
    joints = scene.holding(forces=()).controlled_joints()
    observed = ObservedState(joints.system, scene.couplings)
    driven = [joint.q for joint in joints.joints]
    still = np.zeros(len(scene.couplings.v_index))
    q, torques = scene.initial.q.copy(), []
    for position in reference.q:
        q[driven] = position
        x = observed.state(0.0, q[scene.couplings.q_index], still)
        q = x.q.copy()  # the next sample closes its loops from here
        response = joints.response(x)
        torques.append(MobilityFactor(response.mobility).solve(-response.a_free))
    return np.array(torques)
