"""Names of parts and of what they show."""

import re


def type_name(kind: type) -> str:
    """Type as scenes write it: `joint_spring` of JointSpring."""
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", kind.__name__).lower()
