"""The `scale` section of a task file: how the segments of a scene are measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

from mbd_ros.core.ranges import Length, Positive, Unit
from mbd_ros.errors import SceneError
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema

_AXES = "xyz"


@dataclass(frozen=True)
class Measurement:
    """One measurement of a segment.

    Attributes:
        pairs: Pairs of marker labels, whose distances on the person and in the scene are compared.
        factor: Scale factor in place of pairs.
        axes: Axes of the link that the measurement scales: some of x, y and z.
    """

    pairs: Sequence[Annotated[Sequence[str], Length(2)]] = ()
    factor: Annotated[Positive, Unit("-")] | None = None
    axes: str = _AXES


@dataclass(frozen=True)
class ScaleTask:
    """How a scene is scaled to a person, as its task file describes it.

    Attributes:
        segments: Measurements by link: `pairs` of markers or a `factor`, and the `axes` that they
            scale. Links without one keep their size.
        begin: First time of the static trial [s]; None for its start.
        end: Last time of the static trial [s]; None for its end.
        unit: Unit of the recorded markers; None for that of the file.
        mass: Mass of all segments together [kg]; None keeps it.
        by_volume: Whether masses follow the volumes of segments; else each keeps its share.
        name: Name of the scaled scene.
    """

    segments: Mapping[str, Sequence[Measurement]]
    begin: float | None = None
    end: float | None = None
    unit: str | None = None
    mass: float | None = None
    by_volume: bool = False
    name: str = "scaled"


def build_task(site: Site, entry: Any) -> ScaleTask:
    """Build the `scale` section of a task file.

    Raises:
        SceneError: A key is unknown or its value is not accepted; the message names both.
    """
    task: ScaleTask = schema.call(task_of_keys, entry, site.where, site)
    return task


def task_of_keys(
    site: Site,
    *,
    segments: Mapping[str, Any],
    begin: float | None = None,
    end: float | None = None,
    unit: str | None = None,
    mass: Annotated[Positive, Unit("kg")] | None = None,
    by_volume: bool = False,
    name: str = "scaled",
) -> ScaleTask:
    """Build a task; the keyword arguments are the keys of the section `scale`."""
    measurements = {
        link: _measurements(entry, f"{site.where}.segments.{link}")
        for link, entry in segments.items()
    }
    if not measurements:
        raise SceneError(f"{site.where}.segments: is empty; give the measurements of a link")
    if not name.isidentifier():
        raise SceneError(
            f"{site.where}.name: '{name}', accepted are letters, digits and _, a digit not first"
        )
    return ScaleTask(measurements, begin, end, unit, mass, by_volume, name)


def _measurements(entry: Any, where: str) -> tuple[Measurement, ...]:
    """Build one measurement, or a list of them."""
    entries = entry if isinstance(entry, list) else [entry]
    measurements = tuple(schema.call(Measurement, each, where) for each in entries)
    for measurement in measurements:
        if bool(measurement.pairs) == (measurement.factor is not None):
            raise SceneError(f"{where}: expected either pairs or a factor")
        if not measurement.axes or not set(measurement.axes) <= set(_AXES):
            raise SceneError(f"{where}.axes: '{measurement.axes}', accepted: some of x, y and z")
    return measurements
