"""Langevin dynamics along rows."""

from math import exp, sqrt

import numpy as np

from mbd_ros.errors import DivergedError
from mbd_ros.features.sampling.ensemble import Ensemble, Walkers
from mbd_ros.features.sampling.space import Marks


class Langevin:
    """The splitting g-BAOAB: kick, move, friction and noise, move, kick.

    Its configurations have an error of second order in dt; velocities of every step are along the
    rows.

    Source: B. Leimkuhler, C. Matthews, Proc. R. Soc. A 472, 2016, 20160138.

    Args:
        ensemble: The ensemble; masses of its space are constant.
        dt: Step.
        friction: Rate at which velocities are forgotten, >= 0.
    """

    def __init__(self, ensemble: Ensemble, dt: float, friction: float) -> None:
        self._ensemble, self.dt = ensemble, dt
        self._kept = exp(-friction * dt)
        self._new = sqrt(1.0 - self._kept**2)

    def sweep(self, at: Walkers, random: np.random.Generator, steps: int) -> tuple[Walkers, Marks]:
        """Some steps.

        Args:
            at: States of the chains.
            random: Of this sweep.
            steps: How many.

        Returns:
            States, and which of them were accepted: all, shape (chains,).

        Raises:
            DivergedError: A step does not end on the rows.
        """
        ensemble, h = self._ensemble, self.dt
        for _ in range(steps):
            at = ensemble.move(ensemble.kick(at, 0.5 * h), 0.5 * h)
            noise = ensemble.drawn(random, at.places, at.q.shape[1])
            at = ensemble.move(at._replace(v=self._kept * at.v + self._new * noise), 0.5 * h)
            at = at._replace(force=ensemble.force(at.q, at.places))
            at = ensemble.kick(at, 0.5 * h)
            if not at.whole.all():
                raise DivergedError(
                    f"langevin: no step of {h:g} ends on the rows in {(~at.whole).sum()} of "
                    f"{at.whole.size} chains; try a smaller dt, or the method metropolis"
                )
        return at, at.whole
