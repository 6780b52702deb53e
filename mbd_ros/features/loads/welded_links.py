"""Links that fixed joints tie to one rigid body, and the joints that lead away from them."""

from collections.abc import Collection, Iterator
from typing import NamedTuple

from mbd_ros.core.model.far_base import root_link
from mbd_ros.core.model.model_source import Recipe
from mbd_ros.core.model.robot import WORLD, Robot
from mbd_ros.core.model.urdf import parse_urdf
from mbd_ros.core.model.urdf_reading import link_name
from mbd_ros.errors import ModelError

RESIDUAL = "residual"  # what nothing carries of a free base


class Edge(NamedTuple):
    """A joint between two links.

    Attributes:
        name: Of the joint; `world` where a link stands still, `residual` where it moves freely.
        joint: Its index in the model, 0 where it does not move.
        parent: Index in the model of the frame of the link before it, 0 for the world.
        child: The same of the link behind it.
    """

    name: str
    joint: int
    parent: int
    child: int


class TiedLinks:
    """Links of a robot as a tree of joints, those that never move among them.

    Args:
        robot: The robot.

    Attributes:
        edges: Joint that leads to a link, by the index of the frame of the link in the model.
    """

    def __init__(self, robot: Robot) -> None:
        self._frames = robot.model.frames
        by_v = {joint.v: joint.name for joint in robot.joints}
        names = {i: by_v.get(int(j.idx_v), RESIDUAL) for i, j in enumerate(robot.model.joints)}
        self.edges: dict[int, Edge] = {}
        for recipe in robot.recipes:
            for name, parent, child in _joints(recipe):
                above = robot.frame(parent) if parent else 0
                below = robot.frame(child)
                joint = int(self._frames[below].parentJoint)
                if joint == int(self._frames[above].parentJoint):
                    joint = 0
                called = names[joint] if joint else recipe.scoped(name) if parent else WORLD
                self.edges[below] = Edge(called, joint, above, below)

    def link_of(self, frame: int) -> int:
        """Index of the frame of the link that carries a frame, 0 for the world."""
        while frame not in self.edges and frame:
            frame = int(self._frames[frame].parentFrame)
        return frame

    def tied_to(self, link: int, cuts: Collection[str]) -> list[int]:
        """The links that fixed joints tie to a link, itself the first of them.

        Args:
            link: Index of its frame.
            cuts: Names of fixed joints that tie nothing.
        """
        ties = [
            (edge.parent, edge.child)
            for edge in self.edges.values()
            if not edge.joint and edge.parent and edge.name not in cuts
        ]
        tied = [link]
        for one in tied:  # grows while it is gone through
            beside = [b if a == one else a for a, b in ties if one in (a, b)]
            tied += [other for other in beside if other not in tied]
        return tied

    def behind(self, link: int) -> set[int]:
        """The links that fixed joints tie behind a link, itself included."""
        found = [link]
        for one in found:  # grows while it is gone through
            found += [c for c, e in self.edges.items() if not e.joint and e.parent == one]
        return set(found)

    def around(self, links: Collection[int]) -> list[Edge]:
        """The joints between some links and others, that which leads to them first."""
        inside = [edge for child, edge in self.edges.items() if child in links]
        leading = [edge for edge in inside if edge.parent not in links]
        outside = [
            edge
            for child, edge in self.edges.items()
            if edge.parent in links and child not in links
        ]
        return [*leading, *outside]

    def check_cuts(self, cuts: Collection[str], links: Collection[int]) -> None:
        """Refuse names that are no joints of a body.

        Raises:
            ModelError: Names the joint and those that there are.
        """
        known = [
            edge.name
            for child, edge in self.edges.items()
            if (child in links or edge.parent in links) and edge.name not in (WORLD, RESIDUAL)
        ]
        for name in cuts:
            if name not in known:
                there = ", ".join(known) or "none"
                raise ModelError(f"joint '{name}' is none of this body; its joints are {there}")


def _joints(recipe: Recipe) -> Iterator[tuple[str, str, str]]:
    """Every joint as described, the link before it and that behind it; first the root by itself.

    The frames of a Pinocchio model do not tell what a locked joint joined.
    """
    tree = parse_urdf(recipe.text, recipe.source)
    root = root_link(tree)

    def called(link: str) -> str:
        return recipe.name if link == root and recipe.name else recipe.scoped(link)

    yield "", "", called(root)
    for joint in tree.findall("joint"):
        parent, child = (called(link_name(joint, end)) for end in ("parent", "child"))
        yield joint.get("name", ""), parent, child
