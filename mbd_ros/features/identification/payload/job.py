"""Identification of the payload of a gripper: `mbd-ros payload`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

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
from mbd_ros.features.identification.least_squares import weighted_rows
from mbd_ros.features.identification.outcome import FRICTION
from mbd_ros.features.identification.physical_consistency import fit_consistent_bodies
from mbd_ros.features.identification.problem import Problem
from mbd_ros.features.identification.regression import DelaySearch, Regression, regress
from mbd_ros.features.identification.samples import check_excitation, check_length
from mbd_ros.features.identification.task import Task, keep_remarks
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.jobs.arguments import about
from mbd_ros.jobs.progress import Say, Watch, watching
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene

_SIZE = 0.05  # m: radius of gyration of the payload that is assumed before any data
_FARTHEST = 1000.0  # m: mass centres farther away are refused
_DISTURBANCES = ("offset", "coulomb")  # friction that a known robot may have beyond its model


def payload(
    scene: Scene,
    motion: Source,
    *,
    frame: str | None = None,
    without: Source | None = None,
    wrenches: Source | None = None,
    topic: str = "/joint_states",
    derivatives: Literal["given", "zero-phase"] | None = None,
    band: float | None = None,
    gains: dict[str, float] | None = None,
    partial: bool = False,
    say: Say | None = None,
    progress: Watch = False,
) -> Payload:
    """Identify mass, centre and inertia of what a link carries beyond the bodies of the scene.

    Args:
        scene: The scene without the payload.
        motion: Result, file or bag with positions and efforts.
        frame: Link that carries the payload. By default the last link of the longest chain.
        without: Recording of the robot without the payload, from which the robot is identified
            first. By default the scene is right.
        wrenches: Table of the external loads; a bag contains its own.
        topic: JointState topic of bags.
        derivatives: Source of velocities and accelerations. By default given for a motion with
            accelerations, else zero-phase.
        band: End of the frequency band of the fit [Hz]. By default it is chosen from the motion.
        gains: Torque for a unit of the effort of a joint.
        partial: Accept a motion that hides some of the inertial parameters.
        say: Function that is called with each line for people.
        progress: True for a progress line on a terminal, or a function of a label and a share.

    Raises:
        DataError: A recording cannot be read or does not determine the payload.
    """
    remarks, tell = keep_remarks(say)
    loads = () if wrenches is None else (wrenches,)
    common = Task((motion,), loads, topic, derivatives, band, gains=gains or {}, learned=1.0)
    common = common._replace(partial=partial)
    carrier, body = find_carrier(scene, frame)
    with watching(progress):
        if without is not None:
            tell("identification of the robot without the payload:")
            scene = run_identify(scene, common._replace(motions=(without,)), tell).scene
        loaded = _fit_payload(scene, common, body, carrier, tell)
        unloaded = None
        if without is not None:
            alone = common._replace(motions=(without,))
            unloaded = _fit_payload(scene, alone, body, carrier, lambda line: None)
    return _with_centre(loaded, unloaded, carrier, tell)._replace(remarks=remarks)


class Payload(NamedTuple):
    """A body that is fixed to a link.

    Attributes:
        frame: Name of the link.
        inertia: `pinocchio.Inertia` in the axes of the link, of positive density.
        deviation: Standard deviations of mass [kg] and mass centre [m], shape (4,).
        numbers: Ten inertial parameters about the origin of the link by least squares, shape
            (10,).
        covariance: Covariance of `numbers`, shape (10, 10).
        remarks: Lines for people.
    """

    frame: str
    inertia: Any
    deviation: Array
    numbers: Array
    covariance: Array
    remarks: list[str]

    def table(self) -> Result:
        """Return a table with one parameter per row: name, value, deviation, unit."""
        body, sigma = self.inertia, np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        names = ["mass", "cx", "cy", "cz", *(f"{self.frame}.{p}" for p in PARAMETER_NAMES[4:])]
        values = [body.mass, *body.lever, *self.inertia.toDynamicParameters()[4:]]
        units = ["kg", "m", "m", "m", *["kg·m^2"] * 6]
        deviations = [*self.deviation, *sigma[4:]]
        columns = [("name", names), ("value", values), ("deviation", deviations), ("unit", units)]
        return Result({"samples": Table([Column(n, np.array(v)) for n, v in columns])})


def find_carrier(scene: Scene, frame: str | None) -> tuple[str, int]:
    """Return the name of the carrying link and the index of its body among those that move.

    Raises:
        DataError: The link does not exist or does not move.
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
        raise DataError(f"--frame {frame}: this link does not move; name a link that moves")
    return frame, joint - 1


