"""What a gripper holds: `mbd-ros payload`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.core.model.inertial_parameters import (
    COUNT,
    PARAMETER_NAMES,
    inertia_of,
    parameter_transformation,
)
from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.identification.job import LEAST_DEVIATION, run_identify
from mbd_ros.features.identification.least_squares import rows_by_worth
from mbd_ros.features.identification.outcome import FRICTION
from mbd_ros.features.identification.physical_consistency import consistent
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import Learned, Search, learn
from mbd_ros.features.identification.samples import check_excitation, check_length
from mbd_ros.features.identification.task import Task, keep_remarks
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, watching
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

_SIZE = 0.05  # m: radius of gyration of a payload before anything is known of it
_FARTHEST = 1000.0  # m: no gripper holds anything there
_BESIDE = ("offset", "coulomb")  # what a known robot may have besides its own friction


def payload(
    scene: Scene,
    motion: Source,
    *,
    frame: str | None = None,
    without: Source | None = None,
    wrenches: Source | None = None,
    topic: str = "/joint_states",
    derivatives: str | None = None,
    band: float | None = None,
    gains: dict[str, float] | None = None,
    partial: bool = False,
    say: Say | None = None,
    progress: Watch = False,
) -> Payload:
    """Mass, centre and inertia of what a link carries besides what the scene knows.

    Args:
        scene: The scene without it.
        motion: Result, file or bag with positions and efforts.
        frame: Link that carries it; None for the last one of the longest chain.
        without: A recording of the robot without it, from which the robot is identified first;
            None: the scene is right.
        wrenches: Of a table with external loads.
        topic: JointState topic of bags.
        derivatives: given or zero-phase; None: given where a motion has accelerations.
        band: End of the band that is looked at [Hz]; None: from the motion.
        gains: Joint -> torque for a unit of its effort.
        partial: Go on with a motion that does not show all numbers.
        say: Is called with each line for people.
        progress: True for a line on a terminal, or a function of a label and a share.

    Raises:
        DataError: Recordings that cannot be read, or that say nothing.
    """
    remarks, tell = keep_remarks(say)
    loads = () if wrenches is None else (wrenches,)
    common = Task((motion,), loads, topic, derivatives, band, gains=gains or {}, learned=1.0)
    common = common._replace(partial=partial)
    carrier, place = carrier_of(scene, frame)
    with watching(progress):
        if without is not None:
            tell("the robot alone:")
            scene = run_identify(scene, common._replace(motions=(without,)), tell).scene
        found = _fitted(scene, common, place, carrier, tell)
        nothing = None
        if without is not None:
            alone = common._replace(motions=(without,))
            nothing = _fitted(scene, alone, place, carrier, lambda line: None)
    return _payload(found, nothing, carrier, tell)._replace(remarks=remarks)


class Payload(NamedTuple):
    """What is fixed to a link.

    Attributes:
        inertia: `pinocchio.Inertia` in the axes of the link; a body of positive density.
        deviation: Standard deviations of mass [kg] and mass centre [m], shape (4,).
        numbers: The ten numbers about the origin of the link by least squares, shape (10,).
        covariance: Of them, shape (10, 10).
        remarks: Lines for people.
    """

    frame: str
    inertia: Any
    deviation: Array
    numbers: Array
    covariance: Array
    remarks: list[str]

    def table(self) -> Result:
        """A number a row: name, value, deviation, unit."""
        body, sigma = self.inertia, np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        names = ["mass", "cx", "cy", "cz", *(f"{self.frame}.{p}" for p in PARAMETER_NAMES[4:])]
        values = [body.mass, *body.lever, *self.inertia.toDynamicParameters()[4:]]
        units = ["kg", "m", "m", "m", *["kg·m^2"] * 6]
        scatter = [*self.deviation, *sigma[4:]]
        columns = [("name", names), ("value", values), ("deviation", scatter), ("unit", units)]
        return Result({"samples": Table([Column(n, np.array(v)) for n, v in columns])})


def carrier_of(scene: Scene, frame: str | None) -> tuple[str, int]:
    """Link, and the place of its body among those that move.

    Raises:
        DataError: There is no such link, or it does not move.
    """
    model = scene.robot.model
    if frame is None:
        depth = [0] * model.njoints
        for joint in range(1, model.njoints):
            depth[joint] = depth[model.parents[joint]] + 1
        last = int(np.argmax(depth))
        names = [f.name for f in model.frames if f.parentJoint == last and "BODY" in str(f.type)]
        frame = names[-1]
    try:
        joint = int(model.frames[scene.robot.frame(frame)].parentJoint)
    except ModelError as error:
        raise DataError(f"--frame {frame}: {error}") from error
    if joint == 0:
        raise DataError(f"--frame {frame}: this link does not move")
    return frame, joint - 1


def _fitted(scene: Scene, task: Task, place: int, frame: str, say: Say) -> _Found:
    """Numbers of a body fixed to one of the scene's."""
    problem = Problem(scene, task, say)
    problem.only(place)
    r = len(problem.base.chosen)
    known = {str(entry.get("joint")) for entry in _friction(scene)}
    beside = _BESIDE if known else (*_BESIDE, "viscous")
    limits = Search(0.0, 0.0), problem.correlation
    with about(problem.where):
        found = learn(problem.blocks, problem.columns, r, beside, *limits)
    check_length(problem.where, found.joints, r + sum(map(len, found.fit.taken)), problem.seconds)
    pairs = zip(found.joints, found.fit.deviation, strict=True)
    rows = np.concatenate([joint.R[:, :r] / sigma for joint, sigma in pairs])
    check = problem.where, problem.base, problem.texts, rows, task.partial
    for line in check_excitation(*check):
        say(line)
    own = problem.base.matrix[:, COUNT * place : COUNT * (place + 1)]
    numbers, covariance = np.zeros(COUNT), np.zeros((COUNT, COUNT))
    at = problem.base.chosen - COUNT * place
    numbers[at] = found.fit.base
    covariance[np.ix_(at, at)] = found.covariance[:r, :r]
    model = problem.scene.robot.model
    B = parameter_transformation(
        model.frames[problem.scene.robot.frame(frame)].placement.inverse()
    )
    body = _body(problem, found, own, B)
    return _Found(B @ numbers, B @ covariance @ B.T, body)


