"""Which numbers a scene may hold: ranges as annotations, checked where a file is read.

The largest one leaves room for the powers and products that dynamics makes of it, within 1.8e308.
"""

import math
from typing import Annotated, NamedTuple

LARGEST = 1.0e30  # of any number that says nothing else


class Within(NamedTuple):
    """Smallest and largest accepted value."""

    low: float
    high: float


Duration = Annotated[float, Within(1.0e-9, 1.0e9)]  # s
Smoothing = Annotated[float, Within(1.0e-12, 1.0e12)]  # m/s or rad/s
Unlimited = Annotated[float, Within(-math.inf, math.inf)]  # what has a check of its own
Share = Annotated[float, Within(1.0e-6, 1.0)]
ANY_NUMBER = Within(-LARGEST, LARGEST)
