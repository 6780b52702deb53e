"""External fields of a scene of particles."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mbd_ros.core.particles.fields import Field, PolynomialField, UniformField
from mbd_ros.core.ranges import Vector
from mbd_ros.errors import SceneError
from mbd_ros.scene.schema import schema

_HIGHEST = 12  # power of a coordinate


@dataclass(frozen=True)
class _Uniform:
    acceleration: Vector


@dataclass(frozen=True)
class _Term:
    coefficient: float
    powers: Sequence[int]


@dataclass(frozen=True)
class _Polynomial:
    terms: Sequence[Any]


_TYPES = {"uniform": _Uniform, "polynomial": _Polynomial}


def read_fields(given: Any, where: str) -> tuple[Field, ...]:
    """The fields of the section.

    Raises:
        SceneError: Names file and key.
    """
    if given is None:
        return ()
    if not isinstance(given, list):
        raise SceneError(f"{where}: expected a list, got {given!r}")
    return tuple(_field(entry, f"{where}[{i}]") for i, entry in enumerate(given))


def _field(entry: Any, where: str) -> Field:
    kind = entry.get("type") if isinstance(entry, dict) else None
    if kind not in _TYPES:
        raise SceneError(f"{where}: unknown type {kind!r}, accepted: {', '.join(_TYPES)}")
    rest = {key: value for key, value in entry.items() if key != "type"}
    if kind == "uniform":
        uniform: _Uniform = schema.call(_Uniform, rest, where)
        return UniformField(np.array(uniform.acceleration))
    given: _Polynomial = schema.call(_Polynomial, rest, where)
    terms = [schema.call(_Term, term, f"{where}.terms[{i}]") for i, term in enumerate(given.terms)]
    for i, term in enumerate(terms):
        if len(term.powers) != 3 or not all(0 <= p <= _HIGHEST for p in term.powers):
            raise SceneError(
                f"{where}.terms[{i}].powers: {term.powers}, accepted: three whole numbers, "
                f"0 to {_HIGHEST}"
            )
    powers = np.array([term.powers for term in terms], dtype=np.float64).reshape(-1, 3)
    return PolynomialField(np.array([term.coefficient for term in terms]), powers)
