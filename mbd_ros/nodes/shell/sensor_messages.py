"""Messages of sensors that have a topic each: type, topic, and numbers there and back."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import Imu as ImuMessage

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.kinematics.poses import quaternion_vector, vector_quaternion
from mbd_ros.core.model.robot import Robot, child_link
from mbd_ros.core.state import Array
from mbd_ros.parts.sensors.imu import Imu
from mbd_ros.parts.sensors.pose import Pose
from mbd_ros.parts.sensors.wrench import Wrench
from msg_adapters.errors import MessageError
from msg_adapters.imu import read_imu, write_imu
from msg_adapters.pose import read_pose, write_pose
from msg_adapters.wrench import read_wrench, write_wrench

_WORLD = "world"
_FOLDERS = {Imu: "imu", Pose: "pose", Wrench: "measured_wrench"}


class SensorSample(NamedTuple):
    """One message of a sensor.

    Attributes:
        stamp: Header stamp [ns].
        values: What the sensor measured, shape (m,), NaN where it told nothing.
    """

    stamp: int
    values: Array


class SensorMessage(NamedTuple):
    """How messages of a sensor look.

    Attributes:
        type: Of its messages.
        topic: That carries them.
        read: Numbers of a message; MessageError where it cannot be used.
        write: A message of a stamp [ns] and numbers.
    """

    sensor: Sensor
    type: Any
    topic: str
    read: Callable[[Any], SensorSample]
    write: Callable[[int, Array], Any]


def sensor_messages(robot: Robot, sensors: Sequence[Sensor]) -> tuple[SensorMessage, ...]:
    """Those of the sensors that have a topic of their own.

    Args:
        sensors: Sensors of the scene.
    """
    return tuple(_message_of(robot, sensor) for sensor in sensors if type(sensor) in _FOLDERS)


def _message_of(robot: Robot, sensor: Any) -> SensorMessage:
    topic = sensor.label or f"~/{_FOLDERS[type(sensor)]}/{sensor.name}"
    if isinstance(sensor, Imu):
        return _imu(sensor, topic)
    if isinstance(sensor, Pose):
        return _pose(sensor, topic)
    return _wrench(sensor, topic, child_link(robot.model, sensor.joint.v))


def _imu(sensor: Imu, topic: str) -> SensorMessage:
    noise = sensor.gyro_noise, sensor.acceleration_noise

    def read(msg: Any) -> SensorSample:
        sample = read_imu(msg)
        _refuse(sample.frame_id, sensor.frame)
        return SensorSample(sample.stamp, sample.values)

    def write(stamp: int, values: Array) -> Any:
        return write_imu(ImuMessage(), stamp, sensor.frame, values, noise)

    return SensorMessage(sensor, ImuMessage, topic, read, write)


def _pose(sensor: Pose, topic: str) -> SensorMessage:
    def read(msg: Any) -> SensorSample:
        sample = read_pose(msg)
        _refuse(sample.frame_id, _WORLD)
        turn = quaternion_vector(sample.pose[3:])
        return SensorSample(sample.stamp, np.concatenate((sample.pose[:3], turn)))

    def write(stamp: int, values: Array) -> Any:
        pose = np.concatenate((values[:3], vector_quaternion(values[3:])))
        return write_pose(PoseStamped(), stamp, _WORLD, pose)

    return SensorMessage(sensor, PoseStamped, topic, read, write)


def _wrench(sensor: Wrench, topic: str, frame: str) -> SensorMessage:
    def read(msg: Any) -> SensorSample:
        sample = read_wrench(msg)
        _refuse(sample.frame_id, frame)
        return SensorSample(sample.stamp, sample.wrench)

    def write(stamp: int, values: Array) -> Any:
        return write_wrench(WrenchStamped(), stamp, frame, values)

    return SensorMessage(sensor, WrenchStamped, topic, read, write)


def _refuse(frame: str, expected: str) -> None:
    if frame not in ("", expected):
        raise MessageError(f"frame '{frame}', expected '{expected}'")
