"""What is asked of feet on the ground that no force plate measured."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mbd_ros.motion.unmeasured_contacts import StanceTask


def stance_of(method: str | None, gap: float | None, speed: float | None) -> "StanceTask | None":
    """What is asked of feet on the ground; None for nothing.

    Raises:
        DataError: Names the option and what is accepted.
    """
    if method is gap is speed is None:
        return None
    from mbd_ros.motion.unmeasured_contacts import stance_task  # only where something touches

    return stance_task(method, gap, speed)
