"""Node `simulator`: commands in, the motion of a scene out, tick by tick."""

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

from geometry_msgs.msg import WrenchStamped
from rclpy.executors import Executor
from rclpy.qos import HistoryPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

from mbd_ros.errors import DivergedError, MbdError
from mbd_ros.nodes.shell.joint_state_stream import SENSOR
from mbd_ros.nodes.shell.robot_description import RobotDescription
from mbd_ros.nodes.shell.shell import Shell
from mbd_ros.nodes.simulator.outputs import ClockTopic, SimulatorOutputs
from mbd_ros.nodes.simulator.pace import Pace, wake_exactly
from mbd_ros.nodes.simulator.parameters import PARAMETERS
from mbd_ros.nodes.simulator.plant import Plant
from msg_adapters.diagnostics import OK, WARN
from msg_adapters.errors import MessageError
from msg_adapters.multi_array import read_answered
from msg_adapters.time import NANOSECONDS

# The depth bridges a pause of 0.5 s at 1 kHz. In lock step every command is a tick, however many
# are waiting: a full reader then refuses them, and the writer sends them again.
COMMANDS = QoSProfile(depth=500)
EVERY_COMMAND = QoSProfile(history=HistoryPolicy.KEEP_ALL)
STANDING = 0.1  # s between looks for who comes late, while time stands
LATE = 0.5  # [s] without a command that count as a fault
REPEAT = 0.2  # [s] without a command until the state that waits for one is shown again, at least
ARRIVAL = 0.5  # [s] for which the state is repeated for a new listener
_SLACK = 3.0  # of the slowest answer so far: a slow controller is no loss
_FORGET = 0.9  # of that answer, a command


class SimulatorNode(Shell):
    """Advances a scene by one tick at a time and publishes every state."""

    NAME = "simulator"
    PARAMETERS = PARAMETERS
    _plant: Plant
    _clock_topic: ClockTopic | None = None  # of this activation

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(argv)
        self._description = RobotDescription(self, self.build, self.replace)
        self._is_paused = False
        self._pace = Pace(1.0, 1.0)  # until configured
        self._standing = Standing()
        self._tick = self.guarded(self._advance)
        self._show = self.guarded(self._publish)
        self.create_service(Trigger, "~/reset", self._on_reset)
        self.create_service(Trigger, "~/step", self._on_step)
        self.create_service(SetBool, "~/pause", self._on_pause)

    def build(self, description: str | None) -> None:
        """Build the scene."""
        self._plant = Plant(self.parameters, description, self.get_logger().info)

    def replace(self, description: str) -> None:
        """Keep the robot of a simulation that has begun; the next one takes the new robot."""
        Plant(self.parameters, description)  # says what is wrong with it
        self._description.urdf = description
        raise MbdError("a simulation keeps its robot; clean up and configure to change it")

    def configure_core(self) -> None:
        """Build the scene and its topics."""
        self._description.build()
        values, plant = self.parameters, self._plant
        self._is_paused = values.paused
        self._pace = Pace(1.0 / values.rate, values.real_time_factor)
        wake_exactly()
        self._outputs = SimulatorOutputs(self, plant)
        qos = EVERY_COMMAND if values.lock_step else COMMANDS
        for kind, topic, read in (
            (Float64MultiArray, "~/commands", plant.reader.read_vector),
            (JointState, "~/joint_commands", plant.reader.read_named),
        )[: 2 * plant.has_actuators]:
            take = self._on_command(topic, read)
            self.subscribe(kind, topic, take, qos, single_publisher=True)
        for topic, hear in plant.loads.items():
            self.subscribe(WrenchStamped, topic, self._on_wrench(hear), SENSOR)

    def prepare(self, values: Any) -> None:
        """Listen for the robot of another scene."""
        self._description.follow(values)

    def activate_core(self) -> None:
        """Continue from the kept state; show it at once.

        The clock ends with the activation: listeners see that it ended, and do not take it for a
        pause.
        """
        if self._plant.live.fault:
            raise DivergedError(f"{self._plant.live.fault}; call ~/reset first")
        if self.parameters.publish_clock:
            self._clock_topic = ClockTopic(self)
        self.every(STANDING, self._stand)
        self._restart()
        self._publish(self._begun)

    def deactivate_core(self) -> None:
        """Stand still, and let the clock end."""
        self._clock_topic = None
        self._pace.interrupt()

    def retune(self, values: Any) -> None:
        """New timeouts for the commands; another factor takes hold at once."""
        for watch in self._plant.live.watches:
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
        """Whether time is kept and commands come, then contents of the motion."""
        pace, live = self._pace, self._plant.live
        details = {**self._plant.details(), **pace.details(self._is_running)}
        wrong = [pace.lag] if self._is_running and pace.is_lagging else []
        wrong += [self._plant.silence] if self._plant.silence else []
        wrong += self._plant.lost_wrenches
        if self._waits and self._standing.waited > LATE and live.watch.last is not None:
            wrong.append(f"no command for {self._standing.waited:.3g} s, the state is repeated")
        details["states repeated"] = str(self._standing.repeats)
        details["commands that answered a state again"] = str(self._standing.doubled)
        pace.open_window()
        standing = "paused" if self._is_paused else "waiting for a command"
        what = "simulating" if self._is_running else standing
        text = "; ".join([*wrong, f"{what}, t = {live.now.t:.9g} s"])
        return (WARN if wrong else OK), text, details

    @property
    def _is_running(self) -> bool:
        return self.active and not (self._is_paused or self.parameters.lock_step)

    @property
    def _waits(self) -> bool:
        """Whether time stands until a command comes."""
        return self.active and self.parameters.lock_step and not self._is_paused

    def _advance(self) -> None:
        self._plant.live.tick()
        is_due = self._is_running and self._pace.factor > 0.0
        due = self._epoch + round(self._pace.due * NANOSECONDS) if is_due else self._now()
        self._publish(due)

    def _publish(self, stamp: int) -> None:
        """Show the newest state.

        Args:
            stamp: Counts unless simulated time is published [ns].

        Raises:
            DivergedError: It is not finite, or its time does not fit into a message.
        """
        if self.parameters.publish_clock:
            stamp = self._plant.time
        try:
            if self._clock_topic is not None:
                self._clock_topic.show(stamp)
            self._standing.show(stamp)
            self._outputs.publish(stamp, self.parameters)
        except MessageError as error:
            raise DivergedError(f"the state cannot be published: {error}") from error

    def _stand(self) -> None:
        """Show the state again to listeners that came late or lost a message."""
        if self._is_running:
            return
        if self._standing.is_wanted(self._outputs.listeners, self._waits):
            stamp = self._plant.time if self.parameters.publish_clock else self._now()
            self._standing.show_again(stamp)
            self._outputs.repeat(stamp)

    def _now(self) -> int:
        return int(self.get_clock().now().nanoseconds)

    def _restart(self, factor: float | None = None) -> None:
        """The time between ticks begins now; the present state needs no tick."""
        self._pace.restart(factor)
        self._begun = self._now()
        self._epoch = self._begun - round(self._pace.due * NANOSECONDS)
        self._pace.skip()
        self._pace.interrupt()

    def _on_command(self, topic: str, read: Callable[[Any], Any]) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            try:
                command = read(msg)
            except MessageError as error:
                self.drop("command", f"{topic}: {error}; the last good command is held")
                return
            if self._waits and not self._standing.takes(read_answered(msg)):
                return
            self._plant.live.watch.take(command)
            if self._waits:
                self._advance()

        return take

    def _on_wrench(self, hear: Callable[[Any], None]) -> Callable[[Any], None]:
        def take(msg: Any) -> None:
            try:
                hear(msg)
            except MessageError as error:
                self.drop("wrench", f"{error}; the last good one is held")

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
            was_active = self.active
            self._show(self._begun)
            response.success = self.active == was_active
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
        """Fill in the answer of a service: its action, or the reason of its refusal."""
        if response.success:
            response.message = f"{done}, t = {self._plant.live.now.t:.9g} s"
        else:
            response.message = self.fault or f"the node is {self.state}"
        return response


