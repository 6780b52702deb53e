"""Which combinations of inertial numbers a motion can show, and how they are written.

Columns of a regressor W that others give (W2 = W1 B) cannot be told from these. The base
parameters are b = p1 + B p2: as many as W has rank.

Source: M. Gautier, J. Robotic Systems 8, 1991, 485 (by QR); W. Khalil, E. Dombre, Modeling,
Identification and Control of Robots, 2002, section 9.4.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.model.inertial_parameters import COUNT, PLACES
from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import SINGULAR

# In a body: what others give comes last, so that masses join the moments that they add to.
_ORDER = tuple(
    PLACES.index(place)
    for place in ("Ixx", "Ixy", "Ixz", "Iyy", "Iyz", "Izz", "mcx", "mcy", "mcz", "mass")
)
_ROUNDED = 1.0e-9  # of the largest factor in a combination: what rounding leaves of none


def base_parameters(rows: Array) -> BaseParameters:
    """Base parameters that rows of a regressor show.

    Args:
        rows: W, or an upper triangle R of it, shape (k, p), p a multiple of ten or not.
    """
    p = rows.shape[1]
    scale = np.linalg.norm(rows, axis=0)
    seen = np.flatnonzero(scale > SINGULAR * scale.max(initial=0.0))
    order = np.array([c for c in _columns(p) if c in set(seen.tolist())], dtype=np.intp)
    chosen = _independent(rows[:, order] / scale[order], order)
    given = np.setdiff1d(seen, chosen)
    T = np.zeros((len(chosen), p))
    T[np.arange(len(chosen)), chosen] = 1.0
    if len(given):
        left = rows[:, chosen] / scale[chosen]
        B = np.linalg.lstsq(left, rows[:, given] / scale[given], rcond=None)[0]
        B[np.abs(B) < _ROUNDED * np.abs(B).max(axis=0)] = 0.0
        T[:, given] = B * scale[given] / scale[chosen][:, None]
    T[np.abs(T) < _ROUNDED * np.abs(T).max(initial=1.0)] = 0.0
    return BaseParameters(chosen, T, np.setdiff1d(np.arange(p), seen))


class BaseParameters(NamedTuple):
    """Base parameters b = T p of inertial numbers p.

    Attributes:
        chosen: Numbers that stand for the base parameters: their columns of W are independent.
        matrix: T, shape (r, p), with ones at `chosen`.
        unseen: Numbers that no state shows, neither alone nor with others.
    """

    chosen: NDArray[np.intp]
    matrix: Array
    unseen: NDArray[np.intp]

    def values(self, parameters: Array) -> Array:
        """Base parameters of inertial numbers, shape (r,)."""
        values: Array = self.matrix @ parameters
        return values


def _columns(p: int) -> list[int]:
    """All columns, bodies from the base outwards, in a body as `_ORDER` says."""
    return [COUNT * body + place for body in range(p // COUNT) for place in _ORDER]


def _independent(columns: Array, names: NDArray[np.intp]) -> NDArray[np.intp]:
    """Columns that those before them do not give; columns have length one."""
    basis, chosen = np.zeros((len(columns), 0)), []
    for name, column in zip(names, columns.T, strict=True):
        left = column - basis @ (basis.T @ column)
        left -= basis @ (basis.T @ left)  # twice is enough
        size = np.linalg.norm(left)
        if size > SINGULAR:
            basis = np.column_stack([basis, left / size])
            chosen.append(int(name))
    return np.array(sorted(chosen), dtype=np.intp)


def expressions(base: BaseParameters, bodies: Sequence[str]) -> list[str]:
    """Base parameters for people: moments about mass centres, `shank.Izz + shank.mass (..)`.

    Args:
        base: The base parameters.
        bodies: Names, one for every ten numbers.
    """
    texts = []
    for row, first in zip(base.matrix, base.chosen, strict=True):
        terms = [int(first), *(int(i) for i in np.flatnonzero(row) if i != first)]
        text = " ".join(_term(float(row[i]), i, bodies) for i in terms)
        texts.append(text.removeprefix("+ "))
    return texts


def _term(factor: float, number: int, bodies: Sequence[str]) -> str:
    sign, size = "-" if factor < 0 else "+", abs(factor)
    text = f"{_symbol(PLACES[number % COUNT], bodies[number // COUNT])}"
    is_one = abs(size - 1.0) < _ROUNDED
    if (" + " in text or " - " in text) and not (is_one and factor > 0):
        text = f"({text})"
    if is_one:
        return f"{sign} {text}"
    return f"{sign} {size:.6g} {text}"


def _symbol(place: str, body: str) -> str:
    """A number about the joint in those of the mass centre."""
    if place.startswith("mc"):
        return f"{body}.mass {body}.c{place[-1]}"
    if not place.startswith("I"):
        return f"{body}.{place}"
    i, j = place[1], place[2]
    if i != j:
        return f"{body}.{place} - {body}.mass {body}.c{i} {body}.c{j}"
    others = [axis for axis in "xyz" if axis != i]
    return f"{body}.{place} + {body}.mass ({body}.c{others[0]}^2 + {body}.c{others[1]}^2)"


def parameter_name(number: int, bodies: Sequence[str]) -> str:
    """Name of a number, such as `shank.Izz`; moments are about the joint."""
    return f"{bodies[number // COUNT]}.{PLACES[number % COUNT]}"
