"""Diagnostics of a node: its status, topics that cannot work, messages that it ignores."""

import re
from collections.abc import Callable, Iterable, Mapping
from time import monotonic
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.duration import Duration, Infinite
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, QoSProfile, qos_check_compatible

from msg_adapters.diagnostics import OK, Health, write_diagnostics

QUIET = 5.0  # [s] between two equal warnings
VARIETY = 10  # different warnings for one reason within that time
_NUMBER = re.compile(r"(?<![A-Za-z_0-9])[+-]?\d[\d.]*(e[+-]?\d+)?")  # not that of `joint7`


class Diagnostics:
    """The status of one node on /diagnostics."""

    def __init__(self, node: Node) -> None:
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)

    def send(self, reasons: list[tuple[int, str]], values: Mapping[str, str]) -> None:
        """Publish one status: the worst level, the sentences of all that are not OK.

        Args:
            reasons: Level and sentence of each part of the node, at least one.
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
        announced, topic = _announced(endpoint.entity.qos_profile), endpoint.entity.topic_name
        if endpoint.incoming:
            peers = node.get_publishers_info_by_topic(topic)
            pairs = [(peer.qos_profile, announced) for peer in peers]
        else:
            peers = node.get_subscriptions_info_by_topic(topic)
            pairs = [(announced, peer.qos_profile) for peer in peers]
        for peer, pair in zip(peers, pairs, strict=True):
            verdict, reason = qos_check_compatible(*pair)
            if verdict == QoSCompatibility.ERROR:
                lines.append(f"{topic}: incompatible QoS with node '{peer.node_name}': {reason}")
        if endpoint.single and len(peers) > 1:
            names = ", ".join(sorted(peer.node_name for peer in peers))
            lines.append(f"{topic}: {len(peers)} publishers ({names}), one was expected")
    return lines


def _announced(profile: QoSProfile) -> QoSProfile:
    """The profile as peers see it: a duration left out is 0 here and infinite in the graph."""
    return QoSProfile(
        depth=profile.depth,
        reliability=profile.reliability,
        durability=profile.durability,
        liveliness=profile.liveliness,
        deadline=profile.deadline if profile.deadline.nanoseconds else Infinite,
        liveliness_lease_duration=(
            profile.liveliness_lease_duration
            if profile.liveliness_lease_duration.nanoseconds
            else Infinite
        ),
    )


class Drops:
    """Counts ignored messages, and warns at most once per `QUIET` of the same.

    Warnings that differ in numbers alone are the same. A flood of different ones is cut off at
    `VARIETY` a reason, so that neither log nor memory follows it.
    """

    def __init__(self, warn: Callable[[str], Any]) -> None:
        self.counts: dict[str, int] = {}
        self._warn = warn
        self._quiet_until: dict[str, dict[str, float]] = {}

    def add(self, reason: str, text: str) -> None:
        """Count one drop; `text` is logged unless the same was logged just before."""
        self.counts[reason] = count = self.counts.get(reason, 0) + 1
        now, kind = monotonic(), _NUMBER.sub("#", text)
        quiet = self._quiet_until.setdefault(reason, {})
        if now < quiet.get(kind, 0.0):
            return
        for old in [old for old, quiet_until in quiet.items() if quiet_until <= now]:
            del quiet[old]
        if len(quiet) < VARIETY:
            quiet[kind] = now + QUIET
            self._warn(f"{text} (dropped for '{reason}': {count})")
