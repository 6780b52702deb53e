"""Recordings as gap-free pieces of samples, their frequency band, and checks of their content.

A recording is split into a part for the fit and a part for the test. A low-pass filter keeps the
band in which motions show masses. Motions and efforts that do not determine the parameters are
refused, with messages for the person who recorded them.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mbd_ros.core.state import NANOSECOND, Array, Motion, WrenchSamples
from mbd_ros.errors import DataError
from mbd_ros.features.identification.least_squares import Joint, solve_scaled
from mbd_ros.features.identification.regressor import BaseParameters
from mbd_ros.jobs.progress import Say
from mbd_ros.motion.derivatives import Derivatives, differentiate
from mbd_ros.motion.external_loads import read_loads, wrench_at
from mbd_ros.motion.filters import zero_phase
from mbd_ros.motion.long_stamps import parts_of
from mbd_ros.motion.recordings import Source, name_of, refuse_huge
from mbd_ros.motion.samples import Task, read_recording, select_rows
from mbd_ros.scene.built_scene import Scene

_LARGEST = 1.0e9  # rad, rad/s, N·m, ..: no machine reaches it, and its square would hide all else
_MEASURED_SHARE = 0.99  # of the samples: a joint with fewer efforts counts as unmeasured
_TRAINING_SHARE = 0.6  # of the time of a recording: the part for the fit; the rest is for the test
_ENERGY_SHARE = 0.999  # of the energy of a velocity lies below the frequency of the motion
_BAND_FACTOR = 5.0  # end of the band over that frequency; the band includes products of sines
_GRID = 20.0  # samples per period of the end of the band: friction changes sign within one
_OUTPUT_GRID = 2.5  # the same for filtered samples, which contain only the band
_HALF_LENGTH = 1.5  # half the length of the filter, in periods of the end of the band
HIGHEST = 0.2  # of the sampling rate: upper limit of the end of a band
_LOWEST_RATIO = 0.2  # of measured over given torque; descriptions are not worse than that
_HIGHEST_RATIO = 5.0
_EXPLAINED_SHARE = (
    0.3  # of the torque: the given robot explains so much, or units are not compared
)
_CONDITION = 2.0e4  # of scaled columns: beyond it, the motion hides some parameters
_IN_PHASE = 3.0e2  # the same for motions in which all joints follow one another
_HIDDEN_PART = 0.2  # components of a hidden direction from which parameters are named
_FEWEST_ROWS = 2.0  # independent rows for each unknown
_LEAST_MOTION = 0.02  # rad or m: a joint that moves less shows nothing


class Recorded(NamedTuple):
    """A recording, or a part of one.

    Attributes:
        where: Name of the recording, for messages.
        motion: Samples, independent joints first.
        loads: Measured wrenches by name.
        derivatives: Source of velocities and accelerations: given or zero-phase.
        payload: Inertial parameters of all bodies of a known load, shape (10 bodies,); None
            without a load.
    """

    where: str
    motion: Motion
    loads: dict[str, WrenchSamples]
    derivatives: str
    payload: Array | None = None

    @property
    def times(self) -> Array:
        """Times since the first sample [s]."""
        times: Array = (self.motion.stamps - self.motion.stamps[0]) * NANOSECOND
        return times


class Piece(NamedTuple):
    """Consecutive samples without a gap, low-passed.

    Attributes:
        times: Times [s], shape (n,).
        y: Independent coordinates, shape (n, ny).
        v: Their velocities, shape (n, nv_y).
        a: Their accelerations, same shape.
        effort: Low-passed efforts of the independent joints, shape (n, m), NaN if not measured.
        measured: Efforts without the low-pass.
        loads: Wrenches, shape (n, 6) each.
        rate: Measured velocities of the independent joints, shape (n, m), NaN if not measured.
        payload: Inertial parameters of a known load, as in `Recorded`.
    """

    times: Array
    y: Array
    v: Array
    a: Array
    effort: Array
    measured: Array
    loads: list[Array]
    rate: Array
    payload: Array | None


def load_recording(
    scene: Scene,
    source: Source,
    *,
    wrenches: Source | None,
    topic: str,
    derivatives: str | None,
    say: Say,
) -> Recorded:
    """Load a recording with all that identification needs.

    Args:
        source: Result, file or bag.
        wrenches: Table of the external loads, where the motion does not contain them.
        topic: JointState topic of a bag.
        derivatives: given or zero-phase; None: given where the motion has accelerations.
        say: Receives a line for samples and wrenches that are left out.

    Raises:
        DataError: The recording cannot be read, or lacks a joint.
    """
    solver = scene.inverse_dynamics()
    task = Task(source, topic=topic)
    names = (*scene.couplings.independent, *scene.couplings.dependent)
    recording = read_recording(scene, task, names, solver.needed, say)
    loads, dropped = read_loads(scene, source, wrenches)
    for reason, count in dropped.items():
        say(f"{count} wrenches were left out: {reason}")
    for name, load in loads.items():
        names = [f"wrench {name}"] * load.wrench.shape[1]
        where = name_of(source if wrenches is None else wrenches)
        refuse_huge(where, names, load.wrench, largest=_LARGEST)
    motion, n = recording.motion, len(scene.couplings.independent)
    fields = motion.position, motion.velocity, motion.acceleration, motion.effort
    refuse_huge(name_of(source), motion.names, *fields, largest=_LARGEST)
    if derivatives is None:
        fields = (motion.velocity, motion.acceleration)
        is_complete = all(x is not None and np.isfinite(x[:, :n]).all() for x in fields)
        is_complete = is_complete and all(b.acceleration is not None for b in motion.bodies)
        derivatives = "given" if is_complete else "zero-phase"
    return Recorded(name_of(source), _fill_efforts(motion, n, say), loads, derivatives)


def _fill_efforts(motion: Motion, n: int, say: Say) -> Motion:
    """Interpolate the efforts of single samples that have none."""
    if motion.effort is None:
        return motion
    effort, times = motion.effort.copy(), motion.stamps * NANOSECOND
    for name, values in zip(motion.names[:n], effort[:, :n].T, strict=True):
        is_finite = np.isfinite(values)
        if is_finite.all() or is_finite.mean() <= _MEASURED_SHARE:
            continue
        say(f"{name}: interpolated {int((~is_finite).sum())} samples without an effort")
        values[~is_finite] = np.interp(times[~is_finite], times[is_finite], values[is_finite])
    return motion._replace(effort=effort)


def split_recording(
    recorded: Recorded, share: float = _TRAINING_SHARE
) -> tuple[Recorded, Recorded | None]:
    """Split a recording into a first part for the fit and a second part for the test.

    Args:
        share: Share of the time of the first part; with 1 there is no second part.
    """
    if share >= 1.0:
        return recorded, None
    times = recorded.times
    first = times <= share * times[-1]
    parts = (select_rows(recorded.motion, first), select_rows(recorded.motion, ~first))
    return recorded._replace(motion=parts[0]), recorded._replace(motion=parts[1])


def pieces(scene: Scene, recorded: Recorded, band: float | None) -> Iterator[Piece]:
    """Yield the gap-free pieces of a recording.

    Args:
        band: Cutoff of the low-pass of motions and efforts [Hz]; None: no low-pass.

    Raises:
        DataError: A piece has too few samples.
    """
    n = len(scene.couplings.independent)
    for part in parts_of(recorded.motion.stamps):
        motion = select_rows(recorded.motion, part)
        chosen = Derivatives(
            recorded.derivatives, band if recorded.derivatives != "given" else None
        )
        samples = differentiate(scene, recorded.where, motion, chosen).samples
        unmeasured = np.full((len(motion.stamps), n), np.nan)
        measured = unmeasured if motion.effort is None else motion.effort[:, :n]
        rate = unmeasured if motion.velocity is None else motion.velocity[:, :n]
        loads = [
            wrench_at(recorded.where, name, load, samples.stamps)
            for name, load in recorded.loads.items()
        ]
        low = measured
        if band is not None and recorded.derivatives != "given":
            low = _low_passed(motion, measured, band)
        times = motion.stamps * NANOSECOND
        yield Piece(times, *samples[1:4], low, measured, loads, rate, recorded.payload)


def _low_passed(motion: Motion, effort: Array, band: float) -> Array:
    """Return efforts without the frequencies that would alias on the grid of the regressor."""
    is_measured = np.isfinite(effort).all(axis=0)
    low = np.full_like(effort, np.nan)
    if is_measured.any():
        values = np.ascontiguousarray(effort[:, is_measured])
        low[:, is_measured] = zero_phase(motion.stamps, values, cutoff=4.0 * band).position
    return low


def check_efforts(scene: Scene, recorded: Sequence[Recorded], passive: Sequence[str]) -> None:
    """Refuse recordings without efforts of the joints that motors drive.

    Raises:
        DataError: An effort is missing or 0 throughout; the message names recording and joints.
    """
    names = scene.couplings.independent
    for part in recorded:
        effort = part.motion.effort
        is_measured = np.zeros(len(names), dtype=np.bool_)
        if effort is not None:
            is_measured = np.isfinite(effort[:, : len(names)]).mean(axis=0) > _MEASURED_SHARE
        missing = [name for name, there in zip(names, is_measured, strict=True) if not there]
        missing = [name for name in missing if name not in passive]
        if missing:
            raise DataError(
                f"{part.where}: no effort of {', '.join(missing)}; identification needs the "
                "measured torque of every joint that a motor drives; name all other joints with "
                "--passive JOINT .. and record the wrenches that act on them"
            )
        if effort is None:
            continue
        zero = [n for i, n in enumerate(names) if is_measured[i] and not effort[:, i].any()]
        zero = [name for name in zero if name not in passive]
        if zero:
            raise DataError(
                f"{part.where}: the effort of {', '.join(zero)} is 0 in every sample, so the "
                "driver does not measure it; record measured efforts, or name joints without a "
                "motor (--passive JOINT ..)"
            )


def cutoff_frequencies(scene: Scene, recorded: Recorded) -> Array:
    """Return the cutoff frequencies from the spectra of the joints [Hz], inf for none."""
    if recorded.derivatives == "given":
        return np.full(1, np.inf)
    chosen = Derivatives(recorded.derivatives)
    cutoff = differentiate(scene, recorded.where, recorded.motion, chosen).cutoff
    return np.full(1, np.inf) if cutoff is None else cutoff


def band_of(times: Array, velocity: Array) -> float:
    """Return the end of the frequency band of a motion [Hz].

    Args:
        times: Times [s], shape (n,).
        velocity: Velocities of the joints [rad/s or m/s], shape (n, m).
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
    frequencies = [frequency[np.searchsorted(b, _ENERGY_SHARE)] for b in below.T]
    lowest = 1.0 / (times[-1] - times[0])
    return float(min(_BAND_FACTOR * max(*frequencies, lowest), HIGHEST * rate))


