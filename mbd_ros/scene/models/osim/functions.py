"""Functions of OpenSim -> functions of a scene: f(q) as `couplings` and `moves` write them."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mbd_ros.errors import MbdError
from mbd_ros.scene.models.osim.item import Item
from mbd_ros.scene.models.urdf_text import IDENTITY, Function, constant, linear, sine


def function_in(holder: Item | None) -> Function:
    """The function that an element holds; the coordinate itself where it holds none.

    Raises:
        SceneError: Its numbers are wrong.
        UnknownFunction: No function of a scene expresses it.
    """
    if holder is None:
        return IDENTITY
    inner = [item for item in holder.children() if item.type in _READERS]
    if inner:
        return function_of(inner[0])
    other = [item.type for item in holder.children()]
    if other:
        raise UnknownFunction(f"function {other[0]}")
    return IDENTITY


def function_of(item: Item) -> Function:
    """A function by its type.

    Raises:
        SceneError: Its numbers are wrong.
        UnknownFunction: No function of a scene expresses it.
    """
    if item.type not in _READERS:
        raise UnknownFunction(f"function {item.type}")
    return _READERS[item.type](item)


def is_function(item: Item) -> bool:
    """Whether an element is a function that can be read."""
    return item.type in _READERS


class UnknownFunction(MbdError):
    """A function that no function of a scene expresses."""


def _constant(item: Item) -> Function:
    return constant(item.number("value", default=0.0))


def _linear(item: Item) -> Function:
    slope, offset = item.vector("coefficients", default=(1.0, 0.0), length=2)
    return linear(slope, offset)


def _polynomial(item: Item) -> Function:
    lowest_first = item.numbers("coefficients")[::-1] or [0.0]
    if len(lowest_first) < 3:
        return linear(*[*lowest_first, 0.0][1::-1])
    return Function({"polynomial": lowest_first})


def _simm(item: Item) -> Function:
    x, y = _points(item)
    if len(set(y)) == 1:
        return constant(y[0])
    if len(x) == 2:  # a line
        slope = (y[1] - y[0]) / (x[1] - x[0])
        return linear(slope, y[0] - slope * x[0])
    return Function({"simm_spline": {"x": x, "y": y}})


def _piecewise_linear(item: Item) -> Function:
    x, y = _points(item)
    if len(set(y)) == 1:
        return constant(y[0])
    slopes = [(b - a) / (d - c) for a, b, c, d in zip(y, y[1:], x, x[1:], strict=False)]
    rows = [list(row) for row in zip(slopes, y, strict=False)]
    return Function({"piecewise_polynomial": {"breaks": x, "coefficients": rows}})


def _natural(item: Item) -> Function:
    """GCVSpline: an interpolating natural spline, cubic where its degree is 3."""
    x, y = _points(item)
    if len(set(y)) == 1:
        return constant(y[0])
    degree = item.number("half_order", default=-1.0)
    degree = item.number("degree", default=5.0) if degree < 0.0 else 2.0 * degree - 1.0
    if degree == 1.0:
        return _piecewise_linear(item)
    if degree != 3.0 or item.number("error_variance", default=0.0) > 0.0:
        raise UnknownFunction(f"function {item.type} of degree {degree:g}")
    return Function({"spline": {"x": x, "y": y}})


def _multiplier(item: Item) -> Function:
    holder = item.find("function")
    return scaled(function_in(holder), item.number("scale", default=1.0))


def _sine(item: Item) -> Function:
    """A sine of the coordinate."""
    amplitude, omega = (item.number(tag, default=1.0) for tag in ("amplitude", "omega"))
    phase, offset = (item.number(tag, default=0.0) for tag in ("phase", "offset"))
    return sine(amplitude, omega, phase, offset)


def _points(item: Item) -> tuple[list[float], list[float]]:
    x, y = item.numbers("x"), item.numbers("y")
    if len(x) != len(y) or not x:
        raise item.error(f"{len(x)} <x> and {len(y)} <y>, expected as many")
    pairs = sorted(dict(zip(x, y, strict=True)).items())  # OpenSim sorts SIMM's points
    return [one for one, _ in pairs], [other for _, other in pairs]


def scaled(function: Function, scale: float) -> Function:
    """f(q) times a number."""
    if function.constant is not None:
        return constant(function.constant * scale)
    if scale == 0.0:
        return constant(0.0)
    ((kind, terms), *_) = function.entry.items()
    if kind == "factor":
        return linear(terms * scale, function.offset * scale)
    if kind == "polynomial":
        return Function({kind: [c * scale for c in terms]})
    if kind == "piecewise_polynomial":
        rows = [[c * scale for c in row] for row in terms["coefficients"]]
        return Function({kind: {**terms, "coefficients": rows}})
    if kind == "harmonic":
        heights = {key: terms[key] * scale for key in ("amplitude", "offset")}
        return Function({kind: {**terms, **heights}})
    return Function({kind: {**terms, "y": [y * scale for y in terms["y"]]}})


_READERS: Mapping[str, Callable[[Item], Function]] = {
    "Constant": _constant,
    "LinearFunction": _linear,
    "PolynomialFunction": _polynomial,
    "SimmSpline": _simm,
    "NaturalCubicSpline": _simm,  # as files before 3.0 call it
    "natCubicSpline": _simm,
    "PiecewiseLinearFunction": _piecewise_linear,
    "GCVSpline": _natural,
    "MultiplierFunction": _multiplier,
    "Sine": _sine,
}
