"""Loads on a body that is cut free: `mbd-ros loads`."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path as File
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.kinematics.paths.paths import Path
from mbd_ros.core.state import NANOSECOND, Array, State
from mbd_ros.errors import DataError, ModelError, SceneError, SolveError
from mbd_ros.features.loads.free_body import (
    CONTACT,
    ActingWrenches,
    BodyLoad,
    BodyMotion,
    BodyWrench,
    FreeBody,
    inertial_load,
)
from mbd_ros.features.loads.history import History, Instant, Units, in_slots, instants_of, units_of
from mbd_ros.files.formats import is_bag
from mbd_ros.files.table import (
    MAIN,
    Column,
    Result,
    Table,
    motion_stamps,
    read_result,
    time_columns,
)
from mbd_ros.files.text_file import check_place, refuse_overwriting
from mbd_ros.jobs.progress import Say, Watch, progress, watching
from mbd_ros.methods.inverse_dynamics.efforts import join_names
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.inverse_solution import Solved, solve_motion
from mbd_ros.motion.recordings import Source, metadata_of, name_of, refuse_huge
from mbd_ros.motion.samples import Task
from mbd_ros.motion.stance import stance_of
from mbd_ros.scene.built_scene import Scene

if TYPE_CHECKING:
    from mbd_ros.features.loads.fem.finite_elements import MeshTask

_QUANTITIES = "tension", "force"  # as `simulate` and `muscles` call it
INSTANTS = "instants"
_ROUNDING = 1.0e-9  # accepted residual force, as a share of the largest load
MESHED = ".inp", ".feb", ".vtu"


def loads(
    scene: Scene,
    motion: Source,
    *,
    body: str,
    joints: Sequence[str] = (),
    muscle_forces: Source | None = None,
    at: Sequence[float] = (),
    units: Literal["m", "mm"] = "m",
    derivatives: str = "given",
    cutoff: float | None = None,
    half_width: int | None = None,
    wrenches: Source | None = None,
    external: str | File | None = None,
    time_range: tuple[float, float] | None = None,
    wrench_axes: str | None = None,
    topic: str = "/joint_states",
    bounds: bool = False,
    stance: str | None = None,
    stance_gap: float | None = None,
    stance_speed: float | None = None,
    say: Say | None = None,
    progress: Watch = False,
) -> Result:
    """Compute the loads on one body of a scene in a motion, in axes of its link.

    Arguments that are not listed here have the meaning of those of `inverse`.

    Args:
        scene: The scene.
        motion: Result, file or bag with the positions of its joints.
        body: Link whose loads are computed, with all links that fixed joints tie to it.
        joints: Fixed joints at which the body ends, besides the joints that move.
        muscle_forces: Result or table with columns `<muscle>.force` or `<muscle>.tension` [N]. By
            default these are columns of the motion.
        at: Instants to mark beside the peaks [s].
        units: `m`, or `mm` for lengths in mm, moments in N·mm and masses in tonnes.

    Returns:
        Table `samples`: `time`, `is_instant`; `<load>.force_x`, `.torque_x`, `.point_x` of joints,
        contacts, constraints, forces, external wrenches and muscles; `gravity.acceleration_x`,
        `<body>.linear_acceleration.x`, `.angular_velocity.x`, `.angular_acceleration.x`;
        `weight.force_x`, `inertia.force_x`, `inertia.torque_x`; `balance.force`, `.torque`,
        `.off`. Table `instants`: peaks and chosen times.

    Raises:
        DataError: A file cannot be read or does not fit the scene.
        SceneError: The body or a joint is unknown, or the body has no mass.
        SolveError: A sample cannot be solved, or the loads do not explain the motion of the body.
    """
    remarks: list[str] = []
    with watching(progress):
        recorded = Task(
            motion,
            Derivatives(derivatives, cutoff, half_width),
            wrenches,
            topic,
            bounds=bounds,
            external=None if external is None else File(external),
            time_range=time_range,
            stance=stance_of(stance, stance_gap, stance_speed),
            wrench_axes=wrench_axes,
        )
        task = LoadsTask(recorded, body, joints, muscle_forces, at, units)
        result = run_loads(scene, task, say or remarks.append)[0]
    if say is None:
        result.metadata["remarks"] = remarks
    return result


class LoadsTask(NamedTuple):
    """A recorded motion, and the body whose loads are computed.

    Attributes:
        motion: The motion, as inverse dynamics takes it.
        body: Link whose loads are computed, with all links that fixed joints tie to it.
        joints: Fixed joints at which the body ends, besides the joints that move.
        muscle_forces: Table with `<muscle>.force` or `<muscle>.tension` [N]. By default these are
            columns of the motion.
        at: Instants to mark beside the peaks [s].
        units: m: N, m, kg, s and Pa. mm: N, mm, t, s and MPa.
        mesh: Solid that takes the loads; needed for .inp, .feb and .vtu.
    """

    motion: Task
    body: str
    joints: Sequence[str] = ()
    muscle_forces: Source | None = None
    at: Sequence[float] = ()
    units: Literal["m", "mm"] = "m"
    mesh: "MeshTask | None" = None


def run_loads(scene: Scene, task: LoadsTask, say: Say) -> tuple[Result, History, list[Instant]]:
    """Return the result of `loads`, the history behind it, and its instants."""
    units = units_of(task.units)
    try:
        body = FreeBody(scene.robot, task.body, task.joints)
    except ModelError as error:
        raise SceneError(f"{scene.name}: {error}") from error
    solved = solve_motion(scene, task.motion, say)
    for text in solved.solution.remarks:
        say(text)
    history = _history(body, solved, task, say)
    _check(history, name_of(task.motion.motion), say)
    instants = instants_of(history, task.at)
    inputs = {
        "motion": task.motion.motion,
        "derivatives": solved.observed.derivatives.source,
        "at": list(task.at) or None,
        "muscle_forces": task.muscle_forces,
    }
    about = metadata_of("loads", scene, inputs, {}) | about_body(history, units)
    return Result(tables_of(history, instants, units), about), history, instants


def _history(body: FreeBody, solved: Solved, task: LoadsTask, say: Say) -> History:
    paths, stamps = commanded_paths(solved.scene), solved.observed.samples.stamps
    tensions = tensions_at(paths, task.motion.motion, task.muscle_forces, stamps, say)
    explained, scene = solved.solution.explained, solved.scene
    measured = {n: w for n, w in scene.wrenches.items() if n not in solved.contacts}
    body_wrenches = ActingWrenches(explained.rows, scene.forces_without_input, measured, paths)
    places = [i for i, name in enumerate(scene.wrenches) if name in measured]
    samples: list[list[BodyLoad]] = []
    motions: list[BodyMotion] = []
    contacts = list(_known_contacts(solved))
    for row, (x, a, exerted) in enumerate(
        progress(explained.motions(), explained.count, "loads on the body")
    ):
        body.k.refresh(x.q, x.v)
        values = [solved.wrenches[i][row] for i in places]
        tension = tensions[row].tolist()
        wrenches = list(body_wrenches.at(body.k, x, exerted.multipliers, values, tension))
        wrenches += [wrench for forces, of in contacts for wrench in of(body, x, forces[row])]
        loads, motion = body.loads(x, a, wrenches)
        samples.append(loads)
        motions.append(motion)
    motion = BodyMotion(*(np.array(each) for each in zip(*motions, strict=True)))
    about = body.link, body.links, body.joints, body.inertia, stamps
    return History(*about, *in_slots(samples), motion)


def _known_contacts(solved: Solved) -> Iterator[tuple[Array, Any]]:
    """Yield the forces of known contacts, with functions that give their wrenches on bodies."""
    if not solved.known:
        return
    from mbd_ros.motion.known_contacts import forces_at  # only for motions with contacts

    def wrenches_of(contact: Any) -> Any:
        def wrenches(body: FreeBody, x: State, forces: Array) -> list[BodyWrench]:
            return [BodyWrench(contact.name, CONTACT, w) for w in contact.exert(body.k, x, forces)]

        return wrenches

    observed = solved.observed
    for contact in solved.known:
        forces = forces_at(contact, observed.motion, observed.samples.stamps)
        yield forces, wrenches_of(contact)


def _check(history: History, where: str, say: Say) -> None:
    """Refuse loads that are not finite or do not explain the motion, and report the residual."""
    values = (history.force, history.moment, history.point, *history.motion)
    if not all(np.isfinite(each).all() for each in values):
        raise DataError(f"{where}: loads on {history.body} are not finite")
    off = history.balance().off
    row = int(off.argmax())
    text = f"balance of {history.body}: off by at most {off[row]:.2g} of the largest load"
    if off[row] > _ROUNDING:
        raise SolveError(f"{where}: {text}, at {history.time(row):.9g} s; accepted: {_ROUNDING:g}")
    links, cut = ", ".join(history.links), ", ".join(history.joints)
    say(f"{history.body} ({links}), {history.inertia.mass:.6g} kg, cut at {cut}")
    say(text)


def loads_to(scene: Scene, task: LoadsTask, out: File, say: Say) -> None:
    """Read a motion, and write the loads on a body.

    Args:
        task: The motion and the body.
        out: Path whose suffix chooses the format.
        say: Called with each line for people.

    Raises:
        MbdError: An error of `loads`, or a file that cannot be written.
    """
    motion = task.motion
    sources = motion.motion, motion.wrenches, motion.external, task.muscle_forces
    refuse_overwriting(out, *(source for source in sources if isinstance(source, File)))
    if out.suffix in MESHED:
        _finite_elements(scene, task, out, say)
        return
    if task.mesh is not None:
        raise DataError(f"{out}: --mesh goes with {', '.join(MESHED)}")
    check_place(out)
    result, _, _ = run_loads(scene, task, say)
    result.to(out)
    say(f"{result[MAIN].rows} samples of loads on {task.body} -> {out}")


def _finite_elements(scene: Scene, task: LoadsTask, out: File, say: Say) -> None:
    """Write a mesh with its loads."""
    from mbd_ros.features.loads.fem.finite_elements import body_of, write_body  # for meshes only

    if task.mesh is None:
        raise DataError(f"{out}: --mesh is missing, the solid that takes the loads")
    if not out.parent.is_dir():
        raise DataError(f"{out}: directory {out.parent} does not exist")
    _, history, instants = run_loads(scene, task, say)
    body, steps, text = body_of(history, instants, task.mesh, units_of(task.units))
    say(text)
    write_body(body, steps, out, say, task.mesh.amplitudes)


def tables_of(history: History, instants: Sequence[Instant], units: Units) -> dict[str, Table]:
    """Return table `samples` with all loads, and table `instants` with the marked ones."""
    marked = np.zeros(len(history.stamps))
    marked[[each.row for each in instants]] = 1.0
    columns = [*time_columns(history.stamps), Column("is_instant", marked)]
    columns += _load_columns(history, units)
    columns += _inertial_columns(history, units)
    balance = history.balance()
    force, moment = (np.linalg.norm(each, axis=1) for each in balance[:2])
    columns += [
        Column("balance.force", force, "N"),
        Column("balance.torque", moment * units.per_metre, units.moment),
        Column("balance.off", balance.off),
    ]
    return {MAIN: Table(columns), INSTANTS: _instants(history, instants, units)}


def _load_columns(history: History, units: Units) -> list[Column]:
    columns, L = [], units.per_metre
    for i, slot in enumerate(history.slots):
        columns += _vectors(f"{slot.name}.force_", history.force[:, i], "N", history.body)
        moment = history.moment[:, i] * L
        columns += _vectors(f"{slot.name}.torque_", moment, units.moment, history.body)
        point = history.point[:, i] * L
        columns += _vectors(f"{slot.name}.point_", point, units.name, history.body)
    return columns


def _inertial_columns(history: History, units: Units) -> list[Column]:
    """Return columns of the motion of the body, and of weight and inertial forces."""
    body, L, (gravity, push, spin, turn) = history.body, units.per_metre, history.motion
    force, moment = inertial_load(history.inertia, history.motion)
    weight = history.inertia.mass * gravity
    return [
        *_vectors("gravity.acceleration_", gravity * L, units.acceleration, body),
        *_vectors(f"{body}.linear_acceleration.", push * L, units.acceleration, body),
        *_vectors(f"{body}.angular_velocity.", spin, "rad/s", body),
        *_vectors(f"{body}.angular_acceleration.", turn, "rad/s^2", body),
        *_vectors("weight.force_", weight, "N", body),
        *_vectors("inertia.force_", force - weight, "N", body),
        *_vectors("inertia.torque_", moment * L, units.moment, body),
    ]


def _instants(history: History, instants: Sequence[Instant], units: Units) -> Table:
    turns = np.array([each.name.endswith(".torque") for each in instants], dtype=bool)
    values = np.array([each.value for each in instants]) * np.where(turns, units.per_metre, 1.0)
    rows = [each.row for each in instants]
    return Table(
        [
            Column("time", history.stamps[rows] * NANOSECOND, "s"),
            Column("row", np.array(rows, dtype=np.int64)),
            Column("name", np.array([each.name for each in instants], dtype=np.str_)),
            Column("value", values),
        ]
    )


def _vectors(name: str, values: Array, unit: str, frame: str) -> list[Column]:
    return [
        Column(f"{name}{axis}", np.array(column), unit, frame)
        for axis, column in zip("xyz", values.T, strict=True)
    ]


def about_body(history: History, units: Units) -> dict[str, Any]:
    """Return the metadata that describe the body, in its units."""
    inertia, L = history.inertia, units.per_metre
    mass = float(inertia.mass) * (1.0 if units.mass == "kg" else 1e-3)
    per_mass = mass / float(inertia.mass)
    return {
        "body": history.body,
        "links": list(history.links),
        "joints": list(history.joints),
        "kinds": {slot.name: slot.kind for slot in history.slots},
        "units": {"length": units.name, "mass": units.mass, "force": "N", "time": "s"},
        "mass": mass,
        "mass_centre": (inertia.lever * L).tolist(),
        "inertia": (inertia.inertia * per_mass * L**2).tolist(),
    }


def commanded_paths(scene: Scene) -> dict[str, Path]:
    """Return the paths of muscles and other parts whose tension a motion does not determine."""
    known = {id(part) for part in scene.forces_without_input}
    every = (*scene.commanded, *scene.forces)
    return {p.name: p.path for p in every if p.path is not None and id(p) not in known}


def tensions_at(
    paths: Mapping[str, Path],
    motion: Source,
    muscle_forces: Source | None,
    stamps: NDArray[np.int64],
    say: Say,
) -> Array:
    """Read the tensions at the samples of a motion [N], shape (n, paths).

    Args:
        paths: Paths by the name of the part that pulls.
        motion: The motion, which may have columns `<part>.tension` or `<part>.force`.
        muscle_forces: Table with such columns, linear between its rows; None for those of the
            motion.
        stamps: Times of the samples [ns], shape (n,).
        say: Called with a line about tensions that are taken as 0.

    Raises:
        DataError: The table has none of the columns, or does not cover the motion.
    """
    tensions = np.zeros((len(stamps), len(paths)))
    source = motion if muscle_forces is None else muscle_forces
    table = _table(source)
    columns = {} if table is None else _columns(name_of(source), table, paths)
    if muscle_forces is not None and not columns:
        accepted = join_names([f"{name}.{quantity}" for name in paths for quantity in _QUANTITIES])
        raise DataError(
            f"--muscle-forces {name_of(muscle_forces)}: no column {accepted or 'is needed'}"
        )
    if table is not None and columns:
        at = motion_stamps(table, name_of(source))
        if not (len(at) and at[0] <= stamps[0] and stamps[-1] <= at[-1]):
            covered = " to ".join(f"{t * NANOSECOND:.6g}" for t in at[[0, -1]])
            needed = " to ".join(f"{t * NANOSECOND:.6g}" for t in stamps[[0, -1]])
            raise DataError(f"{name_of(source)}: tensions at {covered} s do not cover {needed} s")
        since, times = (at - at[0]) * NANOSECOND, (stamps - at[0]) * NANOSECOND
        for i, name in enumerate(paths):
            if name in columns:
                tensions[:, i] = np.interp(times, since, columns[name])
    if missing := [name for name in paths if name not in columns]:
        say(f"tensions of {join_names(missing)} are taken as 0; --muscle-forces gives them")
    return tensions


def _table(source: Source) -> Table | None:
    if isinstance(source, Result):
        return source[MAIN]
    return None if is_bag(source) else read_result(File(source))[MAIN]


def _columns(where: str, table: Table, paths: Mapping[str, Path]) -> dict[str, Array]:
    by_name = {}
    for name in paths:
        for quantity in _QUANTITIES:
            column = f"{name}.{quantity}"
            if name not in by_name and column in table:
                values = np.asarray(table[column], dtype=np.float64)
                if not np.isfinite(values).all():
                    raise DataError(f"{where}: column {column} has gaps")
                refuse_huge(where, [column], values)
                by_name[name] = values
    return by_name
