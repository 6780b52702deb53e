"""Results of a demo: numbers of its recording, and the tables of its summary."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.applications.demo.files import PLANT, RATE
from mbd_ros.applications.demo.loop import (
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
from mbd_ros.applications.demo.page import Check, Table, check_table
from mbd_ros.core.contracts import without_multiplier
from mbd_ros.core.rows.constraint import Row
from mbd_ros.core.state import NANOSECOND, NONE, Array
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_reader import messages
from mbd_ros.parts.forces.prescribed_torque import PrescribedTorque
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.runs.simulation import build_simulation
from msg_adapters.diagnostics import Health, read_diagnostics
from msg_adapters.joint_state import JointStateReader
from msg_adapters.joint_trajectory import Trajectory, read_joint_trajectory

Stamps = NDArray[np.int64]
SETTLED = 1.0  # s from which numbers count: hand-over, ramp of the reference and filters are over
_OPEN = 1.0e-9  # rad or m, rad/s or m/s: of constraints that are projected in every step
_LOST = 0.02  # of commands or estimates: a recorder that the machine keeps waiting
_MILLISECOND = 1.0e6  # ns
_NANOSECOND = 1e-9  # s


class DemoNumbers:
    """Numbers of a demo; arrays have one row a joint state from `SETTLED` on.

    Args:
        folder: With the scene of the plant, which knows the disturbance.

    Attributes:
        joints: Actuated joints, in the order of the commands; one column each.
        plant: Scene of the plant.
        time: [s], shape (k,).
        commands: [N·m], shape (k, n).
        estimates: Of the inverse dynamics [N·m], shape (k, n).
        disturbance: [N·m], shape (k, n).
    """

    def __init__(self, signals: Signals, folder: Path) -> None:
        self.signals, self.joints = signals, signals.loop.names
        self.plant = load_scene(folder / PLANT)
        self.time = signals.torques.time[signals.torques.time >= SETTLED]
        answered = signals.states.time[self._answered]
        self.commands = self.at(self.time, answered, signals.commands)
        self.estimates = self._settled(signals.torques).effort
        self.disturbance = self.disturbance_at(self.time)

    @cached_property
    def rows(self) -> Sequence[Row]:
        """Constraint rows of the plant, in the order of their forces."""
        rows = build_simulation(self.plant).system.multiplier_rows
        return [row._replace(name=without_multiplier(row.name)) for row in rows]

    def disturbance_at(self, times: Array) -> Array:
        """The disturbance [N·m], shape (k, n), at times [s]."""
        (part,) = [force for force in self.plant.forces if isinstance(force, PrescribedTorque)]
        rows = [self.plant.robot.joint(name).v for name in self.joints]
        k, x = self.plant.system().k, self.plant.initial
        return np.array([part.force(k, x._replace(t=t), NONE)[rows] for t in times.tolist()])

    @staticmethod
    def at(times: Array, known: Array, values: Array) -> Array:
        """Columns of `values`, linear between the times `known`, at other times."""
        return np.column_stack([np.interp(times, known, column) for column in values.T])

    def loop(self) -> Series:
        """The tracking of the controller, settled."""
        series = self.signals.loop
        return _cut(series, series.time >= SETTLED)

    def reference_at(self, times: Array) -> Array:
        """Measured positions less tracking errors [rad], shape (k, n), at times [s]."""
        states, loop = self.signals.states, self.signals.loop
        measured = self.at(loop.time, states.time, states.position[:, states.columns(self.joints)])
        return self.at(times, loop.time, measured - loop.position)

    @cached_property
    def latency(self) -> Latency:
        """From joint states to commands."""
        sent = self.signals.states.log[self._answered]
        took = (self.signals.command_log - sent) / _MILLISECOND
        return Latency(*np.percentile(took, [50, 99, 100]).tolist())

    @cached_property
    def real_time_factor(self) -> float:
        """Simulated seconds per second."""
        states = self.signals.states
        seconds = (states.log[-1] - states.log[0]) * 1e-9
        return float(states.time[-1] - states.time[0]) / max(float(seconds), 1e-9)

    @cached_property
    def violation(self) -> tuple[float, float]:
        """Largest violation of positions and of velocities in the reports of the simulator."""
        values = [health.values for health in self.signals.health]
        return (
            max(float(v["drift of positions"]) for v in values),
            max(float(v["drift of velocities"]) for v in values),
        )

    def force_errors(self) -> Array | None:
        """RMS of estimated against true multipliers of the dependent joints, shape (n_d,)."""
        estimated, true = self.signals.coupling, self.signals.forces
        if estimated is None or true is None:
            return None
        settled = _cut(estimated, estimated.time >= SETTLED)
        known = true.effort[:, true.columns(settled.names)]
        return rms(settled.effort - self.at(settled.time, true.time, known))

    def checks(self) -> list[Check]:
        """The checks of every demo."""
        signals, ticks = self.signals, len(self.signals.states.time)
        expected = round((signals.states.time[-1] - signals.states.time[0]) * RATE) + 1
        answers, opened = len(signals.loop.time), max(self.violation)
        counts = {"commands": len(signals.commands), "torque estimates": len(signals.torques.time)}
        return [
            Check("every number is finite", self._is_finite(), f"{ticks} joint states"),
            Check("no joint state is missing", ticks == expected, f"{ticks} of {expected}"),
            Check("the controller answered each", answers == ticks, f"{answers} of {ticks}"),
            Check(
                f"at most {100 * _LOST:g} % were not recorded",
                min(counts.values()) >= (1.0 - _LOST) * ticks,
                ", ".join(f"{count} {what}" for what, count in counts.items()),
            ),
            Check(f"constraint violation <= {_OPEN:g}", opened <= _OPEN, f"{opened:.2g}"),
        ]

    @property
    def _answered(self) -> NDArray[np.intp]:
        """Which joint state each command answers: the newest one, as time stands in between."""
        signals = self.signals
        before = np.searchsorted(signals.states.log, signals.command_log, side="right") - 1
        return np.maximum(before, 0)

    def _settled(self, series: Series) -> Series:
        """The columns of the joints, from `SETTLED` on."""
        columns = series.columns(self.joints)
        rows = series.time >= SETTLED
        return Series(
            self.joints,
            series.log[rows],
            series.time[rows],
            *(values[rows][:, columns] for values in series[3:]),
        )

    def _is_finite(self) -> bool:
        states, loop, torques = self.signals[:3]
        arrays: Sequence[Array] = (*states[3:], *loop[3:], *torques[3:], self.signals.commands)
        forces = [s.effort for s in (self.signals.forces, self.signals.coupling) if s is not None]
        return all(np.isfinite(values).all() for values in (*arrays, *forces))


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


class Series(NamedTuple):
    """A JointState topic, one row a message, one column a joint or constraint row; NaN is absent.

    Attributes:
        log: When each message was published [ns of the system clock], shape (k,).
        time: Its stamp [s of simulated time], strictly increasing, shape (k,).
        position: Shape (k, n), as are velocity and effort.
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


