"""What stands between a controller and a simulator in tests: it loses messages, or delays them."""

import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from nodes.joint_stream import parameter_file
from nodes.node_process import NodeProcess
from nodes.simulation_client import DEEP, NAME, QuickProbe
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray

from msg_adapters.multi_array import read_answered
from msg_adapters.time import read_time

IN, OUT = "/relay/commands", "/relay/joint_states"
REMAPPED = ("-r", f"~/commands:={IN}", "-r", f"joint_states:={OUT}")


class Relay:
    """Passes joint states and commands on.

    A command is held back until the simulator shows a state that is `delay` younger than the one
    which it answers: a delay of simulated time, however busy the machine is.

    Args:
        probe: Whose node it uses.
        loss: Share of the messages that get lost, of either kind.
        delay: Of commands [s of stamps].
        without_velocity: Whether joint states lose their velocities.

    Attributes:
        loss: Of joint states; may change at any time.
        loss_of_commands: The same.
        delay: The same.
        stamps: Of the joint states, as they came [ns].
        commands: Vectors that were passed on, with the stamp of the state that they answer, or
            None.
        states: Messages, as they came.
    """

    def __init__(
        self,
        probe: QuickProbe,
        loss: float = 0.0,
        delay: float = 0.0,
        without_velocity: bool = False,
    ) -> None:
        self._random, self._is_blind = np.random.default_rng(12), without_velocity
        self.loss, self.loss_of_commands, self.delay = loss, loss, delay
        self.stamps: deque[int] = deque(maxlen=100_000)
        self.commands: deque[tuple[int | None, Any]] = deque(maxlen=100_000)
        self.states: deque[Any] = deque(maxlen=100_000)
        self._waiting: deque[tuple[int, Any]] = deque()
        create, publish = probe.node.create_subscription, probe.node.create_publisher
        self.to_controller = publish(JointState, OUT, DEEP)
        self.to_simulator = publish(Float64MultiArray, f"{NAME}/commands", DEEP)
        self._states = create(JointState, "/joint_states", self._pass_state, DEEP)
        self._commands = create(Float64MultiArray, IN, self._pass_command, DEEP)

    def _pass_state(self, message: Any) -> None:
        stamp = read_time(message.header.stamp)
        if self.stamps and stamp < self.stamps[-1]:
            self._waiting.clear()  # another simulation
        self.stamps.append(stamp)
        self.states.append(message)
        if self._is_blind:
            message.velocity = []
        if not self._is_lost(self.loss):
            self.to_controller.publish(message)
        while self._waiting and self._waiting[0][0] <= stamp:
            self.to_simulator.publish(self._waiting.popleft()[1])

    def _pass_command(self, message: Any) -> None:
        answered = read_answered(message)
        self.commands.append((answered, np.array(message.data)))
        if self._is_lost(self.loss_of_commands):
            return
        due = (answered or 0) + round(1e9 * self.delay)
        if answered is not None and self.stamps and due > self.stamps[-1]:
            self._waiting.append((due, message))
        else:
            self.to_simulator.publish(message)

    def _is_lost(self, loss: float) -> bool:
        return bool(loss and self._random.random() < loss)


def started(
    domain: int, folder: Path, module: str, arguments: Sequence[str] = (), **parameters: Any
) -> NodeProcess:
    """A node of this package."""
    folder.mkdir(exist_ok=True)
    values = {name.replace("__", "."): value for name, value in parameters.items()}
    file = parameter_file(folder, values)
    target = ("-m", "mbd_ros.nodes", module, "--ros-args", "--params-file", str(file))
    return NodeProcess([sys.executable, *target, *arguments], domain)


@contextmanager
def ended(*nodes: NodeProcess) -> Iterator[list[NodeProcess]]:
    """Kills what still runs of the nodes, and of those that are appended."""
    running = list(nodes)
    try:
        yield running
    finally:
        for node in running:
            if node.process.poll() is None:
                node.process.kill()
                node.wait()
