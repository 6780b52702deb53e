"""A simulated robot controlled over topics, the inverse dynamics watching: `mbd-ros demo`."""

from collections.abc import Iterator
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.files import (
    BAG,
    KNOWN,
    MASS_SCALE,
    OF_LOOP,
    PLANT,
    RATE,
    replacing_folder,
    write_gains,
    write_scenes,
)
from mbd_ros.applications.demo.loop import CUTOFF, LoopRun, record_loop
from mbd_ros.applications.demo.numbers import DemoNumbers, read_signals, tables
from mbd_ros.applications.demo.page import (
    Content,
    Table,
    conclusion,
    inlined,
    machine,
    write_page,
)
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, line, name, picture
from mbd_ros.applications.demo.task import DISTURBANCE_SHARE, LAWS, ROBOTS, disturbance, trajectory
from mbd_ros.errors import DataError
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.runs.simulation import build_simulation
from mbd_ros.view.frames import Frames
from mbd_ros.view.motion import viewed_motion

SHORTEST, LONGEST = 2.0, 60.0  # s
_MOVES = (
    "The recorded motion; arrows are the forces of its constraints. Drag to turn, scroll to zoom."
)
_PACKAGES = ("numpy", "pin", "ros-jazzy-rclpy")


class Demo(NamedTuple):
    """Order of a demo.

    Attributes:
        robot: A key of `ROBOTS`.
        out: Folder for recording, scenes, picture and page.
        time: Simulated time [s].
        law: A key of `LAWS`.
    """

    robot: str
    out: Path
    time: float = 10.0
    law: str = "sliding_mode"


def demo(order: Demo) -> Iterator[str]:
    """Run a demo.

    Yields:
        What happens, then the summary.

    Raises:
        DataError: A time or a place that is not accepted.
        Failed: A node died, the loop stood still (nothing is left), or a check is not met.
    """
    if not SHORTEST <= order.time <= LONGEST:
        raise DataError(f"time {order.time:g} s: accepted are {SHORTEST:g} to {LONGEST:g} s")
    with replacing_folder(order.out, KNOWN) as folder:
        run, gains = _prepare(order, folder)
        robot, law = ROBOTS[order.robot], order.law.replace("_", " ")
        yield f"{robot.title}, {law}, {order.time:g} s over topics ..."
        record_loop(run, folder / BAG)
        for log in folder.glob("*.log"):
            log.unlink()
        numbers = DemoNumbers(read_signals(folder / BAG, run.controller), folder)
        summary = tables(numbers)
        failed = [f"{c.what}: {c.value}" for c in numbers.checks() if not c.is_met]
        moving = _moving(numbers, folder / BAG, robot.title)
        content = _content(order, numbers, summary, failed, gains, moving)
        write_page(folder, overview(numbers), content)
    yield from conclusion(content, "recording, scenes", order.out)


def _prepare(order: Demo, folder: Path) -> tuple[LoopRun, dict[str, Any]]:
    """The order of the run, with its files written, and the parameters of the controller."""
    robot = ROBOTS[order.robot]
    scene = load_scene(robot.scene)
    joints = scene.controlled_joints()
    reference = trajectory(robot, joints.positions(scene.initial), order.time)
    write_scenes(folder, robot, joints.names, disturbance(scene, reference))
    gains = write_gains(folder, robot, order.law, scene)
    rows = build_simulation(load_scene(folder / PLANT)).system.multiplier_rows
    run = LoopRun(
        folder,
        scene.path,
        order.law,
        joints.names,
        reference,
        order.time,
        has_rows=bool(rows),
        has_coupling=bool(scene.couplings.dependent),
    )
    return run, gains


def _content(
    order: Demo,
    numbers: DemoNumbers,
    summary: list[Table],
    failed: list[str],
    gains: dict[str, Any],
    moving: str,
) -> Content:
    robot, law = ROBOTS[order.robot], order.law.replace("_", " ")
    begin = datetime.fromtimestamp(numbers.signals.states.log[0] * 1e-9, tz=timezone.utc)
    lighter = f"{100 * abs(1 - MASS_SCALE):.0f} % too light"
    share = f"{100 * DISTURBANCE_SHARE:.0f} %"
    text = [
        "Simulator, controller and inverse dynamics are processes of their own that talk over "
        f"DDS. The model of the controller ({LAWS[order.law]}) is {lighter}, in every mass and "
        "inertia. "
        f"A sinusoidal torque of {share} of the largest gravity torque disturbs each joint; only "
        "the simulator knows it. The inverse dynamics has the true masses: its estimate is the "
        "command and the disturbance together.",
        f"The simulator is in lock step at {RATE} Hz: every command advances time by one tick, "
        "and the others live in its /clock. A loaded machine makes the demo slower, not "
        "different; latencies and rates are those of this machine.",
    ]
    made = {
        "Gains": ", ".join(f"{k.removeprefix('gains.')} {v}" for k, v in gains.items()),
        "Inverse dynamics": f"causal derivatives, {CUTOFF:g} Hz",
        "Files": ", ".join(OF_LOOP),
        **machine(_PACKAGES),
    }
    facts = f"{begin:%Y-%m-%d %H:%M} UTC, {law}, {order.time:g} s of simulated time."
    title = f"Demo: {robot.title}"
    moves = (moving, _MOVES)
    return Content(title, facts, failed, text, moves, pictures(numbers), summary, made)


def _moving(numbers: DemoNumbers, bag: Path, title: str) -> str:
    """The recorded motion of the plant with the forces that it published, as HTML to inline."""
    scene = numbers.plant
    rows = Frames(scene).rows
    motion = viewed_motion(scene, bag, rows)
    if rows and (forces := numbers.signals.forces) is not None:
        published = dict(zip((row.name for row in numbers.rows), rows, strict=True))
        columns = forces.columns(list(published))
        at = np.searchsorted(forces.time, motion.times + numbers.signals.states.time[0])
        multipliers = forces.effort[np.minimum(at, len(forces.time) - 1)][:, columns]
        motion = motion._replace(multipliers=multipliers)
    return inlined(scene, motion, title)


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


def overview(numbers: DemoNumbers) -> bytes:
    """One PNG with motion, error and torques of every joint side by side."""
    draws = [partial(draw, numbers) for draw in (_draw_motion, _draw_errors, _draw_torques)]
    return panels.overview(list(draws), len(numbers.joints))
