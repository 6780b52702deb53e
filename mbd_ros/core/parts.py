"""What a part of a scene must offer."""

from typing import Any, Protocol

from mbd_ros.core.state import Array, State


class ForceTerm(Protocol):
    """A generalized force that depends on the state.

    A part reads `data`, never runs a Pinocchio algorithm that writes it, and never changes its
    inputs.
    """

    def force(self, data: Any, x: State) -> Array:
        """Generalized force on the joints [N·m or N], shape (nv,)."""
        ...
