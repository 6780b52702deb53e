"""The state of reading an OpenSim model: frames, joints, names and what was left out."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any

from mbd_ros.scene.models.imported_model import LeftOut, Unexpressed
from mbd_ros.scene.models.osim.item import GROUND, Attached, Frames, Item, bodies_of, socket
from mbd_ros.scene.models.osim.mechanism import Mechanism
from mbd_ros.scene.models.urdf_text import Names

FORCES = ("Force", "Muscle", "Actuator", "Spring", "Ligament")


class Reading:
    """A model that is being read.

    Args:
        model: The `<Model>`.
        frames: Its bodies and offset frames.
        fixed: Coordinates that do not move -> position [rad or m].
        closures: Name of a joint that closes a loop -> the constraint in its place.

    Attributes:
        joints: Names of the joints of the scene.
        turning: Those that turn.
        held: Coordinates that move nothing.
        carriers: Link -> the joint that carries it, empty for ground.
        left_out: Elements that the scene does not have.
        names: Of joints and parts.
    """

    def __init__(
        self,
        model: Item,
        frames: Frames,
        mechanism: Mechanism,
        fixed: Mapping[str, float],
        closures: Mapping[str, dict[str, Any]],
    ) -> None:
        self.model, self.frames, self.fixed = model, frames, fixed
        self.closures = closures
        self.joints = {joint.name for joint in mechanism.joints}
        self.turning = {j.name for j in mechanism.joints if j.motion and j.motion.turns}
        self.idle_coordinates = mechanism.coordinates.keys() - self.joints - fixed.keys()
        self.carriers = mechanism.carriers(fixed)
        self.left_out: list[LeftOut] = []
        self.names = Names(self.joints)

    @cached_property
    def wrap_objects(self) -> dict[str, tuple[str, Item]]:
        """Name of a surface that paths wrap over -> its body and itself; the first of a name."""
        ground = self.model.find("Ground")
        bodies = [*([ground] if ground else []), *bodies_of(self.model)]
        surfaces = [(body, one) for body in bodies for one in body.objects("WrapObjectSet")]
        return {one.name: (body.name or GROUND, one) for body, one in reversed(surfaces)}

    @cached_property
    def contact_geometry(self) -> dict[str, Item]:
        """The shapes that touch, by name; the first of a name."""
        return {one.name: one for one in reversed([*self.model.objects("ContactGeometrySet")])}

    def leave_out(self, item: Item, reason: str) -> None:
        """Note that the scene does not have an element."""
        self.left_out.append(LeftOut(item.type, item.name, reason))

    def attached(self, item: Item, *sockets: str) -> Attached:
        """The frame that an element names.

        Raises:
            SceneError: It names none, or one that is not there.
        """
        return self.frames.attached(item, *sockets)

    def refuse_rigid(self, a: Attached, b: Attached | None) -> None:
        """Refuse two frames, or one and ground, that no joint moves against each other.

        Raises:
            Unexpressed: Always then.
        """
        ends = {self.carriers[end.body] if end else "" for end in (a, b)}
        if len(ends) == 1:
            raise Unexpressed("its bodies have no relative motion")

    def coordinate(self, item: Item, *sockets: str) -> str:
        """The coordinate that an element names by its name or by a path to it.

        Raises:
            SceneError: It names none, or one that is not there.
        """
        path = socket(item, *sockets)
        name = path.rstrip("/").split("/")[-1]
        if name in self.idle_coordinates:
            raise Unexpressed(f"'{name}' moves nothing")
        if name not in self.joints and name not in self.fixed:
            known = ", ".join(sorted(self.joints))
            raise item.error(f"there is no coordinate '{path}'; there are {known}")
        return name

    def forces(self) -> Iterator[Item]:
        """The elements of the force set, and other components that are forces, which act."""
        for item in self.model.components("ForceSet", ending=FORCES):
            if item.flag("appliesForce", default=not item.flag("isDisabled")):
                yield item
