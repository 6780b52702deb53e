"""The order of a simulation, and its checks."""

import inspect
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mbd_ros.core.ranges import refuse_dt
from mbd_ros.core.state import NANOSECOND
from mbd_ros.errors import DataError
from mbd_ros.files.formats import is_bag
from mbd_ros.files.times import TIME_LIMIT
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.part_entries import Solver
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.registry import PARTS, resolve

MOST_ROWS = 10_000_000  # some kilobytes each until they are written
_RESOLVED = 64.0  # rounding errors of the time that a step must be longer than


@dataclass(frozen=True)
class Run:
    """Order of a simulation.

    Attributes:
        duration: [s].
        origin: Result, file or bag whose joint state at `start` is the initial one; None takes
            that of the scene.
        start: Time at which the simulation begins [s].
        efforts: Result, file or bag. With actuators their `.command`, or `.effort` of
            those that take the torque of their joint, held between samples. Without actuators
            `.effort` of the joints, linear in between.
        wrenches: Result, file or bag of the external loads of the scene.
        options: Keyword arguments of `Scene.simulation`.
    """

    duration: float
    origin: Source | None = None
    start: float = 0.0
    efforts: Source | None = None
    wrenches: Source | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def inputs(self) -> dict[str, Any]:
        """Its part in the metadata of the result."""
        asked = {"duration": self.duration, "start": self.start, **self.options}
        files = {"from": self.origin, "efforts": self.efforts, "wrenches": self.wrenches}
        return asked | files


def check_words(scene: Scene, run: Run) -> None:
    """Refuse an impossible order before anything is read.

    Raises:
        MbdError: Names the option, what is wrong with it and what is accepted.
    """
    _check_times(scene, run)
    if "solver" in run.options:
        schema.call(Solver, run.options["solver"], "--solver")


def _check_times(scene: Scene, run: Run) -> None:
    """Every output time must be a stamp of its own."""
    dt = run.options.get("dt", scene.dt)
    refuse_dt(run.duration, "-t", DataError)
    refuse_dt(dt, "--dt", DataError)
    end = run.start + run.duration
    if not max(abs(run.start), abs(end)) <= TIME_LIMIT:
        raise DataError(
            f"--start: {run.start:g} s must be finite, the simulation within {TIME_LIMIT:g} s"
        )
    shown = _shown(scene, run)
    if dt < _RESOLVED * math.ulp(max(abs(run.start), abs(end))):
        raise DataError(f"{shown} is lost in rounding between {run.start:g} and {end:g} s")
    if run.duration / dt > MOST_ROWS:
        raise DataError(
            f"{shown}: {run.duration / dt:.3g} rows in -t {run.duration:g} s, accepted are "
            f"{MOST_ROWS:g}; with --tolerance, dt is no more than the interval of the output"
        )


def check_stamps(scene: Scene, run: Run, out: Path) -> None:
    """Refuse times that the stamps of a bag cannot carry.

    Raises:
        DataError: Names the option.
    """
    dt = run.options.get("dt", scene.dt)
    if is_bag(out) and run.start < 0:
        raise DataError(f"--start: {run.start:g} s: the stamps of a bag are >= 0")
    if is_bag(out) and run.start == 0 and dt < 1.5 * NANOSECOND:
        raise DataError(
            f"{_shown(scene, run)}: the stamps of a bag begin with 1 ns, so it must be >= 2e-09 s"
        )


def _shown(scene: Scene, run: Run) -> str:
    """Origin and value of the step."""
    if "dt" in run.options:
        return f"--dt: {run.options['dt']:g} s"
    return f"{scene.name}: dt: {scene.dt:g} s"


def options_of(
    scene: Scene,
    dt: float | None = None,
    integrator: str | Mapping[str, Any] | None = None,
    tolerance: float | None = None,
    solver: str | Mapping[str, str] | None = None,
) -> dict[str, Any]:
    """Keyword arguments of `Scene.simulation`.

    Args:
        scene: The scene.
        dt: Step, and interval of the output [s]; None: that of the scene, as below.
        integrator: Its type, or a whole entry.
        tolerance: Of that integrator, or else of that of the scene.
        solver: Type of the tier, or a whole entry.

    Raises:
        MbdError: There is no such integrator, or it does not take that tolerance.
    """
    options: dict[str, Any] = {} if dt is None else {"dt": dt}
    if isinstance(integrator, Mapping):
        more = {} if tolerance is None else {"tolerance": tolerance}
        method: Mapping[str, Any] | None = {**integrator, **more}
    else:
        method = method_entry(scene, integrator, tolerance)
    if method is not None:
        options["integrator"] = method
    if solver:
        options["solver"] = dict(solver) if isinstance(solver, Mapping) else {"type": solver}
    return options


def method_entry(
    scene: Scene, integrator: str | None, tolerance: float | None
) -> dict[str, Any] | None:
    """Entry of the integrator that the options ask for; None leaves that of the scene.

    Args:
        scene: The scene.
        integrator: Value of `--integrator`.
        tolerance: Value of `--tolerance`, for that integrator or else for that of the scene.

    Raises:
        MbdError: There is no such integrator, or it does not take that tolerance.
    """
    if integrator is None and tolerance is None:
        return None
    entry = dict(scene.integrator_entry or scene.default_integrator)
    where, whose = "--tolerance", f"of {scene.name}" if scene.integrator else "by default"
    if integrator is not None:
        entry, where, whose = {"type": integrator}, f"--integrator {integrator}", "you chose"
    kind = resolve("integrators", entry["type"], where.partition(" ")[0])
    if tolerance is not None:
        if "tolerance" not in inspect.signature(kind).parameters:
            raise DataError(
                f"--tolerance: the integrator {entry['type']} {whose} takes steps of dt and has "
                f"none; --integrator takes {', '.join(_with_tolerance())}, which have one"
            )
        if not math.isfinite(tolerance):
            raise DataError(f"--tolerance: {tolerance:g} is not finite")
        entry["tolerance"] = tolerance
    schema.call(kind, {key: v for key, v in entry.items() if key != "type"}, where)
    return entry


def _with_tolerance() -> list[str]:
    kinds = {name: resolve("integrators", name, "") for name in PARTS["integrators"]}
    return [name for name, k in kinds.items() if "tolerance" in inspect.signature(k).parameters]
