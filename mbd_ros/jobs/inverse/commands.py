"""Efforts of joints to commands: `.effort` is joint torque, `.command` what an actuator takes."""

import numpy as np

from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError
from mbd_ros.files.records import TorqueRecord
from mbd_ros.scene.built_scene import Scene

_SAME = 1e-9  # of the largest effort


def with_commands(scene: Scene, record: TorqueRecord) -> tuple[TorqueRecord, list[str]]:
    """A result with the commands of its efforts, and the efforts that no command gives.

    Commands stand beside the efforts of actuators that take something else than the torque of
    their joint.

    Args:
        scene: The scene.
        record: The result.

    Raises:
        DataError: A command beyond the finite numbers.
    """
    named = record.joints if record.driven is None else record.driven
    column = {name: i for i, name in enumerate(named)}
    states = _states(scene, record)
    names: list[str] = []
    commands: list[Array] = []
    remarks = []
    for actuator in scene.actuators:
        if not all(name in column for name in actuator.joints):
            continue
        wanted = record.effort[:, [column[name] for name in actuator.joints]]
        pairs = list(zip(wanted, states, strict=True))
        u = np.array([actuator.demanded(tau, x) for tau, x in pairs])
        if not np.isfinite(u).all():
            row, i = np.argwhere(~np.isfinite(u))[0]
            raise DataError(
                f"{actuator.joints[i]}.command at {record.stamps[row] * NANOSECOND:.9g} s is not "
                f"finite: no command of its actuator gives the effort {wanted[row, i]:.4g}"
            )
        at = [scene.robot.joint(name).v for name in actuator.joints]
        given = np.array([actuator.torque(one, x)[at] for one, x in zip(u, states, strict=True)])
        short = np.abs(given - wanted) > _SAME * np.abs(wanted).max(initial=1.0)
        for name, lacking in zip(actuator.joints, short.T, strict=True):
            if lacking.any():
                t = record.stamps[int(np.argmax(lacking))] * NANOSECOND
                remarks.append(
                    f"{name}: its actuator cannot give {lacking.sum()} of {len(lacking)} efforts, "
                    f"the first at {t:.9g} s: beyond its limit"
                )
        if actuator.takes:
            names += actuator.joints
            commands.append(u)
    if not names:
        return record, remarks
    return record._replace(commanded=tuple(names), command=np.column_stack(commands)), remarks


def _states(scene: Scene, record: TorqueRecord) -> list[State]:
    count, model = len(record.stamps), scene.robot.model
    q, v = np.zeros((count, model.nq)), np.zeros((count, model.nv))
    joints = [scene.robot.joint(name) for name in record.joints]
    q[:, [joint.q for joint in joints]] = record.position
    v[:, [joint.v for joint in joints]] = record.velocity
    times = (record.stamps * NANOSECOND).tolist()
    return [State(*row) for row in zip(times, q, v, strict=True)]
