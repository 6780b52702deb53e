"""Recordings as pieces of samples without gaps, split in two: to learn from, and to be tested."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from mbd_ros.core.state import NANOSECOND, Array, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.jobs.lines import Say
from mbd_ros.motion.derivatives import Derivatives, differentiate
from mbd_ros.motion.long_stamps import parts_of
from mbd_ros.motion.loop_closing import kept_rows
from mbd_ros.motion.recordings import Source, name_of
from mbd_ros.motion.samples import Task, read_recording
from mbd_ros.motion.wrenches import read_loads, wrench_at
from mbd_ros.motion.zero_phase import zero_phase
from mbd_ros.scene.built_scene import Scene

_MEASURED = 0.99  # of the samples: a joint with fewer efforts has none
_LEARNED = 0.6  # of the time of a recording; what follows is for the test


class Recorded(NamedTuple):
    """A recording, or a part of one.

    Attributes:
        where: Its name.
        motion: Its samples, independent joints first.
        loads: Measured wrenches, by name.
        derivatives: Where velocities and accelerations come from: given or zero-phase.
        carried: Inertial numbers of all bodies of a known load, shape (10 bodies,); None without.
    """

    where: str
    motion: Motion
    loads: dict[str, WrenchSamples]
    derivatives: str
    carried: Array | None = None

    @property
    def times(self) -> Array:
        """[s], from its first sample."""
        times: Array = (self.motion.stamps - self.motion.stamps[0]) * NANOSECOND
        return times


class Piece(NamedTuple):
    """Samples without a gap, low-passed.

    Attributes:
        times: [s], shape (n,).
        y: Independent coordinates, shape (n, ny).
        v: Their velocities, shape (n, nv_y).
        a: Their accelerations, same shape.
        effort: Low-passed efforts of the independent joints, shape (n, m), NaN if not measured.
        measured: The same as measured.
        loads: Wrenches, shape (n, 6) each.
        rate: Velocities of the independent joints as measured, shape (n, m), NaN if not.
        carried: As of the recording.
    """

    times: Array
    y: Array
    v: Array
    a: Array
    effort: Array
    measured: Array
    loads: list[Array]
    rate: Array
    carried: Array | None


def read(
    scene: Scene,
    source: Source,
    *,
    wrenches: Source | None,
    topic: str,
    derivatives: str | None,
    say: Say,
) -> Recorded:
    """A recording with all that identification needs of it.

    Args:
        scene: The scene.
        source: Result, file or bag.
        wrenches: Of its external loads, where a table does not carry them.
        topic: JointState topic of a bag.
        derivatives: given or zero-phase; None: given where accelerations are.
        say: Is told what was left out.

    Raises:
        DataError: It cannot be read, or lacks a joint.
    """
    solver = scene.inverse_dynamics()
    task = Task(source, topic=topic)
    names = (*scene.couplings.independent, *scene.couplings.dependent)
    recording = read_recording(scene, task, names, solver.needed, say)
    loads, dropped = read_loads(scene, source, wrenches)
    for reason, count in dropped.items():
        say(f"{count} wrenches left out: {reason}")
    motion, n = recording.motion, len(scene.couplings.independent)
    if derivatives is None:
        there = (motion.velocity, motion.acceleration)
        whole = all(x is not None and np.isfinite(x[:, :n]).all() for x in there)
        whole = whole and all(body.acceleration is not None for body in motion.bodies)
        derivatives = "given" if whole else "zero-phase"
    return Recorded(name_of(source), _filled(motion, n, say), loads, derivatives)


def _filled(motion: Motion, n: int, say: Say) -> Motion:
    """Single samples without an effort take that between their neighbours."""
    if motion.effort is None:
        return motion
    effort, times = motion.effort.copy(), motion.stamps * NANOSECOND
    for name, values in zip(motion.names[:n], effort[:, :n].T, strict=True):
        there = np.isfinite(values)
        if there.all() or there.mean() <= _MEASURED:
            continue
        say(f"{name}: {int((~there).sum())} samples without an effort, taken from those beside")
        values[~there] = np.interp(times[~there], times[there], values[there])
    return motion._replace(effort=effort)


def split(recorded: Recorded, learned: float = _LEARNED) -> tuple[Recorded, Recorded | None]:
    """What is learned from, and what is left for the test."""
    if learned >= 1.0:
        return recorded, None
    times = recorded.times
    first = times <= learned * times[-1]
    parts = (kept_rows(recorded.motion, first), kept_rows(recorded.motion, ~first))
    return recorded._replace(motion=parts[0]), recorded._replace(motion=parts[1])


def pieces(scene: Scene, recorded: Recorded, band: float | None) -> Iterator[Piece]:
    """Pieces without gaps.

    Args:
        scene: The scene.
        recorded: What they are of.
        band: End of the band of motions and efforts [Hz]; None: as measured.

    Raises:
        DataError: Too few samples in a row.
    """
    n = len(scene.couplings.independent)
    for part in parts_of(recorded.motion.stamps):
        motion = kept_rows(recorded.motion, part)
        chosen = Derivatives(
            recorded.derivatives, band if recorded.derivatives != "given" else None
        )
        samples = differentiate(scene, recorded.where, motion, chosen).samples
        nothing = np.full((len(motion.stamps), n), np.nan)
        measured = nothing if motion.effort is None else motion.effort[:, :n]
        rate = nothing if motion.velocity is None else motion.velocity[:, :n]
        loads = [wrench_at(name, load, samples.stamps) for name, load in recorded.loads.items()]
        low = measured
        if band is not None and recorded.derivatives != "given":
            low = _low_passed(motion, measured, band)
        times = motion.stamps * NANOSECOND
        yield Piece(times, *samples[1:4], low, measured, loads, rate, recorded.carried)


def asked_cutoffs(scene: Scene, recorded: Recorded) -> Array:
    """Half-power frequencies that the spectra of the joints ask for [Hz], inf for none."""
    if recorded.derivatives == "given":
        return np.full(1, np.inf)
    chosen = Derivatives(recorded.derivatives)
    found = differentiate(scene, recorded.where, recorded.motion, chosen).cutoff
    return np.full(1, np.inf) if found is None else found


def _low_passed(motion: Motion, effort: Array, band: float) -> Array:
    """Efforts without what the grid of the regressor could not carry."""
    there = np.isfinite(effort).all(axis=0)
    found = np.full_like(effort, np.nan)
    if there.any():
        values = np.ascontiguousarray(effort[:, there])
        found[:, there] = zero_phase(motion.stamps, values, cutoff=4.0 * band).position
    return found


def check_efforts(scene: Scene, recorded: Sequence[Recorded], passive: Sequence[str]) -> None:
    """Refuse recordings whose efforts say nothing.

    Raises:
        DataError: Names recording and joints.
    """
    names = scene.couplings.independent
    for one in recorded:
        effort = one.motion.effort
        there = np.zeros(len(names), dtype=np.bool_)
        if effort is not None:
            there = np.isfinite(effort[:, : len(names)]).mean(axis=0) > _MEASURED
        lacking = [name for name, is_there in zip(names, there, strict=True) if not is_there]
        lacking = [name for name in lacking if name not in passive]
        if lacking:
            raise DataError(
                f"{one.where}: no effort of {', '.join(lacking)}; identification needs the "
                "measured torque of every joint that a motor drives (--passive JOINT .. names the "
                "others, which need measured wrenches)"
            )
        if effort is None:
            continue
        still = [n for i, n in enumerate(names) if there[i] and not effort[:, i].any()]
        still = [name for name in still if name not in passive]
        if still:
            raise DataError(
                f"{one.where}: the effort of {', '.join(still)} is 0 in every sample: the driver "
                "does not measure it"
            )
