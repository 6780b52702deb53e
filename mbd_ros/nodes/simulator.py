"""Node `simulator`: commands in, the motion of a scene out, tick by tick."""

import sys
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

from rclpy.executors import Executor
from rclpy.qos import HistoryPolicy, QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import JointTrajectory
from visualization_msgs.msg import MarkerArray

from mbd_ros.errors import DivergedError
from mbd_ros.nodes.pace import Pace, wake_exactly
from mbd_ros.nodes.plant import Plant
from mbd_ros.nodes.process import run
from mbd_ros.nodes.shell import Shell
from mbd_ros.nodes.simulator_parameters import PARAMETERS
from msg_adapters.clock import write_clock
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.errors import MessageError
from msg_adapters.time import NANOSECONDS

# The depth bridges a pause of 0.5 s at 1 kHz. In lock step every command is a tick, however many
# are waiting: a full reader then refuses them, and the writer sends them again.
COMMANDS = QoSProfile(depth=500)
EVERY_COMMAND = QoSProfile(history=HistoryPolicy.KEEP_ALL)
STATES = QoSProfile(depth=100)  # a recorder may be away for 0.1 s at 1 kHz
CLOCK_REPEAT = 0.1  # s between messages of a standing clock, for who comes late


class SimulatorNode(Shell):
    """Advances a scene by one tick at a time and publishes every state."""

    NAME = "simulator"
    PARAMETERS = PARAMETERS

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._plant: Plant | None = None
        self._is_paused = False
        self._pace = Pace(1.0, 1.0)  # until configured
        self._tick = self._guarded(self._advance, False)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(SetBool, "~/pause", self._on_pause)

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        values = self.parameters
        self._plant = plant = Plant(values)
        self._is_paused = values.paused
        self._pace = Pace(1.0 / values.rate, values.real_time_factor)
        wake_exactly()
        self._states = self.publish_to(JointState, "joint_states", STATES)
        self._motion = self.publish_to(JointTrajectory, "~/motion", STATES)
        self._forces = self._markers = self._time_out = None
        if plant.rows:
            self._forces = self.publish_to(JointState, "~/constraint_forces", STATES)
        if plant.live.wrenches():
            self._markers, self._marked = self.publish_to(MarkerArray, "~/markers", 10), 0.0
        if values.publish_clock:
            self._time_out, self._time_message = self.publish_to(Clock, "/clock", 10), Clock()
            self.every(CLOCK_REPEAT, self._repeat_clock)
        if plant.has_actuators:
            qos = EVERY_COMMAND if values.lock_step else COMMANDS
            for kind, topic, read in (
                (Float64MultiArray, "~/commands", plant.reader.read_vector),
                (JointState, "~/joint_commands", plant.reader.read_efforts),
            ):
                take = self._on_command(topic, read)
                self.subscribe(kind, topic, take, qos, single_publisher=True)

    def activate_core(self) -> None:
        """Go on from the state that was kept; show it at once."""
        assert self._plant is not None
        if self._plant.live.fault:
            raise DivergedError(f"{self._plant.live.fault}; call ~/reset first")
        self._restart()
        self._publish()

    def deactivate_core(self) -> None:
        """Stand still."""
        self._pace.interrupt()

    def retune(self, values: Any) -> None:
        """New timeouts for the commands; another factor takes hold at once."""
        assert self._plant is not None
        watch = self._plant.live.watch
        watch.timeout, watch.ramp = values.command_timeout, values.safe_ramp
        if values.real_time_factor != self._pace.factor:
            self._restart(values.real_time_factor)

    def reset(self, reason: str) -> None:
        """The node clock jumped: stamps follow it, the simulation does not."""
        self._restart()

    def drive(self, executor: Executor, patience: float) -> None:
        """Tick, and handle callbacks in between."""
        if not self._is_running:
            self._pace.idle(executor, patience)
        end = perf_counter() + patience
        while self._is_running and perf_counter() < end:
            if self._pace.wait(executor):
                self._tick()
                self._pace.ticked()

    def health(self) -> tuple[int, str, dict[str, str]]:
        """Whether time is kept and commands come, then what the motion contains."""
        assert self._plant is not None
        pace, live = self._pace, self._plant.live
        asked = f"{pace.factor:g}" if pace.factor else "0 (as fast as possible)"
        details = {
            **self._plant.details(),
            "real-time factor asked": asked,
            "real-time factor reached": f"{pace.reached:.3f}" if self._is_running else "standing",
            "ticks since the last report": str(pace.ticks),
            "lateness of 99 % of the ticks": f"{pace.lateness:.6f}",
            "overruns": str(pace.overruns),
            "time given up": f"{pace.given_up:.3f}",
        }
        wrong = []
        if self._is_running and pace.is_lagging:
            reached = f"real-time factor {pace.reached:.3f} instead of {pace.factor:g}"
            wrong.append(f"lagging: {reached}, {pace.overruns} overruns")
        if self._plant.has_actuators and live.watch.is_safe:
            since = "yet" if live.watch.held is None else f"for {live.watch.age:.3g} s"
            wrong.append(f"no command {since}, instead: {self._plant.scene.safe}")
        pace.open_window()
        standing = "paused" if self._is_paused else "waiting for a command"
        what = "simulating" if self._is_running else standing
        text = "; ".join([*wrong, f"{what}, t = {live.now.t:.9g} s"])
        return (WARN if wrong else OK), text, details

    # ------------------------------------------------------------------ ticks

    @property
    def _is_running(self) -> bool:
        return self.active and not (self._is_paused or self.parameters.lock_step)

    def _advance(self) -> None:
        assert self._plant is not None
        self._plant.live.tick()
        self._publish()

    def _publish(self) -> None:
        """Show the newest state."""
        plant, stamp = self._plant, self._stamp()
        assert plant is not None
        if self._time_out is not None:
            self._time_out.publish(write_clock(self._time_message, stamp))
        self._states.publish(plant.joint_states(stamp))
        if self._forces is not None:
            self._forces.publish(plant.constraint_forces(stamp))
        if self._motion.get_subscription_count():
            self._motion.publish(plant.motion(stamp))
        rate, now = self.parameters.marker_rate, perf_counter()
        if self._markers is not None and rate > 0.0 and now >= self._marked + 1.0 / rate:
            self._marked = now
            self._markers.publish(plant.markers(stamp, self.parameters.marker_scale))

    def _stamp(self) -> int:
        """Simulated time if it is published, else when the tick was due on the node clock [ns]."""
        assert self._plant is not None
        if self.parameters.publish_clock:
            return self._plant.time
        if self._is_running and self._pace.factor > 0.0:
            return self._epoch + round(self._pace.due * NANOSECONDS)
        return int(self.get_clock().now().nanoseconds)

    def _repeat_clock(self) -> None:
        if self._time_out is not None and not self._is_running:
            self._time_out.publish(self._time_message)

    def _restart(self, factor: float | None = None) -> None:
        """The time between ticks begins now."""
        self._pace.restart(factor)
        self._epoch = self.get_clock().now().nanoseconds - round(self._pace.due * NANOSECONDS)
        self._pace.interrupt()

    # ------------------------------------------------------------------ messages and services

    def _on_command(self, topic: str, read: Callable[[Any], Any]) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            assert self._plant is not None
            try:
                self._plant.live.watch.take(read(msg))
            except MessageError as error:
                self.drop("command", f"{topic}: {error}; the last good command is held")
                return
            if self.parameters.lock_step and not self._is_paused:
                self._advance()

        return take

    def _on_pause(self, request: Any, response: Any) -> Any:
        response.success = self.configured
        if self.configured:
            self._is_paused = request.data
            self._restart()
        return self._answer(response, "paused" if request.data else "not paused")

    def _on_reset(self, request: Any, response: Any) -> Any:
        response.success = self.configured
        if self._plant is not None and self.configured:
            self._plant.live.reset()
            self._restart()
            if self.active:
                self._publish()
        return self._answer(response, "at the initial state")

    def _on_step(self, request: Any, response: Any) -> Any:
        """One tick; an error in it deactivates, as in any tick."""
        response.success = self.active and not self._is_running
        if response.success:
            self._tick()
            response.success = self.active
        elif self.active:
            response.message = "not paused: call ~/pause first"
            return response
        return self._answer(response, "one tick done")

    def _answer(self, response: Any, done: str) -> Any:
        """Fill in what a service says: what it did, or why it could not."""
        if response.success:
            assert self._plant is not None
            response.message = f"{done}, t = {self._plant.live.now.t:.9g} s"
        else:
            response.message = self.fault or f"the node is {self.state}"
        return response


def main() -> int:
    """Entry point `simulator`."""
    return run(SimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
