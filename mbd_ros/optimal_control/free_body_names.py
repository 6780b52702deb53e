"""What coordinates and velocities of a free body are called in tasks and tables."""

_WORDS = (
    ("position", "xyz"),
    ("orientation", "xyzw"),
    ("linear_velocity", "xyz"),
    ("angular_velocity", "xyz"),
)


def body_names(body: str) -> list[str]:
    """Names of the seven coordinates and the six velocities of a free body, in its axes."""
    return [f"{body}.{word}.{axis}" for word, axes in _WORDS for axis in axes]
