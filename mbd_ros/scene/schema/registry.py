"""The module of every part: one line a part, imported only when a scene names it."""

import importlib
import inspect
from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.errors import SceneError
from mbd_ros.scene.schema.code_permission import module_path, require_permission
from mbd_ros.scene.schema.sections import SECTIONS, Section

PARTS: Mapping[str, Mapping[str, str]] = {
    "actuators": {
        "geared_motor": "mbd_ros.parts.actuators.geared_motor:GearedMotor",
        "ideal": "mbd_ros.parts.actuators.ideal:Ideal",
        "series_elastic": "mbd_ros.parts.actuators.series_elastic:SeriesElastic",
        "series_elastic_drive": "mbd_ros.parts.actuators.series_elastic_drive:SeriesElasticDrive",
    },
    "constraints": {
        "distance": "mbd_ros.parts.constraints.distance:Distance",
        "dry_friction": "mbd_ros.parts.constraints.dry_friction:DryFriction",
        "frame_anchor": "mbd_ros.parts.constraints.frame_anchor:FrameAnchor",
        "joint_stop": "mbd_ros.parts.constraints.joint_stop:JointStop",
        "knife_edge": "mbd_ros.parts.constraints.knife_edge:KnifeEdge",
        "loop_closure": "mbd_ros.parts.constraints.loop_closure:LoopClosure",
        "path_length": "mbd_ros.parts.constraints.path_length:PathLength",
        "point_on_plane": "mbd_ros.parts.constraints.point_on_plane:PointOnPlane",
        "prescribed_motion": "mbd_ros.parts.constraints.prescribed_motion:PrescribedMotion",
        "rope": "mbd_ros.parts.constraints.rope:Rope",
        "screw": "mbd_ros.parts.constraints.screw:Screw",
    },
    "contacts": {
        "compliant": "mbd_ros.parts.contacts.compliant:Compliant",
        "rigid": "mbd_ros.parts.contacts.rigid:Rigid",
    },
    "controllers": {  # in the order in which a node offers them
        "sliding_mode": "mbd_ros.parts.controllers.sliding_mode:SlidingMode",
        "super_twisting": "mbd_ros.parts.controllers.super_twisting:SuperTwisting",
        "computed_torque": "mbd_ros.parts.controllers.computed_torque:ComputedTorque",
        "gravity_compensation": "mbd_ros.parts.controllers.gravity_compensation:GravityCompensation",  # noqa: E501
        "trajectory_tracking": "mbd_ros.parts.controllers.trajectory_tracking:TrajectoryTracking",
        "qp_tracking": "mbd_ros.parts.controllers.qp_tracking:QpTracking",
    },
    "estimators": {
        "extended_kalman": "mbd_ros.parts.estimators.extended_kalman:ExtendedKalman",
        "kalman": "mbd_ros.parts.estimators.kalman:Kalman",
        "moving_horizon": "mbd_ros.parts.estimators.moving_horizon:MovingHorizon",
    },
    "forces": {
        "applied_wrench": "mbd_ros.parts.forces.applied_wrench:AppliedWrench",
        "cable": "mbd_ros.parts.forces.cable:Cable",
        "gear_friction": "mbd_ros.parts.forces.gear_friction:GearFriction",
        "gravity_compensation": "mbd_ros.parts.forces.gravity_compensation:GravityCompensation",
        "joint_friction": "mbd_ros.parts.forces.joint_friction:JointFriction",
        "joint_spring": "mbd_ros.parts.forces.joint_spring:JointSpring",
        "joint_torque": "mbd_ros.parts.forces.joint_torque:JointTorque",
        "point_spring": "mbd_ros.parts.forces.point_spring:PointSpring",
        "prescribed_torque": "mbd_ros.parts.forces.prescribed_torque:PrescribedTorque",
        "prescribed_wrench": "mbd_ros.parts.forces.prescribed_wrench:PrescribedWrench",
        "switching_force": "mbd_ros.parts.forces.switching_force:SwitchingForce",
        "body_force": "mbd_ros.parts.forces.body_force:BodyForce",
        "bushing": "mbd_ros.parts.forces.bushing:Bushing",
        "learned_torque": "mbd_ros.parts.forces.learned_torque:LearnedTorque",
        "path_force": "mbd_ros.parts.forces.path_force:PathForce",
        "path_spring": "mbd_ros.parts.forces.path_spring:PathSpring",
        "push_off": "mbd_ros.parts.forces.push_off:PushOff",
        "smooth_ground": "mbd_ros.parts.forces.smooth_ground:SmoothGround",
        "soft_limit": "mbd_ros.parts.forces.soft_limit:SoftLimit",
    },
    "integrators": {
        "adams": "mbd_ros.parts.integrators.adams:Adams",
        "dop853": "mbd_ros.parts.integrators.dop853:Dop853",
        "dopri5": "mbd_ros.parts.integrators.dopri5:Dopri5",
        "filippov": "mbd_ros.parts.integrators.filippov:Filippov",
        "gauss_legendre": "mbd_ros.parts.integrators.gauss_legendre:GaussLegendre",
        "generalized_alpha": "mbd_ros.parts.integrators.generalized_alpha:GeneralizedAlpha",
        "moreau_jean": "mbd_ros.parts.integrators.moreau_jean:MoreauJean",
        "rattle": "mbd_ros.parts.integrators.rattle:Rattle",
        "rk4": "mbd_ros.parts.integrators.rk4:Rk4",
        "semi_implicit_euler": "mbd_ros.parts.integrators.semi_implicit_euler:SemiImplicitEuler",
        "shake": "mbd_ros.parts.integrators.shake:Shake",
    },
    "muscles": {
        "degroote_fregly": "mbd_ros.parts.muscles.degroote_fregly:DegrooteFregly",
        "millard": "mbd_ros.parts.muscles.millard:Millard",
        "thelen": "mbd_ros.parts.muscles.thelen:Thelen",
    },
    "sensors": {
        "accelerometer": "mbd_ros.parts.sensors.accelerometer:Accelerometer",
        "effort": "mbd_ros.parts.sensors.effort:Effort",
        "encoder": "mbd_ros.parts.sensors.encoder:Encoder",
        "gyroscope": "mbd_ros.parts.sensors.gyroscope:Gyroscope",
        "imu": "mbd_ros.parts.sensors.imu:Imu",
        "marker": "mbd_ros.parts.sensors.marker:Marker",
        "pose": "mbd_ros.parts.sensors.pose:Pose",
        "tachometer": "mbd_ros.parts.sensors.tachometer:Tachometer",
        "wrench": "mbd_ros.parts.sensors.wrench:Wrench",
    },
    "stabilization": {
        "baumgarte": "mbd_ros.parts.stabilization.baumgarte:Baumgarte",
        "none": "mbd_ros.parts.stabilization.none:NoStabilization",
        "projection": "mbd_ros.parts.stabilization.projection:Projection",
    },
}
METHODS: Mapping[str, Sequence[str]] = {  # what the parts of a kind must have
    **{section.parts: section.offers for section in SECTIONS if section.parts},
    "controllers": ("effort",),  # of nodes, not of scenes
    "estimators": ("predict", "correct"),  # of nodes and task files
}
_CONTRACTS = {
    "command": "contracts.Actuator",
    "force": "contracts.Load",
    "measure": "contracts.Sensor",
    "residual": "rows.constraint.Constraint",
}