class _Found(NamedTuple):
    """Numbers in the axes of the link: by least squares, their covariance, of a body."""

    numbers: Array
    covariance: Array
    body: Array


def _friction(scene: Scene) -> Sequence[dict[str, Any]]:
    forces = scene.entries.get("forces") or []
    return [entry for entry in forces if entry.get("type") in FRICTION]


def _body(problem: Problem, found: Learned, own: Array, B: Array) -> Array:
    """The nearest numbers of a body, in the axes of the link.

    Before anything is known it is a ball about the mass centre of the least squares.
    """
    r, fit = len(own), found.fit
    mass = max(float(fit.base[np.flatnonzero(own[:, 0] == 1.0)].sum()), 1.0e-3)
    centre = np.zeros(3)
    for k in range(3):
        centre[k] = float(fit.base[np.flatnonzero(own[:, k + 1] == 1.0)].sum()) / mass
    away = float(np.linalg.norm(centre))
    if not away < _FARTHEST:
        raise DataError(
            f"{problem.where}: the mass centre of what is held would be {away:.3g} m away; "
            "motion, efforts and loads do not belong together"
        )
    spread = 0.4 * mass * _SIZE**2
    P = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)) + spread * np.eye(3)
    tensor = [P[0, 0], P[0, 1], P[1, 1], P[0, 2], P[1, 2], P[2, 2]]
    ball = np.array([[mass, *(mass * centre), *tensor]])
    least = np.array([LEAST_DEVIATION * joint.usual for joint in found.joints])
    A, b, is_signed = rows_by_worth(found.joints, fit, r, least)
    with about(problem.where):
        nearest = consistent(A, b, own, ball, is_signed)
    numbers: Array = B @ nearest.inertial[0]
    return numbers


def _payload(found: _Found, nothing: _Found | None, frame: str, say: Say) -> Payload:
    """Numbers of people, with what the same fit finds where nothing is held."""
    covariance = found.covariance.copy()
    if nothing is not None:
        covariance += nothing.covariance + np.diag(np.square(nothing.numbers))
        say(f"the same fit finds {nothing.numbers[0]:.4g} kg where nothing is held")
    body = inertia_of(found.body)
    mass, centre = body.mass, np.asarray(body.lever)
    to_centre = np.column_stack([-centre / mass, np.eye(3) / mass])
    scatter = to_centre @ covariance[:4, :4] @ to_centre.T
    sigma = np.sqrt(np.maximum([covariance[0, 0], *np.diag(scatter)], 0.0))
    at = ", ".join(f"{c:.4g} +- {s:.2g}" for c, s in zip(centre, sigma[1:], strict=True))
    say(f"{frame} carries {mass:.4g} +- {sigma[0]:.2g} kg, its centre at {at} m (one deviation)")
    return Payload(frame, body, sigma, found.numbers, covariance, [])
