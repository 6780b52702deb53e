"""The chatter of commands: the power above a frequency, whatever the sampling."""

import numpy as np
import pytest

from mbd_ros.features.control.loop_watch import ChatterMeter


@pytest.mark.parametrize("frequency", [2.0, 20.0, 300.0])
def test_chatter_is_the_power_that_the_high_pass_leaves(frequency):
    """Closed form: A^2/2 (w^2 / (w^2 + wc^2))^2, half of it at the cutoff."""
    meter, dt, amplitude = ChatterMeter(1, 20.0, 0.5), 1e-4, 3.0
    for k in range(round(5.0 / dt)):
        meter.update(amplitude * np.sin(2 * np.pi * frequency * np.array([k * dt])), dt)
    share = frequency**2 / (frequency**2 + 400.0 / (1.0 + np.sqrt(2.0)))
    expected = 0.5 * amplitude**2 * share**2
    ripple = 1.0 / (2.0 * 2.0 * np.pi * frequency * 0.5)  # of a mean over 0.5 s
    assert meter.energy[0] == pytest.approx(expected, rel=ripple + 1e-3)
    assert meter.total == meter.energy.sum() and meter.rms == pytest.approx(meter.energy**0.5)


@pytest.mark.parametrize("memory", [0.5, 1e-3])
def test_chatter_does_not_depend_on_how_a_held_command_is_sampled(memory):
    """Exact over any step: commands in one update each, and repeated in uneven steps."""
    rng = np.random.default_rng(7)
    commands = rng.normal(size=(4, 2))
    whole, parts = ChatterMeter(2, 20.0, memory), ChatterMeter(2, 20.0, memory)
    whole.update(commands[0], 0.0)
    parts.update(commands[0], 0.0)
    for held, following, duration in zip(
        commands, commands[1:], (0.013, 0.4, 0.002), strict=False
    ):
        for share in rng.dirichlet(np.ones(7)) * duration:
            parts.update(held, share)
        parts.update(following, 0.0)
        whole.update(following, duration)
    np.testing.assert_allclose(parts.energy, whole.energy, rtol=1e-9)


def test_chatter_starts_steady_forgets_and_resets():
    meter = ChatterMeter(2)
    for _ in range(100):
        meter.update(np.array([5.0, -3.0]), 1e-3)
    assert not meter.energy.any()
    meter.update(np.array([6.0, -3.0]), 1e-3)
    meter.update(np.array([6.0, -3.0]), -1.0)  # a clock that stands or runs back moves nothing
    assert not meter.energy.any()
    meter.update(np.array([6.0, -3.0]), 1e-2)
    assert meter.energy[0] > 0.0 and meter.energy[1] == 0.0
    meter.update(np.array([6.0, -3.0]), 1e9)
    assert np.isfinite(meter.energy).all() and meter.total < 1e-300
    meter.update(np.array([1e150, 0.0]), 1e-3)
    meter.update(np.zeros(2), 1e-9)
    assert np.isfinite(meter.energy).all()
    meter.reset()
    meter.update(np.array([1.0, 1.0]), 5.0)
    assert not meter.energy.any()
