"""Targets that are dragged: the configuration whose link is nearest to a handle."""

from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.markers.marker_fit import Fit
from mbd_ros.features.markers.marker_kinematics import Mark, MarkerKinematics
from mbd_ros.view.live_robot import LiveRobot
from mbd_ros.view.stage import Stage

_POSTURE = 1.0e-4  # weight of a radian beside one of a size of the robot, squared
_NEAR, _BETTER = 1.0e-5, 0.9  # of the size, where it is reached; of a miss, what is progress
_STEPS = 20  # of the solver: the next frame goes on


class Reach:
    """A handle on a link, and the posture that follows it: on couplings, loops and limits.

    The problem is that of marker kinematics with one marker; joints that it leaves open stay.

    Args:
        robot: One of the robots of a page.
        joint: Index in the model of the joint whose solids are led.
        server: The `viser.ViserServer`.
        start: Configuration to begin with, shape (nq,).

    Attributes:
        robot: As given.
        joint: As given.

    Raises:
        ModelError: Something flies, or the joint carries nothing that is drawn.
    """

    def __init__(self, robot: LiveRobot, joint: int, server: Any, start: Array) -> None:
        scene = robot.scene
        if scene.robot.bases:
            raise ModelError("a target would move what flies: none for scenes with free bodies")
        self.robot, self.joint = robot, joint
        solids = [solid for solid in robot.solids if solid.joint == joint]
        if not solids:
            raise ModelError("nothing of this joint is drawn")
        vertices = np.concatenate([solid.surface.vertices for solid in solids])
        held = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
        origin = scene.robot.carrier(solids[0].link)
        mark = Mark("handle", scene.robot.shifted(origin, held.astype(np.float64)), 1.0)
        weight = _POSTURE * robot.size**2
        self._solver = MarkerKinematics(
            scene.robot,
            scene.couplings,
            [mark],
            constraints=scene.constraints,
            tasks=dict.fromkeys(scene.couplings.independent, weight),
        )
        self._q = start.copy()
        self._place = self._held_at(held)
        self._wanted: Array | None = None
        self._goal: Array | None = None
        self._miss = np.inf
        self._show(server)

    def posture(self) -> Array | None:
        """The configuration for the place of the handle, shape (nq,); None where it stays.

        Raises:
            SolveError: Loops do not close there.
        """
        wanted, self._wanted = self._wanted, None
        if wanted is not None:
            self._goal, self._miss = wanted, np.inf
        if self._goal is None:
            return None
        goal, self._goal = self._goal, None
        fit = self._fitted(goal)
        miss = float(np.linalg.norm(fit.misses[0, 0]))
        if _NEAR * self.robot.size < miss < _BETTER * self._miss:
            self._goal, self._miss = goal, miss  # the posture holds it back: again from there
        self._q = fit.q[0]
        state = self.robot.begin._replace(q=self._q, v=np.zeros_like(self.robot.begin.v))
        self._ghost.place(self.robot.frames.at(state))
        return self._q

    def remove(self) -> None:
        """Take handle and ghost away."""
        self._handle.remove()
        self._ghost.remove()

    def _fitted(self, goal: Array) -> Fit:
        robot = self.robot.scene.robot
        asked = {j.name: self._q[[j.q]] for j in robot.joints if j.name in self._solver.tasks}
        place = (goal - self.robot.offset + robot.origin).reshape(1, 1, 3)
        seen = self._solver.seen(place, np.zeros(1), asked)
        fit = self._solver.solver.fit(self._q[None], seen, steps=_STEPS)
        if not np.isfinite(fit.q).all():
            raise SolveError("no posture for this target")
        return fit

    def _held_at(self, held: Array) -> Array:
        pose = self.robot.drawn.poses[self.joint]
        w, xyz = pose[3], pose[4:]
        turned = np.cross(xyz, held)
        place: Array = held + 2.0 * (w * turned + np.cross(xyz, turned)) + pose[:3]
        return place + self.robot.offset

    def _show(self, server: Any) -> None:
        robot, scene = self.robot, server.scene
        scene.add_frame("/target", show_axes=False, position=robot.offset)
        self._ghost = Stage(scene, "/target", robot.solids, robot.size, is_ghost=True)
        self._ghost.place(robot.drawn)
        self._handle = scene.add_transform_controls(
            "/handle", scale=0.25 * robot.size, disable_rotations=True, position=self._place
        )

        async def take(event: Any) -> None:
            place = np.array(event.target.position, dtype=np.float64)
            if np.isfinite(place).all():
                self._wanted = place

        self._handle.on_update(take)