def _cut(series: Series, rows: NDArray[np.bool_]) -> Series:
    return Series(series.names, *(values[rows] for values in series[1:]))


class Latency(NamedTuple):
    """Time from a joint state to the command that answers it, both when published [ms]."""

    median: float
    p99: float
    longest: float


def rms(values: Array) -> Array:
    """Root mean square of every column."""
    return np.sqrt(np.mean(values**2, axis=0))


def tables(numbers: DemoNumbers) -> list[Table]:
    """The whole summary."""
    found = [_tracking(numbers), _torques(numbers)]
    if numbers.signals.forces is not None:
        found.append(_forces(numbers))
    return [*found, _loop(numbers), _topics(numbers), check_table(numbers.checks())]


def _tracking(numbers: DemoNumbers) -> Table:
    loop = numbers.loop()
    error, s = 1e3 * loop.position, 1e3 * loop.velocity
    rows = zip(
        numbers.joints,
        *_texts(rms(error), np.abs(error).max(axis=0), np.abs(s).max(axis=0), loop.effort[-1]),
        strict=True,
    )
    columns = ("joint", "RMS [mrad]", "max [mrad]", "max |s| [mrad/s]", "chatter [N·m]")
    return Table(f"Tracking error after {SETTLED:g} s", columns, list(rows))


def _texts(*rows: np.ndarray) -> list[list[str]]:
    return [[f"{value:.3g}" for value in row] for row in rows]


