"""Accelerations of a tree under joint forces, in the form of the fewest operations."""

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca

from mbd_ros.compiled.symbols import articulated
from mbd_ros.compiled.symbols.composite import mass_matrix
from mbd_ros.compiled.symbols.inertias import FREE
from mbd_ros.compiled.symbols.links import Tree
from mbd_ros.compiled.symbols.moving_tree import Placed, in_own_axes, in_world_axes
from mbd_ros.compiled.symbols.sparse_ldl import solved
from mbd_ros.compiled.symbols.tree_forces import joint_forces, needed
from mbd_ros.compiled.symbols.turns import vector

_LONG = 24  # velocities from which M and its factors are not tried

Place = Callable[[Tree, Any], list[Placed]]


def cheapest(
    tree: Tree, q: Sequence[Any], v: Sequence[Any], tau: Sequence[Any], inputs: Sequence[Any]
) -> Any:
    """Accelerations of all joints, shape (nv,), as one column.

    Args:
        tree: The links.
        q: Configuration, one SX scalar an entry.
        v: Velocity, the same.
        tau: Generalized forces, the same.
        inputs: Symbols that all of these are made of.
    """
    found = [ca.vertcat(*form(tree, place, q, v, tau)) for place, form in _forms(tree)]
    return min(found, key=lambda a: operations(inputs, [a]))


def operations(inputs: Sequence[Any], results: Sequence[Any]) -> int:
    """How many operations expressions take, common ones once."""
    return int(ca.Function("count", list(inputs), ca.cse(list(results))).n_instructions())


def _forms(tree: Tree) -> list[tuple[Place, Any]]:
    places: list[Place] = [in_own_axes]
    if all(link.kind != FREE for link in tree.links):
        places.append(in_world_axes)
    forms = [_articulated] if tree.nv > _LONG else [_composite, _articulated]
    return [(place, form) for place in places for form in forms]


def _articulated(tree: Tree, place: Place, q: Any, v: Any, tau: Any) -> list[Any]:
    placed = place(tree, q)
    on_links = needed(tree, placed, v, None, vector(-tree.gravity))
    return articulated.accelerations(tree, placed, on_links, tau)


def _composite(tree: Tree, place: Place, q: Any, v: Any, tau: Any) -> list[Any]:
    placed = place(tree, q)
    on_links = needed(tree, placed, v, None, vector(-tree.gravity))
    h = joint_forces(tree, placed, on_links)
    right = [force - bias for force, bias in zip(tau, h, strict=True)]
    return solved(mass_matrix(tree, placed), right, range(tree.nv - 1, -1, -1))
