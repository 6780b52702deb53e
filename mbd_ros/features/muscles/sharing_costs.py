"""What muscles minimise where they share a load: prices of activations, one a muscle and frame.

The cost is sum w_i a_i^p of the muscles and sum |e_j|^p of reserves, e the effort
in optimal forces. Prices have no units, and are about 1 for a muscle of the mean size.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.core.state import Array

_LEAST = 1.0e-6  # price of a muscle that has no force at all
EXPONENTS = {"activation": 2.0, "stress": 3.0, "volume": 2.0, "metabolic": 1.0}


class Criterion(NamedTuple):
    """A cost of activations.

    - `activation`: w = 1. Source: K. R. Kaufman et al., J. Biomech. 24 (1991) 793.
    - `stress`: w = (F0 / F_max)^p, so that a^p w = (force / peak force)^p, which is fatigue for
      p = 3. Source: R. D. Crowninshield, R. A. Brand, J. Biomech. 14 (1981) 793.
    - `volume`: w = F_max l_opt over their mean: large muscles cost more. Source: R. Happee,
      F. C. T. van der Helm, J. Biomech. 28 (1995) 1179.
    - `metabolic`: w = F_max v_max phi over the mean of F_max v_max, phi(v / v_max) the metabolic
      rate of fibres that shorten at v; p = 1 is that rate itself. Source: A. E. Minetti,
      R. McN. Alexander, J. Theor. Biol. 186 (1997) 467.

    Attributes:
        kind: One of the four.
        exponent: The p >= 1.
    """

    kind: str = "activation"
    exponent: float = 2.0

    def prices(self, sizes: "Sizes", active: Array, speed: Array) -> Array:
        """The w, shape (frames, n).

        Args:
            sizes: Of the muscles.
            active: Their F0, the force at full activation [N], shape (frames, n).
            speed: Lengthening of their fibres [m/s], same shape.
        """
        if self.kind == "activation":
            return np.ones_like(active)
        if self.kind == "stress":
            return np.maximum((active / sizes.peak) ** self.exponent, _LEAST)
        if self.kind == "volume":
            volume = sizes.peak * sizes.optimal
            return np.broadcast_to(volume / volume.mean(), active.shape)
        power = sizes.peak * sizes.fastest
        return power / power.mean() * shortening_rate(-speed / sizes.fastest)


DEFAULT = Criterion()


class Sizes(NamedTuple):
    """Numbers of muscles, shape (n,) each.

    Attributes:
        peak: Largest isometric force [N].
        optimal: Fibre length at which it is reached [m].
        fastest: Largest speed of shortening [m/s].
    """

    peak: Array
    optimal: Array
    fastest: Array


def sizes_of(muscles: Sequence[Muscle]) -> Sizes:
    """Sizes of muscles."""
    every = [muscle.contraction for muscle in muscles]
    rows = [[c.peak, c.optimal, c.fastest] for c in every]
    return Sizes(*np.array(rows, dtype=np.float64).reshape(-1, 3).T)


def shortening_rate(shortening: Array) -> Array:
    """Metabolic rate of active fibres per peak force and largest speed.

    Source: A. E. Minetti, R. McN. Alexander, J. Theor. Biol. 186 (1997) 467.

    Args:
        shortening: Speed per largest speed, negative where fibres lengthen; kept within -1 .. 1.
    """
    x = np.clip(shortening, -1.0, 1.0)
    above = 0.054 + x * (0.506 + 2.46 * x)
    return np.asarray(above / (1.0 + x * (-1.13 + x * (12.8 - 1.64 * x))))
