"""Paths that native code searches before it evaluates a function: those that wrap."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import casadi as ca

from mbd_ros.compiled.symbols.path_tables import SURFACES
from mbd_ros.compiled.symbols.scalar import numbers, plain
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.kinematics.paths.wrapped_path import Taut


class SearchedPath(NamedTuple):
    """A path that wraps.

    Attributes:
        symbols: Its length, its change with every point and with every surface, a column.
        places: Its points, then rotation row by row and origin of every surface, common axes.
    """

    path: Any
    symbols: Any
    places: list[Any]


class SearchedPaths:
    """The paths that functions ask for, in the order in which they do.

    A path that is as short as it can be gets no longer by sliding, so that its length and the
    directions of its lines are numbers to whatever asks for no slopes of them.
    """

    def __init__(self) -> None:
        self._searched: dict[int, SearchedPath] = {}

    def __len__(self) -> int:
        return len(self._searched)

    def __iter__(self) -> Iterator[SearchedPath]:
        return iter(self._searched.values())

    @property
    def symbols(self) -> Any:
        """All of them, a column; those of paths that are asked for later stand behind."""
        return ca.vertcat(*(one.symbols for one in self))

    @property
    def places(self) -> Any:
        """Inputs of the search, a column."""
        return ca.vertcat(*(entry for one in self for entry in one.places))

    def taut(self, path: Any, k: Any, x: Any) -> Taut:
        """A path as symbols.

        Raises:
            Untraceable: Native code does not know one of its surfaces.
        """
        if id(path) not in self._searched:
            for wrap in path.wraps:
                if type(wrap.surface) not in SURFACES:
                    kind = type(wrap.surface).__name__.lower()
                    raise Untraceable(f"its path wraps over '{wrap.name}', a {kind}")
            size = 1 + 3 * len(path.points) + 6 * len(path.wraps)
            symbols = ca.SX.sym(f"path{len(self._searched)}_", size)
            self._searched[id(path)] = SearchedPath(path, symbols, _places(path, k, x))
        values, middle = numbers(self._searched[id(path)].symbols), 1 + 3 * len(path.points)
        return Taut(values[0], values[1:middle].reshape(-1, 3), values[middle:].reshape(-1, 6))


def _places(path: Any, k: Any, x: Any) -> list[Any]:
    points = [entry for point in path.points for entry in point.position(k, x)]
    for wrap in path.wraps:
        points += [*k.rotation(wrap.point).ravel(), *k.position(wrap.point)]
    return [ca.SX(plain(entry)) for entry in points]
