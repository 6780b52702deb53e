"""Identification of inertias and friction from recorded motion: `mbd-ros identify`."""

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.identification.drives import choose_motors, coupled_in, estimate_gains
from mbd_ros.features.identification.least_squares import rows_by_worth, triangle_of
from mbd_ros.features.identification.outcome import (
    csv,
    description_of,
    outcome,
    scene_text,
    without_friction,
)
from mbd_ros.features.identification.physical_consistency import Consistent, consistent
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import Learned, Search, learn
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

_AS_ONE = 1.0e-2  # of the velocities: what is left of them where joints move as one
LEAST_DEVIATION = 1.0e-6  # of the usual torque: deviations that rows have at least
_LONGEST_DELAY = 10.0  # s
_DELAY_REACH = 1.0  # periods of the end of the band: delays that are looked for
_FITS = 2  # friction that grows with the load needs the load of the model found before
_STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse;margin:1rem 0;display:block;overflow-x:auto}"
    "td,th{padding:.2rem .7rem;border-bottom:1px solid #ccc;text-align:right}"
    "td:first-child,th:first-child{text-align:left}img{max-width:100%}"
)
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
_POINTS = 4000  # a curve: more is not to be seen
_TITLES = {
    "validation": "Torques that were not learned from",
    "base_parameters": "Base parameters",
    "bodies": "Bodies, all of positive density",
    "friction": "Friction",
    "drives": "Drives: torque for a unit of effort, answer to noise of the measured velocity",
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
    """Inertias, friction and their accuracy, from motion and measured efforts.

    Args:
        scene: The scene; its inertias are where nothing is known, and its `joint_friction` and
            `gear_friction` are found anew.
        *motions: Results, files or bags with positions and efforts.
        wrenches: Of tables with external loads, one a motion.
        topic: JointState topic of bags.
        derivatives: given or zero-phase; None: given where a motion has accelerations.
        band: End of the band that is looked at [Hz]; None: from the motion.
        friction: `auto`, `none`, or terms: viscous, coulomb, offset, load, stribeck, inertia.
        gains: Joint -> torque for a unit of its effort.
        passive: Joints without a motor, whose effort is 0 where wrenches are measured.
        learned: Share of the time of each recording that is learned from, its first part; the
            rest is for the test.
        delay: Of efforts against motion [s]; None: estimated.
        partial: Go on with a motion that does not show all that states can show.
        held: Motions with a known load, besides those without it.
        payload: That load: link, and mass, centre and perhaps three principal moments about it
            in the axes of the link.
        known: Links that the description has right.
        currents: Efforts are in other units; gains that are not given are estimated, which
            something known has to fix.
        say: Is called with each line for people.
        progress: True for a line on a terminal, or a function of a label and a share.

    Returns:
        The scene with these numbers, and tables.

    Raises:
        DataError: Recordings that cannot be read, or that say nothing, with the reason.
        SolveError: Inertias that bodies can have are not found.
    """
    loads = _several(wrenches)
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
        _several(held),
        payload,
        known,
        currents,
    )
    remarks, tell = keep_remarks(say)
    with watching(progress):
        return run_identify(scene, task, tell)._replace(remarks=remarks)


def _several(sources: Source | Sequence[Source]) -> list[Source]:
    return [sources] if isinstance(sources, str | Path | Result) else list(sources)


def run_identify(scene: Scene, task: Task, say: Say) -> Identified:
    """Do the task of `identify`."""
    if not 0.1 <= task.learned <= 1.0:
        raise DataError(f"--learned {task.learned:g}: accepted are 0.1 .. 1")
    _check_numbers(task)
    allowed = task.allowed
    bare = without_friction(scene)
    problem = Problem(bare, task, say)
    coupled = coupled_in(scene, problem.labels)
    if task.currents:
        if coupled is not None:  # currents are those of motors
            problem.couple(coupled._replace(are_measured=True))
        estimate_gains(problem, allowed, say)
    if {"coulomb", "viscous"} & set(allowed):
        choose_motors(problem, coupled, allowed, _search(problem), say)
    found, fitted = _fitted(problem, allowed, say)
    if any(
        problem.columns[i][k].term == "load" for i, own in enumerate(found.fit.taken) for k in own
    ):
        for _ in range(_FITS - 1):
            problem.carry(fitted.inertial)
            found, fitted = _fitted(problem, allowed, lambda line: None)
    return outcome(scene, problem, found, fitted, say)


