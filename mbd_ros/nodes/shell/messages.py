"""Messages of commands and sensors."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import PoseStamped, WrenchStamped
from sensor_msgs.msg import Imu as ImuMessage

from mbd_ros.core.contracts import Actuator, Sensor
from mbd_ros.core.kinematics.poses import quaternion_vector, vector_quaternion
from mbd_ros.core.loads.inputs import command_names
from mbd_ros.core.model.robot import Robot, child_link
from mbd_ros.core.state import Array
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.parts.sensors.imu import Imu
from mbd_ros.parts.sensors.pose import Pose
from mbd_ros.parts.sensors.wrench import Wrench
from mbd_ros.scene.built_scene import Scene
from msg_adapters.commands import CommandReader
from msg_adapters.errors import MessageError
from msg_adapters.imu import read_imu, write_imu
from msg_adapters.pose import read_pose, write_pose
from msg_adapters.wrench import read_wrench, write_wrench

# ---- sensor messages --------------------------------------------------------------------------
# Messages of sensors that have a topic each: type, topic, and numbers there and back.


_WORLD = "world"
_FOLDERS = {Imu: "imu", Pose: "pose", Wrench: "measured_wrench"}


class Heard(NamedTuple):
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
        sensor: The sensor.
        type: Of its messages.
        topic: That carries them.
        read: Numbers of a message; MessageError where it cannot be used.
        write: A message of a stamp [ns] and numbers.
    """

    sensor: Sensor
    type: Any
    topic: str
    read: Callable[[Any], Heard]
    write: Callable[[int, Array], Any]


def sensor_messages(robot: Robot, sensors: Sequence[Sensor]) -> tuple[SensorMessage, ...]:
    """Those of the sensors that have a topic of their own.

    Args:
        robot: Robot of the scene.
        sensors: Sensors of the scene.
    """
    return tuple(_of(robot, sensor) for sensor in sensors if type(sensor) in _FOLDERS)


def _of(robot: Robot, sensor: Any) -> SensorMessage:
    topic = sensor.label or f"~/{_FOLDERS[type(sensor)]}/{sensor.name}"
    if isinstance(sensor, Imu):
        return _imu(sensor, topic)
    if isinstance(sensor, Pose):
        return _pose(sensor, topic)
    return _wrench(sensor, topic, child_link(robot.model, sensor.joint.v))


def _imu(sensor: Imu, topic: str) -> SensorMessage:
    noise = sensor.gyro_noise, sensor.acceleration_noise

    def read(msg: Any) -> Heard:
        sample = read_imu(msg)
        _refuse(sample.frame_id, sensor.frame)
        return Heard(sample.stamp, sample.values)

    def write(stamp: int, values: Array) -> Any:
        return write_imu(ImuMessage(), stamp, sensor.frame, values, noise)

    return SensorMessage(sensor, ImuMessage, topic, read, write)


def _pose(sensor: Pose, topic: str) -> SensorMessage:
    def read(msg: Any) -> Heard:
        sample = read_pose(msg)
        _refuse(sample.frame_id, _WORLD)
        turn = quaternion_vector(sample.pose[3:])
        return Heard(sample.stamp, np.concatenate((sample.pose[:3], turn)))

    def write(stamp: int, values: Array) -> Any:
        pose = np.concatenate((values[:3], vector_quaternion(values[3:])))
        return write_pose(PoseStamped(), stamp, _WORLD, pose)

    return SensorMessage(sensor, PoseStamped, topic, read, write)


def _wrench(sensor: Wrench, topic: str, frame: str) -> SensorMessage:
    def read(msg: Any) -> Heard:
        sample = read_wrench(msg)
        _refuse(sample.frame_id, frame)
        return Heard(sample.stamp, sample.wrench)

    def write(stamp: int, values: Array) -> Any:
        return write_wrench(WrenchStamped(), stamp, frame, values)

    return SensorMessage(sensor, WrenchStamped, topic, read, write)


def _refuse(given: str, expected: str) -> None:
    if given not in ("", expected):
        raise MessageError(f"frame '{given}', expected '{expected}'")


# ---- command inputs ---------------------------------------------------------------------------
# The inputs of actuators and muscles as messages name them.


def command_reader(scene: Scene, order: Sequence[str]) -> CommandReader:
    """What reads the commands of a scene; a joint stands for its only actuator.

    Args:
        scene: The scene.
        order: Of the values in vectors, by input or joint; empty: actuators, then muscles.

    Raises:
        ParameterError: The order does not name every input once.
    """
    names = scene.inputs.names[: sum(len(part.inputs) for part in scene.commanded)]
    joints, takes = _joints(scene), {}
    for part in scene.commanded:
        if part.takes:
            takes |= dict.fromkeys(names[part.u], part.takes)
    given = [joints.get(name, name) for name in order or names]
    if sorted(given) != sorted(names):
        label = {name: joint for joint, name in joints.items()}
        accepted = ", ".join(label.get(name, name) for name in names) or "none"
        raise ParameterError(
            f"parameter 'joints' is {', '.join(order)}; accepted: all actuated joints, each once: "
            f"{accepted}"
        )
    units = {name: scene.inputs.channels[i].unit for i, name in enumerate(names)}
    positions = [name for name, unit in units.items() if unit in ("rad", "m")]
    return CommandReader(given, names, joints, takes, positions)


def _joints(scene: Scene) -> dict[str, str]:
    """Joint -> the input that it stands for."""
    called = [name for names in command_names(scene.actuators) for name in names]
    pairs = zip(called, scene.inputs.names[: len(called)], strict=True)
    return {joint: name for joint, name in pairs if joint != name}


# ---- driven joints ----------------------------------------------------------------------------
# The joints that the actuators of a scene drive, and their order in commands.


def driven_joints(actuators: Sequence[Actuator]) -> tuple[str, ...]:
    """Joints in the order of the actuators.

    Raises:
        ParameterError: Two actuators drive one joint.
    """
    driven = tuple(name for actuator in actuators for name in actuator.joints)
    twice = sorted({name for name in driven if driven.count(name) > 1})
    if twice:
        raise ParameterError(
            f"actuators: {', '.join(twice)} driven twice: a command by name would be ambiguous"
        )
    return driven


def command_order(given: Sequence[str], driven: Sequence[str]) -> tuple[str, ...]:
    """Joints in the order of the values of a command: that of the parameter, or of the actuators.

    Raises:
        ParameterError: The parameter does not name all of them once.
    """
    if given and sorted(given) != sorted(driven):
        raise ParameterError(
            f"parameter 'joints' is {', '.join(given)}; accepted: all actuated joints, each "
            f"once: {', '.join(driven) or 'none'}"
        )
    return tuple(given or driven)
