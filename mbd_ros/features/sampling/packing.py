"""Arrays as JSON holds them, to the bit: what goes to workers and comes back."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.chains import Checkpoint, Sampled


def listed(done: Sampled) -> dict[str, Any]:
    """What a block of chains gave."""
    return {
        "values": _packed(done.values),
        "accepted": _packed(done.accepted),
        "end": listed_checkpoint(done.end),
    }


def received(value: Mapping[str, Any]) -> Sampled:
    """The same back."""
    values, accepted = (_unpacked(value[key]) for key in ("values", "accepted"))
    return Sampled(values, accepted, checkpoint(value["end"]))


def listed_checkpoint(one: Checkpoint) -> list[Any]:
    """Where a block of chains stands."""
    return [_packed(one.q), _packed(one.v), one.sweeps, one.dt]


def checkpoint(listed: Sequence[Any]) -> Checkpoint:
    """The same back."""
    q, v, sweeps, dt = listed
    return Checkpoint(_unpacked(q), _unpacked(v), sweeps, dt)


def _packed(values: Array) -> list[Any]:
    data = np.ascontiguousarray(values, dtype="<f8").tobytes()
    return [list(values.shape), base64.b64encode(data).decode()]


def _unpacked(packed: Sequence[Any]) -> Array:
    shape, data = packed
    return np.frombuffer(base64.b64decode(data), dtype="<f8").reshape(shape).copy()