def _torques(numbers: DemoNumbers) -> Table:
    difference = numbers.estimates - numbers.commands
    rest = difference - numbers.disturbance
    span = np.ptp(numbers.commands, axis=0)
    rows = zip(
        numbers.joints,
        *_texts(span),
        _shares(rms(difference), span),
        *_texts(rms(numbers.disturbance)),
        _shares(rms(rest), span),
        strict=True,
    )
    columns = ("joint", "command range", "difference", "disturbance", "difference without it")
    title = f"Torque estimate less command after {SETTLED:g} s: RMS [N·m], of the range"
    return Table(title, columns, list(rows))


def _shares(values: np.ndarray, spans: np.ndarray) -> list[str]:
    """Values, and how much of the spans they are."""
    return [
        f"{v:.3g} ({100 * v / s:.2f} %)" if s > 0.0 else f"{v:.3g}"
        for v, s in zip(values, spans, strict=True)
    ]


def _forces(numbers: DemoNumbers) -> Table:
    forces, errors = numbers.signals.forces, numbers.force_errors()
    assert forces is not None
    values = forces.effort[forces.time >= SETTLED]
    units = {row.name: row.unit for row in numbers.rows}
    estimated = () if numbers.signals.coupling is None else numbers.signals.coupling.names
    error_of = {} if errors is None else dict(zip(estimated, errors, strict=True))
    rows = [
        (
            f"{name} [{units[name]}]",
            *(f"{value:.4g}" for value in (values[:, i].min(), values[:, i].max())),
            f"{error_of[name]:.3g}" if name in error_of else "-",
        )
        for i, name in enumerate(forces.names)
    ]
    columns = ("row", "from", "to", "RMS error of the estimate")
    return Table(f"Coupling and loop forces after {SETTLED:g} s", columns, rows)


def _loop(numbers: DemoNumbers) -> Table:
    latency, (position, velocity) = numbers.latency, numbers.violation
    rows = [
        ("joint state -> command, median", f"{latency.median:.3f} ms"),
        ("joint state -> command, 99 %", f"{latency.p99:.3f} ms"),
        ("joint state -> command, longest", f"{latency.longest:.3f} ms"),
        ("simulated seconds per second", f"{numbers.real_time_factor:.2f}"),
        ("constraint violation, position", f"{position:.2g} rad or m"),
        ("constraint violation, velocity", f"{velocity:.2g} per s"),
    ]
    return Table("Loop", ("", "value"), rows)


def _topics(numbers: DemoNumbers) -> Table:
    simulated = float(np.ptp(numbers.signals.states.time))
    rows = []
    for topic, log in sorted(numbers.signals.logs.items()):
        seconds = (log[-1] - log[0]) * _NANOSECOND
        # As many messages begin an interval as there are intervals.
        rates = [(len(log) - 1) / span if span > 0.0 else 0.0 for span in (seconds, simulated)]
        texts = [f"{rate:.1f}" if rate > 0.0 else "once" for rate in rates]
        rows.append((topic, str(len(log)), *texts))
    return Table("Topics", ("topic", "messages", "per second", "per simulated second"), rows)


def read_signals(bag: Path, controller: str) -> Signals:
    """Read a demo.

    Args:
        controller: Fully qualified name of the node.

    Raises:
        DataError: Not a bag, or not that of a demo.
    """
    recorded: dict[str, list[Any]] = {}
    logs: dict[str, list[int]] = {}
    for topic, log_time, message in messages(bag):
        recorded.setdefault(topic, []).append(message)
        logs.setdefault(topic, []).append(log_time)
    trajectory, loop_topic = reference(controller), loop_state(controller)
    needed = (STATES, COMMANDS, loop_topic, TORQUES, trajectory, DIAGNOSTICS)
    if lacking := [topic for topic in needed if topic not in recorded]:
        raise DataError(f"{bag}: nothing on {', '.join(lacking)}")
    stamped = {topic: np.array(times) for topic, times in logs.items()}

    def series(topic: str) -> Series | None:
        return _series(recorded[topic], stamped[topic]) if topic in recorded else None

    states, loop, torques = map(series, (STATES, loop_topic, TORQUES))
    assert states and loop and torques
    return Signals(
        states,
        loop,
        torques,
        series(FORCES),
        series(COUPLING),
        np.array([message.data for message in recorded[COMMANDS]], dtype=np.float64),
        stamped[COMMANDS],
        read_joint_trajectory(recorded[trajectory][-1]),
        _health(recorded[DIAGNOSTICS]),
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
