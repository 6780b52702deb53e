"""Derivatives without lag against exact ones: rates, noise of every kind, gaps, short recordings.

The cut-off is that of the recording unless a test says otherwise.
"""

import re

import numpy as np
import pytest
from offline import SCENES
from scipy.interpolate import BSpline, CubicSpline

from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.files.bags.bag_writer import Spool, StampSpool
from mbd_ros.files.tables.csv import read_table, write_table
from mbd_ros.methods.signals.spectrum import spectrum
from mbd_ros.methods.signals.spline_basis import CellBasis, join_cells, split_cells
from mbd_ros.motion.filters import chosen_cutoffs, low_passed, smoothed, zero_phase
from mbd_ros.motion.long_stamps import Windows

SECOND = 1_000_000_000
TURN = 2 * np.pi
SLOW = (0.5, 0.1), (0.3, 0.25), (0.2, 0.6)  # rad, Hz: an arm that excites its parameters
STEP = tuple((0.5 / k**2, float(k)) for k in range(1, 8))  # human walking: harmonics to 7 Hz
BUZZ = (0.5, 0.3), (0.02, 8.0)  # slow, with a vibration far above


def motion(tones, t, order=0):
    """Sum of sines, or its derivatives, as a column; neither starts nor ends at rest."""
    return sum(
        a * (TURN * f) ** order * np.sin(TURN * f * t + i + order * np.pi / 2)
        for i, (a, f) in enumerate(tones)
    )[:, None]


def stamps_of(t):
    return np.round(t * SECOND).astype(np.int64) + 1_760_000_000 * SECOND


def rms(values):
    return np.sqrt(np.mean(values**2))


def error(tones, t, x, velocity=None, **options):
    """Root mean square error of the acceleration over that of the acceleration; the cut-off."""
    found, exact = zero_phase(stamps_of(t), x, velocity, **options), motion(tones, t, 2)
    return rms(found.acceleration - exact) / rms(exact), found.cutoff


@pytest.mark.parametrize("tones", [SLOW, STEP, BUZZ])
@pytest.mark.parametrize("rate", [100, 500, 1000])
@pytest.mark.parametrize("noise", [1e-5, 5e-5, 5e-4])
def test_noise_at_any_rate_leaves_a_few_percent(tones, rate, noise):
    t, rng = np.arange(0, 8, 1 / rate), np.random.default_rng(1)
    x = motion(tones, t) + noise * rng.normal(size=(len(t), 1))
    found, cutoff = error(tones, t, x)
    assert found <= (0.06 if noise < 1e-4 else 0.12)
    assert cutoff[0] > max(f for _, f in tones)


@pytest.mark.parametrize("tones", [SLOW, STEP, BUZZ])
@pytest.mark.parametrize("rate", [100, 1000])
def test_nothing_is_lost_where_there_is_no_noise(tones, rate):
    t = np.arange(0, 8, 1 / rate)
    found, cutoff = error(tones, t, motion(tones, t))
    assert found <= (2e-3 if rate == 100 else 1e-6)
    assert cutoff[0] >= 25 * (tones is not SLOW)
    found, _ = error(tones, t, motion(tones, t), motion(tones, t, 1))
    assert found <= (2e-4 if rate == 100 else 1e-6)


@pytest.mark.parametrize("rate", [60, 125, 500])
@pytest.mark.parametrize("noise", [0.0, 2.5e-4])
def test_weak_harmonics_of_a_long_walk_are_motion(rate, noise):
    """The third harmonic has 1 % of the variance of the position, the second less; 70 % of the
    variance of the acceleration lie above."""
    sizes = 0.22, 0.018, 0.02, 0.008, 0.012, 0.004, 0.003
    tones = tuple((a, 0.72 * k) for k, a in enumerate(sizes, 1))
    t, rng = np.arange(0, 20, 1 / rate), np.random.default_rng(8)
    measured = motion(tones, t, 1) + noise * rng.normal(size=(len(t), 1))
    for given in (None, measured):
        x = motion(tones, t) + (0.02 * noise * rng.normal(size=(len(t), 1)))
        found, cutoff = error(tones, t, x, given)
        assert found <= 0.03
        assert cutoff[0] > 5.0


