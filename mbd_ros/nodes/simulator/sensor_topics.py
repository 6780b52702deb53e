"""Topics on which the node `simulator` publishes what the sensors of a scene tell."""

import math
from collections import deque
from collections.abc import Callable
from functools import partial

import numpy as np
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.noisy_sensors import NoisySensors
from mbd_ros.nodes.shell.sensor_messages import sensor_messages
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.parts.sensors.effort import Effort
from mbd_ros.parts.sensors.encoder import Encoder
from mbd_ros.parts.sensors.tachometer import Tachometer
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.multi_array import MultiArrayCdrWriter

_SOONER = 0.5e-9  # s by which a message may be early: rounding


class SensorTopics:
    """Messages of sensors, with noise and delays.

    Encoders, and tachometers and effort sensors where every encoder has one, share
    `~/measured_joint_states`; IMUs, poses and wrenches have topics of their own, all others stand
    in `~/sensors`.

    Args:
        node: The publishing node.
        live: What is simulated.
        sensors: Of the scene.
        seed: Of the noise.
    """

    def __init__(
        self,
        node: Shell,
        live: LiveSimulation,
        sensors: tuple[Sensor, ...],
        seed: int,
        depth: QoSProfile,
    ) -> None:
        self._live = live
        self._sensing = NoisySensors(sensors, seed)
        self._waiting = deque[tuple[float, Callable[[], None]]]()
        self._at = {sensor.name: i for i, sensor in enumerate(sensors)}
        self._sample = 0
        self._newest = math.inf
        encoders, rates, efforts = (
            {s.joint.name: s for s in sensors if isinstance(s, kind)}
            for kind in (Encoder, Tachometer, Effort)
        )
        fields = {"position": encoders, "velocity": rates, "effort": efforts}
        self._joints = {
            field: [by_joint[name] for name in encoders]
            for field, by_joint in fields.items()
            if encoders and encoders.keys() <= by_joint.keys()
        }
        robot = live.simulation.system.robot
        self._topics = [
            (message, node.publish_to(message.type, message.topic, depth))
            for message in sensor_messages(robot, sensors)
        ]
        taken = {id(s) for by_joint in self._joints.values() for s in by_joint}
        taken |= {id(message.sensor) for message, _ in self._topics}
        self._others = [s for s in sensors if id(s) not in taken]
        if self._joints:
            self._writer = JointStateCdrWriter(list(encoders), tuple(self._joints))
            self._states = node.publish_to(JointState, "~/measured_joint_states", depth)
        if self._others:
            names = [
                ".".join(filter(None, (s.name, message)))
                for s in self._others
                for message in s.components
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
        messages: list[tuple[float, Callable[[], None]]] = []
        if self._joints:
            fields = {
                field: np.concatenate([values[self._at[s.name]] for s in group])
                for field, group in self._joints.items()
            }
            message = self._writer.write(stamp, **fields)
            delay = max(s.delay for group in self._joints.values() for s in group)
            messages.append((delay, partial(self._states.publish, message)))
        for one, topic in self._topics:
            sensor = one.sensor
            written = one.write(stamp, values[self._at[sensor.name]])
            messages.append((sensor.delay, partial(topic.publish, written)))
        if self._others:
            numbers = np.concatenate([values[self._at[s.name]] for s in self._others]).tolist()
            delay = max(s.delay for s in self._others)
            messages.append((delay, partial(self._array.publish, self._numbers.write(numbers))))
        return messages
