"""Exudyn on the scenes of this package; the only importer of exudyn."""

from collections.abc import Iterator, Sequence
from typing import Any

import exudyn as exu
import exudyn.itemInterface as items
import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.peers.contenders import cpu_time
from mbd_ros.applications.report.peers.translation import End, Follow, Task
from mbd_ros.applications.report.precision.converged import Record
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, SceneError

SETUP = (
    "Exudyn: generalized-alpha with spectral radius 0.9 and 1 and constraints of index 3, and its "
    "trapezoidal rule with constraints of index 2, on a kinematic tree with coordinate and "
    "spherical constraints, without files; fixed base, linear couplings and loops closed in "
    "points only; points of planar loops are held in their plane."
)
_RADII = (0.9, 1.0)  # spectral, at infinity
_STEPS = (0.1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4)  # s
_PARALLEL = 1.0e-12  # of a component of an axis
_LINEAR = 2  # coefficients of a coupling
_Z = np.array([0.0, 0.0, 1.0])


class ExudynRun:
    """Generalized-alpha with one step.

    Args:
        radius: Spectral radius at infinity, of index 3.
        dt: Step [s].
        index: Of the constraints: 3, or 2 with the trapezoidal rule, which alone has it there.

    Raises:
        SceneError: Exudyn cannot express the scene.
    """

    package = "Exudyn"

    def __init__(self, task: Task, radius: float, dt: float, index: int = 3) -> None:
        _refuse(task)
        self._task, self._radius, self._dt, self._index = task, radius, dt, index
        self.setup = f"generalized-alpha, radius {radius:g}" if index == 3 else "trapezoidal rule"
        if task.has_rows:
            self.setup += f", index {index}"
        self.record: Record = {"dt": dt}

    def run(self, times: Sequence[float]) -> tuple[list[State], float]:
        """Return the states at the samples, and the CPU time of the integration [s].

        Raises:
            DivergedError: Exudyn gives up.
        """
        exu.config.suppressWarnings = True  # of steps that do not converge: they raise
        system = exu.SystemContainer().AddSystem()
        node = _build(system, self._task)
        solver, settings = exu.MainSolverImplicitSecondOrder(), self._settings()
        states, used, begin = [], 0.0, 0.0
        for t in times:
            settings.timeIntegration.startTime, settings.timeIntegration.endTime = begin, t
            settings.timeIntegration.numberOfSteps = max(1, round((t - begin) / self._dt))
            try:
                used += cpu_time(lambda: _advance(solver, system, settings))
            except (RuntimeError, ValueError) as error:
                raise DivergedError(f"Exudyn gives up before {t:g} s") from error
            q, v = (np.atleast_1d(system.GetNodeOutput(node, kind)) for kind in _OUTPUTS)
            states.append(State(t, q, v))
            system.systemData.SetSystemState(
                system.systemData.GetSystemState(), configuration=exu.ConfigurationType.Initial
            )
            begin = t
        return states, used

    def _settings(self) -> Any:
        settings = exu.SimulationSettings()
        settings.timeIntegration.verboseMode = 0
        settings.solutionSettings.writeSolutionToFile = False
        settings.solutionSettings.sensorsWriteFileHeader = False
        alpha = settings.timeIntegration.generalizedAlpha
        alpha.spectralRadius = self._radius
        alpha.useNewmark = alpha.useIndex2Constraints = self._index == 2
        return settings


_OUTPUTS = exu.OutputVariableType.Coordinates, exu.OutputVariableType.Coordinates_t


def _advance(solver: Any, system: Any, settings: Any) -> None:
    if not solver.SolveSystem(system, settings):
        raise RuntimeError("no convergence")


def runs(task: Task, quick: bool) -> Iterator[ExudynRun]:
    """The sweep over spectral radii, steps and indices."""
    for dt in _STEPS[3:6] if quick else _STEPS:
        yield from (ExudynRun(task, radius, dt) for radius in _RADII)
        if task.has_rows:
            yield ExudynRun(task, 1.0, dt, index=2)


def _refuse(task: Task) -> None:
    """Say what Exudyn's kinematic trees do not have."""
    lacking = {
        "free bodies": task.is_floating,
        "couplings that are not linear": any(len(f.coefficients) > _LINEAR for f in task.follows),
        "frames that coincide": bool(task.welds),
        "points at a distance": bool(task.bars),
        "springs between points": bool(task.springs),
        "inertias of drives": any(body.armature for body in task.moving),
    }
    if found := [name for name, is_there in lacking.items() if is_there]:
        raise SceneError(", ".join(found))