@pytest.mark.parametrize("rate", [100, 200, 500, 1000])
@pytest.mark.parametrize("noise", [1e-5, 1e-4])
def test_samples_that_a_driver_repeats_are_no_motion(rate, noise):
    """New values come at 50 Hz: stairs, whose edges would be blows of thousands of rad/s^2."""
    t, rng = np.arange(0, 10, 1 / rate), np.random.default_rng(9)
    held = np.arange(len(t)) // (rate // 50) * (rate // 50)
    x = (motion(SLOW, t) + noise * rng.normal(size=(len(t), 1)))[held]
    found, cutoff = error(SLOW, t, x)
    assert found <= 0.3
    assert cutoff[0] == pytest.approx(50.0 / 8.0, rel=1e-6) or cutoff[0] < 50.0 / 8.0


@pytest.mark.parametrize("noise", [1e-3, 1e-2])
def test_measured_velocity_is_smoothed_and_differentiated(noise):
    t, rng = np.arange(0, 8, 2e-3), np.random.default_rng(2)
    rough = [5e-5 * rng.normal(size=(len(t), 1)), noise * rng.normal(size=(len(t), 1))]
    found, _ = error(SLOW, t, motion(SLOW, t) + rough[0], motion(SLOW, t, 1) + rough[1])
    assert found <= 0.05
    smooth = zero_phase(stamps_of(t), motion(SLOW, t), motion(SLOW, t, 1) + rough[1])
    assert rms(smooth.velocity - motion(SLOW, t, 1)) < 0.2 * noise


@pytest.mark.parametrize("counts", [4096, 65536])
@pytest.mark.parametrize("rate", [200, 1000])
def test_encoder_counts_are_noise_even_where_they_repeat(counts, rate):
    """A motion of which a period is a whole number of samples has rounding in lines only."""
    t, size = np.arange(0, 20, 1 / rate), TURN / counts
    found, _ = error(((0.3, 0.8),), t, np.round(motion(((0.3, 0.8),), t) / size) * size)
    assert found <= 0.03


@pytest.mark.parametrize("span", [2, 8])
@pytest.mark.parametrize("rate", [30, 100, 1000])
def test_joint_that_crosses_few_counts_creeps(rate, span):
    """4 mrad are 7 counts of an encoder, 1 mrad two: taken as they are, each is a blow."""
    t, size = np.arange(0, span, 1 / rate), TURN / 4096
    slow = np.hstack([motion(((a, f),), t) for a, f in ((4e-3, 0.5), (1e-3, 0.3))])
    found = zero_phase(stamps_of(t), np.round(slow / size) * size)
    assert rms(found.acceleration) < 0.05
    assert found.cutoff.tolist() == [2.0, 2.0]


def test_noise_that_was_resampled_is_no_motion():
    """0.3 mrad at 30 Hz look smooth at 1 kHz; below them there is white noise of 0.05 mrad."""
    rng, coarse, t = np.random.default_rng(3), np.arange(0, 20.1, 1 / 30), np.arange(0, 20, 1e-3)
    rough = motion(SLOW, coarse) + 3e-4 * rng.normal(size=(len(coarse), 1))
    found, cutoff = error(
        SLOW, t, CubicSpline(coarse, rough)(t) + 5e-5 * rng.normal(size=(20000, 1))
    )
    assert found <= 0.06
    assert cutoff[0] < 6.0


def test_every_joint_has_the_cutoff_of_its_own_noise():
    t, rng = np.arange(0, 8, 2e-3), np.random.default_rng(4)
    noise = np.array([0.0, 1e-5, 3e-3]) * rng.normal(size=(len(t), 3))
    found = zero_phase(stamps_of(t), motion(SLOW, t) + noise)
    assert np.isinf(found.cutoff[0]) or found.cutoff[0] > 20.0
    assert found.cutoff[0] > found.cutoff[1] > found.cutoff[2] >= 2.0
    exact = motion(SLOW, t, 2)
    errors = [rms(column - exact[:, 0]) / rms(exact) for column in found.acceleration.T]
    assert errors[0] < 1e-4 and errors[1] < 0.02 and errors[2] < 0.15


