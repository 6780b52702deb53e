"""Chains in blocks: a block is a function of its number, whoever does it and wherever."""

from collections.abc import Callable, Iterable
from math import exp, sqrt
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.features.sampling.ensemble import Ensemble, Walkers
from mbd_ros.features.sampling.langevin import Langevin
from mbd_ros.features.sampling.metropolis import Metropolis
from mbd_ros.features.sampling.random_streams import stream

METHODS = ("metropolis", "langevin")
_LARGEST, _FEWEST = 256, 2  # chains of a block; blocks of a run with few chains
_WISHED = 0.9  # acceptance
_FIRST, _USUAL = 0.1, 0.05  # steps, in times a particle of kT takes for the scale of the space
_LOST = 0.025  # friction times the step
_QUICK, _FADING = 1.0, 0.6  # how a step is changed while it is looked for


class Plan(NamedTuple):
    """How an ensemble is sampled.

    Attributes:
        method: One of `METHODS`.
        chains: How many.
        samples: Samples a chain.
        warmup: Samples a chain before them, which are not kept.
        steps: Steps between samples.
        dt: Step; None: chosen, by `metropolis` so that most proposals are accepted.
        friction: Rate of `langevin` at which velocities are forgotten; None: chosen.
        seed: Of the random numbers, >= 0.
    """

    method: str = "metropolis"
    chains: int = 64
    samples: int = 1000
    warmup: int = 200
    steps: int = 5
    dt: float | None = None
    friction: float | None = None
    seed: int = 0


class Checkpoint(NamedTuple):
    """Where a block of chains stands; from here it goes on with the same bits.

    Attributes:
        q: Shape (size, chains).
        v: Shape (size, chains).
        sweeps: How many were done.
        dt: The step that is taken.
    """

    q: Array
    v: Array
    sweeps: int
    dt: float


class Sampled(NamedTuple):
    """What a block of chains gave.

    Attributes:
        values: Shape (quantities, chains, samples).
        accepted: Share of proposals, shape (chains,).
        end: Where it stands.
    """

    values: Array
    accepted: Array
    end: Checkpoint


Measure = Callable[[Walkers], Array]  # shape (quantities, chains)


def blocks_of(chains: int) -> list[slice]:
    """The chains of each block; depends on nothing but their number."""
    size = min(max(-(-chains // _FEWEST), 1), _LARGEST)
    return [slice(i, min(i + size, chains)) for i in range(0, chains, size)]


def usual_step(ensemble: Ensemble) -> float:
    """A step that is short beside the time in which a particle of kT moves by the scale."""
    lightest = float(ensemble.space.mass.min())
    return _USUAL * ensemble.space.scale * sqrt(lightest / ensemble.kT)


def method_of(ensemble: Ensemble, plan: Plan, dt: float) -> Langevin | Metropolis:
    """The method of a plan with a step."""
    if plan.method == "metropolis":
        return Metropolis(ensemble, dt)
    friction = _LOST / dt if plan.friction is None else plan.friction
    return Langevin(ensemble, dt, friction)


def begun(ensemble: Ensemble, plan: Plan, number: int, q: Array) -> Checkpoint:
    """A block of chains after its warm-up.

    Args:
        ensemble: The ensemble.
        plan: How it is sampled.
        number: Of the block.
        q: Starts on the rows, shape (size, chains of the block).
    """
    is_tuned = plan.method == "metropolis" and plan.dt is None
    dt = usual_step(ensemble) * (_FIRST / _USUAL if is_tuned else 1.0)
    method = method_of(ensemble, plan, dt if plan.dt is None else plan.dt)
    at = ensemble.at(q, np.zeros(q.shape))
    at = at._replace(v=ensemble.drawn(stream(plan.seed, number, 0), at.places, q.shape[1]))
    steps = []
    for k in range(plan.warmup):
        at, accepted = method.sweep(at, stream(plan.seed, number, k + 1), plan.steps)
        if is_tuned:
            steps.append(method.dt)
            method.dt *= exp(_QUICK * (accepted.mean() - _WISHED) / (1.0 + k) ** _FADING)
    if len(steps) >= 2:
        method.dt = exp(np.log(steps[len(steps) // 2 :]).mean())
    return Checkpoint(at.q, at.v, plan.warmup + 1, method.dt)


def gone_on(
    ensemble: Ensemble,
    plan: Plan,
    number: int,
    start: Checkpoint,
    measure: Measure,
    watch: Callable[[range], Iterable[int]] = iter,
) -> Sampled:
    """Samples of a block of chains from where it stands.

    Args:
        ensemble: The ensemble.
        plan: How it is sampled.
        number: Of the block.
        start: Where it stands.
        measure: What is kept of a sample.
        watch: Passes the numbers of samples on, for people.
    """
    method = method_of(ensemble, plan, start.dt)
    at, values = ensemble.at(start.q, start.v), []
    share = np.zeros(start.q.shape[1])
    for k in watch(range(start.sweeps, start.sweeps + plan.samples)):
        at, accepted = method.sweep(at, stream(plan.seed, number, k), plan.steps)
        values.append(measure(at))
        share += accepted
    end = Checkpoint(at.q, at.v, start.sweeps + plan.samples, start.dt)
    return Sampled(np.stack(values, axis=2), share / plan.samples, end)
