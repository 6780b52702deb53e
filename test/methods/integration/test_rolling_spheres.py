"""Spheres on planes with every method that goes from event to event, against closed forms."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.api import scene_from

GRAVITY, MU, SPEED = 9.81, 0.2, 5.0
METHODS = (
    *({"type": name} for name in ("rk4", "dopri5", "dop853", "filippov")),
    *({"type": "gauss_legendre", "stages": stages} for stages in (1, 2, 3)),
    *({"type": name, "tolerance": 1e-9} for name in ("dopri5", "dop853", "filippov")),
)
SPINNING = (
    SPEED,
    20.0,
    -60.0,
    35.0,
)  # [m/s], [rad/s] along the way, about the axis of rolling, up


def rolled(method, spin, *, mu=MU, mass=1.0, radius=0.1, turn=(0, 0, 0), at=(0, 0, 0), dt=0.05):
    """Times, states in the axes of the plane and events of a sphere that starts on it.

    Returns:
        t (n,), way, velocity and spin (n, 3) each, and the times of events.
    """
    axes = pin.exp3(np.array(turn, dtype=float))
    start = {"linear": (SPEED, 0.0, 0.0), "angular": spin}
    twist = {key: [float(n) for n in axes @ value] for key, value in start.items()}
    place = {"xyz": [float(n) for n in np.array(at) + radius * axes[:, 2]]}
    plane = {"half_space": [float(n) for n in axes[:, 2]], "xyz": [float(n) for n in at]}
    scene = scene_from(
        {
            "bodies": {"ball": {"shape": {"sphere": radius}, "mass": mass, "pose": place}},
            "contacts": [{"type": "rigid", "between": ["ball", plane], "friction": mu}],
            "initial": {"twist": {"ball": {**twist, "expressed_in": "world"}}},
            "gravity": [float(-GRAVITY * n) for n in axes[:, 2]],
            "integrator": method,
            "dt": dt,
        }
    )
    simulation = scene.simulation()
    states = list(simulation.run(scene.initial, 3.0))
    own = [axes.T @ pin.Quaternion(x.q[3:7]).matrix() for x in states]
    way = np.array([axes.T @ (x.q[:3] - states[0].q[:3]) for x in states])
    v = np.array([R @ x.v[:3] for R, x in zip(own, states, strict=True)])
    w = np.array([R @ x.v[3:] for R, x in zip(own, states, strict=True)])
    return np.array([x.t for x in states]), way, v, w, [e.t for e in simulation.events]


def closed_form(t, spin, mu, radius):
    """Way, velocity and spin (n, 3) in the axes of the plane, and when the sphere rolls.

    The slip keeps its direction, its speed falls by 7/2 mu g; the spin about the normal stays.
    """
    v, w = np.array((SPEED, 0.0, 0.0)), np.array(spin, dtype=float)
    arm = np.array((0.0, 0.0, -radius))
    slip = v + np.cross(w, arm)
    rolls = float(np.linalg.norm(slip)) / (3.5 * mu * GRAVITY)
    push = -mu * GRAVITY * slip / np.linalg.norm(slip)
    turn = np.cross(arm, push) / (0.4 * radius**2)
    s = np.minimum(t, rolls)[:, None]
    way = v * s + 0.5 * push * s**2 + (t[:, None] - s) * (v + push * rolls)
    return way, v + push * s, w + turn * s, rolls


def errors(found, spin, mu=MU, radius=0.1):
    """Largest errors of way, velocity, spin and of the time from which the sphere rolls."""
    t, *motion, events = found
    *known, rolls = closed_form(t, spin, mu, radius)
    (event,) = events
    pairs = zip(motion, known, strict=True)
    return [*(float(np.abs(one - other).max()) for one, other in pairs), abs(event - rolls)]


@pytest.mark.parametrize("method", METHODS, ids=lambda method: "_".join(map(str, method.values())))
@pytest.mark.parametrize("spin", [0.0, -60.0])
def test_a_sphere_slides_until_it_rolls_with_any_method_and_step(method, spin):
    """Problem C04, both starts: steps of 0.1 s, in which the sphere turns by up to 6 rad."""
    found = errors(rolled(method, (0.0, spin, 0.0), dt=0.1), (0.0, spin, 0.0))
    assert max(found) <= 1e-11


@pytest.mark.parametrize("method", METHODS[:5], ids=lambda method: method["type"])
def test_a_sphere_that_spins_about_all_axes_rolls(method):
    found = errors(rolled(method, SPINNING[1:]), SPINNING[1:])
    assert max(found) <= 1e-10


VARIANTS = {
    "tilted": {"turn": (0.3, -0.5, 0.7)},
    "far away": {"at": (100.0, -60.0, 80.0), "turn": (0.0, 0.4, 0.0)},
    "heavy": {"mass": 1.0e3},
    "light": {"mass": 1.0e-6},
    "rough": {"mu": 1.5},
}


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_sphere_rolls_wherever_and_whatever_it_is(variant):
    given = VARIANTS[variant]
    found = errors(
        rolled({"type": "rk4"}, SPINNING[1:], **given), SPINNING[1:], given.get("mu", MU)
    )
    assert max(found) <= 1e-10


def test_a_sphere_rolls_along_a_groove():
    """Both planes push with m g / sqrt(2); the least norm of what sticks would leave the cones."""
    planes = [{"half_space": [0.0, way, 1.0]} for way in (1.0, -1.0)]
    place, mu = {"xyz": [0.0, 0.0, 0.1 * 2.0**0.5]}, 0.3
    sections = {
        "bodies": {"ball": {"shape": {"sphere": 0.1}, "mass": 1.0, "pose": place}},
        "contacts": [
            {"type": "rigid", "between": ["ball", plane], "friction": mu} for plane in planes
        ],
        "initial": {"twist": {"ball": {"linear": [1.0, 0.0, 0.0]}}},
    }
    scene = scene_from({**sections, "integrator": {"type": "dopri5"}, "dt": 0.05})
    simulation = scene.simulation()
    *_, x = simulation.run(scene.initial, 0.3)
    (event,) = simulation.events
    speed = 1.0 / 1.8
    assert event.t == pytest.approx((1.0 - speed) / (mu * GRAVITY * 2.0**0.5), abs=1e-10)
    assert np.linalg.norm(x.v[:3]) == pytest.approx(speed, abs=1e-10)