def test_joint_that_only_has_noise_stands_still():
    t, rng = np.arange(0, 8, 1e-3), np.random.default_rng(5)
    found = zero_phase(stamps_of(t), 1.0 + 1e-3 * rng.normal(size=(len(t), 1)))
    assert rms(found.acceleration) < 0.02
    still = zero_phase(stamps_of(t), np.ones((len(t), 1)))
    assert np.abs(still.acceleration).max() < 1e-6  # rounding of 1 at 1 kHz


def test_irregular_stamps_lost_samples_and_gaps():
    rng = np.random.default_rng(6)
    t = np.cumsum(rng.uniform(5e-4, 4e-3, 8000))
    t = t[rng.uniform(size=len(t)) > 0.1]
    t = t[(t < 6.0) | (t > 9.0)]
    x = motion(SLOW, t) + 5e-5 * rng.normal(size=(len(t), 1))
    assert error(SLOW, t, x)[0] <= 0.06
    assert error(SLOW, t, motion(SLOW, t))[0] <= 1e-4
    lone = np.r_[t, t[-1] + 5.0, t[-1] + 5.1]
    with pytest.raises(DataError, match=r"6 samples in a row, from .* there are 2 between gaps"):
        zero_phase(stamps_of(lone), motion(SLOW, lone))


@pytest.mark.parametrize("count", [6, 8, 12, 20])
def test_recordings_of_few_samples(count):
    t = np.arange(count) * 0.01
    assert error(SLOW, t, motion(SLOW, t))[0] <= 0.02
    with pytest.raises(DataError, match="at least 6 samples, there are 5"):
        zero_phase(stamps_of(t[:5]), motion(SLOW, t[:5]))


@pytest.mark.parametrize(
    ("count", "noise", "said"),
    [
        (20, 0.0, "warning: zero-phase derivatives: not smoothed, since 20 samples are too few"),
        (200, 0.0, "warning: zero-phase derivatives: not smoothed, since no noise is found in"),
        (300, 0.0, "\nzero-phase derivatives: not smoothed, since no noise is found: hinge"),
        (300, 0.1, "warning: zero-phase derivatives: 2 Hz is the lowest cut-off that is chosen"),
    ],
)
def test_what_a_recording_cannot_tell_is_warned_of(tmp_path, capsys, count, noise, said):
    t, rng = np.arange(count) * 0.01, np.random.default_rng(2)
    noisy = motion(SLOW, t).ravel() + noise * rng.standard_normal(count)
    write_table(tmp_path / "m.csv", ["time", "hinge.position"], np.c_[t, noisy])
    (tmp_path / "s.yaml").write_text(
        f"robot: {{urdf: {SCENES.parent / 'robots/pendulum.urdf'}}}\n", encoding="utf-8"
    )
    words = ["inverse", tmp_path / "s.yaml", tmp_path / "m.csv", "-o", tmp_path / "o.csv"]
    assert main([*map(str, words), "--derivatives", "zero-phase"]) == 0
    assert said in "\n" + capsys.readouterr().out


@pytest.mark.parametrize("rate", [100, 1000])
def test_cutoff_is_the_frequency_of_half_power_without_lag(rate):
    t, inner = np.arange(0, 10, 1 / rate), slice(2 * rate, 8 * rate)
    found = zero_phase(stamps_of(t), motion(((1.0, 3.0),), t), cutoff=3.0)
    assert found.cutoff.tolist() == [3.0]
    for got, order in ((found.position, 0), (found.velocity, 1), (found.acceleration, 2)):
        basis = [motion(((1.0, 3.0),), t, order + k)[inner, 0] for k in (0, 1)]
        share, lag = np.linalg.lstsq(np.column_stack(basis), got[inner, 0], rcond=None)[0]
        assert share == pytest.approx(np.sqrt(0.5), abs=0.03)
        assert abs(lag) < 1e-5
    windows = Windows(stamps_of(t), found.cutoff)
    ((passed, step),) = low_passed(windows, motion(((1.0, 3.0),), t), found.cutoff)
    places = t[0] + step * (np.arange(len(passed)) + 0.5)
    through = CubicSpline(t, found.position)(places)
    assert passed == pytest.approx(through, abs=2e-5 if rate == 100 else 1e-8)
    assert step * len(passed) == pytest.approx(t[-1] - t[0], rel=1e-12)


