"""Torques of open chains, coupled or not: many samples at once."""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.inverse_dynamics.inverse_dynamics import TorqueComponents
from mbd_ros.core.inverse_dynamics.power_balance import Exerted
from mbd_ros.core.inverse_dynamics.torque_estimator import Observations
from mbd_ros.core.inverse_dynamics.torques import Torques
from mbd_ros.core.kinematics.free_bases import IndependentCoordinates
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.rows.coupling_rows import CouplingRows
from mbd_ros.core.rows.row_layout import RowLayout
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.files.table import Column
from mbd_ros.jobs.progress import progress
from mbd_ros.motion.columns import (
    body_columns,
    body_topics,
    carried_columns,
    joint_columns,
    output_columns,
)
from mbd_ros.motion.explained_motion import Explained, Way
from mbd_ros.motion.samples import Task
from mbd_ros.scene.built_scene import Scene

_CHUNK = 1000  # samples between two signs of progress


def solve(
    scene: Scene, where: str, samples: Observations, wrenches: Sequence[Array], task: Task
) -> Way:
    """Torques of the independent joints, multipliers of the dependent ones, residuals of bodies.

    Args:
        scene: A scene without loops.
        where: Source of the motion, for the messages.
        samples: The observations.
        wrenches: One (n, 6) array for every load of the scene.
        task: Says whether torque components are asked for.

    Returns:
        Columns of motion and torques, no remarks, and what explains the motion.
    """
    chains = OpenChains(scene, task.parts)
    solved = chains.solved(samples, wrenches)
    columns = chains.columns_of(samples, wrenches, solved)
    return Way(columns, [], chains.explained(samples, solved))


