"""Which recorded markers are which sensors of a scene."""

from collections import Counter
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from mbd_ros.errors import DataError
from mbd_ros.features.markers.kinematics_task import KinematicsTask
from mbd_ros.features.markers.marker_kinematics import Mark
from mbd_ros.motion.marker_recording import Capture
from mbd_ros.parts.sensors.marker import Marker
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.schema.nearest import nearest

_LISTED = 8  # labels in a line


class Matched(NamedTuple):
    """Markers that the scene has and the recording too.

    Attributes:
        marks: Of the scene, those that weigh something.
        capture: Their places alone, in the same order.
        lines: For people: what was not used.
    """

    marks: tuple[Mark, ...]
    capture: Capture
    lines: tuple[str, ...]


def match(scene: Scene, capture: Capture, task: KinematicsTask) -> Matched:
    """Find the markers of a scene in a recording, by label, else by name.

    Raises:
        DataError: The scene has no marker, labels that repeat, or none that the recording has.
    """
    markers = markers_of(scene)
    weights = weights_of(markers, task)
    column = {label: i for i, label in enumerate(capture.labels)}
    pairs = [(m, column.get(m.title, column.get(m.name))) for m in markers]
    used = [(m, at) for m, at in pairs if at is not None and weights[m.title] > 0.0]
    if not used and not any(one.weight for one in task.coordinates.values()):
        raise DataError(_nothing(markers, capture, task))
    marks = tuple(Mark(m.title, m.point, weights[m.title]) for m, _ in used)
    places = capture.places[:, [at for _, at in used]]
    mine = capture._replace(labels=tuple(mark.label for mark in marks), places=places)
    taken = {at for _, at in pairs if at is not None}
    lacking = [m.title for m, at in pairs if at is None and weights[m.title] > 0.0]
    others = [label for i, label in enumerate(capture.labels) if i not in taken]
    lines = [
        f"{len(marks)} markers of {len(markers)} in the scene, {len(capture.labels)} recorded"
    ]
    lines += _lines("not recorded", lacking, others)
    lines += _lines("recorded and not in the scene", others, lacking)
    lines += _lines("weights for no marker of the scene", _unknown(markers, task), lacking)
    return Matched(marks, mine, tuple(lines))


def markers_of(scene: Scene) -> tuple[Marker, ...]:
    """The markers among the sensors of a scene.

    Raises:
        DataError: There is none, or two have one label.
    """
    markers = tuple(sensor for sensor in scene.sensors if isinstance(sensor, Marker))
    if not markers:
        raise DataError(f"{scene.name}: no markers: the scene needs sensors of type marker")
    counts = Counter(marker.title for marker in markers)
    repeated = [label for label, count in counts.items() if count > 1]
    if repeated:
        raise DataError(f"{scene.name}: two markers have the label {repeated[0]}")
    return markers


def weights_of(markers: Sequence[Marker], task: KinematicsTask) -> dict[str, float]:
    """Label -> weight: those of a task that names markers, else those of the scene."""
    if task.markers is None:
        return {marker.title: marker.weight for marker in markers}
    asked = task.markers
    return {m.title: asked.get(m.title, asked.get(m.name, 0.0)) for m in markers}


def _unknown(markers: Sequence[Marker], task: KinematicsTask) -> list[str]:
    known = {marker.title for marker in markers} | {marker.name for marker in markers}
    return [label for label in task.markers or {} if label not in known]


def _lines(what: str, labels: Sequence[str], others: Sequence[str]) -> Iterator[str]:
    if not labels:
        return
    more = f" and {len(labels) - _LISTED} more" if len(labels) > _LISTED else ""
    close = [(label, near[0]) for label in labels if (near := nearest(label, others, 1))]
    hint = f"; perhaps {', '.join(f'{a} is {b}' for a, b in close[:3])}" if close else ""
    yield f"{what}: {', '.join(labels[:_LISTED])}{more}{hint}"


def _nothing(markers: Sequence[Marker], capture: Capture, task: KinematicsTask) -> str:
    labels = [marker.title for marker in markers]
    near = [(label, close[0]) for label in capture.labels if (close := nearest(label, labels, 1))]
    hint = f"; the nearest: {', '.join(f'{a} to {b}' for a, b in near[:3])}" if near else ""
    weigh = "" if task.markers is None else " that weighs something in the task"
    return (
        f"{capture.where}: no recorded marker is one of the scene{weigh}; recorded are "
        f"{', '.join(capture.labels[:_LISTED])}, the scene has {', '.join(labels[:_LISTED])}{hint}"
    )
