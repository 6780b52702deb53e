"""The `couplings` section of a scene -> functions."""

from collections.abc import Mapping, Sequence
from typing import Any

from mbd_ros.core.model.coupling_functions import (
    CouplingFunction,
    Harmonic,
    Linear,
    PiecewisePolynomial,
    Polynomial,
    natural_cubic_spline,
)
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.scene.built_scene import Scene
from mbd_ros.scene.reading.building import Site
from mbd_ros.scene.schema import schema

FUNCTIONS = ("factor", "polynomial", "spline", "piecewise_polynomial", "simm_spline", "harmonic")


_CURVES = {
    "spline": natural_cubic_spline,
    "piecewise_polynomial": PiecewisePolynomial,
    "harmonic": Harmonic,
}


def build_couplings(site: Site, entries: Any) -> Couplings:
    """The `couplings` section, and the `<mimic>` of other joints.

    Raises:
        SceneError: Names file, joint and key.
    """
    entries = schema.value(entries, Mapping[str, Any], site.where)
    functions = {
        name: schema.call(_coupling, entry, where := f"{site.where}.{name}", where, name)
        for name, entry in entries.items()
    }
    try:
        return Couplings(site.parts["robot"], functions)
    except ModelError as error:
        raise SceneError(f"{site.where}: {error}") from error


def coupling_kinds(scene: Scene) -> dict[str, str]:
    """Dependent joint -> parent and kind of coupling function, for people."""
    kinds = {
        name: next(kind for kind in FUNCTIONS if entry.get(kind) is not None)
        for name, entry in scene.entries.get("couplings", {}).items()
    }
    return {
        name: f"{scene.couplings.parents[name]} ({kinds.get(name, 'URDF mimic')})"
        for name in scene.couplings.dependent
    }


def _coupling(
    where: str,
    name: str,
    *,
    parent: str,
    factor: float | None = None,
    offset: float | None = None,
    polynomial: Sequence[float] | None = None,
    spline: Any = None,
    simm_spline: Any = None,
    harmonic: Any = None,
    piecewise_polynomial: Any = None,
) -> Coupling:
    if factor == 0:
        raise ModelError(f"factor is 0: the joint never moves; use robot.locked.{name} instead")
    function = one_function(
        where,
        factor=factor,
        offset=offset,
        polynomial=polynomial,
        spline=spline,
        simm_spline=simm_spline,
        harmonic=harmonic,
        piecewise_polynomial=piecewise_polynomial,
    )
    return Coupling(parent, function)


def one_function(
    where: str,
    *,
    factor: float | None = None,
    offset: float | None = None,
    polynomial: Sequence[float] | None = None,
    spline: Any = None,
    simm_spline: Any = None,
    harmonic: Any = None,
    piecewise_polynomial: Any = None,
) -> CouplingFunction:
    """The function of an entry that has one of `FUNCTIONS` as its key.

    Args:
        where: File and key of the entry, for the messages.
        factor: Of a linear function.
        offset: Its value at 0, default 0.
        polynomial: c0, c1, ..
        spline: x and y of `natural_cubic_spline`.
        simm_spline: x and y of the function of that name.
        harmonic: Arguments of `Harmonic`.
        piecewise_polynomial: Arguments of `PiecewisePolynomial`.

    Raises:
        ModelError: None or several are given, or the function refuses its numbers.
    """
    values = (factor, polynomial, spline, piecewise_polynomial, simm_spline, harmonic)
    functions: dict[str, Any] = dict(zip(FUNCTIONS, values, strict=True))
    kinds = [kind for kind, function in functions.items() if function is not None]
    if len(kinds) != 1:
        raise ModelError(
            f"give exactly one of {', '.join(functions)}; got {', '.join(kinds) or 'none'}"
        )
    if offset is not None and factor is None:
        raise ModelError("'offset' goes with 'factor' only")
    kind = kinds[0]
    return _function(kind, functions[kind], offset or 0.0, f"{where}.{kind}")


def _function(kind: str, entry: Any, offset: float, where: str) -> CouplingFunction:
    if kind == "factor":
        return Linear(entry, offset)
    if kind == "polynomial":
        return Polynomial(entry)
    curve: Any = _CURVES.get(kind)
    if kind == "simm_spline":
        from mbd_ros.core.model.coupling_functions import simm_spline as curve
    function: CouplingFunction = schema.call(curve, entry, where)
    return function
