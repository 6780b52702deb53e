"""Sections of one entry without a type: solver, step, start and safe command."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Unlimited, refuse_dt
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.simulation.safe_command import SafeCommand
from mbd_ros.scene.built_scene import Solver
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema


@dataclass(frozen=True)
class _Initial:
    """The `initial` section; joints start at 0, free bodies where they are placed, at rest."""

    position: Mapping[str, float] | None = None
    velocity: Mapping[str, float] | None = None
    pose: Mapping[str, Any] | None = None
    twist: Mapping[str, Any] | None = None
    internal: Mapping[str, Any] | None = None
    phase: str | None = None


def build_solver(site: Site, given: Any) -> Any:
    """The `solver` section."""
    return schema.call(Solver, given, site.where)


def build_safe(site: Site, given: Any) -> Any:
    """The `safe` section."""
    return schema.call(SafeCommand, given, site.where)


def build_step(site: Site, given: Any) -> float:
    """The `dt` section [s]."""
    dt: float = schema.value(given, Unlimited, site.where)
    refuse_dt(dt, site.where, SceneError)
    return dt


def build_initial(site: Site, given: Any) -> State:
    """The `initial` section as a state of all joints; dependent joints follow.

    Raises:
        SceneError: Names file, key and joint.
    """
    initial: _Initial = schema.call(_Initial, given, site.where)
    robot, couplings = site.robot, site.parts["couplings"]
    assert robot is not None and isinstance(couplings, Couplings)
    q, v = np.array(robot.neutral()), np.zeros(robot.model.nv)
    for key, values, index in (
        ("position", initial.position, "q"),
        ("velocity", initial.velocity, "v"),
    ):
        for name, number in (values or {}).items():
            where = f"{site.where}.{key}"
            if name in couplings.dependent:
                raise SceneError(
                    f"{where}.{name}: follows {couplings.parents[name]}, leave it out"
                )
            try:
                joint = robot.joint(name)
            except ModelError as error:
                raise SceneError(f"{where}: {error}") from error
            (q if index == "q" else v)[getattr(joint, index)] = number
    if initial.phase is not None:
        from mbd_ros.scene.reading.phase_entries import known

        known(initial.phase, site.parts.get("phases", {}), "phase", f"{site.where}.phase")
    _place_bases(robot, initial, site.where, q, v)
    couplings.expand(q, v, np.zeros(robot.model.nv))
    return State(0.0, q, v)


def _place_bases(robot: Robot, initial: _Initial, where: str, q: Array, v: Array) -> None:
    """Write poses and velocities of free bodies into a configuration and a velocity."""
    if not (initial.pose or initial.twist):
        return
    from mbd_ros.core.kinematics.poses import configuration_of
    from mbd_ros.scene.reading.pose_entry import read_pose, read_twist

    bases = {base.name: base for base in robot.bases}
    for key, given in (("pose", initial.pose or {}), ("twist", initial.twist or {})):
        for name, entry in given.items():
            place = f"{where}.{key}.{name}"
            if name not in bases:
                free = ", ".join(bases) or "nothing"
                raise SceneError(f"{place}: is no free body; {free} moves freely")
            base = bases[name]
            if key == "pose":
                q[base.q] = configuration_of(robot, read_pose(entry, place))
            else:
                v[base.v] = read_twist(entry, place, pin.XYZQUATToSE3(q[base.q]).rotation)
