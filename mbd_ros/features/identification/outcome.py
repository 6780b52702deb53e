"""Result of an identification: tables, summary, the identified scene, and its files.

The identified scene and the given one are tested on the parts of recordings that were not used for
the fit, both in the band and with the efforts as measured.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import yaml

from mbd_ros.core.model.urdf import place_inertias
from mbd_ros.core.model.xml_tree import xml_tree
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TINY
from mbd_ros.errors import SceneError
from mbd_ros.features.identification.drives import (
    Measured,
    compare_with_measured,
    coupled_joints,
    efforts_of_rows,
    estimate_feedback,
    predicted_efforts,
)
from mbd_ros.features.identification.physical_consistency import (
    ConsistentBodies,
    inertias_of_links,
    prior_deviation,
)
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import Regression, residual
from mbd_ros.features.identification.regressor import Column, parameter_name
from mbd_ros.features.identification.samples import Filter, Piece, grid_step
from mbd_ros.features.identification.task import Identified
from mbd_ros.files.table import Column as TableColumn
from mbd_ros.files.table import Table
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.variants import with_inertias, with_sections

FRICTION = ("joint_friction", "gear_friction")  # types of forces that are identified again
_WIDTH = 140  # of lines of YAML
_MOST_SAMPLES = 200_000  # of a piece of the test
_SHOWN_FACTOR = 0.5  # of the prior deviation: data that reach less show a parameter


def summarize(
    scene: Scene, problem: Problem, regression: Regression, bodies: ConsistentBodies, say: Say
) -> Identified:
    """Build the identified scene, test it, and describe the result in tables and lines.

    Args:
        scene: The given scene.
        say: Receives the lines of the summary.
    """
    fit, entries = regression.fit, _friction_of(problem, regression, bodies)
    inertias, remarks = inertias_of_links(problem.scene.robot, problem.bodies, bodies.inertial)
    new = identified_scene(problem.scene, inertias, entries)
    test = compare_scenes(scene, new, problem, regression)
    base = _base_table(problem, regression, bodies)
    tables = {
        "base_parameters": base,
        "bodies": _bodies_table(problem, bodies),
        "friction": _friction_table(entries),
        "drives": _drives_table(problem, test.feedback),
        "validation": test.table,
    }
    r = len(fit.base)
    for text in (*remarks, *_summary(problem, regression, bodies, test), *_hidden_line(base)):
        say(text)
    covariance = regression.covariance[:r, :r]
    numbers = regression.delay, problem.band, fit.condition, test.errors
    return Identified(new, tables, inertias, covariance, *numbers, [], test.residuals)


def _friction_of(
    problem: Problem, regression: Regression, bodies: ConsistentBodies
) -> list[dict[str, object]]:
    """Return scene entries for the friction of all joints."""
    selection = enumerate(regression.fit.selection)
    chosen = [[problem.columns[i][k] for k in columns] for i, columns in selection]
    ends = np.cumsum([0, *map(len, chosen)])
    values = [bodies.friction[a:b].tolist() for a, b in pairwise(ends)]
    return friction_entries(problem.labels, chosen, values, coupled_joints(problem))


def friction_entries(
    names: Sequence[str],
    chosen: Sequence[Sequence[Column]],
    values: Sequence[Sequence[float]],
    also: Sequence[Mapping[str, float]],
) -> list[dict[str, Any]]:
    """Return entries of type `gear_friction` for the joints that have friction.

    Args:
        names: Names of the joints.
        chosen: Selected columns of each joint.
        values: Values of these columns.
        also: Other joints that turn the motor of each joint: name -> ratio.
    """
    entries = []
    for name, columns, numbers, others in zip(names, chosen, values, also, strict=True):
        entry: dict[str, Any] = {"type": "gear_friction", "joint": name}
        for column, value in zip(columns, numbers, strict=True):
            if column.term == "offset":
                entry["offset"] = -float(value)
            elif column.term == "inertia":
                entry["rotor_inertia"] = float(value)
            else:
                entry[column.term] = float(value)
            if column.smoothing:
                entry["smoothing"] = float(column.smoothing)
            if column.stribeck:
                entry["stribeck_velocity"] = float(column.stribeck)
        if len(entry) > 2:
            entry |= {"also": dict(others)} if others else {}
            entries.append(entry)
    return entries


def _base_table(problem: Problem, regression: Regression, bodies: ConsistentBodies) -> Table:
    """Return a table with one base parameter per row: given, least squares, consistent bodies."""
    r, base = len(regression.fit.base), problem.base
    names = [body.name for body in problem.bodies]
    sigma = np.sqrt(np.maximum(np.diag(regression.covariance)[:r], 0.0))
    is_shown = sigma < _SHOWN_FACTOR * prior_deviation(base.matrix, problem.nominal)
    return Table(
        [
            TableColumn("name", np.array([parameter_name(int(i), names) for i in base.chosen])),
            TableColumn("expression", np.array(problem.texts)),
            TableColumn("given", base.values(problem.nominal.ravel())),
            TableColumn("estimate", regression.fit.base),
            TableColumn("deviation", sigma),
            TableColumn("is_shown", is_shown.astype(np.float64)),
            TableColumn("consistent", base.values(bodies.inertial.ravel())),
        ]
    )


def _bodies_table(problem: Problem, bodies: ConsistentBodies) -> Table:
    """Return a table with one body per row, about mass centres and in the axes of joints."""
    inertias = [pin.Inertia.FromDynamicParameters(p) for p in bodies.inertial]
    nominal = [problem.scene.robot.model.inertias[body.joint] for body in problem.bodies]
    columns = [
        TableColumn("body", np.array([body.name for body in problem.bodies])),
        TableColumn("links", np.array([" ".join(body.links) for body in problem.bodies])),
        TableColumn("mass", np.array([inertia.mass for inertia in inertias]), "kg"),
        TableColumn("mass_given", np.array([inertia.mass for inertia in nominal]), "kg"),
    ]
    for k, axis in enumerate("xyz"):
        levers = np.array([inertia.lever[k] for inertia in inertias])
        columns.append(TableColumn(f"c{axis}", levers, "m"))
    for i in range(3):
        for j in range(i, 3):
            values = np.array([inertia.inertia[i, j] for inertia in inertias])
            columns.append(TableColumn(f"I{'xyz'[i]}{'xyz'[j]}", values, "kg·m^2"))
    columns.append(TableColumn("deviation", bodies.deviation))
    return Table(columns)


def _friction_table(entries: Sequence[dict[str, object]]) -> Table:
    """Return a table of the friction with one joint per row."""
    keys = ("viscous", "coulomb", "load", "stribeck", "stribeck_velocity", "offset")
    keys += ("rotor_inertia", "smoothing")
    columns = [
        TableColumn("joint", np.array([str(entry["joint"]) for entry in entries], dtype=np.str_))
    ]
    for key in keys:
        columns.append(
            TableColumn(key, np.array([float(entry.get(key, 0.0)) for entry in entries]))
        )  # type: ignore[arg-type]
    return Table(columns)


def _drives_table(problem: Problem, feedback: tuple[Array, Array]) -> Table:
    """Return a table of gains and velocity feedback with one joint per row."""
    unit = "N·m·s/rad or N·s/m"
    columns = [TableColumn("joint", np.array(list(problem.labels), dtype=np.str_))]
    gains = [problem.gains.get(name, 1.0) for name in problem.labels]
    deviation = problem.gain_deviation if len(problem.gain_deviation) else np.zeros(len(gains))
    columns += [TableColumn("gain", np.array(gains)), TableColumn("gain_deviation", deviation)]
    columns.append(TableColumn("feedback", feedback[0], unit))
    columns.append(TableColumn("feedback_deviation", feedback[1], unit))
    return Table(columns)


class TestResult(NamedTuple):
    """Result of the test of an identified scene.

    Attributes:
        errors: Relative errors, as `Identified.errors`; empty without a test.
        table: Errors with one joint per row.
        feedback: Velocity feedback of the drives and its standard deviation [N·m·s/rad or N·s/m],
            shape (m,) each.
        residuals: Times [s] and torques measured, identified and given; None without a test.
    """

    errors: dict[str, float]
    table: Table
    feedback: tuple[Array, Array]
    residuals: tuple[Array, Array, Array, Array] | None


def _summary(
    problem: Problem, regression: Regression, bodies: ConsistentBodies, test: TestResult
) -> list[str]:
    """Return the summary for people."""
    r, band, errors = len(regression.fit.base), problem.band, test.errors
    range_ = "unfiltered" if band is None else f"up to {band:.3g} Hz"
    lines = [
        f"{r} base parameters, condition number {regression.fit.condition:.3g}, {range_}",
    ]
    if (problem.joints < 0).any():
        mass = sum(float(numbers[0]) for numbers in bodies.inertial)
        lines.append(f"total mass {mass:.6g} kg, given {problem.nominal[:, 0].sum():.6g} kg")
    if errors:
        shares = {key: 100.0 * value for key, value in errors.items()}
        lines.append(
            "error on data that were not fitted: identified scene {identified:.2f} % of the "
            "torque, given scene {given:.2f} %; with the noise of the measured torque "
            "{identified as measured:.2f} % and {given as measured:.2f} %".format(**shares)
        )
        if (test.feedback[0] > 0.0).any():
            lines.append(_feedback_line(problem, test, shares))
    if "least squares" in errors:
        price = 100.0 * (errors["identified"] - errors["least squares"])
        lines.append(f"error added by physical consistency: {price:+.2f} % over least squares")
    return lines


def _feedback_line(problem: Problem, test: TestResult, shares: dict[str, float]) -> str:
    """Return a line about drives with velocity feedback, and the errors without its correction."""
    pairs = zip(problem.labels, test.feedback[0], strict=True)
    gains = ", ".join(f"{name} {gain:.3g}" for name, gain in pairs if gain > 0.0)
    plain = "{identified without feedback:.2f} % and {given without feedback:.2f} %"
    return (
        f"drives feed the noise of the measured velocity back with {gains} N·m·s/rad; this is "
        f"subtracted from the measured efforts, without that {plain.format(**shares)}"
    )


def _hidden_line(base: Table) -> list[str]:
    """Return a line with the base parameters that the data do not determine, if there are any."""
    is_shown = base["is_shown"] > 0.0
    if is_shown.all():
        return []
    names = [str(name) for name in base["name"][~is_shown]]
    return [
        f"the data determine {int(is_shown.sum())} of {base.rows} base parameters better than the "
        f"given bodies; the others are {', '.join(names)}"
    ]


def compare_scenes(
    scene: Scene, new: Scene, problem: Problem, regression: Regression
) -> TestResult:
    """Compare the identified and the given scene with the test parts of the recordings.

    Args:
        scene: The given scene.
        new: The identified scene.
    """
    names, delay = TableColumn("joint", np.array(list(problem.labels))), regression.delay
    zero = np.zeros(len(problem.rows))
    pieces = problem.test_pieces()
    results = [_filtered_efforts(scene, new, problem, piece, delay) for piece in pieces]
    filtered = [efforts for efforts in results if efforts is not None]
    test_pieces = problem.pieces_of_motion(problem.test)
    raw = compare_with_measured(problem, (new, scene), test_pieces, delay)
    if not filtered or raw is None:
        return TestResult({}, Table([names]), (zero, zero), None)
    training_pieces = problem.pieces_of_motion(problem.training)
    feedback = estimate_feedback(problem, new, training_pieces, delay)
    corrected = raw._replace(predictions=[p - feedback[0] * raw.noise for p in raw.predictions])
    y, *pair = (np.concatenate([efforts[k] for efforts in filtered]) for k in range(3))
    errors, columns = _relative_errors(y, pair, "")
    for suffix, samples in ((" as measured", corrected), (" without feedback", raw)):
        more_errors, more_columns = _relative_errors(samples.effort, samples.predictions, suffix)
        errors, columns = errors | more_errors, [*columns, *more_columns]
    least = _least_squares_error(problem, regression)
    errors |= {} if least is None else {"least squares": least}
    return TestResult(errors, Table([names, *columns]), feedback, _residual_curves(corrected))


def _filtered_efforts(
    scene: Scene, new: Scene, problem: Problem, piece: Piece, delay: float
) -> list[Array] | None:
    """Return filtered torques: measured, identified and given; None if the piece is too short."""
    band, count = problem.band, len(piece.times)
    rate = 1.0 / float(np.median(np.diff(piece.times)))
    step = 1 if band is None else max(grid_step(rate, band), count // _MOST_SAMPLES)
    grid = np.arange(0, count, step)
    loads = [load[grid] for load in piece.loads]
    motion = piece.y[grid], piece.v[grid], piece.a[grid]
    predictions = [
        predicted_efforts(s, problem, motion, loads, piece.payload) for s in (new, scene)
    ]
    values = [efforts_of_rows(problem, piece, piece.effort, grid, delay), *predictions]
    if band is None:
        return values
    low = Filter.of(rate / step, band)
    if not len(low.starts(len(grid))):
        return None
    return [low.apply(torques) for torques in values]


def _relative_errors(
    y: Array, predictions: list[Array], suffix: str
) -> tuple[dict[str, float], list[TableColumn]]:
    """Return relative errors of the identified and the given scene: of all joints, and of each.

    Args:
        suffix: Ending of the keys and of the names of columns.
    """
    errors, columns = {}, []
    size = np.maximum(np.sqrt(np.mean(np.square(y), axis=0)), TINY)
    for model, prediction in zip(("identified", "given"), predictions, strict=True):
        key, rms = f"{model}{suffix}", np.sqrt(np.mean(np.square(prediction - y), axis=0))
        errors[key] = float(np.linalg.norm(prediction - y) / max(np.linalg.norm(y), TINY))
        columns.append(TableColumn(f"{key.replace(' ', '_')}.rms", rms, "N·m or N"))
        columns.append(TableColumn(f"{key.replace(' ', '_')}.share", 100.0 * rms / size, "%"))
    return errors, columns


def _least_squares_error(problem: Problem, regression: Regression) -> float | None:
    """Return the relative error of least squares in the test, in the band."""
    error, total = 0.0, 0.0
    for piece in problem.test_pieces():
        for block in problem.maker.blocks(piece, problem.band, np.array([regression.delay])):
            as_measured = problem.motors.as_measured
            error += float(np.sum(np.square(as_measured(residual(block, regression.fit)))))
            total += float(np.sum(np.square(as_measured(block.Y[:, :, 0] + block.known))))
    return float(np.sqrt(error / total)) if total > 0.0 else None


def _residual_curves(samples: Measured) -> tuple[Array, Array, Array, Array]:
    return samples.times, samples.effort, samples.predictions[0], samples.predictions[1]


def identified_scene(
    scene: Scene, inertias: Mapping[str, Any], friction: Sequence[Mapping[str, Any]]
) -> Scene:
    """Return the scene with other inertias and additional friction."""
    new = with_inertias(scene, inertias)
    if not friction:
        return new
    forces = [*(scene.entries.get("forces") or []), *(dict(entry) for entry in friction)]
    return with_sections(new, forces=forces)


def without_friction(scene: Scene) -> Scene:
    """Return the scene without the friction of its joints."""
    forces = scene.entries.get("forces") or []
    others = [entry for entry in forces if entry.get("type") not in FRICTION]
    return scene if len(others) == len(forces) else with_sections(scene, forces=others)


def description_of(scene: Scene) -> str:
    """Return the URDF of the only robot of a scene, with the inertias of the scene.

    Raises:
        SceneError: There are several robots or bodies.
    """
    model_sources = scene.robot.model_sources
    if len(model_sources) != 1 or model_sources[0].name or model_sources[0].shape:
        raise SceneError(
            f"{scene.name}: the scene has several robots or bodies, but files are written only "
            "for scenes with one robot; use mbd_ros.identify in Python"
        )
    tree = xml_tree(model_sources[0].text)
    place_inertias(tree, model_sources[0].inertias or {}, model_sources[0].source)
    return ElementTree.tostring(tree, encoding="unicode")


def scene_text(scene: Scene, urdf: str) -> str:
    """Return the YAML of a scene whose robot is the file `urdf`."""
    robot = scene.entries.get("robot") or {}
    others = {k: v for k, v in robot.items() if k not in ("urdf", "osim", "mjcf")}
    entries = {"robot": {"urdf": urdf, **others}}
    entries |= {key: entry for key, entry in scene.entries.items() if key != "robot"}
    return yaml.safe_dump(entries, sort_keys=False, default_flow_style=None, width=_WIDTH)


def csv_bytes(table: Table) -> bytes:
    """Return comma-separated values with a header; texts are quoted where they need it."""
    rows = zip(*(column.values.tolist() for column in table.columns), strict=True)
    lines = [",".join(column.name for column in table.columns)]
    lines += [",".join(_cell(value) for value in row) for row in rows]
    return ("\n".join(lines) + "\n").encode()


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"' if "," in value else value
    return repr(float(value))
