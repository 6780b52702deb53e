"""The error of what has no symbolic form."""

from mbd_ros.errors import MbdError


class Untraceable(MbdError):
    """A system that cannot be traced: names the part and why."""
