"""Usual sizes of unknowns and of equations of motion, from a guess."""

from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.optimal_control.phase_equations import LETTERS, PhaseEquations
from mbd_ros.optimal_control.unknowns import PhaseMotion, Unknowns

_WIDEST, _INTERNAL = 0.1, 0.1  # least range of positions [rad or m], and of internal states
_STROKES = 4.0  # accelerations of a motion from rest to rest: 4 range / duration^2, bang-bang
_LOOKED_AT = 20  # points


class Usual(NamedTuple):
    """Usual sizes of a phase.

    Attributes:
        of: Letter -> of each unknown of that kind.
        rows: Of the equations of motion.
        duration: [s].
    """

    of: dict[str, Array]
    rows: Array
    duration: float

    def write(self, sizes: Array, unknowns: Unknowns) -> None:
        """Write them where the unknowns of the phase stand."""
        for letter, values in self.of.items():
            sizes[unknowns.points[letter]] = values
            if letter in unknowns.nodes:
                sizes[unknowns.nodes[letter]] = values
        sizes[unknowns.duration] = sizes[unknowns.begin] = self.duration


def usual_sizes(equations: PhaseEquations, motion: PhaseMotion, p: Array, room: Array) -> Usual:
    """Usual sizes of a motion.

    Args:
        equations: Of the phase.
        motion: A guess.
        p: Parameters.
        room: Widths between the bounds of inputs, inf without, shape (nu,).
    """
    T = max(abs(motion.duration), 1.0e-6)
    largest = {key: np.abs(motion.points[key]).max(axis=0, initial=0.0) for key in LETTERS}
    ranges = np.ptp(motion.nodes["q"], axis=0)
    range_of_all = max(float(ranges.max(initial=0.0)), _WIDEST)
    rate, bend = range_of_all / T, _STROKES * range_of_all / T**2
    of = {
        "q": np.maximum(largest["q"], range_of_all),
        "v": np.maximum(largest["v"], rate),
        "a": np.maximum(largest["a"], bend),
        "z": np.maximum(largest["z"], _INTERNAL),
        "w": np.maximum(largest["w"], _INTERNAL / T),
    }
    forces = _forces(equations, motion, p, of["a"])
    most = float(forces.max(initial=0.0)) or 1.0
    of["u"] = np.maximum(largest["u"], np.where(room > 0.0, np.minimum(room, most), most))
    of["l"] = np.maximum(largest["l"], most)
    accelerations = np.full(equations.sizes.m, float(of["a"].max(initial=bend)))
    return Usual(of, np.concatenate((forces, accelerations, of["w"])), T)


def _forces(equations: PhaseEquations, motion: PhaseMotion, p: Array, a: Array) -> Array:
    """Generalized forces that a motion takes without any input, shape (nv,)."""
    count, nv = len(motion.points["q"]), equations.sizes.nv
    some = np.unique(np.linspace(0, count - 1, min(count, _LOOKED_AT)).astype(int))
    values = {key: motion.points[key][some] for key in "qvz"}
    times = motion.begin + motion.duration * motion.mesh.shares[some]
    r, K = equations.answers(values, times, p)
    found = np.abs(r[:, :nv]).max(axis=0) + (np.abs(K[:, :nv, :nv]) @ a).max(axis=0)
    floor = 1.0e-3 * float(found.max(initial=0.0)) or 1.0
    return np.maximum(found, floor)
