"""Bodies that spin while they touch, and slips that end: what happens within a step."""

import numpy as np
import pytest

from mbd_ros.api import scene_from

GRAVITY, RADIUS, MU, SPEED = 9.81, 0.1, 0.2, 5.0


def rolled(spin, mu, dt, duration):
    """Velocity in the world of a ball that starts on the ground with a speed and a spin."""
    twist = {"linear": [SPEED, 0.0, 0.0], "angular": [0.0, spin, 0.0], "expressed_in": "world"}
    ball = {"shape": {"sphere": RADIUS}, "mass": 1.0, "pose": {"xyz": [0.0, 0.0, RADIUS]}}
    contact = {"type": "rigid", "between": ["ball", "ground"], "friction": mu}
    scene = scene_from(
        {"bodies": {"ball": ball}, "contacts": [contact], "initial": {"twist": {"ball": twist}}}
    )
    simulation = scene.simulation(integrator={"type": "moreau_jean"}, dt=dt)
    return list(simulation.run(scene.initial, duration))


def test_a_frictionless_ball_keeps_its_speed():
    """Axes of the ball turn by 0.04 rad in a step, its path stays straight."""
    for x in rolled(20.0, 0.0, 2e-3, 0.5):
        assert np.linalg.norm(x.v[:3]) == pytest.approx(SPEED, rel=1e-12)
        assert x.q[:3] == pytest.approx([SPEED * x.t, 0.0, RADIUS], abs=1e-12)


@pytest.mark.parametrize("spin", [0.0, -60.0])
def test_a_ball_slides_until_it_rolls(spin):
    """Closed form: v = (5 v0 + 2 R w0) / 7 from t = 2 (v0 - w0 R) / (7 mu g) on."""
    roll, rolls = (5.0 * SPEED + 2.0 * RADIUS * spin) / 7.0, 2.0 * (SPEED - spin * RADIUS)
    rolls /= 7.0 * MU * GRAVITY
    states = rolled(spin, MU, 2e-3, rolls + 0.1)
    late = [x for x in states if x.t > rolls + 0.01]
    assert late and all(abs(np.linalg.norm(x.v[:3]) - roll) <= 1e-9 for x in late)
    assert all(abs(x.v[4] * RADIUS - roll) <= 1e-9 for x in late)


@pytest.mark.parametrize("speed", [0.05, 0.2, 0.7])
def test_a_slip_that_ends_within_a_step_gains_no_energy(speed):
    """A block on an incline stops early in a long step, where mu > tan: closed form."""
    angle, mu = np.deg2rad(20.0), 0.5
    gravity = [-GRAVITY * np.sin(angle), 0.0, -GRAVITY * np.cos(angle)]
    block = {"shape": {"box": [0.4, 0.4, 0.1]}, "mass": 2.0, "pose": {"xyz": [0.0, 0.0, 0.05]}}
    contact = {"type": "rigid", "between": ["block", "ground"], "friction": mu}
    twist = {"block": {"linear": [speed, 0.0, 0.0], "expressed_in": "world"}}
    sections = {"bodies": {"block": block}, "contacts": [contact], "initial": {"twist": twist}}
    scene = scene_from({"gravity": gravity, **sections})
    simulation = scene.simulation(integrator={"type": "moreau_jean"}, dt=0.1)
    states = list(simulation.run(scene.initial, 0.3))
    energies = [x.v[:3].dot(x.v[:3]) - 2.0 * np.dot(gravity, x.q[:3]) for x in states]
    assert np.diff(energies).max() <= 1e-10 * speed**2
    braking = GRAVITY * (np.sin(angle) + mu * np.cos(angle))
    way = speed**2 / (2.0 * braking)
    assert states[-1].q[0] == pytest.approx(way, abs=braking * 0.1**2 / 8.0)
    assert np.abs(states[-1].v).max() <= 1e-11
