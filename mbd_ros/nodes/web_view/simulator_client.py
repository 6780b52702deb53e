"""The services of one simulator: what buttons of a page ask for."""

from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import SetBool, Trigger

from mbd_ros.view.live_panel import REAL_TIME_FACTOR, Wish

_TRIGGERS = ("reset", "step")
_PAUSES = {"pause": True, "run": False}


class SimulatorClient:
    """Asks one simulator, and tells what it answered.

    Args:
        ask_of: Makes a client of a service of that type and name.
        name: Of the simulator, relative or absolute.
        tell: Is told the answers.

    Attributes:
        name: As given.
    """

    def __init__(
        self, ask_of: Callable[[type, str], Any], name: str, tell: Callable[[str], None]
    ) -> None:
        self.name, self._tell = name, tell
        self._clients = {what: ask_of(Trigger, f"{name}/{what}") for what in _TRIGGERS}
        self._pause = ask_of(SetBool, f"{name}/pause")
        self._parameters = ask_of(SetParameters, f"{name}/set_parameters")
        self._waiting: dict[Any, Any] = {}

    def do(self, wish: Wish) -> None:
        """Ask for what somebody wished for."""
        if wish.what in _PAUSES:
            self._ask(self._pause, SetBool.Request(data=_PAUSES[wish.what]), wish.what)
        elif wish.what == REAL_TIME_FACTOR:
            changed = Parameter("real_time_factor", value=wish.value).to_parameter_msg()
            request = SetParameters.Request(parameters=[changed])
            self._ask(self._parameters, request, f"{wish.what} {wish.value:g}")
        else:
            self._ask(self._clients[wish.what], Trigger.Request(), wish.what)

    def _ask(self, client: Any, request: Any, what: str) -> None:
        """Ask; an older question to the same service is answered no more."""
        if client in self._waiting:
            client.remove_pending_request(self._waiting.pop(client))
        if not client.service_is_ready():
            self._tell(f"{what}: no {self.name} there")
            return
        self._tell(f"{what}: asked")
        self._waiting[client] = future = client.call_async(request)
        future.add_done_callback(partial(self._answered, client, what))

    def _answered(self, client: Any, what: str, future: Any) -> None:
        if self._waiting.get(client) is not future:
            return
        del self._waiting[client]
        answer = future.result()
        if hasattr(answer, "results"):
            refused = [result.reason for result in answer.results if not result.successful]
            self._tell(f"{what}: {refused[0] if refused else 'done'}")
        else:
            self._tell(f"{what}: {answer.message}")
