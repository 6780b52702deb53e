"""Pictures of a demo."""

from functools import partial
from typing import Any

from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.numbers import DemoNumbers
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, line, name, picture


def pictures(numbers: DemoNumbers) -> dict[str, bytes]:
    """PNG by title."""
    kinds = {
        "Motion and reference": _draw_motion,
        "Tracking error": _draw_errors,
        "Torques": _draw_torques,
    }
    count = len(numbers.joints)
    made = {title: picture(partial(draw, numbers), count) for title, draw in kinds.items()}
    if numbers.signals.forces is not None:
        rows = len(numbers.signals.forces.names)
        made["Coupling and loop forces"] = picture(partial(_draw_forces, numbers), rows)
    return made


def overview(numbers: DemoNumbers) -> bytes:
    """One PNG with motion, error and torques of every joint side by side."""
    draws = [partial(draw, numbers) for draw in (_draw_motion, _draw_errors, _draw_torques)]
    return panels.overview(list(draws), len(numbers.joints))


def _draw_motion(numbers: DemoNumbers, panel: Any, i: int) -> None:
    states = numbers.signals.states
    column = states.columns(numbers.joints)[i]
    line(panel, states.time, states.position[:, column], BLUE, "measured")
    reference = numbers.reference_at(states.time)[:, i]
    line(panel, states.time, reference, BLACK, "reference", "--")
    name(panel, f"{numbers.joints[i]} [rad]")


def _draw_errors(numbers: DemoNumbers, panel: Any, i: int) -> None:
    loop = numbers.signals.loop
    line(panel, loop.time, 1e3 * loop.position[:, i], BLUE, "error")
    name(panel, f"{numbers.joints[i]} [mrad]")


def _draw_torques(numbers: DemoNumbers, panel: Any, i: int) -> None:
    time = numbers.time
    line(panel, time, numbers.commands[:, i], BLUE, "command")
    line(panel, time, numbers.estimates[:, i], ORANGE, "estimate")
    rest = numbers.estimates[:, i] - numbers.disturbance[:, i]
    line(panel, time, rest, BLACK, "estimate less disturbance", "--")
    name(panel, f"{numbers.joints[i]} [N·m]")


def _draw_forces(numbers: DemoNumbers, panel: Any, i: int) -> None:
    forces, estimated = numbers.signals.forces, numbers.signals.coupling
    assert forces is not None
    row = numbers.rows[i]
    line(panel, forces.time, forces.effort[:, i], BLUE, "simulated")
    if estimated is not None and row.name in estimated.names:
        (column,) = estimated.columns([row.name])
        line(panel, estimated.time, estimated.effort[:, column], ORANGE, "estimated", "--")
    name(panel, f"{row.name} [{row.unit}]")
