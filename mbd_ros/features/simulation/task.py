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
    """A simulation of a scene, as its task file describes it.

    Attributes:
        duration: Simulated time [s].
        start: Time at which the simulation starts [s].
        origin: Table or bag with the initial joint state at `start`, `from` in the file; None
            takes the initial state of the scene.
        efforts: Table or bag of the commands of actuators, or of the efforts of joints.
        wrenches: Table or bag of the external loads.
        options: Keyword arguments of `Scene.simulation`, which replace sections of the scene.
    """

    duration: float
    start: float
    origin: Path | None
    efforts: Path | None
    wrenches: Path | None
    options: Mapping[str, Any]


def build_task(site: Site, entry: Any) -> SimulateTask:
    """Build the `simulate` section of a task file.

    Raises:
        SceneError: A key is unknown or its value is not accepted; the message names both.
    """
    task: SimulateTask = schema.call(task_of_keys, entry, site.where, site)
    return task


def task_of_keys(
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
    """Build a task; the keyword arguments are the keys of the section `simulate`.

    Args:
        site: Place of the section in its file.
        duration: Simulated time [s].
        start: Time at which the simulation starts [s].
        dt: Step of a fixed-step method, and interval of the output [s]. By default that of the
            scene.
        integrator: Integrator in place of that of the scene.
        stabilization: Stabilization in place of that of the scene.
        solver: Solver in place of that of the scene.
        from_: Table or bag with the initial joint state, in place of that of the scene.
        efforts: Table or bag of the inputs: `<actuator>.command` or `<joint>.effort`.
        wrenches: Table or bag of the external loads.
    """
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
