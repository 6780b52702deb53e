"""Errors of adapters."""

from collections.abc import Sequence


class MessageError(ValueError):
    """A message that must be dropped: says which field is wrong and why."""


_MOST, _LONGEST = 8, 64  # names, letters


def listed(names: Sequence[str]) -> str:
    """Names of a message for people: the first ones, shortened, whatever was sent."""
    shown = ", ".join(_printable(name) for name in names[:_MOST])
    return shown if len(names) <= _MOST else f"{shown} and {len(names) - _MOST} more"


def _printable(name: str) -> str:
    start = "".join(letter if letter.isprintable() else "?" for letter in name[:_LONGEST])
    return start if len(name) <= _LONGEST else f"{start} ({len(name)} letters)"
