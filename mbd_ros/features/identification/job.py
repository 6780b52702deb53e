"""Identification of inertias and friction from recorded motions: `mbd-ros identify`."""

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.drives import choose_motors, estimate_gains, scene_motors
from mbd_ros.features.identification.least_squares import triangular_factor, weighted_rows
from mbd_ros.features.identification.outcome import (
    csv_bytes,
    description_of,
    scene_text,
    summarize,
    without_friction,
)
from mbd_ros.features.identification.physical_consistency import (
    ConsistentBodies,
    fit_consistent_bodies,
)
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import DelaySearch, Regression, regress
from mbd_ros.features.identification.samples import (
    check_excitation,
    check_length,
    check_still,
    check_units,
)
from mbd_ros.features.identification.task import Identified, Task, keep_remarks
from mbd_ros.files.output_folder import write_files
from mbd_ros.files.table import Result, Table
from mbd_ros.files.text_file import refuse_overwriting
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, watching
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

_IN_PHASE = 1.0e-2  # second over first singular value of velocities: below, joints move in phase
LEAST_DEVIATION = 1.0e-6  # of the RMS torque: lower bound of the deviation of rows
_LONGEST_DELAY = 10.0  # s
_DELAY_REACH = 1.0  # range of the search for a delay, in periods of the end of the band
_FITS = 2  # load-dependent friction needs the weight of the bodies from an earlier fit
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;margin:1rem 0;display:block;overflow-x:auto}"
    "td,th{padding:.2rem .7rem;border-bottom:1px solid #ccc;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_POINTS = 4000  # of a curve: the eye sees no more
_TITLES = {
    "validation": "Torques of the test, which were not used for the fit",
    "base_parameters": "Base parameters",
    "bodies": "Bodies, all of positive density",
    "friction": "Friction",
    "drives": "Drives: torque for a unit of effort, feedback of noise of the measured velocity",
}


def identify(
    scene: Scene,
    *motions: Source,
    wrenches: Source | Sequence[Source] = (),
    topic: str = "/joint_states",
    derivatives: str | None = None,
    band: float | None = None,
    friction: str | Sequence[str] = "auto",
    gains: Mapping[str, float] | None = None,
    passive: Sequence[str] = (),
    learned: float = 0.6,
    delay: float | None = None,
    partial: bool = False,
    held: Source | Sequence[Source] = (),
    payload: tuple[str, Sequence[float]] | None = None,
    known: Sequence[str] = (),
    currents: bool = False,
    say: Say | None = None,
    progress: Watch = False,
) -> Identified:
    """Identify inertias and friction, and their accuracy, from motions and measured efforts.

    Args:
        scene: The scene. Its inertias remain where the data determine nothing; its
            `joint_friction` and `gear_friction` are replaced.
        *motions: Results, files or bags with positions and efforts.
        wrenches: Tables with external loads, one per motion.
        topic: JointState topic of bags.
        derivatives: given or zero-phase; None: given where a motion has accelerations.
        band: End of the frequency band of the fit [Hz]; None: from the motion.
        friction: `auto`, `none`, or terms: viscous, coulomb, offset, load, stribeck, inertia.
        gains: Joint -> torque for a unit of its effort.
        passive: Joints without a motor, whose effort is 0; wrenches must be measured there.
        learned: Share of the time of each recording that is used for the fit, from its start; the
            remainder is for the test.
        delay: Delay of efforts against motion [s]; None: estimated.
        partial: Identify what the motion shows, instead of refusing a motion that hides
            parameters.
        held: Motions with a known load, in addition to those without it.
        payload: The known load: link, and mass [kg], centre [m] and optionally three principal
            moments of inertia about the centre [kg·m^2], in the axes of the link.
        known: Links whose inertia in the description is right.
        currents: Whether efforts are in other units than torques. Gains that are not given are
            then estimated from a known load, link or force.
        say: Function that is called with each line for people.
        progress: True for a progress line on a terminal, or a function of a label and a share.

    Returns:
        The identified scene and tables about it.

    Raises:
        DataError: A recording cannot be read or does not determine the parameters.
        SolveError: No physically consistent inertias were found.
    """
    loads = _as_list(wrenches)
    task = Task(
        motions,
        loads,
        topic,
        derivatives,
        band,
        [friction] if isinstance(friction, str) else list(friction),
        gains or {},
        passive,
        learned,
        delay,
        partial,
        _as_list(held),
        payload,
        known,
        currents,
    )
    remarks, tell = keep_remarks(say)
    with watching(progress):
        return run_identify(scene, task, tell)._replace(remarks=remarks)


def _as_list(sources: Source | Sequence[Source]) -> list[Source]:
    return [sources] if isinstance(sources, str | Path | Result) else list(sources)


