"""Setup files of OpenSim's inverse kinematics, read as a task of marker kinematics.

Weights of markers and coordinates, the range of times and the file of coordinates are read. Model,
accuracies and files of results come from the command.
"""

from pathlib import Path
from xml.etree import ElementTree

from mbd_ros.errors import SceneError
from mbd_ros.features.markers.kinematics_task import CoordinateTask, KinematicsTask
from mbd_ros.scene.models.imported_model import parse_document, read_text

_TRUE, _VALUE_TYPES = "true", ("default_value", "manual_value", "from_file")
_NO_FILE = ("", "Unassigned")


def read_setup(path: Path) -> KinematicsTask:
    """Read the tasks of a setup file.

    Raises:
        SceneError: The file is not well-formed or has no tasks of inverse kinematics; the message
            names file and element.
    """
    root = parse_document(read_text(path), str(path))
    tasks = next(root.iter("IKTaskSet"), None)
    if tasks is None:
        raise SceneError(
            f"{path}: has no <IKTaskSet>, so it is no setup file of inverse kinematics"
        )
    markers = {
        name: _number(path, task, "weight", 1.0)
        for task in tasks.iter("IKMarkerTask")
        if _applies(task) and (name := _name(path, task))
    }
    coordinates = {
        name: _coordinate(path, task)
        for task in tasks.iter("IKCoordinateTask")
        if _applies(task) and (name := _name(path, task))
    }
    begin, end = _range(path, root)
    motion = _text(root, "coordinate_file")
    file = None
    if motion not in _NO_FILE and any(task.from_motion for task in coordinates.values()):
        file = path.parent / motion.replace("\\", "/")
    return KinematicsTask(markers, coordinates, begin, end, motion=file, source=str(path))


def _applies(task: ElementTree.Element) -> bool:
    return _text(task, "apply", _TRUE).lower() == _TRUE


def _name(path: Path, task: ElementTree.Element) -> str:
    name = task.get("name", "").strip()
    if not name:
        raise SceneError(f"{path}: a <{task.tag}> without a name")
    return name


def _coordinate(path: Path, task: ElementTree.Element) -> CoordinateTask:
    kind = _text(task, "value_type", _VALUE_TYPES[0])
    if kind not in _VALUE_TYPES:
        raise SceneError(
            f"{path}: <{task.tag} name='{task.get('name')}'>: value_type '{kind}', accepted: "
            f"{', '.join(_VALUE_TYPES)}"
        )
    value = _number(path, task, "value", 0.0) if kind == "manual_value" else None
    return CoordinateTask(_number(path, task, "weight", 1.0), value, kind == "from_file")


def _range(path: Path, root: ElementTree.Element) -> tuple[float | None, float | None]:
    times = _text(root, "time_range").split()
    if not times:
        return None, None
    try:
        begin, end = (float(time) for time in times)
    except ValueError as error:
        raise SceneError(f"{path}: <time_range> must be two numbers: {times}") from error
    return (None if begin == -float("inf") else begin), (None if end == float("inf") else end)


def _number(path: Path, task: ElementTree.Element, key: str, default: float) -> float:
    text = _text(task, key)
    try:
        number = float(text.split()[0]) if text else default
    except ValueError:
        number = -1.0 if key == "weight" else float("nan")
    if not abs(number) < float("inf") or (key == "weight" and number < 0.0):
        raise SceneError(
            f"{path}: <{task.tag} name='{task.get('name')}'>: {key} '{text}' is not "
            "accepted; expected a finite number, for a weight at least 0"
        )
    return number


def _text(element: ElementTree.Element, key: str, default: str = "") -> str:
    child = next(element.iter(key), None)
    text = (child.text or "").strip() if child is not None else ""
    return text or default
