"""Loads that somebody puts on links by hand: one topic for all of them."""

from collections.abc import Mapping, Sequence
from typing import Any

import pinocchio as pin

from mbd_ros.core.model.robot import Robot
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.nodes.shell.parameters import ParameterError
from mbd_ros.scene.built_scene import Scene
from msg_adapters.errors import MessageError, listed
from msg_adapters.wrench import read_wrench

EVERY = "*"  # stands for all links that move
_PREFIX = "pushed_"


class Pushes:
    """Links that can be pushed, and which external load stands for each.

    Links that one joint carries share a load: an idle one costs a call in every evaluation.

    Args:
        scene: The scene, without these loads.
        links: Names of links, or `EVERY`.

    Attributes:
        scene: The scene with them.
        loads: Names of the loads, those of the scene itself left out.

    Raises:
        ParameterError: There is no such link, or nothing can move it.
    """

    def __init__(self, scene: Scene, links: Sequence[str]) -> None:
        self._model = scene.robot.model
        self._frames = {link: _frame(scene.robot, link) for link in _asked(scene.robot, links)}
        carriers = {int(self._model.frames[at].parentJoint) for at in self._frames.values()}
        self._loads = {joint: f"{_PREFIX}{joint}" for joint in carriers}
        self._first = {
            joint: next(at for at in self._frames.values() if self._joint(at) == joint)
            for joint in carriers
        }
        self.loads = tuple(self._loads.values())
        self.scene = _loaded(scene, self._entries()) if links else scene

    def read(self, msg: Any) -> tuple[str, Array]:
        """The load that a WrenchStamped is for, and the wrench as that load takes it.

        Raises:
            MessageError: No link that can be pushed, or a component that is not finite.
        """
        sample = read_wrench(msg)
        at = self._frames.get(sample.frame_id)
        if at is None:
            known = listed(list(self._frames)) or "none, see parameter pushed_links"
            raise MessageError(f"frame {listed([sample.frame_id])} is no pushed link: {known}")
        joint = self._joint(at)
        first, link = self._model.frames[self._first[joint]], self._model.frames[at]
        there = first.placement.actInv(link.placement)
        return self._loads[joint], there.act(pin.Force(sample.wrench)).vector

    def _joint(self, frame: int) -> int:
        return int(self._model.frames[frame].parentJoint)

    def _entries(self) -> dict[str, Any]:
        frames = self._model.frames
        return {
            self._loads[joint]: {"frame": frames[at].name} for joint, at in self._first.items()
        }


def _asked(robot: Robot, links: Sequence[str]) -> Sequence[str]:
    if EVERY not in links:
        return links
    frames = robot.model.frames
    return [f.name for f in frames if f.type == pin.FrameType.BODY and f.parentJoint > 0]


def _frame(robot: Robot, link: str) -> int:
    try:
        at = robot.frame(link)
    except ModelError as error:
        raise ParameterError(f"parameter 'pushed_links': {error}") from error
    if robot.model.frames[at].parentJoint == 0:
        raise ParameterError(f"parameter 'pushed_links': nothing moves the link '{link}'")
    return at


def _loaded(scene: Scene, entries: Mapping[str, Any]) -> Scene:
    given = scene.entries.get("external_wrenches") or {}
    return scene.with_(external_wrenches={**given, **entries})
