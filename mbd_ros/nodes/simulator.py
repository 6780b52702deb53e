"""Node `simulator`: commands in, the motion of a scene out, tick by tick."""

import sys
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

from rclpy.executors import Executor
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from mbd_ros.errors import DivergedError, MbdError
from mbd_ros.nodes.pace import Pace, wake_exactly
from mbd_ros.nodes.plant import Plant
from mbd_ros.nodes.process import run
from mbd_ros.nodes.scene_node import SceneNode
from mbd_ros.nodes.simulator_outputs import SimulatedClock, SimulatorOutputs
from mbd_ros.nodes.simulator_parameters import PARAMETERS
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.errors import MessageError
from msg_adapters.time import NANOSECONDS

# The depth bridges a pause of 0.5 s at 1 kHz. In lock step every command is a tick, however many
# are waiting: a full reader then refuses them, and the writer sends them again.
COMMANDS = QoSProfile(depth=500)
EVERY_COMMAND = QoSProfile(history=HistoryPolicy.KEEP_ALL)
CLOCK_REPEAT = 0.1  # s between messages of a standing clock, for who comes late


class SimulatorNode(SceneNode):
    """Advances a scene by one tick at a time and publishes every state."""

    NAME = "simulator"
    PARAMETERS = PARAMETERS
    _plant: Plant
    _simulated_clock: SimulatedClock | None = None  # of this activation

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._is_paused = False
        self._pace = Pace(1.0, 1.0)  # until configured
        self._tick = self._guarded(self._advance, False)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(SetBool, "~/pause", self._on_pause)

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._plant = Plant(self.parameters, description)

    def replace(self, description: str) -> None:
        """Keep the robot of a simulation that has begun; the next one takes the new robot."""
        Plant(self.parameters, description)  # says what is wrong with it
        self._description = description
        raise MbdError("a simulation keeps its robot; clean up and configure to change it")

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        super().configure_core()
        values, plant = self.parameters, self._plant
        self._is_paused = values.paused
        self._pace = Pace(1.0 / values.rate, values.real_time_factor)
        wake_exactly()
        self._outputs = SimulatorOutputs(self, plant)
        if plant.has_actuators:
            qos = EVERY_COMMAND if values.lock_step else COMMANDS
            for kind, topic, read in (
                (Float64MultiArray, "~/commands", plant.reader.read_vector),
                (JointState, "~/joint_commands", plant.reader.read_efforts),
            ):
                take = self._on_command(topic, read)
                self.subscribe(kind, topic, take, qos, single_publisher=True)

    def activate_core(self) -> None:
        """Go on from the state that was kept; show it at once.

        The clock ends with the activation: who waits for it sees that nothing will come, which
        is no pause.
        """
        if self._plant.live.fault:
            raise DivergedError(f"{self._plant.live.fault}; call ~/reset first")
        if self.parameters.publish_clock:
            self._simulated_clock = clock = SimulatedClock(self)
            self.every(CLOCK_REPEAT, lambda: self._is_running or clock.repeat())
        self._restart()
        self._publish()

    def deactivate_core(self) -> None:
        """Stand still, and let the clock end."""
        self._simulated_clock = None
        self._pace.interrupt()

    def retune(self, values: Any) -> None:
        """New timeouts for the commands; another factor takes hold at once."""
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
        pace, live = self._pace, self._plant.live
        details = {**self._plant.details(), **pace.details(self._is_running)}
        wrong = [pace.lag] if self._is_running and pace.is_lagging else []
        wrong += [self._plant.silence] if self._plant.silence else []
        pace.open_window()
        standing = "paused" if self._is_paused else "waiting for a command"
        what = "simulating" if self._is_running else standing
        text = "; ".join([*wrong, f"{what}, t = {live.now.t:.9g} s"])
        return (WARN if wrong else OK), text, details

    @property
    def _is_running(self) -> bool:
        return self.active and not (self._is_paused or self.parameters.lock_step)

    def _advance(self) -> None:
        self._plant.live.tick()
        self._publish()

    def _publish(self) -> None:
        """Show the newest state."""
        stamp = self._stamp()
        if self._simulated_clock is not None:
            self._simulated_clock.show(stamp)
        self._outputs.publish(stamp, self.parameters)

    def _stamp(self) -> int:
        """Simulated time if it is published, else when the tick was due on the node clock [ns]."""
        if self.parameters.publish_clock:
            return self._plant.time
        if self._is_running and self._pace.factor > 0.0:
            return self._epoch + round(self._pace.due * NANOSECONDS)
        return int(self.get_clock().now().nanoseconds)

    def _restart(self, factor: float | None = None) -> None:
        """The time between ticks begins now."""
        self._pace.restart(factor)
        self._epoch = self.get_clock().now().nanoseconds - round(self._pace.due * NANOSECONDS)
        self._pace.interrupt()

    def _on_command(self, topic: str, read: Callable[[Any], Any]) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
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
        if self.configured:
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
            response.message = f"{done}, t = {self._plant.live.now.t:.9g} s"
        else:
            response.message = self.fault or f"the node is {self.state}"
        return response


def main() -> int:
    """Entry point `simulator`."""
    return run(SimulatorNode)


if __name__ == "__main__":
    sys.exit(main())
