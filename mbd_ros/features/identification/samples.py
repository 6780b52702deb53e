"""Recordings as pieces of samples without gaps, their band, and what they can say.

A recording is split in two: to learn from, and to be tested. Motions show masses in a band, which
a filter keeps. What efforts and motion cannot say is refused in words of who recorded them.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.features.identification.least_squares import Joint, solved
from mbd_ros.features.identification.regressor import BaseParameters
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.derivatives import Derivatives, differentiate
from mbd_ros.motion.external_loads import read_loads, wrench_at
from mbd_ros.motion.filters import zero_phase
from mbd_ros.motion.long_stamps import parts_of
from mbd_ros.motion.recordings import Source, name_of, refuse_huge
from mbd_ros.motion.samples import Task, kept_rows, read_recording
from mbd_ros.scene.built_scene import Scene

_LARGEST = 1.0e9  # rad, rad/s, N·m, ..: no machine has that, and its squares hide all others
_MEASURED = 0.99  # of the samples: a joint with fewer efforts has none
_LEARNED = 0.6  # of the time of a recording; what follows is for the test
_ENERGY_SHARE = 0.999  # of the energy of a velocity, which lies below the frequency of the motion
_BAND_FACTOR = 5.0  # of that frequency: where the band ends; products of sines are in it
_GRID = 20.0  # samples for a period of the end of the band: friction changes sign within one
_KEPT_GRID = 2.5  # the same, of what is left when the band is all that there is
_HALF_LENGTH = 1.5  # periods of the end of the band on either side of a sample of the filter
HIGHEST = 0.2  # of the sampling rate: where a band ends at the latest
_LOWEST_RATIO = 0.2  # of measured over given torque: no robot is described as badly as that
_HIGHEST_RATIO = 5.0
_MATTERS = 0.3  # of the torque: what the given robot explains at least, to compare units
_CONDITION = 2.0e4  # of scaled columns: more is a motion that hides some of them
_IN_PHASE = 3.0e2  # the same, of a motion in which all joints follow one another
_HIDDEN_PART = 0.2  # of a hidden direction: parameters that are named
_FEWEST_ROWS = 2.0  # independent rows for each unknown
_LEAST_MOTION = 0.02  # rad or m: a joint that moves less shows nothing


class Recorded(NamedTuple):
    """A recording, or a part of one.

    Attributes:
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
    for name, load in loads.items():
        names = [f"wrench {name}"] * load.wrench.shape[1]
        where = name_of(source if wrenches is None else wrenches)
        refuse_huge(where, names, load.wrench, largest=_LARGEST)
    motion, n = recording.motion, len(scene.couplings.independent)
    fields = motion.position, motion.velocity, motion.acceleration, motion.effort
    refuse_huge(name_of(source), motion.names, *fields, largest=_LARGEST)
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
        loads = [
            wrench_at(recorded.where, name, load, samples.stamps)
            for name, load in recorded.loads.items()
        ]
        low = measured
        if band is not None and recorded.derivatives != "given":
            low = _low_passed(motion, measured, band)
        times = motion.stamps * NANOSECOND
        yield Piece(times, *samples[1:4], low, measured, loads, rate, recorded.carried)


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


def asked_cutoffs(scene: Scene, recorded: Recorded) -> Array:
    """Half-power frequencies that the spectra of the joints ask for [Hz], inf for none."""
    if recorded.derivatives == "given":
        return np.full(1, np.inf)
    chosen = Derivatives(recorded.derivatives)
    found = differentiate(scene, recorded.where, recorded.motion, chosen).cutoff
    return np.full(1, np.inf) if found is None else found


