"""C structures of methods, inputs and times, in the layout of `native/run.h`."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.contracts import type_name
from mbd_ros.core.loads.inputs import Pieces
from mbd_ros.core.state import Array
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.adams import adams_weights, powers, starter
from mbd_ros.methods.integration.runge_kutta import Tableau
from mbd_ros.methods.integration.stepping import Integrator

_ACCEPTED = "rk4, adams, dopri5, dop853, rattle, semi_implicit_euler with explicit damping"
_LONG, _DOUBLE = ctypes.c_long, ctypes.c_double
_LONGS, _DOUBLES = ctypes.c_void_p, ctypes.c_void_p


def method_options(method: Integrator, dt: float) -> CStructure:
    """Return the options of a method with steps of dt [s], or with dt as a first guess.

    Raises:
        ModelError: The method has no native form.
    """
    if not method.native:
        name = type_name(type(method))
        raise ModelError(f"integrator {name} is not compiled; accepted: {_ACCEPTED}")
    kind = Method[method.native.upper()]
    options, tables = OptionsOfC(method=kind, dt=dt), []
    options_of: Any = method
    if kind == Method.RUNGE_KUTTA:
        tables.append(tableau_of(options_of.tableau))
        tolerance = getattr(options_of, "tolerance", None)
        options.is_adaptive, options.tolerance = tolerance is not None, tolerance or 0.0
    elif kind == Method.ADAMS:
        tables += [tableau_of(starter(options_of.order)), adams_of(options_of.order, dt)]
        options.adams = tables[1].value
    elif kind == Method.RATTLE:
        options.closed = options_of.tolerance
    if tables:
        options.tableau = tables[0].value
    return CStructure(options, tuple(array for table in tables for array in table.arrays))


class CStructure(NamedTuple):
    """A C structure and the arrays that it points to, which must live as long."""

    value: Any
    arrays: tuple[NDArray[Any], ...]


class Method(IntEnum):
    """Methods with a native form."""

    RUNGE_KUTTA = 0
    ADAMS = 1
    SEMI_IMPLICIT_EULER = 2
    RATTLE = 3


class WeightsOfC(ctypes.Structure):
    """Rows of weights without their zeros."""

    _fields_ = [("begin", _LONGS), ("column", _LONGS), ("value", _DOUBLES)]


class TableauOfC(ctypes.Structure):
    """An explicit Runge-Kutta method."""

    _fields_ = [
        *((name, _LONG) for name in ("stages", "errors", "weighed", "terms", "all")),
        ("power", _DOUBLE),
        ("c", _DOUBLES),
        *((name, WeightsOfC) for name in ("a", "error", "dense")),
    ]


class AdamsOfC(ctypes.Structure):
    """Weights of an Adams method."""

    _fields_ = [
        *((name, _LONG) for name in ("order", "needed")),
        *((n, WeightsOfC) for n in ("position", "velocity", "positions", "velocities")),
    ]


class OptionsOfC(ctypes.Structure):
    """Constants of a run."""

    _fields_ = [
        *((n, _LONG) for n in ("method", "is_adaptive", "smooth")),
        ("pieces", ctypes.c_void_p),
        *((n, _DOUBLE) for n in ("dt", "tolerance", "closed", "least_health")),
        *((n, _DOUBLES) for n in ("lower", "upper", "sizes", "p")),
        ("tableau", TableauOfC),
        ("adams", AdamsOfC),
    ]


def tableau_of(method: Tableau) -> CStructure:
    """Return a Runge-Kutta method as a C structure."""
    c = method.a.sum(axis=1)
    tables = [weights(rows) for rows in (method.a, method.errors, method.terms)]
    value = TableauOfC(
        *(method.stages, len(method.errors), method.errors.shape[1]),
        *(len(method.terms), len(method.a), 1.0 / (method.error_order + 1), c.ctypes.data),
        *(table.value for table in tables),
    )
    return CStructure(value, (c, *(array for table in tables for array in table.arrays)))


def weights(rows: Sequence[Array] | Array) -> CStructure:
    """Return rows of weights, shape (m, n), as a C structure."""
    table = np.atleast_2d(np.asarray(rows, dtype=np.float64))
    places = [np.flatnonzero(row) for row in table]
    begin = np.cumsum([0, *map(len, places)]).astype(np.int64)
    column = np.concatenate([np.zeros(0, dtype=np.int64), *places]).astype(np.int64)
    chosen = [row[at] for row, at in zip(table, places, strict=True)]
    value = np.concatenate([np.zeros(0), *chosen])
    arrays = begin, column, value
    return CStructure(WeightsOfC(*(array.ctypes.data for array in arrays)), arrays)


def adams_of(order: int, dt: float) -> CStructure:
    """Return an Adams method with steps of dt [s] as a C structure."""
    once, twice = powers(-np.arange(order, dtype=np.float64))
    position, velocity = adams_weights(order, dt)
    tables = [weights(rows) for rows in (position, velocity, twice.T, once.T)]
    value = AdamsOfC(order, order - 1, *(table.value for table in tables))
    return CStructure(value, tuple(array for table in tables for array in table.arrays))


class Status(IntEnum):
    """Reason why a native run returned."""

    DONE = 0
    PAUSED = 1
    NOT_FINITE = 2
    ILL_CONDITIONED = 3
    GUARD = 4
    TOO_SHORT = 5
    OPEN = 6
    NO_INPUTS = 7
    RENAMED = 8


class Field(IntEnum):
    """Fields of a run that Python reads or writes."""

    SIZE = 0
    MEMORY = 1
    T = 2
    Q = 3
    W = 4
    T0 = 5
    Q0 = 6
    W0 = 7
    SAMPLE = 8
    IS_WITHIN = 9
    STEPS = 10
    LENGTH = 11
    INTERVAL = 12
    HEALTH = 13
    EVALUATIONS = 14
    LEFT = 15
    U = 16
    ROW = 17


class PiecesOfC(ctypes.Structure):
    """Inputs that change within steps."""

    _fields_ = [
        *((name, _LONG) for name in ("at", "width", "count", "powers")),
        *((name, _DOUBLES) for name in ("times", "coefficients", "jumps")),
    ]


class TimesOfC(ctypes.Structure):
    """Times of samples."""

    _fields_ = [
        *((n, _DOUBLE) for n in ("origin", "dt", "last", "resolution", "slack")),
        *((n, _LONG) for n in ("end", "ends_at_samples")),
    ]


class InputsOfC(ctypes.Structure):
    """Piecewise constant inputs, one row for each interval."""

    _fields_ = [("count", _LONG), ("until", _DOUBLES), ("values", _DOUBLES)]


def pieces_of(sources: Sequence[tuple[slice, Pieces]]) -> CStructure:
    """Return the pieces of smooth sources, with their slots in u, as C structures."""
    arrays: list[NDArray[Any]] = []
    structures = (PiecesOfC * len(sources))()
    for structure, (at, pieces) in zip(structures, sources, strict=True):
        times, rows = (np.ascontiguousarray(table, np.float64) for table in pieces[:2])
        jumps = np.ascontiguousarray(pieces.jumps, np.int64)
        count, powers, width = rows.shape
        structure.at = at.start
        structure.width = width
        structure.count = count
        structure.powers = powers
        structure.times = times.ctypes.data
        structure.coefficients = rows.ctypes.data
        structure.jumps = jumps.ctypes.data
        arrays += [times, rows, jumps]
    return CStructure(structures, tuple(arrays))


def internal_bounds(system: Any) -> Array:
    """Return lower and upper bounds of internal states, and their error scale, shape (3, nz)."""
    internals = system.internals
    widths = np.minimum(internals.upper - internals.lower, 1.0)
    return np.array([internals.lower, internals.upper, widths]).reshape(3, -1)
