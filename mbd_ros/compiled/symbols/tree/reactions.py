"""Joint reactions as expressions: the backward sweep of Newton and Euler over all links.

The wrench of a joint on its child is what the links beyond need to move, less what else acts on
them: forces on bodies, multipliers of constraints and, where they are asked for, pulls of muscles.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from mbd_ros.compiled.symbols.equations import Equations
from mbd_ros.compiled.symbols.scalar import column, number, numbers, plain, scalars
from mbd_ros.compiled.symbols.tree import link_rotations as turns
from mbd_ros.compiled.symbols.tree.link_rotations import NO_VECTOR, Vector
from mbd_ros.compiled.symbols.tree.links import with_own_inertias
from mbd_ros.compiled.symbols.tree.moving_tree import WORLD, Placed, in_own_axes
from mbd_ros.compiled.symbols.tree.newton_euler import Needed, carried, needed
from mbd_ros.compiled.symbols.untraceable import Untraceable, tracing
from mbd_ros.core.contracts import Wrench
from mbd_ros.core.kinematics.paths.polynomial_path import PolynomialPath
from mbd_ros.methods.inverse_dynamics.reactions import JointLink


class SymbolicReactions:
    """Wrenches of parents on children; they depend on accelerations and multipliers, too.

    Args:
        equations: Of a system in one mode.
    """

    def __init__(self, equations: Equations) -> None:
        self._e = equations
        model = equations.system.model
        self._rows = {int(joint.idx_v): i for i, joint in enumerate(model.joints) if i}

    @cached_property
    def felt(self) -> Any:
        """Wrenches in joints where muscles act in joints, as `Now.reactions`, shape (n, 6).

        Raises:
            Untraceable: Names a part whose forces have no symbols, or no points.
        """
        sums = self._summed([*self._of_rows, *self._of_loads(muscles=False)])
        places = [self._rows[joint.v] for joint in self._e.system.robot.joints]
        every = [self._in_joint(sums, place) for place in places]
        return np.array(every, dtype=object).reshape(-1, 6)

    def load(self, joined: JointLink) -> list[Any]:
        """Six numbers of the load of a joint in axes of the link, where muscles pull on bodies.

        Raises:
            Untraceable: As `felt`.
        """
        robot = self._e.system.robot
        wrench = self._in_joint(self._passed_on, joined.joint)
        to_link = robot.places.points[joined.child.number].at.rotation.T
        return [*to_link.dot(wrench[:3]), *to_link.dot(wrench[3:])]

    @cached_property
    def _passed_on(self) -> list[Needed]:
        loads = [*self._of_loads(muscles=False), *self._of_loads(muscles=True)]
        return self._summed([*self._of_rows, *loads])

    @cached_property
    def _of_rows(self) -> list[Wrench]:
        e, wrenches, first = self._e, list[Wrench](), 0
        lam = numbers(e.symbols["l"])
        for block in e.blocks(e.system.bilateral.constraints.blocks):
            block_lam = lam[first : first + len(block.rows)]
            first += len(block.rows)
            with tracing(block.part):
                wrenches += block.part.wrenches(e.k, e.x, block_lam)
        return wrenches

    def _of_loads(self, *, muscles: bool) -> list[Wrench]:
        """Return the wrenches of actuators on bodies, or those of all other loads."""
        e, wrenches = self._e, list[Wrench]()
        count = len(e.system.loads.actuators)
        for part in e.loads[:count] if muscles else e.loads[count:]:
            with tracing(part):
                if isinstance(getattr(part, "path", None), PolynomialPath):
                    raise Untraceable(
                        "its path is a polynomial of joints, so nobody knows where it pulls on "
                        "links; accepted for loads of joints: paths of points, without wraps"
                    )
                wrenches += part.wrenches(e.k, e.x, e.u)
        return wrenches

    @cached_property
    def _moving(self) -> tuple[list[Placed], list[Needed]]:
        """All links in their own axes, and what their motion needs."""
        e = self._e
        tree, falls = with_own_inertias(e.tree, e.system.model), -e.tree.gravity
        q, v = (scalars(column(value)) for value in (e.coordinates.q, e.coordinates.v))
        a = [ca.SX(value) for value in e.coordinates.lifted(scalars(e.symbols["a"]))]
        placed = in_own_axes(tree, q)
        return placed, needed(tree, placed, v, a, turns.vector(falls))

    def _summed(self, wrenches: Sequence[Wrench]) -> list[Needed]:
        """Return the wrench on each link from all links beyond it, less some wrenches."""
        placed, on_links = self._moving
        sums = list(on_links)
        for wrench in wrenches:
            link, opposite = self._on_link(wrench)
            if link != WORLD:
                force, torque = sums[link]
                sums[link] = Needed(
                    turns.minus(force, opposite.force), turns.minus(torque, opposite.torque)
                )
        for i in range(len(placed) - 1, -1, -1):
            above = placed[i].link.parent
            if above >= 0:
                sums[above] = Needed(*map(turns.plus, sums[above], carried(placed[i], *sums[i])))
        return sums

    def _on_link(self, wrench: Wrench) -> tuple[int, Needed]:
        """The link that a wrench acts on, and the wrench about its origin, in its axes."""
        robot, k = self._e.system.robot, self._e.k
        link = robot.places.points[robot.carrier(wrench.frame).number].joint - 1
        if link == WORLD:
            return WORLD, Needed(NO_VECTOR, NO_VECTOR)
        force, torque, point = (
            _vector(value) for value in (wrench.force, wrench.torque, wrench.point)
        )
        arm = turns.minus(point, k.frames.from_link(WORLD, link, NO_VECTOR))
        about = turns.plus(torque, turns.cross(arm, force))
        back = turns.transposed(k.frames.axes(link))
        return link, Needed(turns.through(back, force), turns.through(back, about))

    def _in_joint(self, sums: Sequence[Needed], joint: int) -> Any:
        """The wrench of a joint of the model about its origin, in its axes, shape (6,)."""
        force, torque = sums[joint - 1]
        seat = self._e.tree.links[joint - 1].seat
        R = turns.matrix(seat.rotation)
        force, torque = turns.through(R, force), turns.through(R, torque)
        torque = turns.plus(torque, turns.cross(turns.vector(seat.translation), force))
        wrenches = np.empty(6, dtype=object)
        wrenches[:] = [number(ca.SX(value)) for value in (*force, *torque)]
        return wrenches


def _vector(values: Any) -> Vector:
    x, y, z = (ca.SX(plain(value)) for value in np.asarray(values, dtype=object).reshape(3))
    return x, y, z