@pytest.mark.parametrize(
    ("cutoffs", "most"),
    [
        *(((3.0, 3.0, 3.0), 1e-9), ((0.75, 3.0, 41.0), 1e-9), ((5.0, 0.3, 90.0), 1e-9)),
        ((1.9, 3.0, 41.0), 0.01),  # noise at the cut-off feels that cells are narrower
    ],
)
def test_joints_of_any_cutoffs_are_smoothed_as_by_themselves(cutoffs, most):
    """Looked at together, in cells of one another, or through the samples (above 40 Hz)."""
    t, rng = np.arange(0, 20, 0.01), np.random.default_rng(11)
    x, v = (np.hstack([motion(SLOW, t + i, k) for i in range(3)]) for k in (0, 1))
    x, v = x + 1e-3 * rng.normal(size=x.shape), v + 1e-2 * rng.normal(size=x.shape)
    v[:, 1] = np.nan
    measured, cutoff, moving = ~np.isnan(v).any(axis=0), np.array(cutoffs), np.hstack([x, v])
    ((_, *found),) = smoothed(Windows(stamps_of(t), cutoff), moving, measured, cutoff)
    for j, own in enumerate(cutoffs):
        alone = zero_phase(stamps_of(t), x[:, [j]], v[:, [j]], cutoff=own)
        for ours, theirs in zip(found, alone[:3], strict=True):
            assert np.abs(ours[:, j] - theirs[:, 0]).max() <= most * np.abs(theirs).max()


@pytest.mark.parametrize("cutoff", [1e-300, 1e-3, 30.0, 1e300])
def test_extreme_cutoffs_are_finite(cutoff):
    t = np.arange(0, 4, 0.02)
    found = zero_phase(stamps_of(t), motion(SLOW, t), cutoff=cutoff)
    assert np.isfinite(found.acceleration).all()
    assert found.cutoff[0] == (cutoff if cutoff < 20.0 else np.inf)


@pytest.mark.parametrize("rate", [30, 1000])
def test_inverse_says_the_cutoff_and_how_far_it_is_off_the_measured_effort(tmp_path, capsys, rate):
    """Efforts with a tremor that the motion cannot have: both sides pass the same low-pass."""
    t, rng = np.arange(0, 8, 1 / rate), np.random.default_rng(7)
    names, scene = ["ankle", "hip_flexion", "knee"], SCENES / "prosthetic_leg.yaml"
    x, v, a = (
        np.hstack([motion(SLOW, t + i, k) - 0.5 * (k == 0) for i in range(3)]) for k in range(3)
    )
    columns = [f"{n}.{f}" for f in ("position", "velocity", "acceleration") for n in names]
    write_table(tmp_path / "exact.csv", ["time", *columns], np.column_stack([t, x, v, a]))
    words = ["inverse", scene, tmp_path / "exact.csv", "-o", tmp_path / "torques.csv"]
    assert main([str(word) for word in words]) == 0
    table = read_table(tmp_path / "torques.csv")
    efforts = table.values[:, [table.columns.index(f"{n}.effort") for n in names]]
    tremor = efforts + 0.5 * rms(efforts) * np.sin(TURN * 0.4 * rate * t)[:, None]
    noisy = x + 5e-5 * rng.normal(size=x.shape)
    columns = [f"{n}.{f}" for f in ("position", "effort") for n in names]
    write_table(tmp_path / "m.csv", ["time", *columns], np.column_stack([t, noisy, tremor]))
    capsys.readouterr()
    words = ["inverse", scene, tmp_path / "m.csv", "-o", tmp_path / "o.csv"]
    assert main([*map(str, words), "--derivatives", "zero-phase"]) == 0
    said = capsys.readouterr().out
    assert re.search(
        r"low-pass of half power at [\d.]+ Hz.*, from the noise of the recording", said
    )
    assert float(re.search(r"off the measured effort by ([\d.e-]+) %", said)[1]) < 3.0
    found = read_table(tmp_path / "o.csv")
    ours = found.values[:, [found.columns.index(f"{n}.effort") for n in names]]
    assert rms(ours - efforts) < 0.03 * rms(efforts)


