"""No step with friction gains energy: random slips and spins of balls and cubes, on inclines.

Their inertia is a multiple of 1 and planes are flat, so that nothing but contacts does work that
a step could get wrong; energies are written by hand.
"""

import numpy as np
import pytest

from mbd_ros.api import scene_from

SIDE, MASS, GAIN = 0.2, 3.0, 1e-10
HALF = SIDE / 2.0
FEET = [[x * HALF, y * HALF, -HALF] for x in (-1, 1) for y in (-1, 1)]


def resting(contacts, friction, gravity):
    """One or two balls, or a cube on three or four feet, that touch level ground."""
    balls = contacts if contacts <= 2 else 0
    shape = {"sphere": HALF} if balls else {"box": [SIDE] * 3}
    names = [f"b{i}" for i in range(max(balls, 1))]
    bodies = {
        name: {"shape": shape, "mass": MASS * 100.0**i, "pose": {"xyz": [float(i), 0.0, HALF]}}
        for i, name in enumerate(names)
    }
    touching = ({"frame": "b0", "points": FEET[:contacts]},) if not balls else names
    pairs = [
        {"type": "rigid", "between": [each, "ground"], "friction": friction} for each in touching
    ]
    scene = scene_from({"gravity": gravity, "bodies": bodies, "contacts": pairs})
    return scene, scene.simulation(integrator={"type": "moreau_jean"}, dt=0.1)


def energy(x, start, gravity, is_ball):
    """Kinetic energy, and potential one beside a start [J]; axes do not matter to the squares."""
    own = (0.4 * HALF**2) if is_ball else (SIDE**2 / 6.0)
    q, v, total = (x.q - start.q).reshape(-1, 7), x.v.reshape(-1, 6), 0.0
    for i in range(len(q)):
        kinetic = 0.5 * (v[i, :3] @ v[i, :3] + own * (v[i, 3:] @ v[i, 3:]))
        total += MASS * 100.0**i * (kinetic - q[i, :3] @ np.array(gravity))
    return total


def largest_gain(contacts, friction, count, rng):
    """Of so many steps from random velocities along the ground, of the energy in play."""
    gravity = [float(g) for g in (*rng.uniform(-8.0, 8.0, 2), -9.81)]
    scene, simulation = resting(contacts, friction, gravity)
    start, found, is_ball = simulation.start(scene.initial), 0.0, contacts <= 2
    for _ in range(count):
        v = rng.normal(size=(len(start.v) // 6, 6)) * 10.0 ** rng.uniform(-4.0, 0.5)
        v[:, 2] = 0.0
        v[:, 3:] *= np.array((1.0, 1.0, 1.0)) / HALF if is_ball else np.array((0.0, 0.0, 1.0))
        x, h = start._replace(v=v.ravel()), float(10.0 ** rng.uniform(-4.0, -2.0))
        simulation.stepper.restart()
        before = energy(x, x, gravity, is_ball)
        after = energy(simulation.stepper.step(x, None, start.t + h), x, gravity, is_ball)
        forces = np.linalg.norm(gravity) * h * np.abs(v[:, :3]).max()
        in_play = 0.5 * np.square(v[:, :3]).sum() + forces + (np.linalg.norm(gravity) * h) ** 2
        heaviest = MASS * 100.0 ** (len(v) - 1)
        found = max(found, (after - before) / (heaviest * in_play))
    return found


@pytest.mark.parametrize("contacts", [1, 2, 3, 4])
def test_no_step_with_friction_gains_energy(contacts):
    rng = np.random.default_rng(contacts)
    for friction in (0.0, 0.1, 0.6, 2.5):
        assert largest_gain(contacts, friction, 40, rng) <= GAIN


@pytest.mark.soak
@pytest.mark.parametrize("contacts", [1, 2, 3, 4])
def test_none_of_ten_thousand_steps_with_friction_gains_energy(contacts):
    rng = np.random.default_rng(100 + contacts)
    for friction in (0.0, 0.1, 0.6, 2.5):
        assert largest_gain(contacts, friction, 625, rng) <= GAIN
