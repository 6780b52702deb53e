"""Topics on which the node `simulator` publishes a state, its sensors and its forces."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np
from geometry_msgs.msg import Point
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import Marker, MarkerArray

from mbd_ros.core.contracts import Sensor
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.files.topics import joint_state_topic, odometry_topic
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.noisy_sensors import NoisySensors
from mbd_ros.nodes.shell.messages import sensor_messages
from mbd_ros.nodes.shell.robot_description import LATCHED
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.nodes.simulator.plant import Plant
from mbd_ros.parts.sensors.effort import Effort
from mbd_ros.parts.sensors.encoder import Encoder
from mbd_ros.parts.sensors.tachometer import Tachometer
from msg_adapters.clock import write_clock
from msg_adapters.joint_state_cdr import JointStateCdrWriter
from msg_adapters.markers import Arrow, Cone, MarkerWriter
from msg_adapters.multi_array_cdr import MultiArrayCdrWriter

# ---- outputs ----------------------------------------------------------------------------------
# Topics on which the node `simulator` publishes a state.


BEAT = 0.05  # s between messages of a clock that stands
STATES = QoSProfile(depth=100)  # a recorder may be away for 0.1 s at 1 kHz


class SimulatorOutputs:
    """Topics of a configured simulator, without those for which a scene has nothing.

    Args:
        node: The publishing node.
        plant: What is shown.
    """

    def __init__(self, node: Shell, plant: Plant) -> None:
        self._plant = plant
        self._states = [
            node.publish_to(JointState, joint_state_topic(member), STATES)
            for member in plant.members
        ]
        self._odometry = _odometry(node, plant.bodies)
        self._motion = node.publish_to(JointTrajectory, "~/motion", STATES)
        self._forces = self._shown = self._markers = self._events = None
        if plant.rows:
            self._forces = node.publish_to(JointState, "~/constraint_forces", STATES)
        if plant.shown:
            self._shown = node.publish_to(Float64MultiArray, "~/outputs", STATES)
        if plant.live.simulation.guards:
            self._events = node.publish_to(Float64MultiArray, "~/events", STATES)
        if plant.live.showing.arrows:
            from visualization_msgs.msg import MarkerArray  # only where something is drawn

            self._markers, self._marked = node.publish_to(MarkerArray, "~/markers", 10), 0.0

        self._phase = None
        if plant.live.phase:
            self._phase = PhaseTopic(node, plant.live)
        self._sensed = None
        if plant.scene.sensors:
            self._sensed = SensorTopics(node, plant.live, plant.scene.sensors, plant.seed, STATES)
        self._contacts = None
        if plant.live.showing.cones:
            from mbd_ros.nodes.shell.contact_topics import ContactTopics  # only with contacts

            self._contacts = ContactTopics(node, plant.live, plant.scene.robot, STATES)

    @property
    def listeners(self) -> int:
        """How many listen to joint states, or to free bodies where there are none."""
        topics = self._states or self._odometry
        return max(int(topic.get_subscription_count()) for topic in topics)

    def repeat(self, stamp: int) -> None:
        """Publish the newest joint states and poses again, under a stamp [ns]."""
        for topic, odometry in zip(self._odometry, self._plant.odometry(stamp), strict=True):
            topic.publish(odometry)
        for topic, states in zip(self._states, self._plant.joint_states(stamp), strict=True):
            topic.publish(states)

    def publish(self, stamp: int, values: Any) -> None:
        """Show the newest state.

        Args:
            stamp: [ns].
            values: Parameters of the node.
        """
        plant = self._plant
        self.repeat(stamp)
        if self._forces is not None:
            self._forces.publish(plant.constraint_forces(stamp))
        if self._shown is not None:
            self._shown.publish(plant.outputs())
        if self._phase is not None:
            self._phase.publish()
        if self._events is not None:
            for event in plant.events():
                self._events.publish(event)
        if self._contacts is not None:
            self._contacts.publish(stamp)
        if self._sensed is not None:
            self._sensed.publish(stamp)
        if self._motion.get_subscription_count():
            self._motion.publish(plant.motion(stamp))
        rate, now = values.marker_rate, perf_counter()
        if self._markers is not None and rate > 0.0 and now >= self._marked + 1.0 / rate:
            self._marked = now
            if self._markers.get_subscription_count():
                self._markers.publish(plant.markers(stamp, values.marker_scale))


def _odometry(node: Shell, bodies: Sequence[str]) -> list[Publisher]:
    """Publishers of free bodies."""
    if not bodies:
        return []
    from nav_msgs.msg import Odometry  # only where something flies

    return [node.publish_to(Odometry, odometry_topic(body), STATES) for body in bodies]


class PhaseTopic:
    """Topic `~/phase`: the name of every phase that begins, kept for who listens later.

    Args:
        node: The publishing node.
        live: What is simulated.
    """

    def __init__(self, node: Shell, live: LiveSimulation) -> None:
        self._publisher, self._live = node.publish_to(String, "~/phase", LATCHED), live
        self._shown = ""

    def publish(self) -> None:
        """Publish the phases that began in the last tick; the present one where it is new."""
        for name in self._live.begun:
            self._show(name)
        if self._live.phase != self._shown:  # at the start and after a reset
            self._show(self._live.phase)

    def _show(self, name: str) -> None:
        self._shown = name
        self._publisher.publish(String(data=name))


class SimulatedClock:
    """Topic `/clock`: every new time, and the same again where none comes.

    By these beats a listener tells a simulation that stands or is slow from one that ended.

    Args:
        node: The publishing node.
    """

    def __init__(self, node: Shell) -> None:
        self._publisher, self._message = node.publish_to(Clock, "/clock", 10), Clock()
        self._shown = perf_counter()
        node.every(BEAT, self._beat)

    def show(self, stamp: int) -> None:
        """Publish a time [ns]."""
        self._shown = perf_counter()
        self._publisher.publish(write_clock(self._message, stamp))

    def _beat(self) -> None:
        """Publish the newest time again, unless it is a new one."""
        if perf_counter() - self._shown > BEAT / 2.0:
            self._publisher.publish(self._message)


# ---- sensed -----------------------------------------------------------------------------------
# Topics on which the node `simulator` publishes what sensors of a scene tell.


_SOONER = 0.5e-9  # s by which a message may be early: rounding


class SensorTopics:
    """What sensors tell, with noise and delays.

    Encoders, and tachometers and effort sensors where every encoder has one, share
    `~/measured_joint_states`; IMUs, poses and wrenches have topics of their own, all others stand
    in `~/sensors`.

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
        encoders, rates, efforts = (
            {s.joint.name: s for s in sensors if isinstance(s, kind)}
            for kind in (Encoder, Tachometer, Effort)
        )
        fields = {"position": encoders, "velocity": rates, "effort": efforts}
        self._joints = {
            field: [told[name] for name in encoders]
            for field, told in fields.items()
            if encoders and encoders.keys() <= told.keys()
        }
        robot = live.simulation.system.robot
        self._own = [
            (one, node.publish_to(one.type, one.topic, depth))
            for one in sensor_messages(robot, sensors)
        ]
        taken = {id(s) for told in self._joints.values() for s in told}
        taken |= {id(one.sensor) for one, _ in self._own}
        self._others = [s for s in sensors if id(s) not in taken]
        if self._joints:
            self._writer = JointStateCdrWriter(list(encoders), tuple(self._joints))
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
            fields = {
                field: np.concatenate([values[self._at[s.name]] for s in told])
                for field, told in self._joints.items()
            }
            message = self._writer.write(stamp, **fields)
            delay = max(s.delay for told in self._joints.values() for s in told)
            found.append((delay, partial(self._states.publish, message)))
        for one, topic in self._own:
            sensor = one.sensor
            written = one.write(stamp, values[self._at[sensor.name]])
            found.append((sensor.delay, partial(topic.publish, written)))
        if self._others:
            told = np.concatenate([values[self._at[s.name]] for s in self._others]).tolist()
            delay = max(s.delay for s in self._others)
            found.append((delay, partial(self._array.publish, self._numbers.write(told))))
        return found


# ---- drawing ----------------------------------------------------------------------------------
# What parts of a scene exert, as markers: arrows of forces and friction cones.


class Drawing:
    """Markers of a live simulation, by the names of its arrows and cones.

    Args:
        robot: The robot of the scene.
        frame_id: Link that stands for the world.
    """

    def __init__(self, robot: Robot, frame_id: str) -> None:
        self._origin = robot.origin
        self._writer = MarkerWriter(MarkerArray(), Marker, Point, frame_id)

    def write(self, live: LiveSimulation, stamp: int, length: float) -> Any:
        """MarkerArray of the newest state.

        Args:
            live: The simulation.
            stamp: Header stamp [ns].
            length: Of an arrow, and height of a cone, per force [m/N].

        Raises:
            MessageError: Something is not finite, or no message can carry the stamp.
        """
        showing, origin = live.showing, self._origin
        arrows = [
            Arrow(one.name, wrench.point + origin, wrench.force)
            for one, wrench in zip(showing.arrows, live.wrenches(), strict=True)
        ]
        cones = [
            Cone(name, cone.point + origin, cone.normal, cone.mu)
            for name, cone in zip(showing.cones, live.cones(), strict=True)
        ]
        return self._writer.write(stamp, arrows, length, cones)
