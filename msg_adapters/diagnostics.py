"""diagnostic_msgs/DiagnosticArray <-> plain values."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from msg_adapters.time import write_time

OK, WARN, ERROR, STALE = 0, 1, 2, 3


class Health(NamedTuple):
    """One DiagnosticStatus.

    Attributes:
        name: The reporting node.
        level: OK, WARN, ERROR or STALE.
        values: Details, all as text.
    """

    name: str
    level: int
    message: str
    values: Mapping[str, str]


def read_diagnostics(msg: Any) -> list[Health]:
    """Statuses of one array."""
    return [
        Health(
            status.name,
            status.level[0] if isinstance(status.level, bytes) else int(status.level),
            status.message,
            {pair.key: pair.value for pair in status.values},
        )
        for status in msg.status
    ]


def write_diagnostics(
    msg: Any, stamp: int, health: Health, new_status: Any, new_pair: Any, hardware_id: str = ""
) -> Any:
    """Fill a DiagnosticArray with one status and return it.

    Args:
        stamp: Header stamp [ns].
        health: What to report.
        new_status: The class DiagnosticStatus.
        new_pair: The class KeyValue.
        hardware_id: Robot that the report is about.
    """
    write_time(msg.header.stamp, stamp)
    status = new_status(name=health.name, message=health.message, hardware_id=hardware_id)
    status.level = bytes([health.level])
    status.values = [new_pair(key=key, value=str(value)) for key, value in health.values.items()]
    msg.status = [status]
    return msg
