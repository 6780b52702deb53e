"""Constraints of a scene as pairs of frames, as other packages take them."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.peers.task import End, Follow
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError
from mbd_ros.scene.built_scene import Scene

_CLOSED = 1.0e-8  # m: directions that no row holds and that stay closed by themselves
_LEVER = 0.1  # m, between the two points that make an axis


class Entry(NamedTuple):
    """A part of a scene that peers are told.

    Attributes:
        kind: Its `type`.
        words: All its keys, those that the scene leaves out with their defaults.
        where: File and key.
    """

    kind: str
    words: Mapping[str, Any]
    where: str


def end_of(
    scene: Scene, frame: str, point: Sequence[float], rpy: Sequence[float] = (0.0, 0.0, 0.0)
) -> End:
    """A point of a link, with axes turned by roll, pitch and yaw [m, rad]."""
    link = scene.robot.model.frames[scene.robot.frame(frame)]
    rotation = pin.rpy.rpyToMatrix(np.array(rpy, dtype=np.float64))
    at = pin.SE3(rotation, np.array(point, dtype=np.float64))
    return End(int(link.parentJoint), link.placement * at)


class Rows:
    """Constraints as pairs of frames.

    Args:
        scene: The scene.
        states: Of all joints, on its motion.
    """

    def __init__(self, scene: Scene, states: Sequence[State]) -> None:
        self._scene, self._states = scene, states
        self.points: list[tuple[End, End]] = []
        self.welds: list[tuple[End, End]] = []
        self.bars: list[tuple[End, End, float]] = []
        self.follows: list[Follow] = []

    def add(self, entry: Entry) -> None:
        """Take one constraint.

        Raises:
            SceneError: Peers cannot express it.
        """
        adds = {
            "loop_closure": self._loop,
            "frame_anchor": self._anchor,
            "distance": self._bar,
            "screw": self._screw,
        }
        if entry.kind not in adds:
            known = ", ".join(adds)
            raise SceneError(f"{entry.where}: peers take {known}, not {entry.kind}")
        adds[entry.kind](entry)

    def _loop(self, entry: Entry) -> None:
        words = entry.words
        a, b = (
            end_of(self._scene, words[f"frame_{c}"], words[f"point_{c}"], words[f"rpy_{c}"])
            for c in "ab"
        )
        free = [i for i, axis in enumerate("xyz") if axis not in words["directions"]]
        if free and not self._stays_closed(a, b, free):
            raise SceneError(
                f"{entry.where}: peers close all directions, not only {words['directions']}"
            )
        if words["kind"] == "full":
            self.welds.append((a, b))
            return
        self.points.append((a, b))
        if words["kind"] == "revolute":
            step = pin.SE3(np.eye(3), _LEVER * np.eye(3)["xyz".index(words["axis"])])
            self.points.append((End(a.body, a.place * step), End(b.body, b.place * step)))

    def _anchor(self, entry: Entry) -> None:
        words = entry.words
        held = end_of(self._scene, words["frame"], words["point"], words["rpy"])
        turned = words["orientation"] or (0.0, 0.0, 0.0)
        place = end_of(self._scene, "universe", words["position"], turned)
        (self.welds if words["kind"] == "full" else self.points).append((place, held))

    def _bar(self, entry: Entry) -> None:
        words = entry.words
        a, b = (end_of(self._scene, words[f"frame_{c}"], words[f"point_{c}"]) for c in "ab")
        self.bars.append((a, b, float(words["distance"])))

    def _screw(self, entry: Entry) -> None:
        joint, parent = (_body_of(self._scene, entry.words[key]) for key in ("joint", "parent"))
        lead = float(entry.words["pitch"]) / (2.0 * math.pi)
        self.follows.append(Follow(joint, parent, (float(entry.words["offset"]), lead)))

    def _stays_closed(self, a: End, b: End, free: Sequence[int]) -> bool:
        """Whether the origins do not part along some axes of a, at any known state."""
        model = self._scene.robot.model
        data = model.createData()
        for x in self._states:
            pin.forwardKinematics(model, data, x.q)
            between = (data.oMi[a.body] * a.place).actInv(data.oMi[b.body] * b.place)
            if np.abs(between.translation[list(free)]).max() > _CLOSED:
                return False
        return True


def _body_of(scene: Scene, joint: str) -> int:
    return int(scene.robot.model.getJointId(scene.robot.joint(joint).urdf_name))
