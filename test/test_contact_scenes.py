"""The embedded scenes with contacts, against closed forms."""

from pathlib import Path

import numpy as np
import pytest

from mbd_ros.scene.reader import load_scene

SCENES = Path(__file__).parents[1] / "config/scenes"
GRAVITY = 9.81


def motion(name, duration, **how):
    """Scene, simulation and states of a scene."""
    scene = load_scene(SCENES / f"{name}.yaml")
    simulation = scene.simulation(**how)
    return scene, simulation, list(simulation.run(scene.initial, duration))


def bounces(height, e, count):
    """Times of the first impacts of a ball that falls from rest, and when it rests."""
    falls = np.sqrt(2.0 * height / GRAVITY)
    times = falls * (1.0 + 2.0 * np.cumsum(e ** np.arange(count)) - 2.0)
    return np.append(falls, times[1:]), falls * (1.0 + e) / (1.0 - e)


def test_the_ball_bounces_in_time_and_rests_after_infinitely_many_bounces():
    _, simulation, states = motion("bouncing_ball", 4.5)
    times, rests = bounces(1.0, 0.8, 20)
    found = [event.t for event in simulation.events]
    assert found[:20] == pytest.approx(times, abs=1e-9)
    assert found[-1] == pytest.approx(rests, abs=1e-9)
    assert states[-1].q[2] == pytest.approx(0.1, abs=1e-12)
    assert states[-1].v == pytest.approx(np.zeros(6), abs=1e-12)


def rolling(t):
    """Way, speed and spin of a homogeneous sphere that starts sliding."""
    mu, radius, speed = 0.2, 0.1, 5.0
    a, ends = mu * GRAVITY, 2.0 * speed / (7.0 * mu * GRAVITY)
    slides, late = np.minimum(t, ends), np.maximum(t - ends, 0.0)
    v = speed - a * slides
    return speed * slides - 0.5 * a * slides**2 + v * late, v, 2.5 * a * slides / radius


def test_the_sphere_slides_and_rolls():
    _, _, states = motion("sphere_on_plane", 2.0)
    x, v, spin = rolling(np.array([x.t for x in states]))
    assert [s.q[0] for s in states] == pytest.approx(x, abs=1e-10)
    assert [np.linalg.norm(s.v[:3]) for s in states] == pytest.approx(v, abs=1e-10)
    assert [s.v[4] for s in states] == pytest.approx(spin, abs=1e-9)
