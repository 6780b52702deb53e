"""Sections of one entry without a type: solver, step, start and safe command."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.points import rotation_matrix
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Length, Unit, Unlimited, Vector, refuse_dt
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.methods.simulation.safe_command import SafeCommand
from mbd_ros.scene.built_scene import Solver
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema

_SMALLEST = 1.0e-6  # length of a quaternion that still says which way to turn
_Quaternion = Annotated[Sequence[float], Length(4), Unit("x, y, z, w")]


def build_initial(site: Site, entry: Any) -> State:
    """The `initial` section as a state of all joints; dependent joints follow.

    Raises:
        SceneError: Names file, key and joint.
    """
    initial: _Initial = schema.call(_Initial, entry, site.where)
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


@dataclass(frozen=True)
class _Initial:
    """The `initial` section; joints start at 0, free bodies where they are placed, at rest."""

    position: Mapping[str, float] | None = None
    velocity: Mapping[str, float] | None = None
    pose: Mapping[str, Any] | None = None
    twist: Mapping[str, Any] | None = None
    internal: Mapping[str, Any] | None = None
    phase: str | None = None


def _place_bases(robot: Robot, initial: _Initial, where: str, q: Array, v: Array) -> None:
    """Write poses and velocities of free bodies into a configuration and a velocity."""
    if not (initial.pose or initial.twist):
        return
    from mbd_ros.core.kinematics.poses import configuration_of

    bases = {base.name: base for base in robot.bases}
    for key, value in (("pose", initial.pose or {}), ("twist", initial.twist or {})):
        for name, entry in value.items():
            place = f"{where}.{key}.{name}"
            if name not in bases:
                free = ", ".join(bases) or "nothing"
                raise SceneError(f"{place}: is no free body; {free} moves freely")
            base = bases[name]
            if key == "pose":
                q[base.q] = configuration_of(robot, read_pose(entry, place))
            else:
                v[base.v] = read_twist(entry, place, pin.XYZQUATToSE3(q[base.q]).rotation)


def build_step(site: Site, entry: Any) -> float:
    """The `dt` section [s]."""
    dt: float = schema.value(entry, Unlimited, site.where)
    refuse_dt(dt, site.where, SceneError)
    return dt


def read_pose(entry: Any, where: str) -> Array:
    """A pose `{xyz: [..], rpy: [..]}` or `{xyz: [..], quaternion: [x, y, z, w]}`.

    Args:
        entry: What the file holds; what it leaves out is 0.
        where: File and key, for the messages.

    Returns:
        Position [m], then the quaternion (x, y, z, w) of length 1, shape (7,).

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    pose: Array = schema.call(_pose, entry, where, where)
    return pose


def _pose(
    where: str,
    *,
    xyz: Vector = (0.0, 0.0, 0.0),
    rpy: Vector | None = None,
    quaternion: _Quaternion | None = None,
) -> Array:
    if quaternion is None:
        turn = pin.Quaternion(rotation_matrix(rpy or (0.0, 0.0, 0.0))).coeffs()
        return np.concatenate((xyz, turn))
    if rpy is not None:
        raise SceneError(f"{where}: give either 'rpy' or 'quaternion'")
    turn = np.array(quaternion)
    length = float(np.linalg.norm(turn))
    if length < _SMALLEST:
        raise SceneError(f"{where}.quaternion: {quaternion} says no rotation, expected length 1")
    return np.concatenate((xyz, turn / length))


def read_twist(entry: Any, where: str, rotation: Array) -> Array:
    """A velocity `{linear: [..], angular: [..], expressed_in: body}`.

    Args:
        entry: What the file holds; what it leaves out is 0.
        where: File and key, for the messages.
        rotation: Of the axes of the body in the world, shape (3, 3).

    Returns:
        Velocity of the body's origin [m/s], then of its axes [rad/s], in its own axes, shape (6,).

    Raises:
        SceneError: Names key, what is wrong and what is accepted.
    """
    twist: Array = schema.call(_twist, entry, where, rotation)
    return twist


def _twist(
    rotation: Array,
    *,
    linear: Vector = (0.0, 0.0, 0.0),
    angular: Vector = (0.0, 0.0, 0.0),
    expressed_in: Literal["body", "world"] = "body",
) -> Array:
    axes = np.eye(3) if expressed_in == "body" else rotation.T
    return np.concatenate((axes.dot(linear), axes.dot(angular)))


def build_solver(site: Site, entry: Any) -> Any:
    """The `solver` section."""
    return schema.call(Solver, entry, site.where)


def build_safe(site: Site, entry: Any) -> Any:
    """The `safe` section."""
    return schema.call(SafeCommand, entry, site.where)
