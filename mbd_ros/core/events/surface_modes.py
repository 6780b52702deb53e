"""The mode of a motion on one or several switching surfaces at once."""

import itertools
from collections.abc import Sequence

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.core.thresholds import TIE
from mbd_ros.errors import SolveError

Mode = tuple[int, ...]  # one a surface: 1 above it, -1 below, 0 sliding on it
MOST_SURFACES = 6  # on which a motion may be at once; 3^k cases are looked at
_SAME = 1.0e-6  # signs that give the same motion


def mode_on(r: Array, D: Array, names: Sequence[str]) -> Mode:
    """The only way to continue where surfaces meet: h' = r + D s with s in -1 .. 1.

        h_i' > 0 and s_i = 1 (leaves above), h_i' < 0 and s_i = -1 (leaves below),
        or h_i' = 0 and -1 <= s_i <= 1 (slides)

    This is Filippov's solution with the equivalent control on every surface that it slides on.
    It is unique where -D is a P-matrix; for one surface: s D < 0, the surface attracts or is
    crossed. At a tangency, where two ways begin with the same velocity, sliding comes first; it
    ends at once if it has to.

    Source: A. F. Filippov, 1988, §4 and §10; V. I. Utkin, Sliding Modes in Control and
    Optimization, 1992, ch. 2.

    Args:
        r: Rates of the surfaces with zero signs, shape (k,).
        D: Change of the rates per sign, shape (k, k).
        names: Of the surfaces.

    Raises:
        SolveError: Several solutions start here (a surface repels), or none does.
    """
    k = len(r)
    if k > MOST_SURFACES:
        raise SolveError(
            f"{k} switching surfaces at once ({', '.join(names)}): {MOST_SURFACES} go"
        )
    cases = sorted(itertools.product((0, 1, -1), repeat=k), key=lambda mode: -mode.count(0))
    found = [(mode, s) for mode in cases if (s := _signs(r, D, mode)) is not None]
    where = f"switching surface {', '.join(names)}"
    if not found:
        raise SolveError(
            f"{where}: no Filippov solution goes on; rates {r}, per sign {D.tolist()}"
        )
    mode, s = found[0]
    if any(np.abs(other - s).max() > _SAME for _, other in found[1:]):
        ways = "; ".join(_words(way) for way, _ in found[:4])
        raise SolveError(f"{where}: the solution is not unique, it may go on {ways}")
    return mode


def equivalent_signs(r: Array, D: Array, names: Sequence[str]) -> Array:
    """Signs s with r + D s = 0, which keep a motion on the surfaces, shape (k,).

    Raises:
        SolveError: The force does not act across the surfaces: D is singular.
    """
    signs = _solve(D, -r)
    if signs is None:
        raise SolveError(f"switching surface {', '.join(names)}: no force keeps a motion on it")
    return signs


def _signs(r: Array, D: Array, mode: Mode) -> Array | None:
    """Signs that a mode needs; None where it is not consistent with the rates."""
    s = np.array(mode, dtype=np.float64)
    slides = s == 0.0
    if slides.any():
        held = _solve(D[np.ix_(slides, slides)], -(r + D.dot(s))[slides])
        if held is None or np.abs(held).max() > 1.0 + TIE:
            return None
        s[slides] = held
    h_rate = r + D.dot(s)
    allowed = -TIE * (np.abs(r) + np.abs(D).sum(axis=1))
    leaves = (np.array(mode) * h_rate)[~slides] >= allowed[~slides]
    return s if leaves.all() else None


def _solve(D: Array, right: Array) -> Array | None:
    """Solution of a small system with rows of any size; None where it is singular."""
    size = np.abs(D).max(axis=1)
    if not (size > TIE * np.abs(right)).all():
        return None
    scaled = D / size[:, None]
    if np.linalg.cond(scaled) > 1.0 / TIE:
        return None
    return np.linalg.solve(scaled, right / size)


def _words(mode: Mode) -> str:
    return ", ".join({1: "above", 0: "on it", -1: "below"}[way] for way in mode)