def _fit_payload(scene: Scene, task: Task, body: int, frame: str, say: Say) -> _LinkParameters:
    """Identify the parameters of a payload that is fixed to a body of the scene."""
    problem = Problem(scene, task, say)
    problem.restrict_to_payload(body)
    r = len(problem.base.chosen)
    known = {str(entry.get("joint")) for entry in _friction(scene)}
    allowed = _DISTURBANCES if known else (*_DISTURBANCES, "viscous")
    arguments = DelaySearch(0.0, 0.0), problem.correlation
    with about(problem.where):
        regression = regress(problem.blocks, problem.columns, r, allowed, *arguments)
    joints, fit = regression.joints, regression.fit
    check_length(problem.where, joints, r + sum(map(len, fit.selection)), problem.seconds)
    pairs = zip(joints, fit.deviation, strict=True)
    rows = np.concatenate([joint.R[:, :r] / sigma for joint, sigma in pairs])
    check = problem.where, problem.base, problem.texts, rows, task.partial
    for line in check_excitation(*check):
        say(line)
    T = problem.base.matrix[:, COUNT * body : COUNT * (body + 1)]
    numbers, covariance = np.zeros(COUNT), np.zeros((COUNT, COUNT))
    places = problem.base.chosen - COUNT * body
    numbers[places] = fit.base
    covariance[np.ix_(places, places)] = regression.covariance[:r, :r]
    model = problem.scene.robot.model
    B = parameter_transformation(
        model.frames[problem.scene.robot.frame(frame)].placement.inverse()
    )
    nearest = _nearest_body(problem, regression, T, B)
    return _LinkParameters(B @ numbers, B @ covariance @ B.T, nearest)


class _LinkParameters(NamedTuple):
    """Inertial parameters in the axes of the link: by least squares, and of the nearest body."""

    numbers: Array
    covariance: Array
    body: Array


def _friction(scene: Scene) -> Sequence[dict[str, Any]]:
    forces = scene.entries.get("forces") or []
    return [entry for entry in forces if entry.get("type") in FRICTION]


def _nearest_body(problem: Problem, regression: Regression, T: Array, B: Array) -> Array:
    """Return the parameters of the nearest body of positive density, in the axes of the link.

    The prior is a ball about the mass centre of the least-squares solution.

    Args:
        T: Matrix from inertial to base parameters, shape (r, 10).
        B: Matrix that moves inertial parameters to the axes of the link, shape (10, 10).
    """
    r, fit = len(T), regression.fit
    mass = max(float(fit.base[np.flatnonzero(T[:, 0] == 1.0)].sum()), 1.0e-3)
    centre = np.zeros(3)
    for k in range(3):
        centre[k] = float(fit.base[np.flatnonzero(T[:, k + 1] == 1.0)].sum()) / mass
    distance = float(np.linalg.norm(centre))
    if not distance < _FARTHEST:
        raise DataError(
            f"{problem.where}: the mass centre of the payload would be {distance:.3g} m away; "
            "check that motion, efforts and wrenches belong to the same recording"
        )
    spread = 0.4 * mass * _SIZE**2
    P = mass * (centre @ centre * np.eye(3) - np.outer(centre, centre)) + spread * np.eye(3)
    tensor = [P[0, 0], P[0, 1], P[1, 1], P[0, 2], P[1, 2], P[2, 2]]
    ball = np.array([[mass, *(mass * centre), *tensor]])
    least = np.array([LEAST_DEVIATION * joint.rms for joint in regression.joints])
    A, b, is_signed = weighted_rows(regression.joints, fit, r, least)
    with about(problem.where):
        nearest = fit_consistent_bodies(A, b, T, ball, is_signed)
    numbers: Array = B @ nearest.inertial[0]
    return numbers


def _with_centre(
    loaded: _LinkParameters, unloaded: _LinkParameters | None, frame: str, say: Say
) -> Payload:
    """Return mass, centre and inertia with deviations, and describe them.

    Args:
        unloaded: Result of the same fit for the robot without the payload, which tells the error.
    """
    covariance = loaded.covariance.copy()
    if unloaded is not None:
        covariance += unloaded.covariance + np.diag(np.square(unloaded.numbers))
        say(f"without the payload, the same fit yields {unloaded.numbers[0]:.4g} kg")
    body = inertia_of(loaded.body)
    mass, centre = body.mass, np.asarray(body.lever)
    to_centre = np.column_stack([-centre / mass, np.eye(3) / mass])
    centre_covariance = to_centre @ covariance[:4, :4] @ to_centre.T
    sigma = np.sqrt(np.maximum([covariance[0, 0], *np.diag(centre_covariance)], 0.0))
    place = ", ".join(f"{c:.4g} +- {s:.2g}" for c, s in zip(centre, sigma[1:], strict=True))
    say(
        f"{frame} carries {mass:.4g} +- {sigma[0]:.2g} kg with the centre at {place} m (one "
        "standard deviation)"
    )
    return Payload(frame, body, sigma, loaded.numbers, covariance, [])
