"""Life cycle of a node: its transitions, and failures of the core."""

import gc
from collections.abc import Callable
from types import TracebackType
from typing import Any

from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn

from mbd_ros.errors import MbdError

DONE = TransitionCallbackReturn.SUCCESS
REFUSED = TransitionCallbackReturn.FAILURE
BROKEN = TransitionCallbackReturn.ERROR  # rclpy then calls on_error and goes to unconfigured


class _Crash:
    """Keeps the exception that rclpy swallows when a transition raises."""

    error: BaseException | None = None

    def __enter__(self) -> None: ...

    def __exit__(
        self, kind: Any, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.error = error or self.error


class LifeCycle(LifecycleNode):
    """The states and transitions of every node.

    Attributes:
        active: True between activation and deactivation.
        fault: Why the node does not work; empty when nothing failed.
    """

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.active = False
        self.fault = ""
        self._crash = _Crash()
        # rclpy raises out of this service for a transition that the state does not allow.
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._change_state_if_allowed

    def configure_core(self) -> None:
        """Build everything from `self.parameters`. An MbdError leaves the node unconfigured."""

    def activate_core(self) -> None:
        """Prepare for the first message. An MbdError leaves the node inactive."""

    def deactivate_core(self) -> None:
        """Stop, with the safe command as the last one."""
        self.safe()

    def safe(self) -> None:
        """Send the safe command."""

    def check(self) -> None:
        """Raise the MbdError that forbids to configure, if there is one."""

    def release(self) -> None:
        """Destroy what `configure_core` and `activate_core` made in ROS."""

    def release_activation(self) -> None:
        """Destroy what `activate_core` made in ROS."""

    @property
    def state(self) -> str:
        """Label of the state: unconfigured, inactive, active, finalized, or a transition's."""
        return str(self._state_machine.current_state[1])

    @property
    def configured(self) -> bool:
        """True while inactive or active."""
        return self.state in ("inactive", "active")

    def start(self) -> None:
        """Configure and activate an unconfigured node."""
        if self.state == "unconfigured" and self.trigger_configure() == DONE:
            self.trigger_activate()

    def fail(self, error: MbdError) -> None:
        """Send the safe command, keep the reason for diagnostics, stop working."""
        self._say(error)
        if self.active:
            self.safe_or_say()
            self.trigger_deactivate()

    def safe_or_say(self) -> None:
        """`safe`, where its own failure must not hide the first one."""
        try:
            self.safe()
        except MbdError as error:
            self.get_logger().error(f"the safe command failed: {error}")

    def raise_crash(self) -> None:
        """Raise what a transition raised and rclpy swallowed, if anything."""
        if self._crash.error is not None:
            raise self._crash.error

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build; a refusal leaves nothing half-built."""
        self.fault = ""
        gc.unfreeze()
        result = self._attempt(self._configure, REFUSED)
        if result != DONE:
            self.release()
        gc.collect()
        gc.freeze()  # a full collection over the imports costs 11 ms
        return result

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start working."""
        self.fault = ""
        result = self._attempt(self.activate_core, REFUSED)
        self.active = result == DONE
        if self.active:
            self.get_logger().info("active")
        else:
            self.release_activation()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        self.active = False
        self.get_logger().info("inactive")
        result = self._attempt(self.deactivate_core, BROKEN)
        self.release_activation()
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Back to unconfigured."""
        self.release()
        return DONE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave for good: the process stays until a signal ends it."""
        if self.active:
            self.active = False
            self.safe_or_say()
        self.release()
        return DONE

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a failed deactivation or a crash in a transition."""
        self.active = False
        self.release()
        return DONE

    def _configure(self) -> None:
        self.check()
        self.configure_core()

    def _attempt(
        self, step: Callable[[], None], otherwise: TransitionCallbackReturn
    ) -> TransitionCallbackReturn:
        with self._crash:
            try:
                step()
            except MbdError as error:
                self._say(error)
                return otherwise
        return DONE

    def _say(self, error: MbdError) -> None:
        self.fault = str(error)
        self.get_logger().error(f"{self.state}: {error}")

    def _change_state_if_allowed(self, request: Any, response: Any) -> Any:
        allowed = self._state_machine.available_transitions
        ids = {row[1]: row[0] for row in allowed}
        wanted = request.transition
        if wanted.label in ids or (not wanted.label and wanted.id in ids.values()):
            return self._change_state(request, response)
        self.get_logger().warning(
            f"transition '{wanted.label or wanted.id}' is not possible while {self.state}; "
            f"accepted: {', '.join(ids)}"
        )
        response.success = False
        return response
