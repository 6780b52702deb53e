"""The drawing of a scene at a state, as arrays: poses, lines, arrows, cones and colours.

Lengths are in metres, in the world less `Robot.origin`: a robot far away stands at the origin.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.rows.constraint_rows import ConstraintRows
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.inverse_dynamics.reactions import JointReactions
from mbd_ros.scene.built_scene import Scene

SLACK, TIGHT = np.array([20.0, 70.0, 220.0]), np.array([230.0, 0.0, 0.0])
CLOSURE, COUPLING = np.array([0.0, 140.0, 50.0]), np.array([130.0, 30.0, 190.0])
_NO_LINES = np.zeros((0, 2, 3))


class Frames:
    """Draws a scene at states; its arrays and Pinocchio data are made here, once.

    Attributes:
        rows: Names of the columns of all multipliers.
        arrow_names: What exerts the forces, in the order of arrows.
        showing: What parts show.
    """

    def __init__(self, scene: Scene) -> None:
        robot, system = scene.robot, scene.system()
        self._system, self._model, self._data = system, robot.model, pin.Data(robot.model)
        self._k = Kinematics(robot, self._data)
        loads = system.loads
        self.showing = Showing(self._k, system.layout, (*loads.actuators, *loads.forces))
        self.rows = tuple(row.name for row in system.layout.rows)
        self.arrow_names = tuple(arrow.name for arrow in self.showing.arrows)
        every = (*scene.constraints, *scene.muscles, *loads.forces)
        unique = {id(part): part for part in every if part.path is not None}
        self._paths = list(unique.values())
        named = {number.name: i for i, number in enumerate(self.showing.numbers)}
        self._tensions = [_tension(part, named) for part in self._paths]
        self._closures = [p for p in scene.constraints if p.path is None]
        self._sizes = [_row_count(p, system.layout) for p in self._closures]
        self._points = [s.point for s in scene.sensors if s.point is not None]
        self._coupled = _coupled(scene)
        self._rows = ConstraintRows(system.layout.blocks, robot.model.nv)
        forces = (*loads.actuators, *loads.forces)
        self._reactions = JointReactions(robot, self._rows, forces=forces)
        at_v = {int(joint.idx_v): i for i, joint in enumerate(robot.model.joints) if i}
        self._jointed = [at_v[joint.v] for joint in robot.joints]
        self._poses = np.zeros((robot.model.njoints, 7))

    def at(
        self, x: State, a: Array | None = None, multipliers: Array | None = None, most: float = 0.0
    ) -> Drawn:
        """Return the drawing at a state.

        Args:
            a: Accelerations [rad/s^2 or m/s^2], shape (nv,); 0 without it.
            multipliers: Of all rows, shape (m,); without them no arrows, cones and tensions.
            most: Tension that is red [N]; 0 for that of the tightest path of the state.
        """
        a = np.zeros(self._model.nv) if a is None else a
        values, arrows, moments, cones = np.zeros(0), _NO_LINES, _NO_LINES, np.zeros((0, 7))
        if multipliers is not None:
            values, arrows, moments, cones = self._forces(x, a, multipliers)
        self._k.refresh(x.q, x.v, Reads.POSITION)
        lines, tensions = self._path_lines(x, values)
        closures, coupled = self._closure_lines(x), self._coupled_lines()
        colours = np.concatenate(
            (
                tension_colours(tensions, most),
                np.tile(CLOSURE, (len(closures), 1)),
                np.tile(COUPLING, (len(coupled), 1)),
            )
        )
        markers = np.array([self._k.position(point) for point in self._points]).reshape(-1, 3)
        points = np.concatenate((markers, closures.reshape(-1, 3)))
        return Drawn(
            self._placed(),
            np.concatenate((lines, closures, coupled)),
            colours.astype(np.uint8),
            points,
            arrows,
            moments,
            cones,
        )

    def reactions(self, x: State, a: Array, multipliers: Array) -> tuple[Array, Array]:
        """Return joint reactions on the children, as arrows of forces and of moments.

        Args:
            a: Accelerations [rad/s^2 or m/s^2], shape (nv,).
            multipliers: Of all rows, shape (m,).

        Returns:
            Places of the joints with forces [N], and with moments about them [N·m], each of
            shape (joints, 2, 3).
        """
        u = self._system.loads.inputs(x, None)
        lam = multipliers[self._rows.slots]
        world = self._reactions.solve(x, a, lam, u=u).world.reshape(-1, 2, 3)
        self._k.refresh(x.q, x.v, Reads.POSITION)
        places = np.array([self._data.oMi[i].translation for i in self._jointed]).reshape(-1, 3)
        return np.stack((places, world[:, 0]), axis=1), np.stack((places, world[:, 1]), axis=1)

    def tensions(self, x: State, a: Array, multipliers: Array) -> Array:
        """Tension of every path [N], shape (paths,), NaN where it is unknown."""
        u = self._system.loads.inputs(x, None)
        values = self.showing.at(x, u, a, multipliers)
        return np.array([np.nan if i is None else values[i] for i in self._tensions])

    def _placed(self) -> Array:
        for i, oMi in enumerate(self._data.oMi):
            pose = pin.SE3ToXYZQUAT(oMi)
            self._poses[i, :3], self._poses[i, 3], self._poses[i, 4:] = (
                pose[:3],
                pose[6],
                pose[3:6],
            )
        return self._poses

    def _forces(self, x: State, a: Array, lam: Array) -> tuple[Array, Array, Array, Array]:
        """Values of all numbers, arrows of forces, of moments, and cones."""
        u, showing = self._system.loads.inputs(x, None), self.showing
        values = showing.at(x, u, a, lam)
        exerted = [*showing.wrenches(x, u, a, lam), *self._exerted(x, lam)]
        arrows = np.array([(w.point, w.force) for w in exerted]).reshape(-1, 2, 3)
        moments = np.array([(w.point, w.torque) for w in exerted]).reshape(-1, 2, 3)
        cones = [(*c.point, *c.normal, c.mu) for c in showing.cones_at(x, u, a, lam)]
        return values, arrows, moments, np.array(cones).reshape(-1, 7)

    def _exerted(self, x: State, lam: Array) -> list[Any]:
        """Wrenches of constraints that show no arrows themselves."""
        self._k.refresh(x.q, x.v, Reads.POSITION)
        pushes = list[Any]()
        for block in self._system.layout.blocks:
            if not any(output.is_drawn for output in block.part.outputs):
                pushes += block.part.wrenches(self._k, x, lam[block.slots])
        return pushes

    def _path_lines(self, x: State, values: Array) -> tuple[Array, Array]:
        """Pieces of all paths, and the tension of each, NaN where it is unknown."""
        pieces, tensions = [_NO_LINES], list[float]()
        for part, at in zip(self._paths, self._tensions, strict=True):
            for corners in part.path.lines(self._k, x):
                pieces.append(np.stack((corners[:-1], corners[1:]), axis=1))
                known = at is not None and len(values) > 0
                tensions += [values[at] if known else np.nan] * (len(corners) - 1)
        return np.concatenate(pieces), np.array(tensions)

    def _closure_lines(self, x: State) -> Array:
        """A line between the two points where a constraint acts."""
        pairs = []
        for part, size in zip(self._closures, self._sizes, strict=True):
            try:
                wrenches = part.wrenches(self._k, x, np.ones(size))
            except SolveError:  # a path or pair without a direction there
                continue
            if len(wrenches) == 2:
                pairs.append((wrenches[0].point, wrenches[1].point))
        return np.array(pairs).reshape(-1, 2, 3)

    def _coupled_lines(self) -> Array:
        """From a joint to each that follows it, where they are apart."""
        places = np.array([oMi.translation for oMi in self._data.oMi])
        lines = places[self._coupled]
        return lines[np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1) > 0.0]


def _tension(part: Any, named: dict[str, int]) -> int | None:
    """Which number is the tension of a part with a path."""
    return next(
        (named[n] for n in (f"{part.name}.tension", f"{part.name}.multiplier") if n in named), None
    )


def _row_count(part: Any, layout: Any) -> int:
    found = (b.slots.stop - b.slots.start for b in layout.blocks if b.part is part)
    return next(found, 0)


def _coupled(scene: Scene) -> NDArray[np.intp]:
    """Joints of the model, each that is followed with the one that follows, shape (n, 2)."""
    at_v = {int(joint.idx_v): i for i, joint in enumerate(scene.robot.model.joints) if i}
    pairs = [(at_v[pair.parent_v], at_v[pair.child_v]) for pair in scene.couplings.pairs]
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)


def tension_colours(tensions: Array, most: float = 0.0) -> Array:
    """Blue where slack or unknown, red at the largest tension, shape (n, 3).

    Args:
        tensions: [N], shape (n,); NaN where unknown.
        most: Tension that is red [N]; 0 for the largest there is.
    """
    known = np.nan_to_num(tensions)
    most = most or float(np.abs(known).max(initial=0.0))
    share = np.clip(known / most, 0.0, 1.0) if most > 0.0 else np.zeros(len(known))
    return SLACK + share[:, None] * (TIGHT - SLACK)


class Drawn(NamedTuple):
    """The drawing at one state.

    Attributes:
        poses: Of every joint of the model: place [m], then quaternion (w, x, y, z), shape
            (njoints, 7), overwritten by the next one.
        lines: Begin and end of every piece of a path, then of a closure, then from a joint to
            each that follows it, shape (n, 2, 3).
        colours: Of lines, 0 .. 255, shape (n, 3), uint8.
        points: Of markers, then both ends of every closure, shape (m, 3).
        arrows: Where forces of constraints and contacts act, and the forces [N], shape (k, 2, 3).
        moments: The same with their moments [N·m], shape (k, 2, 3).
        cones: Tips of friction cones, normal forces [N] and coefficients, shape (c, 7).
    """

    poses: Array
    lines: Array
    colours: NDArray[np.uint8]
    points: Array
    arrows: Array
    moments: Array
    cones: Array


def arrow_ends(arrows: Array, scale: float, shortest: float = 1.0e-6) -> Array:
    """Begin and end of arrows of forces, without those that are too short to be seen.

    Args:
        arrows: Where forces act [m], and the forces [N], shape (n, 2, 3).
        scale: Length per force [m/N].
        shortest: Length from which an arrow is drawn [m].
    """
    lengths = np.linalg.norm(arrows[:, 1], axis=1) * scale
    seen = arrows[lengths > shortest]
    return np.stack((seen[:, 0], seen[:, 0] + scale * seen[:, 1]), axis=1)


def cone_lines(cones: Array, scale: float, around: int = 12) -> Array:
    """Lines from the tips of friction cones to their rims, and along these.

    Args:
        cones: Tip [m], normal force [N] and coefficient, shape (n, 7).
        scale: Height per force [m/N].
        around: Lines of a cone.

    Returns:
        Shape (2 n around, 2, 3).
    """
    pieces = [_NO_LINES]
    turn = np.arange(around) * (2.0 * np.pi / around)
    for cone in cones:
        axis = cone[3:6] * scale
        height = float(np.linalg.norm(axis))
        if height <= 0.0:
            continue
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        across /= np.linalg.norm(across)
        beside = np.cross(axis / height, across)
        out = np.outer(np.cos(turn), across) + np.outer(np.sin(turn), beside)
        rim = cone[:3] + axis + cone[6] * height * out
        tips = np.broadcast_to(cone[:3], rim.shape)
        pieces.append(np.stack((tips, rim), axis=1))
        pieces.append(np.stack((rim, np.roll(rim, -1, axis=0)), axis=1))
    return np.concatenate(pieces)


def length_per(largest: float, size: float) -> float:
    """Length per force [m/N] or moment [m/(N·m)] at which the largest is a third of a size [m]."""
    return size / (3.0 * largest) if largest > 0.0 else 0.001


def largest(arrows: Array) -> float:
    """Return the largest force or moment of arrows, shape (n, 2, 3); 0 without any."""
    return float(np.linalg.norm(arrows[:, 1], axis=1).max(initial=0.0))


def upright(robot: Robot) -> Array:
    """Axes whose last one, along an axis of the world, is the most opposite to gravity, (3, 3)."""
    gravity = np.array(robot.model.gravity.linear)
    up = np.zeros(3)
    at = int(np.argmax(np.abs(gravity))) if gravity.any() else 2
    up[at] = -1.0 if gravity[at] > 0.0 else 1.0
    turn: Array = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), up).matrix()
    return turn


def joint_indices(robot: Robot) -> dict[str, int]:
    """Joint or free body -> its index in the model."""
    at_v = {int(j.idx_v): i for i, j in enumerate(robot.model.joints) if i and j.nv == 1}
    found = {joint.name: at_v[joint.v] for joint in robot.joints}
    return found | {base.name: base.joint for base in robot.bases}
