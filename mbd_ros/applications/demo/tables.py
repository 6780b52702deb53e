"""The summary of a demo: tables for terminal and page."""

import numpy as np

from mbd_ros.applications.demo.numbers import SETTLED, DemoNumbers, rms
from mbd_ros.applications.demo.summary import Table, check_table

_NANOSECOND = 1e-9  # s


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


def _texts(*rows: np.ndarray) -> list[list[str]]:
    return [[f"{value:.3g}" for value in row] for row in rows]


def _shares(values: np.ndarray, spans: np.ndarray) -> list[str]:
    """Values, and how much of the spans they are."""
    return [
        f"{v:.3g} ({100 * v / s:.2f} %)" if s > 0.0 else f"{v:.3g}"
        for v, s in zip(values, spans, strict=True)
    ]
