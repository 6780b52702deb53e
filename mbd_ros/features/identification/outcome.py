"""What an identification found: tables, lines, the scene, and its files.

The new scene and the given one are tested on what was not learned from, in the band and as
measured.
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
    also_of,
    as_measured,
    efforts,
    feedback_of,
    torques,
)
from mbd_ros.features.identification.physical_consistency import (
    Consistent,
    inertias_of_links,
    prior_deviation,
)
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import Learned, residual
from mbd_ros.features.identification.regressor import Column, parameter_name
from mbd_ros.features.identification.samples import Filter, Piece, grid_step
from mbd_ros.features.identification.task import Identified
from mbd_ros.files.table import Column as TableColumn
from mbd_ros.files.table import Table
from mbd_ros.jobs.progress import Say
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.variants import with_inertias, with_sections

FRICTION = ("joint_friction", "gear_friction")  # what is found anew
_WIDTH = 140  # of lines of YAML
_MOST_SAMPLES = 200_000  # of the test
_SHOWN = 0.5  # of what the given bodies leave open: data that say more show a parameter


def outcome(
    scene: Scene, problem: Problem, found: Learned, fitted: Consistent, say: Say
) -> Identified:
    """What was found, as values.

    Args:
        scene: The scene as it was given.
        fitted: The nearest bodies.
        say: Is told what matters.
    """
    fit, entries = found.fit, _friction(problem, found, fitted)
    inertias, remarks = inertias_of_links(problem.scene.robot, problem.bodies, fitted.inertial)
    new = identified_scene(problem.scene, inertias, entries)
    test = tested(scene, new, problem, found)
    base = _base_table(problem, found, fitted)
    tables = {
        "base_parameters": base,
        "bodies": _bodies_table(problem, fitted),
        "friction": _friction_table(entries),
        "drives": _drives_table(problem, test.feedback),
        "validation": test.table,
    }
    r = len(fit.base)
    for text in (*remarks, *_lines(problem, found, fitted, test), *_shown(base)):
        say(text)
    covariance = found.covariance[:r, :r]
    about = found.delay, problem.band, fit.condition, test.errors
    return Identified(new, tables, inertias, covariance, *about, [], test.residuals)


def _friction(problem: Problem, found: Learned, fitted: Consistent) -> list[dict[str, object]]:
    """Entries of the friction of all joints."""
    chosen = [[problem.columns[i][k] for k in own] for i, own in enumerate(found.fit.taken)]
    ends = np.cumsum([0, *map(len, chosen)])
    values = [fitted.friction[a:b].tolist() for a, b in pairwise(ends)]
    return friction_entries(problem.labels, chosen, values, also_of(problem))


def friction_entries(
    names: Sequence[str],
    chosen: Sequence[Sequence[Column]],
    values: Sequence[Sequence[float]],
    also: Sequence[Mapping[str, float]],
) -> list[dict[str, Any]]:
    """Entries of `gear_friction`, of joints with any.

    Args:
        names: Of the joints.
        chosen: Columns of each.
        values: Of these columns.
        also: Of each the other joints that turn its motor, and their ratios.
    """
    entries = []
    for name, columns, own, others in zip(names, chosen, values, also, strict=True):
        entry: dict[str, Any] = {"type": "gear_friction", "joint": name}
        for column, value in zip(columns, own, strict=True):
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


def _base_table(problem: Problem, found: Learned, fitted: Consistent) -> Table:
    """A base parameter a row: given, by least squares with its deviation, of the bodies."""
    r, base = len(found.fit.base), problem.base
    names = [body.name for body in problem.bodies]
    sigma = np.sqrt(np.maximum(np.diag(found.covariance)[:r], 0.0))
    is_shown = sigma < _SHOWN * prior_deviation(base.matrix, problem.given)
    return Table(
        [
            TableColumn("name", np.array([parameter_name(int(i), names) for i in base.chosen])),
            TableColumn("expression", np.array(problem.texts)),
            TableColumn("given", base.values(problem.given.ravel())),
            TableColumn("estimate", found.fit.base),
            TableColumn("deviation", sigma),
            TableColumn("is_shown", is_shown.astype(np.float64)),
            TableColumn("consistent", base.values(fitted.inertial.ravel())),
        ]
    )


def _bodies_table(problem: Problem, fitted: Consistent) -> Table:
    """A body a row: its ten numbers about its mass centre, in the axes of its joint."""
    found = [pin.Inertia.FromDynamicParameters(p) for p in fitted.inertial]
    given = [problem.scene.robot.model.inertias[body.joint] for body in problem.bodies]
    columns = [
        TableColumn("body", np.array([body.name for body in problem.bodies])),
        TableColumn("links", np.array([" ".join(body.links) for body in problem.bodies])),
        TableColumn("mass", np.array([one.mass for one in found]), "kg"),
        TableColumn("mass_given", np.array([one.mass for one in given]), "kg"),
    ]
    for k, axis in enumerate("xyz"):
        columns.append(TableColumn(f"c{axis}", np.array([one.lever[k] for one in found]), "m"))
    for i in range(3):
        for j in range(i, 3):
            values = np.array([one.inertia[i, j] for one in found])
            columns.append(TableColumn(f"I{'xyz'[i]}{'xyz'[j]}", values, "kg·m^2"))
    columns.append(TableColumn("deviation", fitted.deviation))
    return Table(columns)


def _friction_table(entries: Sequence[dict[str, object]]) -> Table:
    """A joint a row."""
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
    """A joint a row: torque for a unit of effort, what the drive answers to noise."""
    unit = "N·m·s/rad or N·s/m"
    columns = [TableColumn("joint", np.array(list(problem.labels), dtype=np.str_))]
    gains = [problem.gains.get(name, 1.0) for name in problem.labels]
    scatter = problem.gain_deviation if len(problem.gain_deviation) else np.zeros(len(gains))
    columns += [TableColumn("gain", np.array(gains)), TableColumn("gain_deviation", scatter)]
    columns.append(TableColumn("feedback", feedback[0], unit))
    columns.append(TableColumn("feedback_deviation", feedback[1], unit))
    return Table(columns)


class Tested(NamedTuple):
    """What a test says.

    Attributes:
        errors: Shares of the torque, see `Identified.errors`; empty without a test.
        table: A joint a row.
        feedback: What drives answer to noise of the measured velocity, and its deviation
            [N·m·s/rad or N·s/m], shape (m,) each.
        residuals: Of the test: times [s], torques measured, identified and given; None without.
    """

    errors: dict[str, float]
    table: Table
    feedback: tuple[Array, Array]
    residuals: tuple[Array, Array, Array, Array] | None


def _lines(problem: Problem, found: Learned, fitted: Consistent, test: Tested) -> list[str]:
    """Summary for people."""
    r, band, errors = len(found.fit.base), problem.band, test.errors
    looked = "all that was measured" if band is None else f"up to {band:.3g} Hz"
    lines = [
        f"{r} base parameters, condition number {found.fit.condition:.3g}, {looked}",
    ]
    if (problem.joints < 0).any():
        mass = sum(float(numbers[0]) for numbers in fitted.inertial)
        lines.append(f"total mass {mass:.6g} kg, given {problem.given[:, 0].sum():.6g} kg")
    if errors:
        shares = {key: 100.0 * value for key, value in errors.items()}
        lines.append(
            "not learned from: identified {identified:.2f} % of the torque, given "
            "{given:.2f} %; as measured, with its noise {identified as measured:.2f} % and "
            "{given as measured:.2f} %".format(**shares)
        )
        if (test.feedback[0] > 0.0).any():
            lines.append(_answer(problem, test, shares))
    if "least squares" in errors:
        price = 100.0 * (errors["identified"] - errors["least squares"])
        lines.append(f"price of bodies that can exist: {price:+.2f} % beside least squares")
    return lines


def _answer(problem: Problem, test: Tested, shares: dict[str, float]) -> str:
    """Says which drives answer to noise, and what it would be without."""
    pairs = zip(problem.labels, test.feedback[0], strict=True)
    gains = ", ".join(f"{name} {gain:.3g}" for name, gain in pairs if gain > 0.0)
    plain = "{identified without feedback:.2f} % and {given without feedback:.2f} %"
    return (
        f"drives answer to noise of the measured velocity by {gains} N·m·s/rad, which is taken "
        f"out of the efforts as measured; with it {plain.format(**shares)}"
    )


def _shown(base: Table) -> list[str]:
    """Names of the base parameters that the data tell, where they do not tell all."""
    is_shown = base["is_shown"] > 0.0
    if is_shown.all():
        return []
    names = [str(name) for name, shown in zip(base["name"], is_shown, strict=True) if not shown]
    return [
        f"{int(is_shown.sum())} of {base.rows} base parameters are told better than by the given "
        f"bodies; not {', '.join(names)}"
    ]


def tested(scene: Scene, new: Scene, problem: Problem, found: Learned) -> Tested:
    """Errors of a new scene and the given one on what is left.

    Args:
        scene: As it was given.
        new: What was found.
    """
    names, delay = TableColumn("joint", np.array(list(problem.labels))), found.delay
    none = np.zeros(len(problem.rows))
    low = [_in_band(scene, new, problem, piece, delay) for piece in problem.tested()]
    kept = [one for one in low if one is not None]
    raw = as_measured(problem, (new, scene), problem.recorded(problem.left), delay)
    if not kept or raw is None:
        return Tested({}, Table([names]), (none, none), None)
    feedback = feedback_of(problem, new, problem.recorded(problem.learned), delay)
    answered = raw._replace(predictions=[p - feedback[0] * raw.noise for p in raw.predictions])
    y, *pair = (np.concatenate([one[k] for one in kept]) for k in range(3))
    errors, columns = _compared(y, pair, "")
    for way, one in ((" as measured", answered), (" without feedback", raw)):
        more, shown = _compared(one.effort, one.predictions, way)
        errors, columns = errors | more, [*columns, *shown]
    price = _least_squares(problem, found)
    errors |= {} if price is None else {"least squares": price}
    return Tested(errors, Table([names, *columns]), feedback, _pictured(answered))


def _in_band(
    scene: Scene, new: Scene, problem: Problem, piece: Piece, delay: float
) -> list[Array] | None:
    """Torques measured, identified and given, through the filter; None of too short a piece."""
    band, count = problem.band, len(piece.times)
    rate = 1.0 / float(np.median(np.diff(piece.times)))
    step = 1 if band is None else max(grid_step(rate, band), count // _MOST_SAMPLES)
    grid = np.arange(0, count, step)
    loads = [load[grid] for load in piece.loads]
    motion = piece.y[grid], piece.v[grid], piece.a[grid]
    predictions = [torques(one, problem, motion, loads, piece.carried) for one in (new, scene)]
    values = [efforts(problem, piece, piece.effort, grid, delay), *predictions]
    if band is None:
        return values
    low = Filter.of(rate / step, band)
    if not len(low.starts(len(grid))):
        return None
    return [low.passed(one) for one in values]


def _compared(
    y: Array, predictions: list[Array], way: str
) -> tuple[dict[str, float], list[TableColumn]]:
    """Shares of all, and of each joint, that the new and the given scene leave."""
    errors, columns = {}, []
    size = np.maximum(np.sqrt(np.mean(np.square(y), axis=0)), TINY)
    for who, prediction in zip(("identified", "given"), predictions, strict=True):
        key, off = f"{who}{way}", np.sqrt(np.mean(np.square(prediction - y), axis=0))
        errors[key] = float(np.linalg.norm(prediction - y) / max(np.linalg.norm(y), TINY))
        columns.append(TableColumn(f"{key.replace(' ', '_')}.rms", off, "N·m or N"))
        columns.append(TableColumn(f"{key.replace(' ', '_')}.share", 100.0 * off / size, "%"))
    return errors, columns


def _least_squares(problem: Problem, found: Learned) -> float | None:
    """Share of the torque of the test that least squares leave, in the band."""
    left, whole = 0.0, 0.0
    for piece in problem.tested():
        for block in problem.maker.blocks(piece, problem.band, np.array([found.delay])):
            of = problem.motors.as_measured
            left += float(np.sum(np.square(of(residual(block, found.fit)))))
            whole += float(np.sum(np.square(of(block.Y[:, :, 0] + block.known))))
    return float(np.sqrt(left / whole)) if whole > 0.0 else None


def _pictured(found: Measured) -> tuple[Array, Array, Array, Array]:
    return found.times, found.effort, found.predictions[0], found.predictions[1]


def identified_scene(
    scene: Scene, inertias: Mapping[str, Any], friction: Sequence[Mapping[str, Any]]
) -> Scene:
    """The scene with other inertias and friction."""
    found = with_inertias(scene, inertias)
    if not friction:
        return found
    forces = [*(scene.entries.get("forces") or []), *(dict(entry) for entry in friction)]
    return with_sections(found, forces=forces)


def without_friction(scene: Scene) -> Scene:
    """The scene without the friction of its joints."""
    given = scene.entries.get("forces") or []
    kept = [entry for entry in given if entry.get("type") not in FRICTION]
    return scene if len(kept) == len(given) else with_sections(scene, forces=kept)


def description_of(scene: Scene) -> str:
    """URDF of the only robot of a scene, its inertias written into it.

    Raises:
        SceneError: There are several robots or bodies.
    """
    model_sources = scene.robot.model_sources
    if len(model_sources) != 1 or model_sources[0].name or model_sources[0].shape:
        raise SceneError(f"{scene.name}: files are written of scenes with one robot; use Python")
    tree = xml_tree(model_sources[0].text)
    place_inertias(tree, model_sources[0].inertias or {}, model_sources[0].source)
    return ElementTree.tostring(tree, encoding="unicode")


def scene_text(scene: Scene, urdf: str) -> str:
    """YAML of a scene whose robot is a file of that name."""
    given = scene.entries.get("robot") or {}
    kept = {k: v for k, v in given.items() if k not in ("urdf", "osim", "mjcf")}
    entries = {"robot": {"urdf": urdf, **kept}}
    entries |= {key: entry for key, entry in scene.entries.items() if key != "robot"}
    return yaml.safe_dump(entries, sort_keys=False, default_flow_style=None, width=_WIDTH)


def csv(table: Table) -> bytes:
    """Comma-separated values with a line of names; texts are quoted where they need it."""
    rows = zip(*(column.values.tolist() for column in table.columns), strict=True)
    lines = [",".join(column.name for column in table.columns)]
    lines += [",".join(_word(value) for value in row) for row in rows]
    return ("\n".join(lines) + "\n").encode()


def _word(value: Any) -> str:
    if isinstance(value, str):
        return f'"{value}"' if "," in value else value
    return repr(float(value))
