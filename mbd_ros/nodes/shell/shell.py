"""The shell of every node: topics, diagnostics, life cycle, time."""

import gc
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from time import monotonic, perf_counter
from types import TracebackType
from typing import Any, NamedTuple

import yaml
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockChange, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration, Infinite
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from mbd_ros.errors import MbdError
from mbd_ros.nodes.shell.parameters import PARAMETERS, Declared, Parameter, ParameterError
from mbd_ros.nodes.shell.serialized import message_of
from msg_adapters.clock import read_clock
from msg_adapters.diagnostics import ERROR, OK, WARN, Health, write_diagnostics
from msg_adapters.errors import MessageError

# ---- health -----------------------------------------------------------------------------------
# Reports of a node: dropped messages, topics that cannot work, one status.


QUIET = 5.0  # [s] between two equal warnings
VARIETY = 10  # different warnings for one reason within that time
_NUMBER = re.compile(r"(?<![A-Za-z_0-9])[+-]?\d[\d.]*(e[+-]?\d+)?")  # not that of `joint7`


class Drops:
    """Counts ignored messages, and warns at most once per `QUIET` of the same.

    Warnings that differ in numbers alone are the same. A flood of different ones is cut off at
    `VARIETY` a reason, so that neither log nor memory follows it.
    """

    def __init__(self, warn: Callable[[str], Any]) -> None:
        self.counts: dict[str, int] = {}
        self._warn = warn
        self._said: dict[str, dict[str, float]] = {}

    def add(self, reason: str, text: str) -> None:
        """Count one drop; `text` is logged unless the same was logged just before."""
        self.counts[reason] = count = self.counts.get(reason, 0) + 1
        now, kind = monotonic(), _NUMBER.sub("#", text)
        said = self._said.setdefault(reason, {})
        if now < said.get(kind, 0.0):
            return
        for old in [old for old, quiet_until in said.items() if quiet_until <= now]:
            del said[old]
        if len(said) < VARIETY:
            said[kind] = now + QUIET
            self._warn(f"{text} (dropped for '{reason}': {count})")


class Endpoint(NamedTuple):
    """A subscription or publisher under watch.

    Attributes:
        entity: The rclpy Subscription or Publisher.
        incoming: True for a subscription.
        single: More than one publisher is a fault.
    """

    entity: Any
    incoming: bool
    single: bool = False


def topic_problems(node: Node, endpoints: Iterable[Endpoint]) -> list[str]:
    """Why messages of some topics cannot be what the node expects, one sentence each.

    The graph is asked (50 us per topic) instead of QoS events: an event tells when a fault
    begins and never when it ends.
    """
    lines: list[str] = []
    for endpoint in endpoints:
        own, topic = _announced(endpoint.entity.qos_profile), endpoint.entity.topic_name
        if endpoint.incoming:
            peers = node.get_publishers_info_by_topic(topic)
            pairs = [(peer.qos_profile, own) for peer in peers]
        else:
            peers = node.get_subscriptions_info_by_topic(topic)
            pairs = [(own, peer.qos_profile) for peer in peers]
        for peer, pair in zip(peers, pairs, strict=True):
            verdict, reason = qos_check_compatible(*pair)
            if verdict == QoSCompatibility.ERROR:
                lines.append(f"{topic}: incompatible QoS with node '{peer.node_name}': {reason}")
        if endpoint.single and len(peers) > 1:
            names = ", ".join(sorted(peer.node_name for peer in peers))
            lines.append(f"{topic}: {len(peers)} publishers ({names}), one was expected")
    return lines


def _announced(own: QoSProfile) -> QoSProfile:
    """The profile as peers see it: a duration left out is 0 here and infinite in the graph."""
    return QoSProfile(
        depth=own.depth,
        reliability=own.reliability,
        durability=own.durability,
        liveliness=own.liveliness,
        deadline=own.deadline if own.deadline.nanoseconds else Infinite,
        liveliness_lease_duration=(
            own.liveliness_lease_duration
            if own.liveliness_lease_duration.nanoseconds
            else Infinite
        ),
    )


