"""Tables of an identification, and its test on what was not learned from."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pinocchio as pin

from mbd_ros.core.identification.base_parameters import parameter_name
from mbd_ros.core.identification.inertial_parameters import parameters_of
from mbd_ros.core.state import Array
from mbd_ros.files.table import Column, Table
from mbd_ros.jobs.identify.band import Filter, grid_step
from mbd_ros.jobs.identify.bodies import inertias_of_links
from mbd_ros.jobs.identify.consistent import Consistent, prior_deviation
from mbd_ros.jobs.identify.identified_scene import friction_entries, identified_scene
from mbd_ros.jobs.identify.learning import Learned, residual
from mbd_ros.jobs.identify.problem import Problem, regressor_of
from mbd_ros.jobs.identify.samples import Piece
from mbd_ros.jobs.identify.task import Identified
from mbd_ros.jobs.lines import Say
from mbd_ros.scene.built_scene import Scene

_MOST = 200_000  # samples of the test
_SHOWN = 0.5  # of what the given bodies leave open: data that say more show a parameter


def outcome(
    scene: Scene, problem: Problem, found: Learned, fitted: Consistent, say: Say
) -> Identified:
    """What was found, as values.

    Args:
        scene: The scene as it was given.
        problem: The rows.
        found: Least squares.
        fitted: The nearest bodies.
        say: Is told what matters.
    """
    fit, entries = found.fit, _friction(problem, found, fitted)
    price = _without_bodies(problem, found)
    inertias, remarks = inertias_of_links(problem.scene.robot, problem.bodies, fitted.inertial)
    new = identified_scene(problem.scene, inertias, entries)
    errors, tested, residuals = _test(scene, new, problem, found.delay)
    base = _base_table(problem, found, fitted)
    if price is not None:
        errors["least squares"] = price
    tables = {
        "base_parameters": base,
        "bodies": _bodies_table(problem, fitted),
        "friction": _friction_table(entries),
        "validation": tested,
    }
    r = len(fit.base)
    for text in (*remarks, *_lines(problem, found, fitted, errors), *_shown(base)):
        say(text)
    covariance = found.covariance[:r, :r]
    about = found.delay, problem.band, fit.condition, errors
    return Identified(new, tables, inertias, covariance, *about, [], residuals)


def _friction(problem: Problem, found: Learned, fitted: Consistent) -> list[dict[str, object]]:
    """Entries of the friction of all joints."""
    chosen = [[problem.columns[i][k] for k in own] for i, own in enumerate(found.fit.taken)]
    ends = np.cumsum([0, *map(len, chosen)])
    values = [fitted.friction[a:b].tolist() for a, b in pairwise(ends)]
    return friction_entries(problem.labels, chosen, values)


def _lines(
    problem: Problem, found: Learned, fitted: Consistent, errors: dict[str, float]
) -> list[str]:
    """Summary for people."""
    r, band = len(found.fit.base), problem.band
    looked = "all that was measured" if band is None else f"up to {band:.3g} Hz"
    lines = [
        f"{r} base parameters, condition number {found.fit.condition:.3g}, {looked}",
    ]
    if (problem.joints < 0).any():
        mass = sum(float(numbers[0]) for numbers in fitted.inertial)
        lines.append(f"total mass {mass:.6g} kg, given {problem.given[:, 0].sum():.6g} kg")
    if errors:
        lines.append(
            "not learned from: identified {identified:.2f} % of the torque, given "
            "{given:.2f} %; as measured, with its noise {identified as measured:.2f} % and "
            "{given as measured:.2f} %".format(**{k: 100.0 * v for k, v in errors.items()})
        )
    if "least squares" in errors:
        price = 100.0 * (errors["identified"] - errors["least squares"])
        lines.append(f"price of bodies that can exist: {price:+.2f} % beside least squares")
    return lines


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


def _base_table(problem: Problem, found: Learned, fitted: Consistent) -> Table:
    """A base parameter a row: given, by least squares with its deviation, of the bodies."""
    r, base = len(found.fit.base), problem.base
    names = [body.name for body in problem.bodies]
    sigma = np.sqrt(np.maximum(np.diag(found.covariance)[:r], 0.0))
    is_shown = sigma < _SHOWN * prior_deviation(base.matrix, problem.given)
    return Table(
        [
            Column("name", np.array([parameter_name(int(i), names) for i in base.chosen])),
            Column("expression", np.array(problem.texts)),
            Column("given", base.values(problem.given.ravel())),
            Column("estimate", found.fit.base),
            Column("deviation", sigma),
            Column("is_shown", is_shown.astype(np.float64)),
            Column("consistent", base.values(fitted.inertial.ravel())),
        ]
    )


def _bodies_table(problem: Problem, fitted: Consistent) -> Table:
    """A body a row: its ten numbers about its mass centre, in the axes of its joint."""
    found = [pin.Inertia.FromDynamicParameters(p) for p in fitted.inertial]
    given = [problem.scene.robot.model.inertias[body.joint] for body in problem.bodies]
    columns = [
        Column("body", np.array([body.name for body in problem.bodies])),
        Column("links", np.array([" ".join(body.links) for body in problem.bodies])),
        Column("mass", np.array([one.mass for one in found]), "kg"),
        Column("mass_given", np.array([one.mass for one in given]), "kg"),
    ]
    for k, axis in enumerate("xyz"):
        columns.append(Column(f"c{axis}", np.array([one.lever[k] for one in found]), "m"))
    for i in range(3):
        for j in range(i, 3):
            values = np.array([one.inertia[i, j] for one in found])
            columns.append(Column(f"I{'xyz'[i]}{'xyz'[j]}", values, "kg·m^2"))
    columns.append(Column("deviation", fitted.deviation))
    return Table(columns)


def _friction_table(entries: Sequence[dict[str, object]]) -> Table:
    """A joint a row."""
    keys = ("viscous", "coulomb", "load", "stribeck", "stribeck_velocity", "offset")
    keys += ("rotor_inertia", "smoothing")
    columns = [
        Column("joint", np.array([str(entry["joint"]) for entry in entries], dtype=np.str_))
    ]
    for key in keys:
        columns.append(Column(key, np.array([float(entry.get(key, 0.0)) for entry in entries])))  # type: ignore[arg-type]
    return Table(columns)


def _test(
    scene: Scene, new: Scene, problem: Problem, delay: float
) -> tuple[dict[str, float], Table, tuple[Array, Array, Array, Array] | None]:
    """Errors on what is left, through the filter and as measured."""
    found = []
    for piece in problem.tested():
        part = _compared(scene, new, problem, piece, delay)
        if part is not None:
            found.append(part)
    empty = Table([Column("joint", np.array(list(problem.labels)))])
    if not found:
        return {}, empty, None
    low = [np.concatenate([part[0][k] for part in found]) for k in range(3)]
    raw = [np.concatenate([part[1][k] for part in found]) for k in range(4)]
    errors, columns = {}, [*empty.columns]
    for name, y, pair in (("", low[0], low[1:]), (" as measured", raw[1], raw[2:])):
        for who, prediction in zip(("identified", "given"), pair, strict=True):
            off = np.sqrt(np.mean(np.square(prediction - y), axis=0))
            size = np.maximum(np.sqrt(np.mean(np.square(y), axis=0)), 1e-300)
            key = f"{who}{name}"
            errors[key] = float(np.linalg.norm(prediction - y) / max(np.linalg.norm(y), 1e-300))
            columns.append(Column(f"{key.replace(' ', '_')}.rms", off, "N·m or N"))
            columns.append(Column(f"{key.replace(' ', '_')}.share", 100.0 * off / size, "%"))
    return errors, Table(columns), (raw[0], raw[1], raw[2], raw[3])


def _without_bodies(problem: Problem, found: Learned) -> float | None:
    """Share of the torque of the test that least squares leave, in the band."""
    left, whole = 0.0, 0.0
    for piece in problem.tested():
        for block in problem.maker.blocks(piece, problem.band, np.array([found.delay])):
            left += float(np.sum(np.square(residual(block, found.fit))))
            whole += float(np.sum(np.square(block.Y[:, :, 0])))
    return float(np.sqrt(left / whole)) if whole > 0.0 else None


def _compared(
    scene: Scene, new: Scene, problem: Problem, piece: Piece, delay: float
) -> tuple[list[Array], list[Array]] | None:
    """Torques measured, identified and given: filtered, and as measured with times."""
    band, count = problem.band, len(piece.times)
    rate = 1.0 / float(np.median(np.diff(piece.times)))
    step = 1 if band is None else max(grid_step(rate, band), count // _MOST)
    grid = np.arange(0, count, step)
    loads = [load[grid] for load in piece.loads]
    motion = piece.y[grid], piece.v[grid], piece.a[grid]
    predictions = [_torques(one, problem, motion, loads) for one in (new, scene)]
    plain = _efforts(problem, piece, piece.measured, grid, 0.0)
    low = _efforts(problem, piece, piece.effort, grid, delay)
    times = piece.times[grid]
    raw = [times, plain, *(_later(times, values, delay) for values in predictions)]
    if band is None:
        return [plain, *predictions], raw
    filtered = Filter.of(rate / step, band)
    if not len(filtered.starts(len(grid))):
        return None
    return [filtered.passed(values) for values in (low, *predictions)], raw


def _later(times: Array, values: Array, delay: float) -> Array:
    """What is measured of values that arrive later; efforts keep their noise so."""
    if not delay:
        return values
    return np.transpose([np.interp(times - delay, times, column) for column in values.T])


def _torques(
    scene: Scene, problem: Problem, motion: tuple[Array, Array, Array], loads: list[Array]
) -> Array:
    """What a scene says of the torques of the rows."""
    regressor = regressor_of(scene, problem.learned)
    W = regressor.rows(*motion)
    inertial = parameters_of(scene.robot.model).ravel()
    found: Array = (W @ inertial + regressor.known(W, *motion, loads))[:, problem.rows]
    return found


def _efforts(problem: Problem, piece: Piece, values: Array, grid: Array, delay: float) -> Array:
    """Efforts of the rows at the times of the motion, 0 of rows without any."""
    found = np.zeros((len(grid), len(problem.rows)))
    for k, joint in enumerate(problem.joints):
        if joint >= 0 and delay:
            found[:, k] = np.interp(piece.times[grid] + delay, piece.times, values[:, joint])
        elif joint >= 0:
            found[:, k] = values[grid, joint]
    return found
