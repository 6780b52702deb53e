"""The test's side of a conversation over DDS."""

import math
import time
from collections.abc import Callable
from typing import Any

import rclpy
from deadline import DEADLINE
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState, GetState
from nodes.node_process import NodeProcess
from rcl_interfaces.srv import SetParameters
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter

from msg_adapters.diagnostics import Health, read_diagnostics

RESEND = 10.0  # s
_AGAIN = 1.0  # s
_TOPICS = 10  # of a test at most, with messages that wait to be taken


class Probe:
    """The test's side of the conversation: a node with a context and executor of its own."""

    def __init__(self, domain: int) -> None:
        self._context = Context()
        rclpy.init(context=self._context, domain_id=domain)
        self.node: Node = rclpy.create_node("probe", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self.health: list[Health] = []
        self._clients: dict[str, Any] = {}
        self.node.create_subscription(DiagnosticArray, "/diagnostics", self._keep, 10)

    def __enter__(self) -> "Probe":
        return self

    def __exit__(self, *error: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self._context)

    def spin_until(self, done: Callable[[], Any], timeout: float = DEADLINE) -> Any:
        """First true value of `done()`.

        Raises:
            AssertionError: There is none within `timeout` [s].
        """
        end = time.monotonic() + timeout
        while not (value := done()):
            assert time.monotonic() < end, self._expired(timeout)
            self._executor.spin_once(timeout_sec=0.02)
        return value

    def publish_until(self, publisher: Any, message: Any, done: Callable[[], Any]) -> Any:
        """Publish a message, and return the first true value of `done()`.

        A reader with best effort may lose the message on a busy machine, so that it is published
        again after `RESEND` seconds.
        """
        sent = -math.inf

        def is_done() -> Any:
            nonlocal sent
            if time.monotonic() > sent + RESEND:
                publisher.publish(message)
                sent = time.monotonic()
            return done()

        return self.spin_until(is_done)

    def spin_for(self, seconds: float) -> None:
        """Take messages for `seconds` [s]."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            self._executor.spin_once(timeout_sec=left)

    def wait_health(self, done: Callable[[Health], Any], timeout: float = DEADLINE) -> Health:
        """First status from now on that satisfies `done`."""
        seen = len(self.health)
        found = self.spin_until(lambda: [h for h in self.health[seen:] if done(h)], timeout)
        return found[0]

    def meet(self, node: str) -> None:
        """Until a node knows all publishers and subscriptions that were made here.

        Who asks it a service that was made later: it learns of one after the other.
        """
        client = self.node.create_client(GetState, f"{node}/get_state")
        self.spin_until(client.service_is_ready)
        self.ask_repeatedly(client, GetState.Request())
        self.node.destroy_client(client)

    def call(self, kind: type, name: str, request: Any) -> Any:
        """Response of a service; all but `ChangeState` may hear the request twice."""
        is_new = name not in self._clients
        if is_new:
            self._clients[name] = self.node.create_client(kind, name)
        client = self._clients[name]
        self.spin_until(client.service_is_ready)
        if kind is not ChangeState:
            return self.ask_repeatedly(client, request)
        if is_new:
            self.ask_repeatedly(client, ChangeState.Request())  # of no transition: refused
        return self.ask(client, request)

    def ask(self, client: Any, request: Any) -> Any:
        """Response to a request, sent once."""
        future = client.call_async(request)
        self.spin_until(future.done)
        return future.result()

    def ask_repeatedly(self, client: Any, request: Any) -> Any:
        """Response to a request, sent again and again until there is one.

        A client knows a service a moment before the service knows the client, and rmw gives the
        response to an unknown client up after 0.1 s.
        """
        end = time.monotonic() + DEADLINE
        while time.monotonic() < end:
            future, again = client.call_async(request), time.monotonic() + _AGAIN
            while time.monotonic() < again and not future.done():
                self._executor.spin_once(timeout_sec=0.02)
            if future.done():
                return future.result()
        raise AssertionError(f"{client.srv_name}: no response; {self._expired(DEADLINE)}")

    def set_parameter(self, node: str, name: str, value: Any) -> Any:
        """SetParametersResult of one change."""
        request = SetParameters.Request(
            parameters=[Parameter(name, value=value).to_parameter_msg()]
        )
        return self.call(SetParameters, f"{node}/set_parameters", request).results[0]

    def change_state(self, node: str, label: str) -> bool:
        """Whether the transition `label` succeeded."""
        request = ChangeState.Request()
        request.transition.label = label
        return bool(self.call(ChangeState, f"{node}/change_state", request).success)

    def state(self, node: str) -> str:
        """Label of the life cycle state, when the node has handled all that was sent before."""
        response = self.call(GetState, f"{node}/get_state", GetState.Request())
        for _ in range(_TOPICS):  # what the node said before may still wait to be taken
            self._executor.spin_once(timeout_sec=0.0)
        return str(response.current_state.label)

    def _expired(self, timeout: float) -> str:
        """How long was waited, and what all nodes said meanwhile."""
        logs = [f"{' '.join(node.command)}:\n{node.log}" for node in NodeProcess.started]
        newest = {health.name: health for health in self.health}
        return "\n".join([f"waited {timeout} s in vain", *map(str, newest.values()), *logs])

    def _keep(self, msg: Any) -> None:
        self.health += read_diagnostics(msg)
