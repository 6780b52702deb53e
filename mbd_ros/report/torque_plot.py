"""Torques and coupling forces over time as a picture."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from mbd_ros.core.robot import Robot
from mbd_ros.core.state import Array, Motion
from mbd_ros.tables import replacing


def plot_torques(
    path: Path,
    robot: Robot,
    torques: Motion,
    constraint_forces: Motion,
    exact: tuple[NDArray[np.int64], Array],
) -> None:
    """One panel a joint: the live estimate over the exact torque, then the coupling forces.

    Args:
        path: PNG to write.
        robot: The robot.
        torques: Estimate; its efforts are drawn.
        constraint_forces: Multipliers of the dependent joints, as efforts.
        exact: Stamps [ns] and torques of the same joints.
    """
    names = torques.names + constraint_forces.names
    figure = Figure(figsize=(9, 2.0 * len(names)), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0]
    begin = exact[0][0]
    for panel, name in zip(panels, names, strict=True):
        panel.set_ylabel(f"{name}\n[{robot.joint(name).effort_unit}]")
        panel.grid(alpha=0.3)
    for i in range(len(torques.names)):
        panels[i].plot(_seconds(exact[0], begin), exact[1][:, i], "k--", lw=1, label="exact")
        _draw(panels[i], torques, i, begin, "live estimate")
    for i in range(len(constraint_forces.names)):
        panel = panels[len(torques.names) + i]
        _draw(panel, constraint_forces, i, begin, "coupling force (tendon)")
        panel.legend(loc="upper right")
    panels[0].legend(loc="upper right")
    panels[-1].set_xlabel("time [s]")
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def _draw(panel: object, motion: Motion, column: int, begin: np.int64, label: str) -> None:
    assert motion.effort is not None
    panel.plot(  # type: ignore[attr-defined]
        _seconds(motion.stamps, begin), motion.effort[:, column], lw=1.2, label=label
    )


def _seconds(stamps: NDArray[np.int64], begin: np.int64) -> Array:
    return (stamps - begin) * 1e-9