def types_of(section: Section) -> Mapping[str, str]:
    """Type -> `module:Class` of a section."""
    return PARTS[section.parts] if section.parts else section.types


def resolve(kind: str, name: str, where: str) -> Any:
    """The class behind `type: name` in a section of a scene.

    Args:
        kind: Key of the registry, such as `forces`, or `controllers`.
        name: A name of the registry, or `package.module:Class` of code outside this package,
            which is looked for as Python does: in PYTHONPATH and the installed packages.
        where: File and key, for the messages.

    Raises:
        SceneError: There is none, with what exists; or nobody permitted code of others.
    """
    return resolve_type(PARTS[kind], METHODS[kind], name, where)


def resolve_type(
    types: Mapping[str, str], offers: Sequence[str], name: str | type, where: str
) -> Any:
    """The class behind `type: name`, for a section of any package.

    Args:
        types: Type -> `module:Class`.
        offers: Methods that the class must have.
        name: One of the types, or `package.module:Class`; or the class itself, from Python.
        where: File and key, for the messages.

    Raises:
        SceneError: There is none, with what exists; or nobody permitted code of others.
    """
    if not isinstance(name, str | type):
        raise SceneError(
            f"{where}: type is {name!r}, accepted: a word such as {next(iter(types))}"
        )
    part = name if isinstance(name, type) else _named(types, name, where)
    lacking = [one for one in offers if not any(hasattr(part, m) for m in one.split(" or "))]
    shown = name.__name__ if isinstance(name, type) else name
    if not inspect.isclass(part) or lacking:
        raise SceneError(
            f"{where}: type '{shown}' is not a class with a method "
            + " and ".join(f"'{method}'" for method in lacking or offers)
        )
    contract = next((_CONTRACTS[method] for method in offers if method in _CONTRACTS), "")
    if contract and not hasattr(part, "bind"):
        raise SceneError(f"{where}: type '{shown}' must derive from mbd_ros.core.{contract}")
    return part


def _named(types: Mapping[str, str], name: str, where: str) -> Any:
    module, _, attribute = types.get(name, name).partition(":")
    if not all(word.isidentifier() for word in (*module.split("."), attribute)):
        accepted = ", ".join((*types, "or package.module:Class"))
        raise SceneError(f"{where}: unknown type '{name}', accepted: {accepted}")
    if name not in types:
        require_permission(where, {"type": name})
    return imported(module, attribute, f"{where}: type '{name}'")


def imported(module: str, attribute: str, where: str) -> Any:
    """The object of a name in a module of this or another package.

    Args:
        module: Name of the module.
        attribute: Name in it.
        where: File, key and name, for the messages.

    Raises:
        SceneError: It cannot be imported, with where it was looked for; or it has none such.
    """
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        raise SceneError(f"{where}: {error}; {module_path()}") from error
    except (ImportError, SyntaxError, AttributeError) as error:
        raise SceneError(f"{where}: {error}") from error
