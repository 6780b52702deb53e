"""Efforts of joints to commands: `.effort` is joint torque, `.command` what an actuator takes."""

from collections.abc import Sequence

import numpy as np

from mbd_ros.core.contracts.parts import Actuator
from mbd_ros.core.kinematics.free_bases import configuration_of
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.inputs import command_names
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError
from mbd_ros.files.body_columns import POSE, TWIST, names_of
from mbd_ros.files.table import Column, Table
from mbd_ros.files.times import TIME, stamps_of
from mbd_ros.motion.columns import command_columns
from mbd_ros.scene.built_scene import Scene

_SAME = 1e-9  # of the largest effort


def commands_of(scene: Scene, table: Table) -> tuple[list[Column], list[str]]:
    """Commands that give the efforts of a table, and which efforts no command gives.

    Commands are those of actuators that take something else than the torque of their joint, and
    whose torque follows from a motion: internal states are not in it.

    Args:
        scene: The scene.
        table: Motion and efforts.

    Raises:
        DataError: A command beyond the finite numbers.
    """
    names: list[str] = []
    commands: list[Array] = []
    remarks = []
    states = _states(scene, table) if scene.actuators else []
    for actuator, inputs in zip(scene.actuators, command_names(scene.actuators), strict=True):
        if not all(f"{name}.effort" in table for name in actuator.joints):
            continue
        if actuator.internal:
            states_of = ", ".join(one.name or "its state" for one in actuator.internal)
            remarks.append(f"{actuator.name}: no command, a motion does not show {states_of}")
            continue
        wanted = np.column_stack([table[f"{name}.effort"] for name in actuator.joints])
        pairs = list(zip(wanted, states, strict=True))
        u = np.array([actuator.demanded(tau, x) for tau, x in pairs])
        if not np.isfinite(u).all():
            row, i = np.argwhere(~np.isfinite(u))[0]
            listed = ", ".join(f"{effort:.4g}" for effort in wanted[row])
            raise DataError(
                f"{inputs[i]}.command at {table[TIME][row]:.9g} s is not "
                f"finite: no command of its actuator gives the effort {listed}"
            )
        given = _given(scene, actuator, u, states)
        short = np.abs(given - wanted) > _SAME * np.abs(wanted).max(initial=1.0)
        for name, lacking in zip(actuator.joints, short.T, strict=True):
            if lacking.any():
                t = table[TIME][int(np.argmax(lacking))]
                remarks.append(
                    f"{name}: its actuator cannot give {lacking.sum()} of {len(lacking)} efforts, "
                    f"the first at {t:.9g} s: beyond its limit"
                )
        if actuator.takes or inputs != actuator.joints:
            names += inputs
            commands.append(u)
    return command_columns(names, np.column_stack(commands)) if names else [], remarks


def _given(scene: Scene, actuator: Actuator, commands: Array, states: Sequence[State]) -> Array:
    """Efforts of the joints of an actuator under its commands, a row a state."""
    k, idle = Kinematics(scene.robot), Loads(scene.robot.model.nv, (), scene.actuators).idle
    at = [scene.robot.joint(name).v for name in actuator.joints]
    given = np.empty((len(states), len(at)))
    for row, (u, x) in enumerate(zip(commands, states, strict=True)):
        every = idle.copy()
        every[actuator.u] = u
        k.refresh(x.q, x.v, actuator.reads)
        given[row] = actuator.force(k, x, every)[at]
    return given


def _states(scene: Scene, table: Table) -> list[State]:
    model = scene.robot.model
    q, v = np.zeros((table.rows, model.nq)), np.zeros((table.rows, model.nv))
    for joint in scene.robot.joints:
        if f"{joint.name}.position" in table:
            q[:, joint.q] = table[f"{joint.name}.position"]
            v[:, joint.v] = table[f"{joint.name}.velocity"]
    for base in scene.robot.bases:
        pose = np.column_stack([table[name] for name in names_of(base.name, POSE)])
        q[:, base.q] = configuration_of(scene.robot, pose)
        v[:, base.v] = np.column_stack([table[name] for name in names_of(base.name, TWIST)])
    times = (stamps_of(table) * NANOSECOND).tolist()
    return [State(*row) for row in zip(times, q, v, strict=True)]