def _check_numbers(task: Task) -> None:
    """Refuse numbers without a meaning."""
    if task.band is not None and not 0.0 < task.band < float("inf"):
        raise DataError(f"--band {task.band:g}: must be finite and > 0")
    if task.delay is not None and not abs(task.delay) <= _LONGEST_DELAY:
        raise DataError(
            f"--delay {task.delay:g}: accepted are -{_LONGEST_DELAY:g} .. {_LONGEST_DELAY:g} s"
        )


def _search(problem: Problem) -> Search:
    """Delays that are looked for: none where one is given."""
    has_motors = problem.band is not None and (problem.joints >= 0).any()
    is_open = problem.task.delay is None and has_motors
    return Search(_DELAY_REACH / (problem.band or 1.0) if is_open else 0.0, 0.5 * problem.step)


def _fitted(problem: Problem, allowed: Sequence[str], say: Say) -> tuple[Learned, Consistent]:
    """Least squares, then the nearest bodies."""
    r, task = len(problem.base.chosen), problem.task
    if task.delay is not None:
        problem.shift(task.delay)
    for line in check_still(problem.where, movement(problem), problem.texts, task.partial):
        say(line)
    limits = allowed, _search(problem), problem.correlation
    with about(problem.where):
        found = learn(problem.blocks, problem.columns, r, *limits)
    if found.delay:
        later = "later" if found.delay > 0 else "earlier"
        say(f"efforts come {abs(found.delay) * 1e3:.3g} ms {later} than the motion: taken out")
    driven = problem.joints >= 0
    measured = [j for j, is_driven in zip(found.joints, driven, strict=True) if is_driven]
    names = [n for n, is_driven in zip(problem.labels, driven, strict=True) if is_driven]
    check_units(problem.where, names, measured, problem.base.values(problem.given.ravel()), r)
    check_length(problem.where, found.joints, r + sum(map(len, found.fit.taken)), problem.seconds)
    whole = np.concatenate(
        [j.R[:, :r] / d for j, d in zip(found.joints, found.fit.deviation, strict=True)]
    )
    shown = problem.where, problem.base, problem.texts, whole, task.partial
    for line in check_excitation(*shown, moves_as_one(problem)):
        say(line)
    return found, _nearest(problem, found)


def _nearest(problem: Problem, found: Learned) -> Consistent:
    """The nearest bodies, rows weighed by what they are worth."""
    r = len(problem.base.chosen)
    usual = np.array([joint.usual for joint in found.joints])
    least = np.maximum(LEAST_DEVIATION * usual, 0.1 * LEAST_DEVIATION * usual.max())
    A, b, is_signed = rows_by_worth(found.joints, found.fit, r, least)
    with about(problem.where):
        return consistent(A, b, problem.base.matrix, problem.given, is_signed)


def movement(problem: Problem) -> list[tuple[str, float, str]]:
    """Of each driven joint: name, how far it moves [rad or m], the body it moves first."""
    far, mine = np.zeros(len(problem.rows)), problem.maker.coordinates
    for piece in problem.pieces:
        step = float(np.median(np.diff(piece.times)))
        far = np.maximum(far, np.ptp(np.cumsum(piece.v[:, mine], axis=0), axis=0) * step)
    model, at = problem.scene.robot.model, problem.scene.couplings.v_index
    first = {int(model.joints[body.joint].idx_v): body.name for body in problem.bodies}
    names = [first.get(int(at[i]), n) for i, n in zip(mine, problem.labels, strict=True)]
    every = zip(problem.labels, far.tolist(), names, strict=True)
    return [one for one, joint in zip(every, problem.joints, strict=True) if joint >= 0]


