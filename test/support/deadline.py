"""The one time-out of all tests: what is awaited comes by then, however busy the machine is.

A wait ends as soon as its condition holds, so that a generous time-out costs nothing.
"""

import time
from collections.abc import Callable
from typing import Any

DEADLINE = 120.0  # s; a test as a whole has the `timeout` of pyproject.toml, which is longer
# Parameters of a node that answers a stream: to it, no pause of a busy machine is silence, and
# stamps that fall behind the clock of a busy machine are not those of another clock.
PATIENT = {"timeout": 60.0, "clock_tolerance": 600.0}


def until(condition: Callable[[], Any]) -> Any:
    """First true value of `condition()`, which is asked again and again.

    Raises:
        AssertionError: There is none within `DEADLINE`.
    """
    end = time.monotonic() + DEADLINE
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {DEADLINE} s in vain"
        time.sleep(0.01)
    return value
