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
        pairs: Labels of two markers each, whose distances are compared.
        factor: In place of pairs.
        axes: Of the link that it scales: some of x, y and z.
    """

    pairs: Sequence[Annotated[Sequence[str], Length(2)]] = ()
    factor: Annotated[Positive, Unit("-")] | None = None
    axes: str = _AXES


@dataclass(frozen=True)
class ScaleTask:
    """How a scene is scaled.

    Attributes:
        segments: Link -> its measurements; links that are left out keep their size.
        begin: First time of the static trial that counts [s].
        end: Last one [s].
        unit: Of the recorded places; None for that of the file.
        mass: Of all segments together [kg]; None keeps it.
        by_volume: Whether masses follow the volumes of segments; else each keeps its share.
        name: Of the scaled scene.
    """

    segments: Mapping[str, Sequence[Measurement]]
    begin: float | None = None
    end: float | None = None
    unit: str | None = None
    mass: float | None = None
    by_volume: bool = False
    name: str = "scaled"


def build_task(site: Site, given: Any) -> ScaleTask:
    """The `scale` section of a task file.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    task: ScaleTask = schema.call(_task, given, site.where, site)
    return task


def _task(
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
    measured = {
        link: _measurements(entry, f"{site.where}.segments.{link}")
        for link, entry in segments.items()
    }
    if not measured:
        raise SceneError(f"{site.where}.segments: names no link")
    if not name.isidentifier():
        raise SceneError(f"{site.where}.name: '{name}' is no word of letters, digits and _")
    return ScaleTask(measured, begin, end, unit, mass, by_volume, name)


def _measurements(entry: Any, where: str) -> tuple[Measurement, ...]:
    """One measurement, or a list of them."""
    listed = entry if isinstance(entry, list) else [entry]
    found = tuple(schema.call(Measurement, one, where) for one in listed)
    for one in found:
        if bool(one.pairs) == (one.factor is not None):
            raise SceneError(f"{where}: expected pairs, or a factor in their place")
        if not one.axes or not set(one.axes) <= set(_AXES):
            raise SceneError(f"{where}.axes: '{one.axes}', accepted: some of x, y and z")
    return found
