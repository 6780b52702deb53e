"""Reserves from a file of OpenSim: a `<ForceSet>` of actuators in coordinates and on bodies."""

import math
from pathlib import Path

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot import Robot
from mbd_ros.errors import ModelError
from mbd_ros.methods.inverse_dynamics.reserves import BodyReserve, CoordinateReserve, joint_reserve
from mbd_ros.scene.models.imported_model import parse_document, read_text
from mbd_ros.scene.models.osim.item import Item

Reserve = CoordinateReserve | BodyReserve
_SIGNS = {"inf": 1.0, "infinity": 1.0, "-inf": -1.0, "-infinity": -1.0}


def read_reserves(path: Path, robot: Robot, couplings: Couplings) -> list[Reserve]:
    """Read the actuators of a file in their order, without those that it disables.

    Args:
        path: File (.xml), perhaps packed by gzip.
        robot: The robot that the actuators act on.
        couplings: Dependent joints of the robot.

    Raises:
        SceneError: The file is missing or is no XML, it has no `<ForceSet>`, or an actuator has
            another type or does not fit the robot; the message names file and element.
    """
    source = str(path)
    root = Item(parse_document(read_text(path), source), source)
    forces = root if root.type == "ForceSet" else root.find("ForceSet")
    if forces is None:
        raise root.error("expected <ForceSet> with actuators")
    reserves = []
    for item in forces.children() if forces.find("objects") is None else forces.objects("objects"):
        if item.flag("isDisabled") or not item.flag("appliesForce", default=True):
            continue
        if item.type not in _READERS:
            raise item.error(f"is not a reserve actuator, accepted: {', '.join(_READERS)}")
        try:
            reserves.append(_READERS[item.type](item, robot, couplings))
        except ModelError as error:
            raise item.error(str(error)) from error
    return reserves


def _coordinate(item: Item, robot: Robot, couplings: Couplings) -> Reserve:
    joint, optimal = item.text("coordinate"), _optimal(item)
    return joint_reserve(robot, couplings, joint, optimal, item.name, _bounds(item))


def _point(item: Item, robot: Robot, couplings: Couplings) -> Reserve:
    if item.flag("point_is_global"):
        raise item.error("<point_is_global> is true, accepted: a point of the body")
    body = item.text("body")
    force = item.vector("direction")
    return _on_body(item, robot, body, "force_is_global", force=force, point=item.vector("point"))


def _torque(item: Item, robot: Robot, couplings: Couplings) -> Reserve:
    other = item.text("bodyB", default="ground")
    if other.rpartition("/")[2] != "ground":
        raise item.error(f"<bodyB> is '{other}', accepted: ground")
    body = item.text("bodyA")
    return _on_body(item, robot, body, "torque_is_global", torque=item.vector("axis"))


def _on_body(
    item: Item, robot: Robot, body: str, is_global: str, **load: list[float]
) -> BodyReserve:
    frame = body.rpartition("/")[2]
    length = math.hypot(*(number for name in ("force", "torque") for number in load.get(name, ())))
    for name in ("force", "torque"):
        if name in load and length > 0.0:
            load[name] = [number / length for number in load[name]]
    axes = "world" if item.flag(is_global, default=True) else frame
    return BodyReserve(
        robot,
        name=item.name,
        frame=frame,
        expressed_in=axes,
        optimal_force=_optimal(item),
        bounds=_bounds(item),
        **load,
    )


def _optimal(item: Item) -> float:
    optimal = item.number("optimal_force", default=1.0)
    if not optimal > 0.0:
        raise item.error(f"<optimal_force> is {optimal:g}, accepted: > 0")
    return optimal


def _bounds(item: Item) -> tuple[float, float]:
    lower = _bound(item, "min_control", -math.inf)
    upper = _bound(item, "max_control", math.inf)
    if not lower < upper:
        raise item.error(f"<min_control> {lower:g} is not below <max_control> {upper:g}")
    return lower, upper


def _bound(item: Item, tag: str, default: float) -> float:
    text = item.text(tag).lower()
    if text in _SIGNS:
        return math.copysign(math.inf, _SIGNS[text])
    return item.number(tag, default=default)


_READERS = {
    "CoordinateActuator": _coordinate,
    "PointActuator": _point,
    "TorqueActuator": _torque,
}
