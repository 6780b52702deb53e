"""Names of parts and of what they show."""

import re
from typing import Any


def type_name(kind: type) -> str:
    """Type as scenes write it: `joint_spring` of JointSpring."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()


def label(part: Any, quantity: str) -> str:
    """Quantity of a part as columns, topics and messages call it.

    Args:
        part: Has a name, or an empty one where the quantity says it all.
        quantity: Its name in the part.
    """
    return f"{part.name}.{quantity}" if part.name else quantity


def without_multiplier(label: str) -> str:
    """Name on topics of joint states, where a coupling goes by its dependent joint."""
    return label.removesuffix(".multiplier")
