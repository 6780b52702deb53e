"""The shell of every node: life cycle, topics, parameters, time and diagnostics.

A node is a subclass of `Shell` that converts messages, computes with the core, and publishes.
`process.run` drives it.
"""

import gc
from collections.abc import Callable, Sequence
from contextlib import suppress
from time import perf_counter
from types import TracebackType
from typing import Any

from rclpy.clock import Clock, ClockChange, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from mbd_ros.errors import MbdError
from mbd_ros.nodes.shell.clock import guard_clock
from mbd_ros.nodes.shell.diagnostics import Diagnostics, Drops, Endpoint, topic_problems
from mbd_ros.nodes.shell.parameters import (
    PARAMETERS,
    Declared,
    Parameter,
    ParameterError,
    guard_parameter_services,
)
from mbd_ros.nodes.shell.params_file import file_warnings
from mbd_ros.nodes.shell.serialized import message_of
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.errors import MessageError

DONE = TransitionCallbackReturn.SUCCESS
REFUSED = TransitionCallbackReturn.FAILURE
BROKEN = TransitionCallbackReturn.ERROR  # rclpy then calls on_error and goes to unconfigured


class Shell(LifecycleNode):
    """A node that works, or reports in /diagnostics why it does not.

    Subclasses set `NAME` and `PARAMETERS` and override what they need of `configure_core`,
    `activate_core`, `deactivate_core`, `safe`, `retune`, `prepare`, `reset` and `health`. What
    `subscribe`, `publish_to`, `every` and `keep` get in `configure_core` or `activate_core` is
    destroyed with that configuration or activation; what they get in the constructor stays.

    Attributes:
        active: True between activation and deactivation.
        fault: Why the node does not work; empty when nothing failed.
        steady_clock: A clock that never stands, whatever /clock does.
    """

    NAME = "shell"
    PARAMETERS: tuple[Parameter, ...] = ()

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(self.NAME)
        self.active = False
        self.fault = ""
        self._crash = _Crash()
        # rclpy raises out of this service for a transition that the state does not allow.
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._change_state_if_allowed
        guard_parameter_services(self)
        self._entities = Entities()
        self._known_problems: set[str] = set()
        self._drops = Drops(self.get_logger().warning)
        parameters = PARAMETERS + self.PARAMETERS
        self._declared = Declared(self, parameters, self._retune, lambda: self.configured)
        self._follow_or_wait()
        self.add_post_set_parameters_callback(self._follow_or_wait)
        unheard = file_warnings(argv, self.get_fully_qualified_name())
        for line in self._declared.undeclared(self) + unheard:
            self.get_logger().warning(line)
        guard_clock(self, lambda text: self.drop("clock", text))
        self.steady_clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = Diagnostics(self)
        self.create_timer(1.0, self.guarded(self.report, always=True), clock=self.steady_clock)
        least = Duration(nanoseconds=-1)
        backward = JumpThreshold(min_forward=None, min_backward=least, on_clock_change=True)
        self._jump = self.get_clock().create_jump_callback(backward, post_callback=self._jumped)

    # What a subclass overrides.

    def configure_core(self) -> None:
        """Build everything from `self.parameters`. An MbdError leaves the node unconfigured."""

    def activate_core(self) -> None:
        """Prepare for the first message. An MbdError leaves the node inactive."""

    def deactivate_core(self) -> None:
        """Stop, with the safe command as the last one."""
        self.safe()

    def safe(self) -> None:
        """Send the safe command."""

    def reset(self, reason: str) -> None:
        """Forget the past of a configured node: time jumped back or the clock changed."""

    def health(self) -> tuple[int, str, dict[str, str]]:
        """Level, sentence and details of a configured node; asked once per second."""
        return OK, "", {}

    def all_parameters(self, values: Any) -> tuple[Parameter, ...]:
        """Parameters of a node that is not configured, where some depend on values of others.

        Args:
            values: All parameters. An MbdError says that what they name has none.
        """
        return PARAMETERS + self.PARAMETERS

    def prepare(self, values: Any) -> None:
        """Parameters change while the node is not configured.

        Args:
            values: All parameters, not yet in `self.parameters`.
        """

    def retune(self, values: Any) -> None:
        """Replace the objects made from gains; called between cycles, on a configured node.

        Args:
            values: All parameters, not yet in `self.parameters`. An MbdError refuses them.
        """

    # What a subclass calls.

    @property
    def parameters(self) -> Any:
        """All parameters as one immutable named tuple; dots in names are underscores."""
        return self._declared.values

    @property
    def state(self) -> str:
        """Label of the state: unconfigured, inactive, active, finalized, or a transition's."""
        return str(self._state_machine.current_state[1])

    @property
    def configured(self) -> bool:
        """True while inactive or active."""
        return self.state in ("inactive", "active")

    def subscribe(
        self,
        kind: type,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile | int,
        *,
        single_publisher: bool = False,
        always: bool = False,
        raw: bool = False,
    ) -> Subscription:
        """Subscribe; the callback runs while active, and an MbdError in it deactivates.

        Args:
            callback: Takes the message.
            qos: Profile or depth.
            single_publisher: Report more than one publisher.
            always: Call in every state: robot_description comes before configuring.
            raw: The callback takes the serialized bytes.
        """
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)  # topic_problems tells
        take = self.guarded(
            callback if raw else self._decoded(kind, topic, callback), always=always
        )
        subscription = self.create_subscription(
            kind, topic, take, qos, event_callbacks=silent, raw=True
        )
        endpoint = Endpoint(subscription, True, single_publisher)
        self.keep(subscription, self.destroy_subscription, endpoint)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """Destroy a subscription before its time."""
        self._entities.drop(subscription)

    def publish_to(self, kind: type, topic: str, qos: QoSProfile | int) -> Publisher:
        """Make a publisher; a subscriber with incompatible QoS is reported."""
        silent = PublisherEventCallbacks(use_default_callbacks=False)
        publisher = self.create_publisher(kind, topic, qos, event_callbacks=silent)
        self.keep(publisher, self.destroy_publisher, Endpoint(publisher, False))
        return publisher

    def every(self, period: float, callback: Callable[[], None]) -> Timer:
        """Call while active, every `period` [s] of the steady clock: also when /clock stands."""
        timer = self.create_timer(period, self.guarded(callback), clock=self.steady_clock)
        self.keep(timer, self.destroy_timer)
        return timer

    def keep(self, entity: Any, destroy: Callable[[Any], Any], *watch: Endpoint) -> None:
        """Destroy an entity with the present configuration or activation.

        Args:
            entity: A publisher, subscription, timer, client, or whatever else must end then.
            watch: Its topic, where faults of the topic are reported.
        """
        self._entities.keep(self.state, entity, destroy, *watch)

    def drop(self, reason: str, text: str) -> None:
        """Count an ignored message under a short key; warns at most every 5 s of the same."""
        self._drops.add(reason, text)

    def guarded(
        self, callback: Callable[..., None], *, always: bool = False
    ) -> Callable[..., None]:
        """The callback, to be called while active only; an MbdError in it deactivates.

        Args:
            callback: Of a topic, a timer or a tick.
            always: Call it in every state.
        """

        def call(*message: Any) -> None:
            if self.active or always:
                try:
                    callback(*message)
                except MbdError as error:
                    self._fail(error)
                    self.report()

        return call

    def try_start(self) -> None:
        """Configure and activate, if `autostart` is set and the node is unconfigured."""
        if not self.parameters.autostart or self.state != "unconfigured":
            return
        if self.trigger_configure() == DONE:
            self.trigger_activate()

    # What `process.run` calls.

    def drive(self, executor: Executor, patience: float) -> None:
        """Handle callbacks for `patience` [s]; a node that ticks does so here."""
        # Not spin_until_future_complete: that of an EventsExecutor loses 32 bytes a call.
        end = perf_counter() + patience
        while (left := end - perf_counter()) > 0.0:
            executor.spin_once(timeout_sec=left)

    def raise_crash(self) -> None:
        """Raise what a transition raised and rclpy swallowed, if anything."""
        if self._crash.error is not None:
            raise self._crash.error

    def close(self, error: BaseException | None) -> None:
        """End: safe command, diagnostics with `error` (None: a signal), shutdown."""
        if self.active:
            self._safe_or_say()
        self.active = False
        last = (OK, "stopped") if error is None else (ERROR, repr(error))
        self._diagnostics.send([last], {"state": "finalized"})
        self._diagnostics.flush()
        if self.state != "finalized":
            self.trigger_shutdown()

    def report(self) -> None:
        """Publish the present diagnostics."""
        problems = topic_problems(self, self._entities.endpoints)
        for line in set(problems) - self._known_problems:
            self.get_logger().warning(line)
        self._known_problems = set(problems)
        reasons = [(WARN, line) for line in problems]
        if self.fault or not self.active:
            reasons.insert(0, (ERROR, self.fault) if self.fault else (WARN, self.state))
        values = {"state": self.state}
        if self.configured:
            level, text, details = self.health()
            reasons.append((level, text))
            values.update(details)
        values.update({f"dropped.{key}": str(n) for key, n in self._drops.counts.items()})
        self._diagnostics.send(reasons, values)

    # Transitions of the life cycle, which rclpy calls.

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Build; a refusal leaves nothing half-built."""
        self.fault = ""
        gc.unfreeze()
        result = self._attempt(self._configure, REFUSED)
        if result != DONE:
            self._entities.release()
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
            self._entities.release_activation()
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stop working."""
        self.active = False
        self.get_logger().info("inactive")
        result = self._attempt(self.deactivate_core, BROKEN)
        self._entities.release_activation()
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Back to unconfigured."""
        self._entities.release()
        return DONE

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Leave for good: the process stays until a signal ends it."""
        if self.active:
            self.active = False
            self._safe_or_say()
        self._entities.release()
        return DONE

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a failed deactivation or a crash in a transition."""
        self.active = False
        self._entities.release()
        return DONE

    def _configure(self) -> None:
        """Refuse to configure while a parameter given at the start is wrong; else build."""
        self._declared.follow(self, self.all_parameters(self.parameters))
        if self._declared.problems:
            raise ParameterError("; ".join(self._declared.problems.values()))
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

    def _fail(self, error: MbdError) -> None:
        """Send the safe command, keep the reason for diagnostics, stop working."""
        self._say(error)
        if self.active:
            self._safe_or_say()
            self.trigger_deactivate()

    def _safe_or_say(self) -> None:
        """`safe`, where its own failure must not hide the first one."""
        try:
            self.safe()
        except MbdError as error:
            self.get_logger().error(f"the safe command failed: {error}")

    def _say(self, error: MbdError) -> None:
        self.fault = str(error)
        self.get_logger().error(f"{self.state}: {error}")

    def _decoded(
        self, kind: type, topic: str, callback: Callable[[Any], None]
    ) -> Callable[[bytes], None]:
        def take(cdr: bytes) -> None:
            try:
                message = message_of(cdr, kind)
            except MessageError as error:
                self.drop("malformed", f"{self.resolve_topic_name(topic)}: {error}")
                return
            callback(message)

        return take

    def _jumped(self, jump: TimeJump) -> None:
        changes = (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED)
        back = f"time jumped back by {-jump.delta.nanoseconds * 1e-9:.3f} s"
        reason = "the clock changed" if jump.clock_change in changes else back
        self.get_logger().info(f"{reason}: starting afresh")
        if self.configured:
            self.guarded(self.reset, always=True)(reason)

    def _retune(self, values: Any) -> None:
        if self.configured:
            self.retune(values)
        else:
            self.prepare(values)

    def _follow_or_wait(self, changes: Sequence[Any] = ()) -> None:
        """Have the parameters that belong to the values; configuring says why it failed."""
        if not self.configured:
            with suppress(MbdError):
                self._declared.follow(self, self.all_parameters(self.parameters))


_Owned = list[tuple[Any, Callable[[], None]]]


class Entities:
    """Destroys entities together with the configuration or activation that made them.

    Attributes:
        endpoints: Topics under watch.
    """

    def __init__(self) -> None:
        self.endpoints: list[Endpoint] = []
        self._of_node: _Owned = []
        self._of_configuration: _Owned = []
        self._of_activation: _Owned = []

    def keep(
        self, state: str, entity: Any, destroy: Callable[[Any], Any], *watch: Endpoint
    ) -> None:
        """Remember an entity; what is made in the state unconfigured stays with the node."""
        self.endpoints += watch

        def forget() -> None:
            self.endpoints = [kept for kept in self.endpoints if kept not in watch]
            destroy(entity)

        later = self._of_node if state == "unconfigured" else self._of_configuration
        owned = self._of_activation if state == "activating" else later
        owned.append((entity, forget))

    def drop(self, entity: Any) -> None:
        """Destroy one entity before its time."""
        for owned in (self._of_node, self._of_configuration, self._of_activation):
            for entry in [e for e in owned if e[0] is entity]:
                owned.remove(entry)
                entry[1]()

    def release(self) -> None:
        """Destroy what the configuration and its activation made, the newest first."""
        self.release_activation()
        _empty(self._of_configuration)

    def release_activation(self) -> None:
        """Destroy what the activation made, the newest first."""
        _empty(self._of_activation)


def _empty(owned: _Owned) -> None:
    while owned:
        owned.pop()[1]()


class _Crash:
    """Keeps the exception that rclpy swallows when a transition raises."""

    error: BaseException | None = None

    def __enter__(self) -> None: ...

    def __exit__(
        self, kind: Any, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.error = error or self.error
