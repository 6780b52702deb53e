"""Dynamics of a tree of links in one choice of axes."""

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

from mbd_ros.compiled.symbols import articulated
from mbd_ros.compiled.symbols.composite import mass_matrix
from mbd_ros.compiled.symbols.coordinates import Entries
from mbd_ros.compiled.symbols.inertias import FREE
from mbd_ros.compiled.symbols.link_rotations import vector
from mbd_ros.compiled.symbols.links import Tree
from mbd_ros.compiled.symbols.moving_tree import Placed, in_own_axes, in_world_axes
from mbd_ros.compiled.symbols.tree_forces import joint_forces, needed

Place = Callable[[Tree, Sequence[Any]], Sequence[Placed]]
LONG = 24  # velocities from which an open chain has one form


class TreeDynamics:
    """Dynamics of all joints, without rows and loads.

    Args:
        tree: The links.
        q: Configuration, one SX scalar an entry.
        v: Velocity, the same.
        place: Gives where the links are, in axes of its choice.
    """

    def __init__(self, tree: Tree, q: Sequence[Any], v: Sequence[Any], place: Place) -> None:
        self._tree, self._q, self._v, self._place = tree, q, v, place

    @cached_property
    def _placed(self) -> Sequence[Placed]:
        return self._place(self._tree, self._q)

    @cached_property
    def mass(self) -> Entries:
        """The lower triangle of M."""
        return mass_matrix(self._tree, self._placed)

    def forces(self, a: Sequence[Any] | None = None) -> list[Any]:
        """M a + h but for what armature takes, SX scalars.

        Args:
            a: Accelerations, SX scalars; None for none.
        """
        on_links = needed(self._tree, self._placed, self._v, a, vector(-self._tree.gravity))
        return joint_forces(self._tree, self._placed, on_links)

    def needed(self, a: Sequence[Any]) -> list[Any]:
        """M a + h."""
        armature = [one for link in self._tree.links for one in _armature(link)]
        found = self.forces(a)
        for i, value in armature:
            found[i] = found[i] + value * a[i]
        return found

    def articulated(self, tau: Sequence[Any]) -> list[Any]:
        """Accelerations under joint forces, in a time linear in the links."""
        tree, placed = self._tree, self._placed
        on_links = needed(tree, placed, self._v, None, vector(-tree.gravity))
        return articulated.accelerations(tree, placed, on_links, tau)


def choices(
    tree: Tree, q: Sequence[Any], v: Sequence[Any], *, has_rows: bool
) -> list[TreeDynamics]:
    """The same dynamics in axes of the links and in those of the world, where that may pay.

    Args:
        tree: The links.
        q: Configuration, SX scalars.
        v: Velocity, SX scalars.
        has_rows: Whether rows of frames stand in axes of the world.
    """
    found = [TreeDynamics(tree, q, v, in_own_axes)]
    if all(link.kind != FREE for link in tree.links) and (has_rows or tree.nv <= LONG):
        found.append(TreeDynamics(tree, q, v, in_world_axes))
    return found


def _is_zero(value: Any) -> bool:
    return isinstance(value, float) and value == 0.0


def _armature(link: Any) -> list[tuple[int, Any]]:
    return [(link.v + i, one) for i, one in enumerate(link.armature) if not _is_zero(one)]
