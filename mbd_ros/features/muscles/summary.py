"""Lines for people on how muscles shared the forces of a motion."""

from collections.abc import Iterator, Sequence

import numpy as np

from mbd_ros.core.inverse_dynamics.reserves import CoordinateReserve
from mbd_ros.core.inverse_dynamics.torque_estimator import Observations
from mbd_ros.core.state import NANOSECOND, Array
from mbd_ros.features.muscles.columns import together
from mbd_ros.features.muscles.static_optimization import Shares, StaticOptimization
from mbd_ros.scene.describe.coordinate_names import coordinate_names

_SHOWN = 5  # frames, coordinates or parts that a line names
_LACKS = 1.0e-6  # of the largest need: what counts as lacking


def summary(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> Iterator[str]:
    """The lines.

    Args:
        solver: What shared.
        samples: The motion.
        chunks: Its shares, some frames each.
    """
    criterion, reserves = solver.wishes.criterion, solver.reserves
    passive = "takes part" if solver.wishes.passive else "is left out"
    yield (
        f"objective: {criterion.kind}, exponent {criterion.exponent:g}, {len(solver.muscles)} "
        f"muscles and {len(reserves)} reserves; passive force of the fibres {passive}"
    )
    null, movable = together(chunks, "null_space"), [m for s in chunks for m in s.movable]
    free = f"{null.min()}" if null.min() == null.max() else f"{null.min()} to {null.max()}"
    yield (
        f"optimum: largest residual {together(chunks, 'residual').max():.1e}; {free} of "
        f"{len(solver.names)} unknowns are free to share"
    )
    several = [i for i, each in enumerate(movable) if each]
    if several:
        names = sorted({solver.names[i] for each in movable for i in each})
        yield f"not unique in {len(several)} of {len(movable)} frames: {_listed(names)}"
    yield from _reserve_lines(solver, chunks)
    yield from _lacking_lines(solver, samples, chunks)


def _reserve_lines(solver: StaticOptimization, chunks: Sequence[Shares]) -> Iterator[str]:
    """What each reserve exerts, and its share of what its coordinate needs."""
    forces, needed = together(chunks, "reserve"), together(chunks, "needed")
    at = {int(v): i for i, v in enumerate(solver.known.couplings.v_index)}
    for reserve, force in zip(solver.reserves, forces.T, strict=True):
        line = f"reserve {reserve.name}: at most {np.abs(force).max():.4g} {reserve.unit}"
        if isinstance(reserve, CoordinateReserve):
            whole = _rms(needed[:, at[reserve.at]])
            share = 100.0 * _rms(force) / whole if whole > 0.0 else 0.0
            line += f", {share:.3g} % of what its coordinate needs (rms)"
        yield line


def _lacking_lines(
    solver: StaticOptimization, samples: Observations, chunks: Sequence[Shares]
) -> Iterator[str]:
    """Frames whose forces muscles and reserves cannot produce, and what lacks most."""
    lacks = np.flatnonzero(~together(chunks, "is_feasible"))
    if not len(lacks):
        return
    needed, lacking = together(chunks, "needed"), together(chunks, "lacking")
    names = coordinate_names(solver.robot, solver.known.couplings)
    times = [f"{samples.stamps[i] * NANOSECOND:.6g}" for i in lacks]
    yield (
        f"warning: {len(lacks)} of {len(needed)} frames need more than muscles and reserves can "
        f"give, at {_listed(times)} s"
    )
    most = np.abs(lacking).max(axis=0)
    order = np.argsort(-most)
    scale = _LACKS * np.abs(needed).max(initial=0.0)
    texts = []
    for i in (i for i in order if most[i] > scale):
        row = int(np.abs(lacking[:, i]).argmax())
        time = samples.stamps[row] * NANOSECOND
        texts.append(f"{names[i]} lacks {lacking[row, i]:.4g} at {time:.6g} s")
    yield f"warning: at most: {_listed(texts)}"


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _listed(texts: Sequence[str]) -> str:
    more = f", .. ({len(texts)})" if len(texts) > _SHOWN else ""
    return ", ".join(texts[:_SHOWN]) + more
