"""Contracts of what a node that answers joint states builds when it is configured."""

from collections.abc import Sequence
from typing import Protocol

from msg_adapters.joint_state import JointStateReader
from msg_adapters.joint_state_cdr import JointStateCdrReader


class Heard(Protocol):
    """What the newest messages carried."""

    @property
    def extra(self) -> tuple[str, ...]:
        """Joints that were not asked for."""
        ...


class JointStatePipeline(Protocol):
    """From serialized joint states to samples.

    Attributes:
        reader: Serialized joint states to samples.
        joints: Which joints the newest joint state carried.
    """

    reader: JointStateCdrReader
    joints: JointStateReader

    def held(self) -> Sequence[str]:
        """Joints that the newest joint state lacked, and that nothing else gives."""
        ...
