"""Commands of joints, as vector in an agreed order or by name -> vector in the order of use."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError, listed
from msg_adapters.joint_state import JointStateReader
from msg_adapters.multi_array import read_multi_array


class CommandReader:
    """Reads commands of all joints or of none: half a command is no command.

    Args:
        joints: Order of the vectors in messages.
        order: The same joints in the order of the result.
        takes: What a command is where it is no effort of the joint, by name.
    """

    def __init__(
        self, joints: Sequence[str], order: Sequence[str], takes: Mapping[str, str] | None = None
    ) -> None:
        self._takes = dict(takes or {})
        self._size = len(joints)
        self._columns = np.array([list(joints).index(name) for name in order], dtype=np.intp)
        self._reader = JointStateReader(order)

    def read_vector(self, msg: Any) -> NDArray[np.float64]:
        """Commands of a Float64MultiArray, fresh.

        Raises:
            MessageError: Wrong length, or a value that is NaN or infinite.
        """
        return read_multi_array(msg, self._size)[self._columns]

    def read_efforts(self, msg: Any) -> NDArray[np.float64]:
        """Commands of a JointState, its efforts by name, fresh.

        Raises:
            MessageError: Names empty, repeated, unknown or missing, an array of wrong length, an
                effort that is absent, NaN or infinite, or joints whose commands are no efforts.
        """
        for name, what in self._takes.items():
            raise MessageError(f"an effort is no command of {name}, which takes the {what}")
        sample, reader = self._reader.read(msg), self._reader
        if reader.extra:
            accepted = ", ".join(reader.names)
            raise MessageError(f"unknown names {listed(reader.extra)}; accepted: {accepted}")
        if reader.missing:
            raise MessageError(f"names {', '.join(reader.missing)} are missing")
        if not np.isfinite(sample.effort).all():
            raise MessageError(f"effort is absent or not finite: {sample.effort.tolist()}")
        return np.array(sample.effort)
