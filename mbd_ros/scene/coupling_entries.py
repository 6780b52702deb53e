"""The `couplings` section of a scene -> functions."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mbd_ros.core.model.coupling_functions import (
    CouplingFunction,
    Linear,
    PiecewisePolynomial,
    Polynomial,
    natural_cubic_spline,
)
from mbd_ros.core.model.couplings import Coupling
from mbd_ros.errors import ModelError
from mbd_ros.scene import schema


def coupling_functions(path: Path, entries: Any) -> dict[str, tuple[Coupling, str]]:
    """Every dependent joint with what it follows and the kind of function.

    Args:
        path: Scene file, for the messages.
        entries: The section.

    Raises:
        SceneError: Names file, joint and key.
    """
    entries = schema.value(entries, Mapping[str, Any], f"{path}: couplings")
    return {
        name: schema.call(_coupling, entry, f"{path}: couplings.{name}", path, name)
        for name, entry in entries.items()
    }


def _coupling(
    path: Path,
    name: str,
    *,
    parent: str,
    factor: float | None = None,
    offset: float | None = None,
    polynomial: Sequence[float] | None = None,
    spline: Any = None,
    piecewise_polynomial: Any = None,
) -> tuple[Coupling, str]:
    functions: dict[str, Any] = {
        "factor": factor,
        "polynomial": polynomial,
        "spline": spline,
        "piecewise_polynomial": piecewise_polynomial,
    }
    given = [kind for kind, function in functions.items() if function is not None]
    if len(given) != 1:
        raise ModelError(
            f"give exactly one of {', '.join(functions)}; got {', '.join(given) or 'none'}"
        )
    if offset is not None and factor is None:
        raise ModelError("'offset' goes with 'factor' only")
    if factor == 0:
        raise ModelError(f"factor is 0: the joint never moves; use robot.locked.{name} instead")
    kind = given[0]
    where = f"{path}: couplings.{name}.{kind}"
    return Coupling(parent, _function(kind, functions[kind], offset or 0.0, where)), kind


def _function(kind: str, entry: Any, offset: float, where: str) -> CouplingFunction:
    if kind == "factor":
        return Linear(entry, offset)
    if kind == "polynomial":
        return Polynomial(entry)
    curve = natural_cubic_spline if kind == "spline" else PiecewisePolynomial
    function: CouplingFunction = schema.call(curve, entry, where)
    return function
