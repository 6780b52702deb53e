"""Where a function of one variable changes its sign, to rounding."""

import math
from collections.abc import Callable

Point = tuple[float, float]
"""An argument of a function, and its value there."""
_WIDTH = 1.0e-4  # of a bracket: for a slope


def sign_change(f: Callable[[float], float], near: Point, far: Point, width: float = 0.0) -> float:
    """Argument between two others at which f changes its sign.

    Bisection, or inverse quadratic interpolation where that is safe; ends when the bracket is a
    few units of rounding wide.

    Source: T. R. Chandrupatla, Advances in Engineering Software 28, 1997, 145-149.

    Args:
        f: Continuous between the arguments.
        near: An argument and f there, >= 0 or <= 0.
        far: Another one, with f of the other sign.
        width: Of a bracket that is short enough, beside rounding of the arguments.
    """
    (a, fa), (b, fb), part = far, near, 0.5
    for _ in range(200):
        x = a + part * (b - a)
        fx = f(x)
        if (fx > 0.0) == (fa > 0.0):
            c, fc = a, fa
        else:
            c, fc = b, fb
            b, fb = a, fa
        a, fa = x, fx
        best, f_best = (a, fa) if abs(fa) < abs(fb) else (b, fb)
        limit = max(2.0 * math.ulp(best), width) / abs(b - a) if b != a else 1.0
        if f_best == 0.0 or limit > 0.5:
            return best
        part = min(max(_interpolated((a, fa), (b, fb), (c, fc)), limit), 1.0 - limit)
    return best


def narrowed(
    f: Callable[[float], float], like: Callable[[float], float], near: Point, far: Point
) -> tuple[Point, Point]:
    """A shorter bracket of a change of sign, by two arguments of f; the same where they miss it.

    Args:
        f: The function.
        like: One that is nearly the same and costs less; asked before f.
        near: An argument and f there, > 0.
        far: Another one, with f < 0.
    """
    start, end = like(near[0]), like(far[0])
    if not start > 0.0 > end:
        return near, far
    guess = sign_change(like, (near[0], start), (far[0], end))
    ends = min(near[0], far[0]), max(near[0], far[0])
    width = _WIDTH * (ends[1] - ends[0])
    low, high = max(guess - width, ends[0]), min(guess + width, ends[1])
    slope = (like(high) - like(low)) / (high - low)
    first = guess, f(guess)
    if slope == 0.0 or first[1] == 0.0:
        return near, far
    other = guess - 2.0 * first[1] / slope
    if not ends[0] < other < ends[1]:
        return near, far
    second = other, f(other)
    if (first[1] > 0.0) == (second[1] > 0.0):
        return near, far
    return (first, second) if first[1] > 0.0 else (second, first)


def _interpolated(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    """Part of the way from a to b at which to look next."""
    (xa, fa), (xb, fb), (xc, fc) = a, b, c
    if fb == fc or fa in (fb, fc):
        return 0.5
    xi, phi = (xa - xb) / (xc - xb), (fa - fb) / (fc - fb)
    if not 1.0 - math.sqrt(1.0 - xi) < phi < math.sqrt(xi):
        return 0.5
    return fa / (fb - fa) * fc / (fb - fc) + (xc - xa) / (xb - xa) * fa / (fc - fa) * fb / (
        fc - fb
    )
