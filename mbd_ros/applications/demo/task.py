"""The task of the controlled robot of the demo: a reference, against a disturbance."""

from typing import NamedTuple

import numpy as np

from mbd_ros.applications.demo.choices import DemoRobot
from mbd_ros.core.control.mobility_factor import MobilityFactor
from mbd_ros.core.projection.observed_state import ObservedState
from mbd_ros.core.state import Array
from mbd_ros.scene.built_scene import Scene

RATE, DISTURBANCE_RATE = 20.0, 50.0  # samples of the reference and of the disturbance [Hz]
DISTURBANCE_SHARE = 0.2  # of the largest gravity torque
MARGIN = 1.0  # s that reference and disturbance outlast the demo
_SECOND_SIZE, _SECOND_SPEED = 0.3, 2.3  # of the second sine, in those of the first


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


def disturbance(scene: Scene, reference: ReferenceTrajectory) -> Disturbance:
    """Sines of a fifth of the largest torque that holds each joint along the reference."""
    size = DISTURBANCE_SHARE * np.abs(_gravity_torques(scene, reference)).max(axis=0)
    times = np.arange(round(reference.times[-1] * DISTURBANCE_RATE) + 1) / DISTURBANCE_RATE
    i = np.arange(len(size))
    torque = size * np.sin((4.0 + 0.7 * i) * times[:, None] + 0.9 * i + 0.3)
    return Disturbance(times, torque, size)


def _gravity_torques(scene: Scene, reference: ReferenceTrajectory) -> Array:
    """Torques of the actuated joints that hold the robot at rest [N·m], shape (k, n)."""
    joints = scene.holding(forces=()).controlled_joints()
    observed = ObservedState(joints.system, scene.couplings)
    driven = [joint.q for joint in joints.joints]
    still = np.zeros(len(scene.couplings.v_index))
    q, held = scene.initial.q.copy(), []
    for position in reference.q:
        q[driven] = position
        x = observed.state(0.0, q[scene.couplings.q_index], still)
        q = x.q.copy()  # the next sample closes its loops from here
        response = joints.response(x)
        held.append(MobilityFactor(response.mobility).solve(-response.a_free))
    return np.array(held)
