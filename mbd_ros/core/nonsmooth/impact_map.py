"""Impacts: jumps of the velocity, solved for at once.

    M (v+ - v-) = J' p

Restitution is Poisson's for every impact. In its compression impulses p_c end the approach,

    p_c >= 0,   g'_c >= 0,   p_c g'_c = 0       at v_c = v- + M^-1 J' p_c

and in its expansion a row gives back at least its share e of them,

    p_e >= e p_c,   g'+ >= 0,   (p_e - e p_c) g'+ = 0       at v+ = v_c + M^-1 J' p_e

So the expansion leaves the least kinetic energy that impulses p_e >= e p_c can. p_e = p_c is one
of them and gives back what v- had: no impact gains energy, whatever the e of its rows. Friction
of contacts keeps Coulomb's law in both, with v_c and then with v+, without restitution. Beside it
an expansion may gain energy; then only the largest share of e p_c is given back that gains none,
and the impact says so. Bilateral rows and couplings hold in both: J v+ = 0, with impulses of any
sign. So a foot that stays on the ground strikes plastically, M (v+ - v-) = J' p with J v+ = 0.
Source: F. Pfeiffer, C. Glocker,
Multibody Dynamics with Unilateral Contacts, 1996, ch. 8.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.bounded_rows import PushImpulses
from mbd_ros.core.dynamics.mechanism import ImpulseResponse, Mechanism, RigidRows
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import Cone, ConstraintRows
from mbd_ros.core.state import Array, State

Slots = NDArray[np.intp]


class ImpactMap:
    """Solves for impacts of one system; has a `Data` of its own.

    Dry friction and limited drives are bounded forces and exert no impulse.

    Args:
        system: The system, under any tier; velocities here are those of all joints.
    """

    def __init__(self, system: System) -> None:
        nv, layout = int(system.model.nv), system.layout
        self._mechanism = Mechanism(system.robot, system.loads)
        self._rigid = RigidRows(self._mechanism, ConstraintRows(layout.rigid, nv))
        self._bilateral = self._rigid.constraints.slots
        self._rows = layout.rows
        pushing = layout.having(Kind.UNILATERAL, Kind.CONE)
        self._pushing = [(block, block.cones()) for block in pushing]
        self._restitution = np.zeros(len(layout.rows))
        for block in pushing:
            normals = slice(block.slots.start, block.slots.stop, 3 if block.cones() else 1)
            self._restitution[normals] = block.law.restitution
        self._nothing = np.zeros((0, nv)), np.zeros(0)

    def impact(self, x: State, touching: Sequence[int], *, expands: bool = True) -> Impact:
        """Return the velocity after an impact, and its impulses; none where nothing approaches.

        Args:
            x: State of all joints before it.
            touching: Slots of the one-sided rows that are closed, in the `layout` of the system;
                they may depend on one another. Slots of other rows are passed over.
            expands: Whether rows give back their share of the compression.

        Raises:
            SolveError: Nothing can keep a row from closing further; names it.
        """
        slots, J, rate, cones = self._touched(x, touching)
        M = np.array(self._mechanism.mass(x.q))
        hold, goal = self._nothing
        factor = None
        if len(self._bilateral):
            hold, goal = self._rigid.jacobian(x.t, x.q), -self._rigid.rate(x.t, x.q)
            factor = self._rigid.factorise(M, hold)
        response = ImpulseResponse(M, J, hold, factor)
        v, bilateral_impulse = response.constrain(x.v, goal)
        approach, speed = J.dot(v) + rate, max(float(v.dot(M).dot(v)), 0.0) ** 0.5
        e = self._restitution[slots] if expands else np.zeros(len(slots))
        impulse, share = self._impulses(slots, response, cones, e, approach, speed)
        bilateral_impulse = bilateral_impulse + response.bilateral(impulse)
        p = np.zeros(len(self._rows))
        p[slots], p[self._bilateral] = impulse, bilateral_impulse
        return Impact(x.v + response.free(impulse.dot(J) + bilateral_impulse.dot(hold)), p, share)

    def _impulses(
        self,
        slots: Slots,
        response: ImpulseResponse,
        cones: Sequence[Cone],
        e: Array,
        approach: Array,
        speed: float,
    ) -> tuple[Array, float]:
        """Impulses of compression and expansion together, one a touching row, and their share."""
        names = [self._rows[i].name for i in slots]
        if cones:
            from mbd_ros.core.nonsmooth.frictional_impacts import with_friction

            return with_friction(response, names, cones, e, approach, speed)
        G = response.G
        pushing = PushImpulses(G, response.loose, names)
        impulse = pushing.solve(approach, speed)
        if (restored := e * impulse).any():
            impulse = impulse + restored
            impulse += pushing.solve(approach + G.T.dot(G.dot(impulse)), speed)
        return impulse, 1.0

    def _touched(
        self, x: State, touching: Sequence[int]
    ) -> tuple[Slots, Array, Array, list[Cone]]:
        """Slots of rows that push, J and the part of g' without the velocity, and contacts."""
        wanted, k = set(touching), self._mechanism.k
        slots: list[int] = []
        J, rates = ([nothing] for nothing in self._nothing)
        cones: list[Cone] = []
        for block, contacts in self._pushing:
            here = [i for i in range(block.slots.start, block.slots.stop) if i in wanted]
            if contacts:  # a normal and its tangents are one contact
                touched = [cone for cone in contacts if not wanted.isdisjoint(_rows(cone))]
                here = [i for cone in touched for i in _rows(cone)]
                first = range(len(slots), len(slots) + len(here), 3)
                pairs = zip(touched, first, strict=True)
                cones += [cone._replace(slots=slice(i, i + 3)) for cone, i in pairs]
            if here:
                part, own = block.part, np.array(here) - block.slots.start
                k.refresh(x.q, x.v, part.reads)
                J.append(part.jacobian(k, x)[own])
                rates.append(part.rate(k, x)[own])
                slots += here
        return np.array(slots, dtype=np.intp), np.concatenate(J), np.concatenate(rates), cones


def _rows(cone: Cone) -> range:
    return range(cone.slots.start, cone.slots.stop)


class Impact(NamedTuple):
    """A jump of the velocity.

    Attributes:
        v: Velocity of all joints after it [rad/s or m/s], shape (nv,).
        p: Impulses, one a multiplier of the scene [N·s or N·m·s], shape (m,).
        share: Of the restitution of contacts that was given back: less than 1 where the whole
            would have gained energy.
    """

    v: Array
    p: Array
    share: float = 1.0