@pytest.mark.parametrize("rate", [200, 400])
def test_windows_of_a_long_recording_are_smoothed_as_the_whole(monkeypatch, rate):
    """Stamps that jitter, a gap, cut-offs of their own; one joint with a measured velocity."""
    rng = np.random.default_rng(8)
    t = np.arange(0, 60, 1 / rate) + rng.uniform(0, 0.3 / rate, 60 * rate)
    t[len(t) // 3 :] += 2.0
    x, v = motion(SLOW, t), motion(SLOW, t, 1)
    noise = [1e-4, 3e-4, 1e-3, 0.0] * rng.normal(size=(2, len(t), 4))
    x, v = x + noise[0], v + noise[1]
    v[:, 1:] = np.nan
    whole = zero_phase(stamps_of(t), x, v)
    monkeypatch.setattr("mbd_ros.motion.long_stamps._WINDOW", 8 * rate)
    monkeypatch.setattr("mbd_ros.motion.long_stamps._BESIDE", 100)
    found = zero_phase(stamps_of(t), x, v)
    assert (found.cutoff == whole.cutoff).all() and np.isfinite(whole.cutoff).any()
    for ours, theirs in zip(found[:3], whole[:3], strict=True):
        off = np.abs(ours - theirs).max(axis=0) / np.abs(theirs).max()
        # without noise the cut-off is high, and rounding of a position grows by its square
        assert (off <= np.where(found.cutoff < 20.0, 1e-10, 1e-8)).all()


def placed(cells, uneven):
    """Samples with as many a cell each, with a few more or less, with very many and none."""
    rng = np.random.default_rng(2)
    places = np.arange(0, 40, 0.1) + 0.04
    if uneven:
        places = np.sort(np.r_[places + uneven * rng.uniform(size=400), 7 + rng.uniform(size=90)])
        places = places[(places < 20) | (places > 23)]
    return places * (cells / 48), rng.uniform(0.5, 1.0, len(places))


@pytest.mark.parametrize("uneven", [0.0, 0.3, 5.0])
@pytest.mark.parametrize("cells", [48, 400, 3000])
def test_sums_and_values_in_rows_are_those_of_scipys_splines(cells, uneven):
    """Several samples a cell, about one, and several cells a sample."""
    places, weights = placed(cells, uneven)
    basis, rng, n = CellBasis(places, cells, weights), np.random.default_rng(4), len(places)
    knots = np.arange(-5.0, cells + 6.0)
    for level in (0, 1, 3):
        wide = np.arange(-5.0, cells // 2**level + 6.0)
        theirs = BSpline.design_matrix(places / 2**level, wide, 5)
        normal = (theirs.T @ theirs.multiply(weights[:, None])).tocsr()
        ours = basis.normal(level)
        for d in range(6):
            assert np.abs(ours[5 - d, d:] - normal.diagonal(d)).max() <= 1e-12 * np.abs(ours).max()
    values, some = rng.normal(size=(n, 4)), np.array([2, 0, 1])
    sums = basis.projected(values, some)
    theirs = BSpline.design_matrix(places, knots, 5).T @ (weights[:, None] * values[:, some])
    assert np.abs(sums - theirs.T).max() <= 1e-13 * np.abs(sums).max()
    coefficients, found = rng.normal(size=(3, cells + 5)), np.full((3, n - 20, 4), np.nan)
    wanted = [(k, np.array([1, 2]), found[k], np.array([3, 0])) for k in range(3)]
    basis.put(coefficients, 2.0, wanted, slice(5, n - 15))
    exact = BSpline(knots, coefficients[1:].T, 5)
    for k, ours in enumerate(found):
        theirs = exact(places, nu=k)[5 : n - 15] / 2.0**k
        assert np.abs(ours[:, [3, 0]] - theirs).max() <= 1e-12 * np.abs(theirs).max()
        assert np.isnan(ours[:, 1:3]).all()


def test_splines_of_pairs_of_cells_are_sums_of_splines_of_the_cells():
    places, weights = placed(48, 0.3)
    fine, wide = (CellBasis(places / k, 48 // k, weights) for k in (1, 2))
    rng, n = np.random.default_rng(5), len(places)
    values, every = rng.normal(size=(n, 3)), np.arange(3)
    sums = wide.projected(values, every)
    assert (
        np.abs(join_cells(fine.projected(values, every)) - sums).max()
        <= 1e-13 * np.abs(sums).max()
    )
    coefficients, found = rng.normal(size=(3, 24 + 5)), np.empty((2, n, 3))
    for own, basis, target in zip(
        (split_cells(coefficients), coefficients), (fine, wide), found, strict=True
    ):
        basis.put(own, 1.0, [(0, every, target, every)], slice(0, n))
    assert np.abs(found[0] - found[1]).max() <= 1e-13 * np.abs(found).max()


def test_density_of_white_noise_below_a_motion_of_which_it_is_a_trillionth():
    """1e-7 rad at 1 kHz are 2e-17 rad^2/Hz; 3 rad that end in the middle of a swing, 1e12 more."""
    t, rng = np.arange(0, 30, 1e-3), np.random.default_rng(3)
    x = 3.0 * motion(((1.0, 0.21),), t) + 1e-7 * rng.normal(size=(len(t), 4))
    found = spectrum([(t, x)])
    for low, high in ((5, 10), (50, 100), (300, 499)):
        own = (found.frequency > low) & (found.frequency < high)
        assert found.density[own].mean(axis=0) == pytest.approx(2e-17, rel=0.35)
    jitter = t + rng.uniform(0, 3e-4, len(t))
    jitter[1::9] += 2e-4
    x = 3.0 * motion(((1.0, 0.21),), jitter) + 1e-7 * rng.normal(size=(len(t), 4))
    found = spectrum([(jitter[:17000], x[:17000]), (jitter[17000:], x[17000:])])
    own = (found.frequency > 50) & (found.frequency < 100)
    assert found.density[own].mean(axis=0) == pytest.approx(2e-17, rel=0.35)


@pytest.mark.parametrize("few", [0, 3000, 20_000, 2**24])
def test_stamps_in_a_file_are_as_good_as_in_memory(tmp_path, monkeypatch, few):
    """All, most, some or none of the 48 kB of stamps are in a file."""
    monkeypatch.setattr("mbd_ros.files.bags.bag_writer._IN_MEMORY", few)
    monkeypatch.setattr("mbd_ros.motion.long_stamps._TELLING", 1024)
    monkeypatch.setattr("mbd_ros.motion.long_stamps._WINDOW", 1500)
    rng = np.random.default_rng(4)
    t = np.arange(0, 12, 2e-3) + rng.uniform(0, 5e-4, 6000)
    t[3500:] += 3.0
    x = motion(SLOW, t) + 1e-4 * rng.normal(size=(6000, 2))
    whole = zero_phase(stamps_of(t), x)
    with Spool(tmp_path, 1, np.int64) as stamps, Spool(tmp_path, 2) as position:
        for i in range(0, 6000, 700):
            stamps.append(stamps_of(t)[i : i + 700])
            position.append(x[i : i + 700])

        moving = position, np.zeros(2, dtype=bool)
        cutoff = chosen_cutoffs(StampSpool(stamps), *moving, None)
        windows = Windows(StampSpool(stamps), cutoff)
        rows = [found for _, *found in smoothed(windows, *moving, cutoff)]
    assert (cutoff == whole.cutoff).all() and len(rows) > 2
    for k, theirs in enumerate(whole[:3]):
        assert (np.concatenate([each[k] for each in rows]) == theirs).all()
