"""Where a function of one variable changes its sign, to rounding."""

import math
from collections.abc import Callable


def sign_change(
    f: Callable[[float], float], near: tuple[float, float], far: tuple[float, float]
) -> float:
    """Argument between two others at which f changes its sign.

    Bisection, or inverse quadratic interpolation where that is safe; ends when the bracket is a
    few units of rounding wide.

    Source: T. R. Chandrupatla, Advances in Engineering Software 28, 1997, 145-149.

    Args:
        f: Continuous between the arguments.
        near: An argument and f there, >= 0 or <= 0.
        far: Another one, with f of the other sign.
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
        limit = 2.0 * math.ulp(best) / abs(b - a) if b != a else 1.0
        if f_best == 0.0 or limit > 0.5:
            return best
        part = min(max(_interpolated((a, fa), (b, fb), (c, fc)), limit), 1.0 - limit)
    return best


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
