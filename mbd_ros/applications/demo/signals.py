"""The recording of a demo, read back as arrays."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.applications.demo.topics import (
    COMMANDS,
    COUPLING,
    DIAGNOSTICS,
    FORCES,
    SIMULATOR,
    STATES,
    TORQUES,
    loop_state,
    reference,
)
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bags import messages
from msg_adapters.diagnostics import Health, read_diagnostics
from msg_adapters.joint_state import JointStateReader
from msg_adapters.joint_trajectory import Trajectory, read_joint_trajectory

Stamps = NDArray[np.int64]


class Series(NamedTuple):
    """A JointState topic, one row a message, one column a joint or constraint row; NaN is absent.

    Attributes:
        names: Columns.
        log: When each message was published [ns of the system clock], shape (k,).
        time: Its stamp [s of simulated time], strictly increasing, shape (k,).
        position: Shape (k, n), as are velocity and effort.
        velocity: See above.
        effort: See above.
    """

    names: tuple[str, ...]
    log: Stamps
    time: Array
    position: Array
    velocity: Array
    effort: Array

    def columns(self, names: Sequence[str]) -> list[int]:
        """Columns of some names."""
        return [self.names.index(name) for name in names]


class Signals(NamedTuple):
    """A demo as it was recorded.

    Attributes:
        states: Motion of the plant; effort is what the actuators exerted.
        loop: Of the controller: position is the tracking error, velocity s, effort the chatter.
        torques: Estimates of the inverse dynamics.
        forces: Multipliers of the plant, as efforts; None without constraint rows.
        coupling: Estimated multipliers of the dependent joints; None without any.
        commands: Torques of the actuated joints, in the order of `loop` [N·m], shape (k, n).
        command_log: When each was published [ns], shape (k,).
        trajectory: The reference.
        health: Reports of the simulator, in their order.
        logs: Topic -> when its messages were published [ns].
    """

    states: Series
    loop: Series
    torques: Series
    forces: Series | None
    coupling: Series | None
    commands: Array
    command_log: Stamps
    trajectory: Trajectory
    health: list[Health]
    logs: dict[str, Stamps]


def read_signals(bag: Path, controller: str) -> Signals:
    """Read a demo.

    Args:
        bag: The recording.
        controller: Fully qualified name of the node.

    Raises:
        DataError: Not a bag, or not that of a demo.
    """
    kept: dict[str, list[Any]] = {}
    logs: dict[str, list[int]] = {}
    for topic, log_time, message in messages(bag):
        kept.setdefault(topic, []).append(message)
        logs.setdefault(topic, []).append(log_time)
    trajectory, own = reference(controller), loop_state(controller)
    needed = (STATES, COMMANDS, own, TORQUES, trajectory, DIAGNOSTICS)
    if lacking := [topic for topic in needed if topic not in kept]:
        raise DataError(f"{bag}: nothing on {', '.join(lacking)}")
    stamped = {topic: np.array(times) for topic, times in logs.items()}

    def series(topic: str) -> Series | None:
        return _series(kept[topic], stamped[topic]) if topic in kept else None

    states, loop, torques = map(series, (STATES, own, TORQUES))
    assert states and loop and torques
    return Signals(
        states,
        loop,
        torques,
        series(FORCES),
        series(COUPLING),
        np.array([message.data for message in kept[COMMANDS]], dtype=np.float64),
        stamped[COMMANDS],
        read_joint_trajectory(kept[trajectory][-1]),
        _health(kept[DIAGNOSTICS]),
        stamped,
    )


def _series(rows: list[Any], log: Stamps) -> Series:
    reader = JointStateReader(rows[0].name)
    samples = [reader.read(row) for row in rows]
    time = np.array([sample.stamp for sample in samples]) * NANOSECOND
    new = np.r_[True, time[1:] > np.maximum.accumulate(time)[:-1]]
    fields = (np.array([s[i] for s in samples], dtype=np.float64)[new] for i in (1, 2, 3))
    return Series(reader.names, log[new], time[new], *fields)


def _health(arrays: Iterable[Any]) -> list[Health]:
    """Those of a simulator that has a scene."""
    every = (health for array in arrays for health in read_diagnostics(array))
    return [h for h in every if h.name == SIMULATOR and "simulated time" in h.values]