def moves_as_one(problem: Problem) -> bool:
    """Whether all driven joints move in one phase, each by its own factor."""
    mine = problem.maker.coordinates[problem.joints >= 0]
    if len(mine) < 2:
        return False
    v = triangle_of(np.concatenate([piece.v for piece in problem.pieces])[:, mine])
    size = np.linalg.norm(v, axis=0)
    s = np.linalg.svd(v / np.where(size > 0.0, size, 1.0), compute_uv=False)
    return bool(s[1] < _AS_ONE * s[0])


def identify_to(scene: Scene, task: Task, folder: Path, say: Say) -> None:
    """Write `identified.urdf`, `scene.yaml`, tables (.csv) and `report.html`; all, or none."""
    sources: Sequence[Source] = (*task.motions, *task.held, *task.wrenches)
    refuse_overwriting(folder, *(source for source in sources if isinstance(source, Path)))
    description_of(scene)  # refuses scenes that no file can hold
    lines, tell = keep_remarks(say)
    found = run_identify(scene, task, tell)._replace(remarks=lines)
    files = {
        "identified.urdf": description_of(found.scene).encode(),
        "scene.yaml": scene_text(found.scene, "identified.urdf").encode(),
        **{f"{name}.csv": csv(table) for name, table in found.tables.items()},
        "report.html": page(found, scene.name).encode(),
    }
    write_files(folder, files)
    say(f"{folder}: {', '.join(files)}")


def _rows(table: Table) -> Iterator[tuple[Any, ...]]:
    return zip(*(column.values.tolist() for column in table.columns), strict=True)


def page(found: Identified, title: str) -> str:
    """The result as one page."""
    policy = f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">'
    return "\n".join(
        [
            f'<!DOCTYPE html><html lang="en"><head><meta charset="utf-8">{policy}',
            f"<title>{escape(title)}</title><style>{_STYLE}</style></head><body>",
            f"<h1>Identification of {escape(Path(title).name)}</h1>",
            *(f"<p>{escape(line)}</p>" for line in found.remarks),
            *_pictures(found),
            *(line for key, name in _TITLES.items() for line in _table(name, found.tables[key])),
            "</body></html>\n",
        ]
    )


def _pictures(found: Identified) -> Iterator[str]:
    """Torques of the test and what is left of them, a panel a joint."""
    if found.residuals is None:
        return
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    names = found.tables["validation"]["joint"].tolist()
    times, measured, identified, given = found.residuals
    every = slice(None, None, max(1, len(times) // _POINTS))
    t = times[every] - times[0]
    picture = Figure(figsize=(10.0, 2.0 * len(names) + 0.6), layout="constrained")
    FigureCanvasAgg(picture)
    grid: Any = picture.subplots(len(names), 2, sharex=True, squeeze=False)
    for k, name in enumerate(names):
        _curves(grid[k], name, t, [v[every, k] for v in (measured, identified, given)])
    grid[0, 0].legend(fontsize=7, loc="upper right")
    drawn = BytesIO()
    picture.savefig(drawn, format="png", dpi=100)
    data = b64encode(drawn.getvalue()).decode()
    yield f'<img alt="torques and residuals of the test" src="data:image/png;base64,{data}">'


def _curves(panels: Any, name: str, t: Array, values: list[Array]) -> None:
    """Torques of a joint, and their residuals with the band of 95 %."""
    measured, identified, given = values
    for curve, label in ((measured, "measured"), (identified, "identified"), (given, "given")):
        panels[0].plot(t, curve, lw=0.8, label=label)
    panels[0].set_ylabel(f"{name} [N·m or N]", fontsize=7)
    panels[1].plot(t, given - measured, lw=0.5, color="C2")
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
