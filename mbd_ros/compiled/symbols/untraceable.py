"""The error of what has no symbolic form."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from mbd_ros.errors import MbdError


class Untraceable(MbdError):
    """A system that cannot be traced: names the part and why."""


@contextmanager
def tracing(part: Any) -> Iterator[None]:
    """Says which part it is that cannot be asked with symbols.

    Args:
        part: The part that is asked.

    Raises:
        Untraceable: Names it.
    """
    kind, own = type(part).__name__, getattr(part, "name", "")
    name = part if isinstance(part, str) else f"{own} ({kind})" if own else kind
    try:
        yield
    except Untraceable as error:
        raise Untraceable(f"{name} cannot be traced: {error}") from error
    except (TypeError, AttributeError, ValueError, NotImplementedError) as error:
        raise Untraceable(f"{name} takes numbers only: {error}") from error
