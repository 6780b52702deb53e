"""Torques of open chains, coupled or not: many samples at once."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.loads import Loads
from mbd_ros.core.dynamics.showing import Showing
from mbd_ros.core.estimation.torque_estimator import Observations
from mbd_ros.core.inverse.inverse_dynamics import TorqueComponents
from mbd_ros.core.model.base_motion import IndependentCoordinates
from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.files.table import Column
from mbd_ros.jobs.columns import (
    body_columns,
    body_topics,
    carried_columns,
    joint_columns,
    output_columns,
)
from mbd_ros.jobs.progress import progress
from mbd_ros.scene.built_scene import Scene

HAS_CAUSES = True
_CHUNK = 1000  # samples between two signs of progress


def solve(
    scene: Scene,
    where: str,
    samples: Observations,
    wrenches: Sequence[Array],
    with_parts: bool,
) -> tuple[list[Column], list[str]]:
    """Torques of the independent joints, multipliers of the dependent ones, residuals of bodies.

    Args:
        scene: A scene without loops.
        where: Source of the motion, for the messages.
        samples: The observations.
        wrenches: One (n, 6) array for every load of the scene.
        with_parts: Also give the torque components.

    Returns:
        Columns of motion and torques, and no remarks.
    """
    solver, robot = scene.inverse_dynamics(), scene.robot
    z, v, a = samples[1:4]
    chunks = [slice(i, i + _CHUNK) for i in range(0, len(z), _CHUNK)]
    solved = [
        solver.batch(z[part], v[part], a[part], [w[part] for w in wrenches])
        for part in progress(chunks, len(chunks), "solving")
    ]
    tau, multipliers = (np.concatenate([each[i] for each in solved]) for i in (0, 1))
    residual = np.concatenate([each.residual.reshape(len(each.tau), -1) for each in solved])
    at = IndependentCoordinates(robot, solver.couplings)
    found = {"position": z, "velocity": v, "acceleration": a, "effort": tau}
    if with_parts:
        each = zip(z, v, a, *wrenches, strict=True)
        rows = progress(each, len(z), "components")
        causes = [solver.components(*row[:3], row[3:]) for row in rows]
        for i, name in enumerate(TorqueComponents._fields):
            found[name] = np.array([c[i] for c in causes])
    free, columns = [robot.joint(name) for name in solver.couplings.independent], []
    for field, values in found.items():
        mine = at.joint_y if field == "position" else at.joint_w
        columns += joint_columns(free, field, values[:, mine])
    bodies = [(z[:, y], v[:, w], a[:, w]) for y, w in zip(at.body_y, at.body_w, strict=True)]
    columns += [*body_columns(robot, bodies), *carried_columns(robot, residual)]
    return [*columns, *_shown(scene, samples, multipliers)], []


def _shown(scene: Scene, samples: Observations, multipliers: Array) -> list[Column]:
    """Columns of multipliers and of what forces show."""
    robot, couplings = scene.robot, scene.couplings
    rows = [CouplingRows(robot, couplings)] if couplings.dependent else []
    showing = Showing(Kinematics(robot), RowLayout(rows), scene.forces)
    if len(showing.numbers) == multipliers.shape[1]:
        return output_columns(showing.numbers, multipliers)
    u, shown = Loads(robot.model.nv, scene.forces, scene.actuators).idle, []
    for sample, lam in zip(samples.each(), multipliers, strict=True):
        q, v, a = robot.neutral().copy(), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
        q[couplings.q_index], v[couplings.v_index], a[couplings.v_index] = sample[1:4]
        couplings.expand(q, v, a)
        shown.append(showing.at(State(sample.stamp * NANOSECOND, q, v), u, a, lam))
    return output_columns(showing.numbers, np.array(shown))


def topics(scene: Scene) -> dict[str, Any]:
    """Topics of a bag, see `files.bag_streams`."""
    return {
        "/joint_torques": {field: field for field in ("effort", "position", "velocity")},
        **body_topics(scene.robot),
        "/constraint_forces": {"effort": "multiplier"},
    }


def violations(scene: Scene, samples: Observations) -> Iterator[str]:
    """How far the dependent joints are off their couplings, or that nobody measured them."""
    couplings = scene.couplings
    if not couplings.dependent:
        return
    q = np.zeros((scene.robot.model.nq, len(samples.stamps)))
    q[couplings.q_index] = samples.position.T
    couplings.expand(q, np.zeros_like(q), np.zeros_like(q))
    for i, name in enumerate(couplings.dependent):
        measured = samples.dependent[:, i]
        if np.isfinite(measured).all():
            off = np.abs(measured - q[scene.robot.joint(name).q]).max()
            yield f"{name} is off its coupling by at most {off:.3g}"
        else:
            yield f"{name} is reconstructed from {scene.coupling_kinds[name]}"