def _build(system: Any, task: Task) -> int:
    """Add the tree and its constraints; the node of its coordinates."""
    bodies, turns = task.moving, [np.eye(3), *(_turn(body.axis) for body in task.moving)]
    places = [
        pin.SE3(turns[b.parent].T, np.zeros(3)) * b.place * pin.SE3(turns[i], np.zeros(3))
        for i, b in enumerate(bodies, 1)
    ]
    count = len(bodies)
    node = system.AddNode(
        items.NodeGenericODE2(
            referenceCoordinates=[0.0] * count,
            initialCoordinates=list(task.q),
            initialCoordinates_t=list(task.v),
            numberOfODE2Coordinates=count,
        )
    )
    kinds = exu.JointType.RevoluteZ, exu.JointType.PrismaticZ
    tree = system.AddObject(
        items.ObjectKinematicTree(
            nodeNumber=node,
            gravity=list(task.gravity),
            jointTypes=[kinds[body.slides] for body in bodies],
            linkParents=[body.parent - 1 for body in bodies],
            jointTransformations=exu.Matrix3DList([place.rotation for place in places]),
            jointOffsets=exu.Vector3DList([place.translation for place in places]),
            linkInertiasCOM=exu.Matrix3DList(
                [R.T @ b.inertia.inertia @ R for R, b in zip(turns[1:], bodies, strict=True)]
            ),
            linkCOMs=exu.Vector3DList(
                [R.T @ b.inertia.lever for R, b in zip(turns[1:], bodies, strict=True)]
            ),
            linkMasses=[body.inertia.mass for body in bodies],
            jointForceVector=list(task.torques),
            jointPControlVector=[body.stiffness for body in bodies],
            jointDControlVector=[body.damping for body in bodies],
            jointPositionOffsetVector=[body.rest for body in bodies],
            jointVelocityOffsetVector=[0.0] * count,
        )
    )
    _add_rows(system, task, node, tree, turns)
    system.Assemble()
    return int(node)


def _add_rows(system: Any, task: Task, node: int, tree: int, turns: Sequence[Any]) -> None:
    for follow in task.follows:
        _add_coupling(system, node, follow)
    held = _held_axes(task)
    for pair in task.points:
        markers = [_marker(system, tree, end, turns) for end in pair]
        system.AddObject(items.ObjectJointSpherical(markerNumbers=markers, constrainedAxes=held))


def _add_coupling(system: Any, node: int, follow: Follow) -> None:
    """Add factor parent - child + offset = 0."""
    offset, factor = follow.coefficients
    markers = [
        system.AddMarker(items.MarkerNodeCoordinate(nodeNumber=node, coordinate=body - 1))
        for body in (follow.child, follow.parent)
    ]
    system.AddObject(
        items.ObjectConnectorCoordinate(markerNumbers=markers, factorValue1=factor, offset=-offset)
    )


def _held_axes(task: Task) -> list[int]:
    """World axes along which a point has to be held: not the common axis of all hinges."""
    places = [pin.SE3.Identity()]
    for body in task.moving:
        places.append(places[body.parent] * body.place)
    axes = [p.rotation @ b.axis for p, b in zip(places[1:], task.moving, strict=True)]
    is_planar = not any(body.slides for body in task.moving)
    common = np.abs(np.array(axes)).min(axis=0) > 1.0 - _PARALLEL
    return [int(not (is_planar and along)) for along in common]


def _marker(system: Any, tree: int, end: End, turns: Sequence[Any]) -> int:
    point = turns[end.body].T @ end.place.translation
    if end.body == 0:
        ground = system.AddObject(items.ObjectGround())
        marker = items.MarkerBodyRigid(bodyNumber=ground, localPosition=list(point))
    else:
        marker = items.MarkerKinematicTreeRigid(
            objectNumber=tree, linkNumber=end.body - 1, localPosition=list(point)
        )
    return int(system.AddMarker(marker))


def _turn(axis: Any) -> Any:
    """A rotation that takes z to an axis."""
    return pin.Quaternion.FromTwoVectors(_Z, axis / np.linalg.norm(axis)).toRotationMatrix()
