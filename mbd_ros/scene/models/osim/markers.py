"""Markers -> the section `sensors`."""

from typing import Any

from mbd_ros.scene.models.osim.reading import Reading


def read_markers(reading: Reading) -> dict[str, Any]:
    """The markers of a model by name; `label` is what files of markers call them.

    Raises:
        SceneError: Names marker and what is wrong.
    """
    sensors: dict[str, Any] = {}
    for item in reading.model.objects("MarkerSet"):
        frame = reading.attached(item, "parent_frame", "body")
        name = reading.names.part(item.name, "marker")
        entry = {
            "type": "marker",
            "frame": frame.body,
            "xyz": frame.point(item.vector("location")),
        }
        if name != item.name:
            entry["label"] = item.name
        if item.flag("fixed"):
            entry["fixed"] = True
        sensors[name] = entry
    return sensors