def band_of(times: Array, velocity: Array) -> float:
    """Where the band of a motion ends [Hz].

    Args:
        times: [s], shape (n,).
        velocity: Of the joints [rad/s or m/s], shape (n, m).
    """
    rate = 1.0 / float(np.median(np.diff(times)))
    n = len(times)
    taper = np.hanning(n)[:, None]
    energy = np.square(np.abs(np.fft.rfft((velocity - velocity.mean(axis=0)) * taper, axis=0)))
    frequency = np.fft.rfftfreq(n, 1.0 / rate)
    total = energy.sum(axis=0)
    moving = np.sqrt(total) > 1e-6 * np.sqrt(total.max(initial=0.0))
    if not (moving.any() and total.max() > 0.0):
        return HIGHEST * rate
    below = np.cumsum(energy[:, moving], axis=0) / total[moving]
    own = [frequency[np.searchsorted(b, _ENERGY_SHARE)] for b in below.T]
    lowest = 1.0 / (times[-1] - times[0])
    return float(min(_BAND_FACTOR * max(*own, lowest), HIGHEST * rate))


class Filter(NamedTuple):
    """Zero-phase low-pass with decimation: rows of a sparse matrix, one for each sample kept.

    Attributes:
        taps: Weights of a window of samples, sum 1, shape (l,).
        step: Samples from one window to the next.
    """

    taps: Array
    step: int

    @classmethod
    def of(cls, rate: float, band: float) -> "Filter":
        """The filter of a band.

        Args:
            rate: Of the samples [Hz].
            band: Its end [Hz].

        Source: A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 2010, section
            7.5 (windowed sinc, Hamming).
        """
        half = int(np.ceil(_HALF_LENGTH * rate / band))
        at = np.arange(-half, half + 1)
        taps = np.sinc(2.0 * band / rate * at) * np.hamming(2 * half + 1)
        return cls(taps / taps.sum(), max(int(rate / (_KEPT_GRID * band)), 1))

    @property
    def correlation(self) -> Array:
        """Of white noise behind it, of samples kept so many apart, 1 first, shape (k,)."""
        lags = range(0, len(self.taps), self.step)
        found = np.array([self.taps[: len(self.taps) - lag] @ self.taps[lag:] for lag in lags])
        return np.asarray(found / found[0])

    def starts(self, count: int) -> NDArray[np.intp]:
        """First samples of the windows in a piece of so many samples."""
        return np.arange(0, count - len(self.taps) + 1, self.step)

    def passed(self, values: Array) -> Array:
        """Samples of a piece through the filter: shape (windows, ..) of values (n, ..)."""
        starts = self.starts(len(values))
        flat = values.reshape(len(values), -1)
        found = np.empty((len(starts), flat.shape[1]))
        size = max(8 * len(self.taps), 256)  # samples of a dense block of the matrix
        count = max((size - len(self.taps)) // self.step + 1, 1)
        for first in range(0, len(starts), count):
            some = starts[first : first + count]
            begin, end = some[0], some[-1] + len(self.taps)
            block = np.zeros((len(some), end - begin))
            for row, start in zip(block, some - begin, strict=True):
                row[start : start + len(self.taps)] = self.taps
            found[first : first + count] = block @ flat[begin:end]
        return found.reshape(len(starts), *values.shape[1:])


def grid_step(rate: float, band: float) -> int:
    """Every how many samples the regressor is asked for."""
    return max(int(rate / (_GRID * band)), 1)


def check_units(
    where: str, labels: Sequence[str], joints: Sequence[Joint], given: Array, r: int
) -> None:
    """Refuse efforts that are the torque of the given robot times something else.

    Args:
        labels: Names of the joints.
        given: Base parameters of the description.
        r: Number of base parameters.

    Raises:
        DataError: Most joints that carry much say so.
    """
    slopes = {}
    for label, joint in zip(labels, joints, strict=True):
        model, y = joint.R[:, :r] @ given, joint.R[:, -1]
        plain = [i for i, c in enumerate(joint.columns) if c.term in ("viscous", "offset")]
        dry = [i for i, c in enumerate(joint.columns) if c.term == "coulomb"][2:3]
        others = joint.R[:, [r + i for i in plain + dry]]
        alone = model - others @ solved(others, model)[0] if others.shape[1] else model
        left = y - others @ solved(others, y)[0] if others.shape[1] else y
        if np.linalg.norm(alone) < 1e-9 * max(np.linalg.norm(y), 1e-300) or not left.any():
            continue
        along = float(alone @ left) / float(np.linalg.norm(alone) * np.linalg.norm(left))
        if (
            abs(along) > 1.0 - _MATTERS
            and np.linalg.norm(left) > _MATTERS * np.linalg.norm(y) / 3.0
        ):
            slopes[label] = float(alone @ left / (alone @ alone))
    off = {
        name: slope for name, slope in slopes.items() if not _LOWEST_RATIO < slope < _HIGHEST_RATIO
    }
    if off and 2 * len(off) > len(slopes):
        found = ", ".join(f"{name} {slope:.3g}" for name, slope in off.items())
        raise DataError(
            f"{where}: efforts are the torques of the given robot times {found}: these look like "
            "motor currents, torques before the gear or of the other sign, not N·m at the joint; "
            "give the torque for a unit of effort of each joint, --gain JOINT=VALUE .., or have "
            "it estimated from what is known, --currents"
        )


def check_excitation(
    where: str,
    base: BaseParameters,
    texts: Sequence[str],
    rows: Array,
    partial: bool,
    in_phase: bool = False,
) -> list[str]:
    """Refuse a motion that hides base parameters, or name them.

    Args:
        base: What states can show.
        texts: Expressions of the base parameters.
        rows: Weighted rows of the base parameters, shape (k, r).
        partial: Name them only.
        in_phase: All joints move in one phase, which tells sums from parts by curvature alone.

    Raises:
        DataError: With the names.
    """
    most = _IN_PHASE if in_phase else _CONDITION
    scale = np.linalg.norm(rows, axis=0)
    hidden = scale <= 1e-9 * scale.max(initial=0.0)
    seen = np.flatnonzero(~hidden)
    _, s, V = np.linalg.svd(rows[:, seen] / scale[seen], full_matrices=True)
    s = np.r_[s, np.zeros(len(seen) - len(s))]
    weak = V[s * most < s.max(initial=0.0)]
    hidden[seen] |= (np.abs(weak) > _HIDDEN_PART).any(axis=0)
    if not hidden.any():
        return []
    names = [texts[i] for i in np.flatnonzero(hidden)]
    how = ", all joints in one phase," if in_phase else ""
    said = f"{where}: the motion{how} does not show {'; '.join(names)}"
    if not partial:
        raise DataError(
            f"{said}. Move all joints, together and fast (mbd-ros excite makes such a motion), or "
            "go on without these (--partial)"
        )
    return [said]


def check_still(
    where: str,
    movement: Sequence[tuple[str, float, str]],
    texts: Sequence[str],
    partial: bool,
) -> list[str]:
    """Refuse joints that do not move, with the parameters that they would show.

    Args:
        movement: Of each row: name, how far it moves [rad or m], body that it moves first.
        texts: Expressions of the base parameters.
        partial: Name them only.

    Raises:
        DataError: With the names.
    """
    said = []
    for label, far, body in movement:
        if far < _LEAST_MOTION:
            own = [text for text in texts if text.startswith(f"{body}.")]
            shown = f": that does not show {'; '.join(own)}" if own else ""
            said.append(f"{where}: {label} moves by {far:.2g} only{shown}")
    if said and not partial:
        raise DataError(f"{said[0]}. Let it move, or go on without these (--partial)")
    return said


def check_length(where: str, joints: Sequence[Joint], unknown: int, seconds: float) -> None:
    """Refuse a recording with fewer independent rows than unknowns.

    Raises:
        DataError: Says how long it would have to be.
    """
    rows = sum(joint.rows for joint in joints)
    if rows < _FEWEST_ROWS * unknown:
        enough = (
            f"; about {seconds * _FEWEST_ROWS * unknown / rows:.3g} s would do" if rows else ""
        )
        raise DataError(
            f"{where}: {seconds:.3g} s to learn from are too short: {rows:.0f} independent values "
            f"for {unknown} unknowns{enough}"
        )
