"""Loads that come as wrenches: those of the scene from outside, and those of contacts."""

from collections.abc import Callable
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import WrenchStamped

from mbd_ros.core.dynamics.output_values import Showing
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.points import Point
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.nodes.shell.contact_topics import contacts_of, topic_of
from mbd_ros.nodes.web_view.newest import Newest
from mbd_ros.scene.built_scene import Scene
from msg_adapters.errors import MessageError
from msg_adapters.wrench import WrenchSample, read_wrench

_LASTS = 0.5  # s, a wrench without a successor


class _Load(NamedTuple):
    """A load that is heard.

    Attributes:
        newest: Its topic.
        about: The point that it refers to; None where its message names the link.
    """

    newest: Newest
    about: Point | None


class MeasuredLoads:
    """Hears all loads of a robot.

    Args:
        scene: The scene.
        showing: What parts of it show.
        simulator: Node whose topics `~/..` are.
        newest: Makes what hears a topic.

    Attributes:
        names: Of the loads.
    """

    def __init__(
        self,
        scene: Scene,
        showing: Showing,
        simulator: str,
        newest: Callable[[type, str], Newest],
    ) -> None:
        self._robot, self._loads = scene.robot, dict[str, _Load]()
        for name, wrench in scene.wrenches.items():
            topic = wrench.heard_on.replace("~/", f"{simulator}/", 1)
            self._loads[name] = _Load(newest(WrenchStamped, topic), wrench.about)
        for name in contacts_of(showing):
            topic = topic_of(name).replace("~/", f"{simulator}/", 1)
            self._loads[name] = _Load(newest(WrenchStamped, topic), None)
        self.names = tuple(self._loads)
        self._held: dict[str, tuple[float, Point, Array]] = {}

    def at(self, k: Kinematics, contacts_are_drawn: bool) -> Array:
        """Where loads act, and their forces, shape (n, 2, 3); NaN where they are unknown.

        A load has no place of its own: it is drawn on its axis, next to the point that it is
        given about.

        Args:
            k: Kinematics at positions.
            contacts_are_drawn: Whether arrows of contacts come from elsewhere: no places then.
        """
        now, found = perf_counter(), np.full((len(self._loads), 2, 3), np.nan)
        for row, (name, load) in zip(found, self._loads.items(), strict=True):
            fresh = load.newest.message(lambda msg, load=load: self._read(msg, load))
            if fresh is not None:
                self._held[name] = (now, *fresh)
            since, about, wrench = self._held.get(name, (-np.inf, None, None))
            if about is None or wrench is None or now - since > _LASTS:
                continue
            axes, force, torque = k.rotation(about), wrench[:3], wrench[3:]
            square = float(force @ force)
            beside = np.cross(force, torque) / square if square > 0.0 else np.zeros(3)
            row[1] = axes @ force
            if load.about is not None or not contacts_are_drawn:
                row[0] = k.position(about) + axes @ beside
        return found

    def _read(self, msg: Any, load: _Load) -> tuple[Point, Array]:
        sample: WrenchSample = read_wrench(msg)
        if load.about is not None:
            return load.about, sample.wrench
        try:
            return self._robot.point(sample.frame_id), sample.wrench
        except ModelError as error:
            raise MessageError(str(error)) from error