class Diagnostics:
    """The status of one node on /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def send(self, reasons: list[tuple[int, str]], values: Mapping[str, str]) -> None:
        """Publish one status: the worst level, the sentences of all that are not OK.

        Args:
            reasons: Level and sentence of each part of the node, at least one.
            values: Details.
        """
        level = max(level for level, _ in reasons)
        texts = [text for own, text in reasons if text and (own != OK or level == OK)]
        health = Health(self._node.get_fully_qualified_name(), level, "; ".join(texts), values)
        now = self._node.get_clock().now().nanoseconds
        self._publisher.publish(
            write_diagnostics(DiagnosticArray(), now, health, DiagnosticStatus, KeyValue)
        )

    def flush(self) -> None:
        """Wait until the last status has arrived, at most 0.1 s."""
        self._publisher.wait_for_all_acked(Duration(seconds=0.1))


# ---- entities ---------------------------------------------------------------------------------
# Publishers, subscriptions and timers of a node, and how long they live.


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
        self, state: str, destroy: Callable[[Any], Any], entity: Any, *watch: Endpoint
    ) -> None:
        """Remember an entity.

        Args:
            state: Of the life cycle; what is made before any configuration stays.
            destroy: Destroys the entity.
            entity: Publisher, subscription or timer.
            watch: Its topic.
        """
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


# ---- life cycle -------------------------------------------------------------------------------
# Life cycle of a node: its transitions, and failures of the core.


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


# ---- shell ------------------------------------------------------------------------------------
# The shell of every node: parameters, topics, diagnostics, time. `process.run` drives it.


# Faults of parameter files that rcl accepts in silence: duplicate keys and keys of no node.


def file_warnings(argv: Sequence[str], node_name: str) -> list[str]:
    """Faults that rcl accepts in silence in the files after --params-file.

    Args:
        argv: Command line.
        node_name: Fully qualified name of the node.

    Returns:
        A line per duplicate key (the last one wins), and per file of which no key is this node.
    """
    files = [value for flag, value in pairwise(argv) if flag == "--params-file"]
    lines: list[str] = []
    for file in files:
        try:
            tree = yaml.compose(Path(file).read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        except yaml.YAMLError as error:
            lines.append(f"{file}: not checked for duplicate and unused keys: {error}")
            continue
        lines += [f"{file}: key '{key}' is given twice, the last wins" for key in _twice(tree)]
        keys = sorted(set(_node_keys(tree, "")))
        if not any(_matches(key, node_name) for key in keys):
            lines.append(
                f"{file}: no key is this node: the keys {', '.join(keys)} do not match; "
                f"accepted: {node_name} or /**"
            )
    return lines


def _entries(tree: Any) -> Iterable[tuple[Any, Any]]:
    return tree.value if isinstance(tree, yaml.MappingNode) else ()


def _twice(tree: Any) -> Iterator[str]:
    counts = Counter(key.value for key, _ in _entries(tree))
    yield from (key for key, count in counts.items() if count > 1)
    for _, value in _entries(tree):
        yield from _twice(value)


def _node_keys(tree: Any, path: str) -> Iterator[str]:
    for key, value in _entries(tree):
        if key.value == "ros__parameters":
            yield path
        else:
            yield from _node_keys(value, f"{path}/{key.value.strip('/')}")


def _matches(key: str, node_name: str) -> bool:
    pattern = re.escape(key).replace(r"/\*\*", "(/[^/]+)*").replace(r"/\*", "/[^/]+")
    return re.fullmatch(pattern, node_name) is not None


# Checks of /clock: rclpy takes any message, and a bad one ends the process.


def guard_clock(node: Node, drop: Callable[[str], None]) -> None:
    """Let a node in simulated time ignore messages of /clock without a valid time.

    A negative second raises in rclpy, out of the callback; a nanosec of a second or more gives a
    time that no stamp can carry.

    Args:
        node: The node, as constructed.
        drop: Told of each ignored message.
    """
    source = node._time_source
    take = source.clock_callback

    def take_if_time(msg: Any) -> None:
        try:
            now = read_clock(msg)
        except MessageError as error:
            drop(f"/clock: {error}")
            return
        if now < 0:
            drop(
                f"/clock: {msg.clock.sec} s is before the beginning of time; accepted: 0 and more"
            )
            return
        take(msg)

    source.clock_callback = take_if_time  # of a subscription that is made later
    if source._clock_sub is not None:
        source._clock_sub.callback = take_if_time


class Shell(LifeCycle):
    """A node that works, or reports in /diagnostics why it does not.

    Subclasses set `NAME` and `PARAMETERS` and override what they need of `configure_core`,
    `activate_core`, `deactivate_core`, `safe`, `retune`, `prepare`, `reset` and `health`. What
    `subscribe`, `publish_to` and `every` make in `configure_core` or `activate_core` is destroyed
    with that configuration or activation; what they make in the constructor stays.
    """

    NAME = "shell"
    PARAMETERS: tuple[Parameter, ...] = ()

    def __init__(self, argv: Sequence[str] = ()) -> None:
        super().__init__(self.NAME)
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
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._diagnostics = Diagnostics(self)
        self.create_timer(1.0, self._guarded(self.report, True), clock=self._steady)
        least = Duration(nanoseconds=-1)
        backward = JumpThreshold(min_forward=None, min_backward=least, on_clock_change=True)
        self._jump = self.get_clock().create_jump_callback(backward, post_callback=self._jumped)

    def all_parameters(self, values: Any) -> tuple[Parameter, ...]:
        """Parameters of a node that is not configured, where some depend on values of others.

        Args:
            values: All parameters. An MbdError says that what they name has none.
        """
        return PARAMETERS + self.PARAMETERS

    def retune(self, values: Any) -> None:
        """Replace the objects made from gains; called between cycles, on a configured node.

        Args:
            values: All parameters, not yet in `self.parameters`. An MbdError refuses them.
        """

    def prepare(self, values: Any) -> None:
        """Parameters change while the node is not configured.

        Args:
            values: All parameters, not yet in `self.parameters`.
        """

    def reset(self, reason: str) -> None:
        """Forget the past of a configured node: time jumped back or the clock changed."""

    def health(self) -> tuple[int, str, dict[str, str]]:
        """Level, sentence and details of a configured node; asked once per second."""
        return OK, "", {}

    @property
    def parameters(self) -> Any:
        """All parameters as one immutable named tuple; dots in names are underscores."""
        return self._declared.values

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
            kind: Message class.
            topic: Relative name.
            callback: Takes the message.
            qos: Profile or depth.
            single_publisher: Report more than one publisher.
            always: Call in every state: robot_description comes before configuring.
            raw: The callback takes the serialized bytes.
        """
        silent = SubscriptionEventCallbacks(use_default_callbacks=False)  # topic_problems tells
        take = self._guarded(callback if raw else self._decoded(kind, topic, callback), always)
        subscription = self.create_subscription(
            kind, topic, take, qos, event_callbacks=silent, raw=True
        )
        endpoint = Endpoint(subscription, True, single_publisher)
        self._entities.keep(self.state, self.destroy_subscription, subscription, endpoint)
        return subscription

    def unsubscribe(self, subscription: Subscription) -> None:
        """Destroy a subscription before its time."""
        self._entities.drop(subscription)

    def publish_to(self, kind: type, topic: str, qos: QoSProfile | int) -> Publisher:
        """Make a publisher; a subscriber with incompatible QoS is reported."""
        silent = PublisherEventCallbacks(use_default_callbacks=False)
        publisher = self.create_publisher(kind, topic, qos, event_callbacks=silent)
        endpoint = Endpoint(publisher, False)
        self._entities.keep(self.state, self.destroy_publisher, publisher, endpoint)
        return publisher

    def every(self, period: float, callback: Callable[[], None]) -> Timer:
        """Call while active, every `period` [s] of the steady clock: also when /clock stands."""
        timer = self.create_timer(period, self._guarded(callback, False), clock=self._steady)
        self._entities.keep(self.state, self.destroy_timer, timer)
        return timer

    def drop(self, reason: str, text: str) -> None:
        """Count an ignored message under a short key; warns at most every 5 s of the same."""
        self._drops.add(reason, text)

    def try_start(self) -> None:
        """Configure and activate, if `autostart` is set and the node is unconfigured."""
        if self.parameters.autostart:
            self.start()

    def drive(self, executor: Executor, patience: float) -> None:
        """Handle callbacks for `patience` [s]; a node that ticks does so here."""
        # Not spin_until_future_complete: that of an EventsExecutor loses 32 bytes a call.
        end = perf_counter() + patience
        while (left := end - perf_counter()) > 0.0:
            executor.spin_once(timeout_sec=left)

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

    def close(self, error: BaseException | None) -> None:
        """End: safe command, diagnostics with `error` (None: a signal), shutdown."""
        if self.active:
            self.safe_or_say()
        self.active = False
        last = (OK, "stopped") if error is None else (ERROR, repr(error))
        self._diagnostics.send([last], {"state": "finalized"})
        self._diagnostics.flush()
        if self.state != "finalized":
            self.trigger_shutdown()

    def check(self) -> None:
        """Refuse to configure while a parameter given at the start is wrong."""
        self._declared.follow(self, self.all_parameters(self.parameters))
        if self._declared.problems:
            raise ParameterError("; ".join(self._declared.problems.values()))

    def release(self) -> None:
        """Destroy what this configuration and its activation made."""
        self._entities.release()

    def release_activation(self) -> None:
        """Destroy what this activation made."""
        self._entities.release_activation()

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

    def _guarded(self, callback: Callable[..., None], always: bool) -> Callable[..., None]:
        def call(*message: Any) -> None:
            if self.active or always:
                try:
                    callback(*message)
                except MbdError as error:
                    self.fail(error)
                    self.report()

        return call

    def _follow_or_wait(self, changes: Sequence[Any] = ()) -> None:
        """Have the parameters that belong to the values; configuring says why it failed."""
        if not self.configured:
            with suppress(MbdError):
                self._declared.follow(self, self.all_parameters(self.parameters))

    def _retune(self, values: Any) -> None:
        if self.configured:
            self.retune(values)
        else:
            self.prepare(values)

    def _jumped(self, jump: TimeJump) -> None:
        changes = (ClockChange.ROS_TIME_ACTIVATED, ClockChange.ROS_TIME_DEACTIVATED)
        back = f"time jumped back by {-jump.delta.nanoseconds * 1e-9:.3f} s"
        reason = "the clock changed" if jump.clock_change in changes else back
        self.get_logger().info(f"{reason}: starting afresh")
        if self.configured:
            self._guarded(self.reset, True)(reason)