class Filter(NamedTuple):
    """Zero-phase low-pass with decimation.

    Attributes:
        taps: Weights of a window of samples, sum 1, shape (l,).
        step: Input samples per output sample.
    """

    taps: Array
    step: int

    @classmethod
    def of(cls, rate: float, band: float) -> "Filter":
        """Return the filter of a band.

        Args:
            rate: Sampling rate [Hz].
            band: End of the band [Hz].

        Source: A. V. Oppenheim, R. W. Schafer, Discrete-Time Signal Processing, 2010, section
            7.5 (windowed sinc, Hamming).
        """
        half = int(np.ceil(_HALF_LENGTH * rate / band))
        offsets = np.arange(-half, half + 1)
        taps = np.sinc(2.0 * band / rate * offsets) * np.hamming(2 * half + 1)
        return cls(taps / taps.sum(), max(int(rate / (_OUTPUT_GRID * band)), 1))

    @property
    def correlation(self) -> Array:
        """Autocorrelation of filtered white noise by distance in output samples, shape (k,)."""
        lags = range(0, len(self.taps), self.step)
        products = np.array([self.taps[: len(self.taps) - lag] @ self.taps[lag:] for lag in lags])
        return np.asarray(products / products[0])

    def starts(self, count: int) -> NDArray[np.intp]:
        """Return the first samples of the windows of a piece with `count` samples."""
        return np.arange(0, count - len(self.taps) + 1, self.step)

    def apply(self, values: Array) -> Array:
        """Return filtered values of a piece, shape (windows, ..) for values of shape (n, ..)."""
        starts = self.starts(len(values))
        flat = values.reshape(len(values), -1)
        filtered = np.empty((len(starts), flat.shape[1]))
        size = max(8 * len(self.taps), 256)  # samples of a dense block of the filter matrix
        count = max((size - len(self.taps)) // self.step + 1, 1)
        for first in range(0, len(starts), count):
            windows = starts[first : first + count]
            begin, end = windows[0], windows[-1] + len(self.taps)
            block = np.zeros((len(windows), end - begin))
            for row, start in zip(block, windows - begin, strict=True):
                row[start : start + len(self.taps)] = self.taps
            filtered[first : first + count] = block @ flat[begin:end]
        return filtered.reshape(len(starts), *values.shape[1:])


def grid_step(rate: float, band: float) -> int:
    """Return the number of samples from one evaluation of the regressor to the next."""
    return max(int(rate / (_GRID * band)), 1)


def check_units(
    where: str, labels: Sequence[str], joints: Sequence[Joint], nominal: Array, r: int
) -> None:
    """Refuse efforts that are proportional to the torques of the given robot, but not equal.

    Args:
        labels: Names of the joints.
        nominal: Base parameters of the description.
        r: Number of base parameters.

    Raises:
        DataError: The efforts of most joints whose torque is significant have other units.
    """
    slopes = {}
    for label, joint in zip(labels, joints, strict=True):
        model, y = joint.R[:, :r] @ nominal, joint.R[:, -1]
        plain = [i for i, c in enumerate(joint.columns) if c.term in ("viscous", "offset")]
        dry = [i for i, c in enumerate(joint.columns) if c.term == "coulomb"][2:3]
        others = joint.R[:, [r + i for i in plain + dry]]
        ours = model - others @ solve_scaled(others, model)[0] if others.shape[1] else model
        theirs = y - others @ solve_scaled(others, y)[0] if others.shape[1] else y
        if np.linalg.norm(ours) < 1e-9 * max(np.linalg.norm(y), 1e-300) or not theirs.any():
            continue
        cosine = float(ours @ theirs) / float(np.linalg.norm(ours) * np.linalg.norm(theirs))
        if (
            abs(cosine) > 1.0 - _EXPLAINED_SHARE
            and np.linalg.norm(theirs) > _EXPLAINED_SHARE * np.linalg.norm(y) / 3.0
        ):
            slopes[label] = float(ours @ theirs / (ours @ ours))
    off = {
        name: slope for name, slope in slopes.items() if not _LOWEST_RATIO < slope < _HIGHEST_RATIO
    }
    if off and 2 * len(off) > len(slopes):
        factors = ", ".join(f"{name} {slope:.3g}" for name, slope in off.items())
        raise DataError(
            f"{where}: efforts are the torques of the given robot times {factors}: these look "
            "like motor currents, or torques before the gear or of the other sign, not N·m at the "
            "joint; give the torque for a unit of effort of each joint (--gain JOINT=VALUE ..), "
            "or let it be estimated from known bodies (--currents)"
        )


def check_excitation(
    where: str,
    base: BaseParameters,
    texts: Sequence[str],
    rows: Array,
    partial: bool,
    in_phase: bool = False,
) -> list[str]:
    """Refuse a motion that hides base parameters, or return a line that names them.

    Args:
        base: Base parameters that motions can show.
        texts: Expressions of the base parameters.
        rows: Weighted rows of the base parameters, shape (k, r).
        partial: Whether to return a line instead of raising.
        in_phase: Whether all joints move in one phase, so that only the curvature of the motion
            separates some parameters.

    Raises:
        DataError: The motion hides some parameters.
    """
    limit = _IN_PHASE if in_phase else _CONDITION
    scale = np.linalg.norm(rows, axis=0)
    hidden = scale <= 1e-9 * scale.max(initial=0.0)
    visible = np.flatnonzero(~hidden)
    _, s, V = np.linalg.svd(rows[:, visible] / scale[visible], full_matrices=True)
    s = np.r_[s, np.zeros(len(visible) - len(s))]
    weak = V[s * limit < s.max(initial=0.0)]
    hidden[visible] |= (np.abs(weak) > _HIDDEN_PART).any(axis=0)
    if not hidden.any():
        return []
    names = [texts[i] for i in np.flatnonzero(hidden)]
    phase = ", with all joints in one phase," if in_phase else ""
    message = f"{where}: the motion{phase} does not show {'; '.join(names)}"
    if not partial:
        raise DataError(
            f"{message}. Move all joints at once and fast (see mbd-ros excite), "
            "or identify the other parameters only (--partial)"
        )
    return [message]


def check_still(
    where: str,
    movement: Sequence[tuple[str, float, str]],
    texts: Sequence[str],
    partial: bool,
) -> list[str]:
    """Refuse joints that do not move, or return lines with the parameters that they hide.

    Args:
        movement: Name, range of motion [rad or m] and first moved body of each row.
        texts: Expressions of the base parameters.
        partial: Whether to return lines instead of raising.

    Raises:
        DataError: A joint does not move.
    """
    lines = []
    for label, extent, body in movement:
        if extent < _LEAST_MOTION:
            parameters = [text for text in texts if text.startswith(f"{body}.")]
            hidden = f" and does not show {'; '.join(parameters)}" if parameters else ""
            lines.append(f"{where}: {label} moves by only {extent:.2g}{hidden}")
    if lines and not partial:
        raise DataError(
            f"{lines[0]}. Move this joint, or identify the other parameters only (--partial)"
        )
    return lines


def check_length(where: str, joints: Sequence[Joint], unknown: int, seconds: float) -> None:
    """Refuse a recording with too few independent rows for its unknowns.

    Raises:
        DataError: The recording is too short; the message tells a sufficient duration.
    """
    rows = sum(joint.rows for joint in joints)
    if rows < _FEWEST_ROWS * unknown:
        enough = (
            f"; record at least {seconds * _FEWEST_ROWS * unknown / rows:.3g} s" if rows else ""
        )
        raise DataError(
            f"{where}: the {seconds:.3g} s for the fit are too short: {rows:.0f} independent "
            f"values for {unknown} unknowns{enough}"
        )
