"""Messages of external loads."""

from typing import Any

from mbd_ros.scene.reading.part_entries import MeasuredWrench
from msg_adapters.errors import MessageError
from msg_adapters.wrench import WrenchSample, read_wrench


def read_load(msg: Any, wrench: MeasuredWrench) -> WrenchSample:
    """The sample of a WrenchStamped.

    Raises:
        MessageError: It names the load: a frame other than that of the scene, or a component that
            is NaN or infinite.
    """
    expected = wrench.expressed_in
    try:
        sample = read_wrench(msg)
    except MessageError as error:
        raise MessageError(f"wrench '{wrench.name}': {error}") from error
    if sample.frame_id not in ("", expected):
        raise MessageError(
            f"wrench '{wrench.name}': frame '{sample.frame_id}', expected '{expected}'"
        )
    return sample
