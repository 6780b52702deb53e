"""Coordinates that functions of time prescribe -> constraints `prescribed_motion`."""

from collections.abc import Iterable, Mapping
from typing import Any

from mbd_ros.scene.models.imported import Unexpressed
from mbd_ros.scene.models.osim.functions import UnknownFunction, function_in
from mbd_ros.scene.models.osim.item import Item
from mbd_ros.scene.models.osim.motions import Coordinate
from mbd_ros.scene.models.osim.reading import Reading


def read_prescribed(
    reading: Reading, coordinates: Mapping[str, Coordinate], coupled: Iterable[str]
) -> list[dict[str, Any]]:
    """The motions of coordinates that do not stand still.

    Args:
        reading: The model.
        coordinates: By name.
        coupled: Those that follow others.

    Raises:
        SceneError: Names coordinate and what is wrong.
    """
    found = []
    for name, coordinate in coordinates.items():
        is_free = name in reading.joints and name not in reading.fixed and name not in coupled
        if is_free and coordinate.item.flag("prescribed"):
            try:
                motion = _motion(coordinate.item)
            except Unexpressed as error:
                reading.leave_out(coordinate.item, str(error))
                continue
            title = reading.names.part(f"{name}_motion", "motion")
            found.append({"name": title, "type": "prescribed_motion", "joint": name, **motion})
    return found


def _motion(item: Item) -> dict[str, Any]:
    """The function of time, where `prescribed_motion` has it."""
    holder = item.find("prescribed_function")
    try:
        function = function_in(holder)
    except UnknownFunction as error:
        raise Unexpressed(f"is prescribed by a {error}") from error
    if function.slope is not None:
        return {"polynomial": [function.offset, function.slope]}
    if not {"polynomial", "spline", "harmonic"}.isdisjoint(function.entry):
        return dict(function.entry)
    raise Unexpressed(f"is prescribed by a function {next(iter(function.entry))}")