def run_identify(scene: Scene, task: Task, say: Say) -> Identified:
    """Identify a scene as a task says."""
    if not 0.1 <= task.learned <= 1.0:
        raise DataError(f"--learned {task.learned:g}: accepted are 0.1 .. 1")
    _check_numbers(task)
    allowed = task.allowed
    bare = without_friction(scene)
    problem = Problem(bare, task, say)
    coupled = scene_motors(scene, problem.labels)
    if task.currents:
        if coupled is not None:  # currents belong to motors
            problem.set_motors(coupled._replace(are_measured=True))
        estimate_gains(problem, allowed, say)
    if {"coulomb", "viscous"} & set(allowed):
        choose_motors(problem, coupled, allowed, _search(problem), say)
    regression, bodies = _fit_bodies(problem, allowed, say)
    selection = enumerate(regression.fit.selection)
    if any(problem.columns[i][k].term == "load" for i, columns in selection for k in columns):
        for _ in range(_FITS - 1):
            problem.set_load_model(bodies.inertial)
            regression, bodies = _fit_bodies(problem, allowed, lambda line: None)
    return summarize(scene, problem, regression, bodies, say)


def _check_numbers(task: Task) -> None:
    """Refuse values of options outside of their ranges."""
    if task.band is not None and not 0.0 < task.band < float("inf"):
        raise DataError(f"--band {task.band:g}: must be finite and > 0 Hz")
    if task.delay is not None and not abs(task.delay) <= _LONGEST_DELAY:
        raise DataError(
            f"--delay {task.delay:g}: accepted are -{_LONGEST_DELAY:g} .. {_LONGEST_DELAY:g} s"
        )


def _search(problem: Problem) -> DelaySearch:
    """Return the range of delays to search; it is empty if the task gives the delay."""
    has_motors = problem.band is not None and (problem.joints >= 0).any()
    is_open = problem.task.delay is None and has_motors
    return DelaySearch(
        _DELAY_REACH / (problem.band or 1.0) if is_open else 0.0, 0.5 * problem.step
    )


def _fit_bodies(
    problem: Problem, allowed: Sequence[str], say: Say
) -> tuple[Regression, ConsistentBodies]:
    """Fit parameters by least squares, check them, and find the nearest consistent bodies."""
    r, task = len(problem.base.chosen), problem.task
    if task.delay is not None:
        problem.set_delay(task.delay)
    for line in check_still(problem.where, joint_movement(problem), problem.texts, task.partial):
        say(line)
    arguments = allowed, _search(problem), problem.correlation
    with about(problem.where):
        regression = regress(problem.blocks, problem.columns, r, *arguments)
    if regression.delay:
        later = "later" if regression.delay > 0 else "earlier"
        delay = f"{abs(regression.delay) * 1e3:.3g} ms"
        say(f"efforts come {delay} {later} than the motion; the delay is compensated")
    joints, fit = regression.joints, regression.fit
    driven = problem.joints >= 0
    measured = [j for j, is_driven in zip(joints, driven, strict=True) if is_driven]
    names = [n for n, is_driven in zip(problem.labels, driven, strict=True) if is_driven]
    check_units(problem.where, names, measured, problem.base.values(problem.nominal.ravel()), r)
    check_length(problem.where, joints, r + sum(map(len, fit.selection)), problem.seconds)
    rows = np.concatenate([j.R[:, :r] / d for j, d in zip(joints, fit.deviation, strict=True)])
    excitation = problem.where, problem.base, problem.texts, rows, task.partial
    for line in check_excitation(*excitation, moves_in_phase(problem)):
        say(line)
    return regression, _nearest_bodies(problem, regression)


def _nearest_bodies(problem: Problem, regression: Regression) -> ConsistentBodies:
    """Return the consistent bodies nearest to the description and the data."""
    r = len(problem.base.chosen)
    rms = np.array([joint.rms for joint in regression.joints])
    least = np.maximum(LEAST_DEVIATION * rms, 0.1 * LEAST_DEVIATION * rms.max())
    A, b, is_signed = weighted_rows(regression.joints, regression.fit, r, least)
    with about(problem.where):
        return fit_consistent_bodies(A, b, problem.base.matrix, problem.nominal, is_signed)


def joint_movement(problem: Problem) -> list[tuple[str, float, str]]:
    """Return name, range of motion [rad or m] and first moved body of each driven joint."""
    extent, coordinates = np.zeros(len(problem.rows)), problem.maker.coordinates
    for piece in problem.pieces:
        step = float(np.median(np.diff(piece.times)))
        travel = np.ptp(np.cumsum(piece.v[:, coordinates], axis=0), axis=0) * step
        extent = np.maximum(extent, travel)
    model, v_index = problem.scene.robot.model, problem.scene.couplings.v_index
    first = {int(model.joints[body.joint].idx_v): body.name for body in problem.bodies}
    names = [
        first.get(int(v_index[i]), n) for i, n in zip(coordinates, problem.labels, strict=True)
    ]
    movements = zip(problem.labels, extent.tolist(), names, strict=True)
    return [m for m, joint in zip(movements, problem.joints, strict=True) if joint >= 0]


