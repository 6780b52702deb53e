"""What is asked of the activations that share a motion."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.muscles.muscle import Muscle
from mbd_ros.errors import ModelError
from mbd_ros.features.muscles.sharing_costs import DEFAULT, Criterion

MOST_WITH_TRACKING = 3.0  # exponent beside a measured activation


class Wishes(NamedTuple):
    """What is asked of the activations.

    Attributes:
        criterion: What is minimised.
        passive: Whether the elastic force of the fibres acts beside the active one.
        rise: Fastest rise of an activation [1/s], inf without a limit.
        fall: Fastest fall [1/s].
        tracking: Price of (a - measured)^2, beside prices of about 1; 0 without tracking.
        measured_is_least: Whether a measured activation is a lower bound: co-contraction.
    """

    criterion: Criterion = DEFAULT
    passive: bool = False
    rise: float = np.inf
    fall: float = np.inf
    tracking: float = 0.0
    measured_is_least: bool = False


NOTHING_SPECIAL = Wishes()


def check_wishes(muscles: Sequence[Muscle], wishes: Wishes) -> None:
    """Refuse what no optimum is defined for.

    Raises:
        ModelError: No muscles, an exponent beside tracking that is too large, or a rate of 0.
    """
    if not muscles:
        raise ModelError("static optimisation: the scene has no muscles")
    exponent = wishes.criterion.exponent
    if wishes.tracking > 0.0 and exponent > MOST_WITH_TRACKING:
        raise ModelError(
            f"static optimisation: exponent {exponent:g} beside measured activations that are "
            f"tracked; accepted: 1 .. {MOST_WITH_TRACKING:g}"
        )
    if not (wishes.rise > 0.0 and wishes.fall > 0.0):
        raise ModelError("static optimisation: rates of activation must be greater than 0")