class OpenChains:
    """Torques of a scene without loops.

    Args:
        scene: The scene.
        with_parts: Also give the torque components.
    """

    def __init__(self, scene: Scene, with_parts: bool) -> None:
        self._scene, self._with_parts = scene, with_parts
        self._solver = scene.inverse_dynamics()
        self._at = IndependentCoordinates(scene.robot, self._solver.couplings)
        couplings = scene.couplings
        rows = [CouplingRows(scene.robot, couplings)] if couplings.dependent else []
        self._layout = RowLayout(rows)
        self._showing = Showing(Kinematics(scene.robot), self._layout, scene.forces)

    def columns(self, samples: Observations, wrenches: Sequence[Array]) -> list[Column]:
        """Columns of the motion and the torques; arguments as those of `solve`."""
        return self.columns_of(samples, wrenches, self.solved(samples, wrenches))

    def solved(self, samples: Observations, wrenches: Sequence[Array]) -> Torques:
        """Torques of all samples; arguments as those of `solve`."""
        solver, (z, v, a) = self._solver, samples[1:4]
        chunks = [slice(i, i + _CHUNK) for i in range(0, len(z), _CHUNK)]
        solved = [
            solver.batch(z[part], v[part], a[part], [w[part] for w in wrenches])
            for part in progress(chunks, len(chunks), "solving")
        ]
        tau, multipliers = (np.concatenate([each[i] for each in solved]) for i in (0, 1))
        residual = np.concatenate([each.residual.reshape(len(each.tau), -1) for each in solved])
        return Torques(tau, multipliers, solved[0].rank, residual)

    def columns_of(
        self, samples: Observations, wrenches: Sequence[Array], solved: Torques
    ) -> list[Column]:
        """Columns of the motion and of torques that were found."""
        solver, robot, at = self._solver, self._scene.robot, self._at
        (z, v, a), (tau, multipliers, _, residual) = samples[1:4], solved[:4]
        found = {"position": z, "velocity": v, "acceleration": a, "effort": tau}
        if self._with_parts:
            found |= self._causes(samples, wrenches)
        free, columns = [robot.joint(name) for name in solver.couplings.independent], []
        for field, values in found.items():
            mine = at.joint_y if field == "position" else at.joint_w
            columns += joint_columns(free, field, values[:, mine])
        bodies = [(z[:, y], v[:, w], a[:, w]) for y, w in zip(at.body_y, at.body_w, strict=True)]
        columns += [*body_columns(robot, bodies), *carried_columns(robot, residual)]
        return [*columns, *self._shown(samples, multipliers)]

    def _causes(self, samples: Observations, wrenches: Sequence[Array]) -> dict[str, Array]:
        """Torques by cause."""
        each = zip(*samples[1:4], *wrenches, strict=True)
        rows = progress(each, len(samples.stamps), "components")
        causes = [self._solver.components(*row[:3], row[3:]) for row in rows]
        names = TorqueComponents._fields
        return {name: np.array([c[i] for c in causes]) for i, name in enumerate(names)}

    def explained(self, samples: Observations, solved: Torques) -> Explained:
        """The motion of all joints, and what explains it."""
        couplings, robot = self._scene.couplings, self._scene.robot
        rows = ConstraintRows(self._layout.blocks, robot.model.nv)
        index = couplings.v_index
        carried = np.isin(index, robot.base_v)

        def motions() -> Iterator[tuple[State, Array, Exerted]]:
            each = zip(self._states(samples), *solved[:2], strict=True)
            for (x, a), tau, multipliers in each:
                efforts, residual = np.zeros(robot.model.nv), np.zeros(robot.model.nv)
                efforts[index], residual[index] = np.where(
                    carried, (0.0 * tau, tau), (tau, 0.0 * tau)
                )
                yield x, a, Exerted(efforts, residual, multipliers)

        return Explained(rows, couplings.independent, len(samples.stamps), motions)

    def _states(self, samples: Observations) -> Iterator[tuple[State, Array]]:
        """States and accelerations of all joints."""
        robot, couplings = self._scene.robot, self._scene.couplings
        for sample in samples.each():
            q, v, a = robot.neutral().copy(), np.zeros(robot.model.nv), np.zeros(robot.model.nv)
            q[couplings.q_index], v[couplings.v_index], a[couplings.v_index] = sample[1:4]
            couplings.expand(q, v, a)
            yield State(sample.stamp * NANOSECOND, q, v), a

    def _shown(self, samples: Observations, multipliers: Array) -> list[Column]:
        """Columns of multipliers and of what forces show."""
        scene, showing = self._scene, self._showing
        if len(showing.numbers) == multipliers.shape[1]:
            return output_columns(showing.numbers, multipliers)
        u = Loads(scene.robot.model.nv, scene.forces, scene.actuators).idle
        pairs = zip(self._states(samples), multipliers, strict=True)
        shown = [showing.at(x, u, a, lam) for (x, a), lam in pairs]
        return output_columns(showing.numbers, np.array(shown))


def topics(scene: Scene) -> dict[str, Any]:
    """Topics of a bag, see `files.bags.bag_streams`."""
    return {
        "/joint_torques": {field: field for field in ("effort", "position", "velocity")},
        **body_topics(scene.robot),
        "/constraint_forces": {"effort": "multiplier"},
    }


class Violations:
    """How far the dependent joints are off their couplings, or that nobody measured them.

    Args:
        scene: The scene.
    """

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._off = np.zeros(len(scene.couplings.dependent))  # NaN where not measured

    def add(self, samples: Observations) -> None:
        """Look at more samples."""
        couplings, robot = self._scene.couplings, self._scene.robot
        if not couplings.dependent:
            return
        q = np.zeros((robot.model.nq, len(samples.stamps)))
        q[couplings.q_index] = samples.position.T
        couplings.expand(q, np.zeros_like(q), np.zeros_like(q))
        coupled = q[[robot.joint(name).q for name in couplings.dependent]].T
        measured = np.where(np.isfinite(samples.dependent), samples.dependent, np.nan)
        self._off = np.maximum(self._off, np.abs(measured - coupled).max(axis=0))

    def lines(self) -> Iterator[str]:
        """A line for each joint."""
        for name, off in zip(self._scene.couplings.dependent, self._off, strict=True):
            if np.isnan(off):
                yield f"{name} is reconstructed from {self._scene.coupling_kinds[name]}"
            else:
                yield f"{name} is off its coupling by at most {off:.3g}"
