"""Tables of estimates and their innovations."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.estimation.smoother import Filtered
from mbd_ros.core.state import Array
from mbd_ros.features.estimation.estimation import Estimation
from mbd_ros.files.table import Column, Table
from mbd_ros.files.times import TIME
from mbd_ros.motion.columns import body_columns, joint_columns, output_columns, whole_bodies

INNOVATIONS = "innovations"


def sample_table(
    estimation: Estimation, samples: Sequence[Filtered], inputs: Sequence[Array | None]
) -> Table:
    """Estimated motion, what parts show in it, and deviations.

    Args:
        estimation: What was estimated.
        samples: One a sample.
        inputs: u at each of them.
    """
    process = estimation.process
    system, tangent = process.simulation.system, process.tangent
    robot, loads, nv = system.robot, system.loads, system.robot.model.nv
    showing = Showing(system.k, system.layout, loads.forces)
    t, q, v, a, effort, shown, deviation = [], [], [], [], [], [], []
    for sample, u in zip(samples, inputs, strict=True):
        belief = sample.belief
        x = system.expand(belief.x)
        now = process.evaluate(x, u)
        known = loads.inputs(x, u)
        t.append(belief.t)
        q.append(x.q)
        v.append(x.v)
        a.append(now.a)
        effort.append(loads.actuator_torque(system.k, x, known))
        shown.append(showing.at(x, known, now.a, now.lam))
        of_joints = tangent.of_all_joints(belief.x)
        spread = np.einsum("ij,jk,ik->i", of_joints, belief.P, of_joints)
        z = belief.P.diagonal()[len(belief.P) - len(x.z) :]
        deviation.append(np.sqrt(np.maximum(np.concatenate((spread, z)), 0.0)))
    joints = robot.joints
    q_at, v_at = [j.q for j in joints], [j.v for j in joints]
    every = np.array(v), np.array(a), np.array(effort), np.array(deviation)
    v_all, a_all, efforts, deviations = every
    q_all = np.array(q)
    return Table(
        [
            Column(TIME, np.array(t), "s"),
            *joint_columns(joints, "position", q_all[:, q_at]),
            *joint_columns(joints, "velocity", v_all[:, v_at]),
            *joint_columns(joints, "acceleration", a_all[:, v_at]),
            *joint_columns(joints, "effort", efforts[:, v_at]),
            *body_columns(robot, whole_bodies(robot, q_all, v_all, a_all)),
            *output_columns(showing.numbers, np.array(shown)),
            *_deviations(estimation, deviations, nv, v_at),
        ]
    )


def _deviations(
    estimation: Estimation, deviations: Array, nv: int, v_at: list[int]
) -> list[Column]:
    system = estimation.process.simulation.system
    joints = system.robot.joints
    columns = []
    for quantity, values in (
        ("position", deviations[:, v_at]),
        ("velocity", deviations[:, nv : 2 * nv][:, v_at]),
    ):
        for one in joint_columns(joints, quantity, values):
            columns.append(one._replace(name=f"{one.name}_deviation"))
    pairs = zip(system.internals.names, system.internals.units, strict=True)
    for i, (name, unit) in enumerate(pairs):
        columns.append(Column(f"{name}_deviation", deviations[:, 2 * nv + i], unit))
    return columns


def innovation_table(estimation: Estimation, samples: Sequence[Filtered]) -> Table:
    """Innovations over their expected deviation, and what they say together.

    Args:
        estimation: What was estimated.
        samples: One a sample.
    """
    names = estimation.process.sensors.names
    found = [s.belief.innovation for s in samples]
    values = np.array([np.full(len(names), np.nan) if i is None else i.normalized for i in found])
    nis = [np.nan if i is None or not i.freedom else i.squared / i.freedom for i in found]
    times = np.array([s.belief.t for s in samples])
    columns = [Column(name, values[:, i]) for i, name in enumerate(names)]
    return Table([Column(TIME, times, "s"), *columns, Column("nis", np.array(nis))])
