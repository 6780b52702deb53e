"""The `simulate` section of a task file: the motion that is asked of a scene."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mbd_ros.core.ranges import Unlimited, refuse_dt
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Solver
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.reading.part_entries import build_part
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.locate import find_file


@dataclass(frozen=True)
class SimulateTask:
    """A simulation, asked of a scene.

    Attributes:
        duration: [s].
        start: Time at which it begins [s].
        origin: Table or bag whose joint state at `start` is the initial one, `from` in the file;
            None takes that of the scene.
        efforts: Table or bag of the commands of the actuators.
        wrenches: Table or bag of the external loads.
        options: Keyword arguments of `Scene.simulation`, which replace sections of the scene.
    """

    duration: float
    start: float
    origin: Path | None
    efforts: Path | None
    wrenches: Path | None
    options: Mapping[str, Any]


def build_task(site: Site, given: Any) -> SimulateTask:
    """The `simulate` section of a task file.

    Raises:
        SceneError: Names file, key, what is wrong and what is accepted.
    """
    task: SimulateTask = schema.call(_task, given, site.where, site)
    return task


def _task(
    site: Site,
    *,
    duration: float,
    start: Unlimited = 0.0,
    dt: float | None = None,
    integrator: Mapping[str, Any] | None = None,
    stabilization: Mapping[str, Any] | None = None,
    solver: Mapping[str, Any] | None = None,
    from_: str | None = None,
    efforts: str | None = None,
    wrenches: str | None = None,
) -> SimulateTask:
    where = site.where
    refuse_dt(duration, f"{where}.duration", SceneError)
    if dt is not None:
        refuse_dt(dt, f"{where}.dt", SceneError)
    for key, kind, entry in (
        ("integrator", "integrators", integrator),
        ("stabilization", "stabilization", stabilization),
    ):
        if entry is not None:
            build_part(kind, entry, f"{where}.{key}")
    if solver is not None:
        schema.call(Solver, solver, f"{where}.solver")
    options = {
        "dt": dt,
        "integrator": integrator,
        "stabilization": stabilization,
        "solver": solver,
    }
    files = [
        None if name is None else find_file(site.origin.folder, name, f"{where}.{key}")
        for key, name in (("from", from_), ("efforts", efforts), ("wrenches", wrenches))
    ]
    return SimulateTask(
        duration, start, *files, {key: o for key, o in options.items() if o is not None}
    )
