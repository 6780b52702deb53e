"""What a joint takes besides the inertias of bodies: friction, offset, rotor inertia.

    tau = viscous v + (coulomb + load |g| + stribeck / (1 + (v / v_s)^2)) s + offset + inertia a
    s = tanh(v / smoothing)

with g the torque that holds the given robot still. It is linear in all but smoothing and v_s, of
which a few multiples of the usual velocity of the joint are tried.

Source: D. P. Hess, A. Soom, J. Tribology 112, 1990, 147 (this curve of Stribeck); B.
Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30, 1994, 1083 (a survey).
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array

_SMOOTHINGS = (0.005, 0.02, 0.05, 0.1, 0.2, 0.4)  # of the usual velocity
_STRIBECKS = (0.1, 0.3, 0.6)  # the same
TERMS = ("viscous", "coulomb", "offset", "load", "stribeck", "inertia")
OF_SEVERAL = ("viscous", "coulomb", "offset", "stribeck")  # of a motor that several joints turn


class Column(NamedTuple):
    """One column of a joint.

    Attributes:
        term: Of `TERMS`.
        smoothing: Velocity of it [rad/s or m/s]; 0 where the term has none.
        stribeck: v_s [rad/s or m/s]; 0 where the term has none.
    """

    term: str
    smoothing: float = 0.0
    stribeck: float = 0.0


def candidates(usual: float) -> tuple[Column, ...]:
    """All columns that are tried of a joint.

    Args:
        usual: Root mean square of its velocity [rad/s or m/s].
    """
    smooth = [factor * usual for factor in _SMOOTHINGS]
    curves = [(s, factor * usual) for s in smooth[:3] for factor in _STRIBECKS]
    return (
        *(Column(term) for term in ("viscous", "offset", "inertia")),
        *(Column("coulomb", s) for s in smooth),
        *(Column("load", s) for s in smooth),
        *(Column("stribeck", s, v) for s, v in curves),
    )


def columns_of(chosen: Sequence[Column], v: Array, a: Array, weight: Array) -> Array:
    """Values of columns, shape (n, len(chosen)).

    Args:
        chosen: The columns.
        v: Velocities of the joint [rad/s or m/s], shape (n,).
        a: Its accelerations, shape (n,).
        weight: Torques that hold it still, shape (n,).
    """
    found = np.empty((len(v), len(chosen)))
    for k, (term, smoothing, stribeck) in enumerate(chosen):
        plain = {"viscous": v, "inertia": a, "offset": np.ones_like(v)}
        if term in plain:
            found[:, k] = plain[term]
            continue
        side = np.tanh(v / smoothing)
        if term == "load":
            side *= np.abs(weight)
        if term == "stribeck":
            side /= 1.0 + np.square(v / stribeck)
        found[:, k] = side
    return found


def choices(columns: Sequence[Column], allowed: Iterable[str]) -> list[tuple[int, ...]]:
    """Sets of columns that make sense together, by place; the empty one first.

    Args:
        columns: Those of `candidates`.
        allowed: Of `TERMS`.
    """
    terms = set(allowed)
    at: dict[str, list[int]] = {term: [] for term in TERMS}
    for i, column in enumerate(columns):
        if column.term in terms:
            at[column.term].append(i)
    dry: list[tuple[int, ...]] = [()]
    for c in at["coulomb"]:
        same = columns[c].smoothing
        loads = [i for i in at["load"] if columns[i].smoothing == same]
        curves = [i for i in at["stribeck"] if columns[i].smoothing == same]
        dry += [(c,), *((c, i) for i in loads), *((c, i) for i in curves)]
    dry += [(i,) for i in at["load"]]
    found = []
    for some in dry:
        for viscous in ((), *((i,) for i in at["viscous"])):
            for offset in ((), *((i,) for i in at["offset"])):
                plain = (*some, *viscous, *offset)
                found += [plain, *((*plain, i) for i in at["inertia"])]
    return found
