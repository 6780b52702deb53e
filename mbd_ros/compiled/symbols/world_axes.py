"""Velocities of free bodies in the axes of the world, in symbols; see `core.dynamics.world_axes`.

Where contacts of free bodies are found, runs integrate these; all else is in axes of the bodies.
"""

from collections.abc import Iterator, Sequence
from typing import Any

from mbd_ros.compiled.symbols import link_rotations as turns
from mbd_ros.compiled.symbols.curved import CurvedChart, turn_rate, turned
from mbd_ros.compiled.symbols.link_rotations import Vector, cross, minus, plus, through, transposed
from mbd_ros.compiled.symbols.moving_tree import rotation_of


class WorldChart(CurvedChart):
    """Configurations of which free bodies move along straight lines and turn, in world axes."""

    def _moved(self, pose: list[Any], step: list[Any]) -> list[Any]:
        place = plus(tuple(pose[:3]), tuple(step[:3]))
        return [*place, *turned(pose[3:], tuple(step[3:]), in_world=True)]

    def _rate(self, step: list[Any], v: list[Any]) -> list[Any]:
        return [*v[:3], *turn_rate(tuple(step[3:]), tuple(v[3:]))]


class WorldAxes:
    """From axes of the bodies to those of the world, and back.

    Args:
        model: Pinocchio model whose joints have the coordinates that are integrated.
        q: Configuration of these, SX scalars.
    """

    def __init__(self, model: Any, q: Sequence[Any]) -> None:
        bases = [joint for joint in model.joints if joint.nv == 6]
        self._axes = {
            int(joint.idx_v): rotation_of(q[joint.idx_q + 3 : joint.idx_q + 7]) for joint in bases
        }

    def in_world(self, v: Sequence[Any]) -> list[Any]:
        """Velocities, or small motions, in the axes of the world, SX scalars."""
        found = list(v)
        for at, R in self._vectors():
            found[at : at + 3] = through(R, tuple(v[at : at + 3]))
        return found

    def in_own_axes(self, v: Sequence[Any]) -> list[Any]:
        """The reverse of `in_world`."""
        found = list(v)
        for at, R in self._vectors():
            found[at : at + 3] = through(transposed(R), tuple(v[at : at + 3]))
        return found

    def rate(self, a: Sequence[Any], v: Sequence[Any]) -> list[Any]:
        """Rates of velocities in the axes of the world, SX scalars.

        Args:
            a: Accelerations in the axes of the bodies.
            v: Velocities in those of the world.
        """
        found = self.in_world(a)
        for at in self._axes:
            along: Vector = tuple(v[at : at + 3])
            turning = cross(tuple(v[at + 3 : at + 6]), along)
            found[at : at + 3] = plus(tuple(found[at : at + 3]), turning)
        return found

    def slowing(self, a: Sequence[Any], v: Sequence[Any]) -> list[Any]:
        """The reverse of `rate`."""
        found = list(a)
        for at in self._axes:
            turning = cross(tuple(v[at + 3 : at + 6]), tuple(v[at : at + 3]))
            found[at : at + 3] = minus(tuple(a[at : at + 3]), turning)
        return self.in_own_axes(found)

    def _vectors(self) -> Iterator[tuple[int, turns.Matrix]]:
        for at, R in self._axes.items():
            yield at, R
            yield at + 3, R