def moves_in_phase(problem: Problem) -> bool:
    """Return whether all driven joints move in one phase, each by its own factor."""
    driven = problem.maker.coordinates[problem.joints >= 0]
    if len(driven) < 2:
        return False
    v = triangular_factor(np.concatenate([piece.v for piece in problem.pieces])[:, driven])
    size = np.linalg.norm(v, axis=0)
    s = np.linalg.svd(v / np.where(size > 0.0, size, 1.0), compute_uv=False)
    return bool(s[1] < _IN_PHASE * s[0])


def identify_to(scene: Scene, task: Task, folder: Path, say: Say) -> None:
    """Identify and write `identified.urdf`, `scene.yaml`, tables (.csv) and `report.html`.

    If anything fails, no file is written.
    """
    sources: Sequence[Source] = (*task.motions, *task.held, *task.wrenches)
    refuse_overwriting(folder, *(source for source in sources if isinstance(source, Path)))
    description_of(scene)  # refuses scenes that cannot be written before any work is done
    lines, tell = keep_remarks(say)
    result = run_identify(scene, task, tell)._replace(remarks=lines)
    files = {
        "identified.urdf": description_of(result.scene).encode(),
        "scene.yaml": scene_text(result.scene, "identified.urdf").encode(),
        **{f"{name}.csv": csv_bytes(table) for name, table in result.tables.items()},
        "report.html": page(result, scene.name).encode(),
    }
    write_files(folder, files)
    say(f"{folder}: {', '.join(files)}")


def _rows(table: Table) -> Iterator[tuple[Any, ...]]:
    return zip(*(column.values.tolist() for column in table.columns), strict=True)


def page(result: Identified, title: str) -> str:
    """Return the result as one HTML page."""
    policy = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
    return "\n".join(
        [
            f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">{policy}',
            f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
            f"<h1>Identification of {escape(Path(title).name)}</h1>",
            *(f"<p>{escape(line)}</p>" for line in result.remarks),
            *_pictures(result),
            *(line for key, name in _TITLES.items() for line in _table(name, result.tables[key])),
            "</body></html>\n",
        ]
    )


def _pictures(result: Identified) -> Iterator[str]:
    """Yield a figure of the torques and residuals of the test, with one row per joint."""
    if result.residuals is None:
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = result.tables["validation"]["joint"].tolist()
    times, measured, identified, nominal = result.residuals
    every = slice(None, None, max(1, len(times) // _POINTS))
    t = times[every] - times[0]
    picture = Figure(figsize=(10.0, 2.0 * len(names) + 0.6), layout="constrained")
    FigureCanvasAgg(picture)
    grid: Any = picture.subplots(len(names), 2, sharex=True, squeeze=False)
    for k, name in enumerate(names):
        _curves(grid[k], name, t, [v[every, k] for v in (measured, identified, nominal)])
    grid[0, 0].legend(fontsize=7, loc="upper right")
    image = BytesIO()
    picture.savefig(image, format="png", dpi=100)
    data = b64encode(image.getvalue()).decode()
    yield f'<img alt="torques and residuals of the test" src="data:image/png;base64,{data}">'


def _curves(panels: Any, name: str, t: Array, values: list[Array]) -> None:
    """Plot the torques of a joint and their residuals with a band of 95 %."""
    measured, identified, nominal = values
    for curve, label in ((measured, "measured"), (identified, "identified"), (nominal, "given")):
        panels[0].plot(t, curve, lw=0.8, label=label)
    panels[0].set_ylabel(f"{name} [N·m or N]", fontsize=7)
    panels[1].plot(t, nominal - measured, lw=0.5, color="C2")
    panels[1].plot(t, identified - measured, lw=0.5, color="C1")
    band = 1.96 * float(np.std(identified - measured))
    panels[1].axhspan(-band, band, alpha=0.15)
    panels[1].set_ylabel("residual", fontsize=7)
    for panel in panels:
        panel.tick_params(labelsize=7)
        panel.grid(visible=True, alpha=0.3)


def _table(title: str, table: Table) -> Iterator[str]:
    yield f"<h2>{escape(title)}</h2><table><tr>"
    yield "".join(f"<th>{escape(column.label)}</th>" for column in table.columns) + "</tr>"
    for row in _rows(table):
        cells = (x if isinstance(x, str) else f"{x:.4g}" for x in row)
        yield "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in cells) + "</tr>"
    yield "</table>"
