"""Inputs of actuators, as vector in an agreed order or by name -> vector in the order of use."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.errors import MessageError, listed
from msg_adapters.joint_state import JointStateReader
from msg_adapters.multi_array import read_multi_array


class CommandReader:
    """Reads all inputs or none: half a command is no command.

    Args:
        order: Order of the vectors in messages, by name of input or joint.
        inputs: Names of the inputs in the order of the result.
        joints: Joint -> the input that it stands for.
        takes: Input -> what it is, where it is no effort of a joint.
        positions: Inputs whose values stand in `position` instead of `effort`.
    """

    def __init__(
        self,
        order: Sequence[str],
        inputs: Sequence[str],
        joints: Mapping[str, str] | None = None,
        takes: Mapping[str, str] | None = None,
        positions: Collection[str] = (),
    ) -> None:
        self._joints, self._takes = dict(joints or {}), dict(takes or {})
        places = [self._joints.get(name, name) for name in order]
        self._size = len(places)
        self._columns = np.array([places.index(name) for name in inputs], dtype=np.intp)
        self._reader = JointStateReader(inputs)
        self._is_position = np.array([name in positions for name in inputs], dtype=np.bool_)

    def read_vector(self, msg: Any) -> NDArray[np.float64]:
        """Inputs of a Float64MultiArray, fresh.

        Raises:
            MessageError: Wrong length, or a value that is NaN or infinite.
        """
        return read_multi_array(msg, self._size)[self._columns]

    def read_named(self, msg: Any) -> NDArray[np.float64]:
        """Inputs of a JointState by name, fresh; a joint stands for its only actuator.

        Raises:
            MessageError: Names empty, repeated, unknown or missing, an array of wrong length, a
                value that is absent, NaN or infinite, or the effort of a joint whose actuator
                takes something else.
        """
        sample, reader = self._reader.read(self._renamed(msg)), self._reader
        if reader.extra:
            accepted = ", ".join(self._label(name) for name in reader.names)
            raise MessageError(f"unknown names {listed(reader.extra)}; accepted: {accepted}")
        if reader.missing:
            lacking = ", ".join(self._label(name) for name in reader.missing)
            raise MessageError(f"names {lacking} are missing")
        self._refuse_efforts(msg.name, sample.position)
        values = np.where(self._is_position, sample.position, sample.effort)
        if not np.isfinite(values).all():
            field = "effort or position" if self._is_position.any() else "effort"
            raise MessageError(f"{field} is absent or not finite: {values.tolist()}")
        return values

    def _renamed(self, msg: Any) -> "_Renamed":
        """The message with inputs in place of joints."""
        names = [self._joints.get(name, name) for name in msg.name]
        return _Renamed(msg.header, names, msg.position, msg.velocity, msg.effort)

    def _label(self, name: str) -> str:
        """The joint that stands for an input, or the input."""
        return next((joint for joint, one in self._joints.items() if one == name), name)

    def _refuse_efforts(self, names: Sequence[str], position: NDArray[np.float64]) -> None:
        for name in names:
            mine = self._joints.get(name)
            if mine is None or mine == name or mine not in self._takes:
                continue
            at = self._reader.names.index(mine)
            if not (self._is_position[at] and np.isfinite(position[at])):
                raise MessageError(
                    f"an effort is no command of {name}, which takes the {self._takes[mine]}; the "
                    f"name of that input is {mine}"
                )


class _Renamed(NamedTuple):
    """The fields of a JointState."""

    header: Any
    name: list[str]
    position: Any
    velocity: Any
    effort: Any