class Standing:
    """The state that waits: listeners that have not seen it, and commands that answered it.

    A message may be lost, and a listener may come late. While time stands no later state makes up
    for it, so the same state is shown again: for `ARRIVAL` when a listener appears, and in lock
    step whenever no command comes. A controller may then answer one state twice. The second answer
    must not advance time, or the loop would run a tick late for ever. Commands carry the stamp of
    the state that they answer, which separates them.

    Attributes:
        repeats: How often a state was shown again.
        doubled: Commands not taken: the state that they answer was answered before.
    """

    def __init__(self) -> None:
        self.repeats = self.doubled = 0
        self._listeners = 0
        self._until = 0.0
        self._slowest = 0.0
        self._stamps: set[int] = set()
        self._answered: set[int] = set()
        self._since = self._shown = perf_counter()

    def show(self, stamp: int) -> None:
        """A new state is shown under a stamp [ns]; answers to the one before come too late."""
        self._answered, self._stamps = self._stamps - {stamp}, {stamp}
        self._since = self._shown = perf_counter()

    def show_again(self, stamp: int) -> None:
        """The same state is shown under a stamp [ns]."""
        self.repeats += 1
        self._stamps.add(stamp)
        self._shown = perf_counter()

    def takes(self, answered: int | None) -> bool:
        """Whether a command counts.

        Args:
            answered: Stamp of the state that it answers [ns]; None where it does not say so.
        """
        if answered in self._answered:
            self.doubled += 1
            return False
        latency = perf_counter() - self._shown
        self._slowest = max(latency, _FORGET * self._slowest)
        return True

    def is_wanted(self, listeners: int, is_lock_step: bool) -> bool:
        """Whether the state should be shown again now.

        Args:
            listeners: How many there are.
            is_lock_step: Whether a command is waited for.
        """
        now = perf_counter()
        if listeners > self._listeners:
            self._until = now + ARRIVAL
        self._listeners = listeners
        is_late = now - self._shown >= max(REPEAT, _SLACK * self._slowest)
        return now < self._until or (is_lock_step and is_late)

    @property
    def waited(self) -> float:
        """For how long the newest state has waited for its command [s]."""
        return perf_counter() - self._since
