"""Steps of RATTLE that are accepted or not: exact whatever their length."""

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.ensemble import Ensemble, Walkers
from mbd_ros.features.sampling.space import Marks

_BACK = 1.0e-8  # of the scale: how near a step back has to come
_VARIED = 0.2  # of the step, so that no motion comes back to its start


class Metropolis:
    """New velocities, some steps of RATTLE, and a decision.

    A step counts only where the step back leads to its start: the equations for the multipliers
    may have several solutions, and one that the step back does not find would make the sample
    wrong.

    Sources: E. Zappa, M. Holmes-Cerfon, J. Goodman, Comm. Pure Appl. Math. 71, 2018, 2609;
    T. Lelievre, M. Rousset, G. Stoltz, Numer. Math. 143, 2019, 379.

    Args:
        ensemble: The ensemble.
        dt: Step.
    """

    def __init__(self, ensemble: Ensemble, dt: float) -> None:
        self._ensemble, self.dt = ensemble, dt

    def sweep(self, at: Walkers, random: np.random.Generator, steps: int) -> tuple[Walkers, Marks]:
        """One proposal for every chain.

        Args:
            at: States of the chains.
            random: Of this sweep.
            steps: Steps of RATTLE.

        Returns:
            States with new velocities, and which proposals were accepted, shape (chains,).
        """
        ensemble, chains = self._ensemble, at.q.shape[1]
        h = self.dt * random.uniform(1.0 - _VARIED, 1.0 + _VARIED)
        at = at._replace(v=ensemble.drawn(random, at.places, chains))
        chosen = random.random(chains)
        there = at._replace(whole=np.ones(chains, dtype=np.bool_))
        with np.errstate(all="ignore"):
            before = self._total(at)
            for _ in range(steps):
                there = self._stepped(there, h)
            rise = self._total(there) - before
            accepted: Marks = there.whole & (chosen < np.exp(np.minimum(-rise / ensemble.kT, 0.0)))
        return _chosen(accepted, there, at), accepted

    def _total(self, at: Walkers) -> Array:
        total: Array = self._ensemble.energy(at.q, at.places) + self._ensemble.kinetic(at.v)
        return total

    def _stepped(self, at: Walkers, h: float) -> Walkers:
        ensemble = self._ensemble
        there, _ = ensemble.step(at, h)
        if not ensemble.manifold.parts:
            return there
        back = there.q - h * (there.v - (0.5 * h / ensemble.space.mass[:, None]) * there.force)
        back, whole = ensemble.manifold.close(there.places, back)
        near = np.abs(back - at.q).max(axis=0) <= _BACK * ensemble.space.scale
        return there._replace(whole=there.whole & whole & near)


def _chosen(taken: Marks, there: Walkers, here: Walkers) -> Walkers:
    """The states of `there` for some chains, those of `here` for the others."""
    places = [
        type(a)(*(_taken(taken, *pair) for pair in zip(a, b, strict=True)))
        for a, b in zip(there.places, here.places, strict=True)
    ]
    q, v, force = (
        np.where(taken, a, b)
        for a, b in ((there.q, here.q), (there.v, here.v), (there.force, here.force))
    )
    return Walkers(q, v, places, force, np.ones(len(taken), dtype=np.bool_))


def _taken(taken: Marks, there: Array, here: Array) -> Array:
    copies = there.shape[-1] // len(taken)
    return np.where(np.tile(taken, copies), there, here)
