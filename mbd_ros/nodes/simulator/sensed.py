"""Topics on which the node `simulator` publishes what sensors of a scene tell."""

import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import Imu as ImuMessage
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.core.sensor import Sensor
from mbd_ros.core.simulation.live_simulation import LiveSimulation
from mbd_ros.core.simulation.noisy_sensors import NoisySensors
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.sensors.encoder import Encoder
from mbd_ros.sensors.imu import Imu
from mbd_ros.sensors.tachometer import Tachometer
from msg_adapters.imu import write_imu
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.multi_array_cdr import MultiArrayCdrWriter

_SOONER = 0.5e-9  # s by which a message may be early: rounding


class SensorTopics:
    """What sensors tell, with noise and delays.

    Encoders and tachometers of one delay share `~/measured_joint_states`, an IMU has
    `~/imu/<name>` or the topic that it names, all others stand in `~/sensors`.

    Args:
        node: The publishing node.
        live: What is simulated.
        sensors: Of the scene.
        seed: Of the noise.
        depth: Of the topics.
    """

    def __init__(
        self,
        node: Shell,
        live: LiveSimulation,
        sensors: tuple[Sensor, ...],
        seed: int,
        depth: QoSProfile,
    ) -> None:
        self._live, self._sensing = live, NoisySensors(sensors, seed)
        self._waiting = deque[tuple[float, Callable[[], None]]]()
        self._at = {sensor.name: i for i, sensor in enumerate(sensors)}
        self._sample, self._newest = 0, math.inf
        encoders = {s.frame: s for s in sensors if isinstance(s, Encoder)}
        rates = {s.frame: s for s in sensors if isinstance(s, Tachometer)}
        self._joints = [(encoders[name], rates.get(name)) for name in encoders]
        self._has_rates = bool(encoders) and encoders.keys() <= rates.keys()
        self._imus = [
            (s, node.publish_to(ImuMessage, s.label or f"~/imu/{s.name}", depth))
            for s in sensors
            if isinstance(s, Imu)
        ]
        taken = {id(s) for pair in self._joints for s in (pair[0], *pair[1:]) if s is not None}
        taken |= {id(s) for s, _ in self._imus}
        self._others = [s for s in sensors if id(s) not in taken]
        if self._joints:
            fields = ("position", "velocity") if self._has_rates else ("position",)
            self._writer = JointStateCdrWriter(list(encoders), fields)
            self._states = node.publish_to(JointState, "~/measured_joint_states", depth)
        if self._others:
            names = [
                ".".join(filter(None, (s.name, one))) for s in self._others for one in s.components
            ]
            self._numbers = MultiArrayCdrWriter(len(names), names)
            self._array = node.publish_to(Float64MultiArray, "~/sensors", depth)

    def publish(self, stamp: int) -> None:
        """Measure the newest state, and send what is due.

        Args:
            stamp: Of the state [ns].
        """
        time = self._live.now.t
        if time <= self._newest:  # the simulation began anew, and so does the noise
            self._sample = 0
            self._waiting.clear()
        self._newest = time
        values = self._live.measured(self._sensing, self._sample)
        self._sample += 1
        now = stamp * NANOSECOND
        for delay, send in self._messages(stamp, values):
            self._waiting.append((now + delay, send))
        late = deque[tuple[float, Callable[[], None]]]()
        for due, send in self._waiting:
            if due <= now + _SOONER:
                send()
            else:
                late.append((due, send))
        self._waiting = late

    def _messages(self, stamp: int, values: list[Array]) -> list[tuple[float, Callable[[], None]]]:
        found: list[tuple[float, Callable[[], None]]] = []
        if self._joints:
            position = np.concatenate([values[self._at[e.name]] for e, _ in self._joints])
            fields = {"position": position}
            if self._has_rates:
                rates = [values[self._at[r.name]] for _, r in self._joints if r is not None]
                fields["velocity"] = np.concatenate(rates)
            message = self._writer.write(stamp, **fields)
            delay = max(s.delay for pair in self._joints for s in pair if s is not None)
            found.append((delay, partial(self._states.publish, message)))
        for sensor, topic in self._imus:
            imu = write_imu(
                ImuMessage(), stamp, sensor.frame, values[self._at[sensor.name]], _noise(sensor)
            )
            found.append((sensor.delay, partial(topic.publish, imu)))
        if self._others:
            told = np.concatenate([values[self._at[s.name]] for s in self._others]).tolist()
            delay = max(s.delay for s in self._others)
            found.append((delay, partial(self._array.publish, self._numbers.write(told))))
        return found


def _noise(sensor: Any) -> tuple[float, float]:
    return sensor.gyro_noise, sensor.acceleration_noise
