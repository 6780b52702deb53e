"""Topics on which the node `simulator` publishes a state."""

from time import perf_counter
from typing import Any

from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray, String
from trajectory_msgs.msg import JointTrajectory

from mbd_ros.files.bag_paths import joint_state_topic, odometry_topic
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.nodes.shell.robot_description import LATCHED
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.nodes.simulator.plant import Plant
from msg_adapters.time import write_clock

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
        self._odometry: list[Publisher] = []
        if plant.bodies:
            from nav_msgs.msg import Odometry  # only where something flies

            self._odometry = [
                node.publish_to(Odometry, odometry_topic(body), STATES) for body in plant.bodies
            ]
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

            from mbd_ros.nodes.simulator.drawing import Drawing

            self._markers = node.publish_to(MarkerArray, "~/markers", 10)
            self._marked = 0.0
            self._drawing = Drawing(plant.scene.robot)
        self._phase = None
        if plant.live.phase:
            self._phase = PhaseTopic(node, plant.live)
        self._sensed = None
        if plant.scene.sensors:
            from mbd_ros.nodes.simulator.sensor_topics import SensorTopics  # only with sensors

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
                markers = self._drawing.write(plant.live, stamp, values.marker_scale)
                self._markers.publish(markers)


class PhaseTopic:
    """Topic `~/phase`: the name of every phase that begins, kept for who listens later.

    Args:
        node: The publishing node.
        live: What is simulated.
    """

    def __init__(self, node: Shell, live: LiveSimulation) -> None:
        self._publisher = node.publish_to(String, "~/phase", LATCHED)
        self._live = live
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


class ClockTopic:
    """Topic `/clock`: every new time, and the same again where none comes.

    By these beats a listener tells a simulation that stands or is slow from one that ended.

    Args:
        node: The publishing node.
    """

    def __init__(self, node: Shell) -> None:
        self._publisher = node.publish_to(Clock, "/clock", 10)
        self._message = Clock()
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
