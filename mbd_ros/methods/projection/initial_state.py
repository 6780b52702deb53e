"""Initial state of a motion: assembled, and without bodies that overlap at contacts.

Overlapping bodies are an error, or are separated by the smallest displacement d in the mass
metric,

    min |d|_M   subject to   g + J (d - d_k) >= 0 (gaps),   J_b (d - d_k) = 0 (bilateral rows)

which is solved repeatedly, linearised at the last displacement d_k, since gaps are nonlinear.
Source: J. J. Moreau, Quadratic programming in mechanics: dynamics of one-sided constraints,
SIAM J. Control 4, 1966.
"""

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.complementarity.bounded_rows import PushImpulses
from mbd_ros.core.dynamics.mass import check_mass
from mbd_ros.core.dynamics.mechanism import ImpulseResponse, Mechanism, RigidRows
from mbd_ros.core.dynamics.system import System
from mbd_ros.core.kinematics.kinematics import Kinematics, Reads
from mbd_ros.core.rows.constraint import Kind
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowBlock
from mbd_ros.core.state import Array, State
from mbd_ros.errors import SolveError
from mbd_ros.methods.projection.assembly import assemble

_ROUNDING = 1.0e-6  # accepted overlap of a start in decimal digits, relative to the size of a body
_SEPARATED = 1.0e-12  # accepted overlap after separation, relative to the size of a body
_NEAR = 10.0  # gaps up to this multiple of the deepest overlap take part
_PLACED = 1.0e-14  # rounding of a position, relative to the largest coordinate
_CONVERGED = 1.0e-9  # last displacement, relative to the size of a body
_MAX_ITERATIONS = 100
_LONGEST = 0.5  # largest displacement of an iteration [rad or m]
_LISTED = 4  # features in an error message


def consistent_start(system: System, x: State) -> State:
    """Return the nearest consistent state of the integrated coordinates.

    Args:
        x: State of all joints.

    Raises:
        SolveError: The mechanism cannot be assembled near x, its mass matrix is singular, or
            bodies of contacts overlap.
    """
    y = system.reduce(x)
    check_mass(system, y.q)
    if system.bilateral.rows:
        assembled = assemble(system, y)
        if assembled is not y:
            check_mass(system, assembled.q)
        y = assembled
    return resolve_overlaps(system, y) if system.layout.cones else y


def resolve_overlaps(system: System, y: State) -> State:
    """Return a state in which no bodies of rigid contacts overlap.

    Args:
        y: State of the integrated coordinates, on the bilateral rows.

    Raises:
        SolveError: Bodies overlap and their contact does not have `assemble: true`, or they cannot
            be separated; the message names contact, bodies, features and depth.
    """
    from mbd_ros.core.geometry.contact_pair import (
        distance_to_mass,
    )  # only where there are contacts

    blocks = system.layout.having(Kind.CONE)
    parts = [(block, block.part) for block in blocks if block.part.pair is not None]
    k, x = Kinematics(system.robot), system.expand(y)
    k.refresh(x.q, x.v, Reads.POSITION)
    must_separate, sizes = False, list[float]()
    for block, part in parts:
        gaps = block.part.residual(k, x)[::3]
        if gaps.min() >= 0.0:
            continue
        size = distance_to_mass(system.robot, part.pair)
        if getattr(part, "assemble", False):
            sizes.append(size)
            must_separate = must_separate or bool(gaps.min() < -_SEPARATED * size)
        elif gaps.min() < -_ROUNDING * size:
            raise SolveError(
                f"{_describe_overlap(block, gaps)}; move one of them, or set assemble: true there"
            )
    return _separate(system, y, min(sizes)) if must_separate else y


def _separate(system: System, y: State, size: float) -> State:
    """Separate overlapping bodies by the smallest displacement in the mass metric."""
    mechanism, layout = Mechanism(system.robot, system.loads), system.layout
    nv = int(system.model.nv)
    rigid = RigidRows(mechanism, ConstraintRows(layout.rigid, nv, (0.0, 0.0)))
    blocks = layout.having(Kind.CONE, Kind.UNILATERAL)
    rows = ConstraintRows(blocks, nv)
    every = np.concatenate([_gaps(block) for block in blocks])
    names = [rows.rows[i].name for i in np.flatnonzero(every)]
    pushed = np.zeros(len(names), dtype=np.bool_)
    first, slack = y, _PLACED * float(np.abs(y.q).max())
    for _ in range(_MAX_ITERATIONS):
        y = assemble(system, y)
        displacement = system.chart.difference(first.q, y.q)
        x = system.expand(y._replace(v=displacement))
        mechanism.k.refresh(x.q, x.v, Reads.JACOBIAN)
        gap = rows.residual(mechanism.k, x)[every]
        near = pushed | (gap <= max(-_NEAR * float(gap.min()), _ROUNDING * size))
        J = rows.jacobian(mechanism.k, x)[every][near]
        M = np.array(mechanism.mass(x.q))
        hold = rigid.jacobian(x.t, x.q) if rigid.rows else np.zeros((0, nv))
        response = ImpulseResponse(M, J, hold, rigid.factorise(M, hold) if rigid.rows else None)
        least, _ = response.constrain(np.zeros(nv), hold.dot(x.v))
        left = gap[near] + J.dot(least - x.v)
        rates = PushImpulses(response.G, response.loose, np.array(names)[near].tolist())
        push = rates.solve(left, 0.0)
        pushed[near] = push > 0.0
        step = system.integrated(least + response.X.dot(push)) - displacement
        longest = float(np.abs(step).max())
        if gap.min() >= -_SEPARATED * size - slack and longest <= _CONVERGED * size + slack:
            return y._replace(v=first.v)
        step *= _LONGEST / max(longest, _LONGEST)
        y = y._replace(q=system.chart.integrate(first.q, displacement + step))
    raise SolveError(
        f"{names[int(gap.argmin())]} overlaps by {-gap.min():.3g} m at the start and cannot be "
        "separated; change the initial positions"
    )


def _gaps(block: RowBlock) -> NDArray[np.bool_]:
    """Return which rows of a block are gaps."""
    is_gap = np.full(len(block.rows), block.law.kind is Kind.UNILATERAL)
    is_gap[::3] = True
    return is_gap


def _describe_overlap(block: RowBlock, gaps: Array) -> str:
    pair = block.part.pair
    names = [pair.features[i] for i in np.argsort(gaps) if gaps[i] < 0.0]
    a, b = pair.between
    more = f" and {len(names) - _LISTED} more" if len(names) > _LISTED else ""
    return (
        f"contact {block.part.name}: {a.frame} and {b.frame} overlap by {-gaps.min():.3g} m at "
        f"the start, at {', '.join(names[:_LISTED])}{more}"
    )
