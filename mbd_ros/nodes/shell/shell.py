"""The shell of every node: parameters, topics, diagnostics, time. `process.run` drives it."""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import Any

import yaml
from rclpy.clock import Clock, ClockChange, JumpThreshold, TimeJump
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from rclpy.timer import Timer

from mbd_ros.errors import MbdError
from mbd_ros.nodes.shell.declared import Declared
from mbd_ros.nodes.shell.entities import Entities
from mbd_ros.nodes.shell.health import Diagnostics, Drops, Endpoint, topic_problems
from mbd_ros.nodes.shell.life_cycle import LifeCycle
from mbd_ros.nodes.shell.parameters import PARAMETERS, Parameter, ParameterError
from mbd_ros.nodes.shell.serialized import message_of
from msg_adapters.clock import read_clock
from msg_adapters.diagnostics import ERROR, OK, WARN
from msg_adapters.errors import MessageError

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
