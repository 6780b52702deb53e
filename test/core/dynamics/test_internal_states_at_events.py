"""Internal states through events: stops and dry friction beside a drive, by hand."""

import math

import numpy as np
import pytest
from internal_states import INERTIA, driven, numbers, pendulum, rates_by_hand
from scipy.integrate import solve_ivp

STOP = {"type": "joint_stop", "joint": "hinge", "lower": 0.68, "upper": 0.71, "restitution": 0.6}
FRICTION = {"type": "dry_friction", "joint": "hinge", "limit": 3.0}
METHODS = [
    {"type": "dopri5", "tolerance": 1e-12},
    {"type": "dop853", "tolerance": 1e-12},
    {"type": "dop853"},
]


def bounced(duration, u):
    """The end of the motion between two stops that give back 0.6 of the speed."""
    y, t, count = np.array([0.7, 0.0, 3.0, 8.0]), 0.0, 0
    ends = [lambda _, y: 0.71 - y[0], lambda _, y: y[0] - 0.68]
    for end in ends:
        end.terminal, end.direction = True, -1.0
    while t < duration:
        found = solve_ivp(
            lambda _, y: rates_by_hand(y, u)[:4],
            *((t, duration), y, "DOP853"),
            **{"rtol": 1e-13, "atol": 1e-13, "events": ends},
        )
        t, y = found.t[-1], found.y[:, -1]
        if found.status:
            y[1] *= -0.6
            count += 1
    return y, count


@pytest.mark.parametrize("method", METHODS, ids=lambda method: "_".join(map(str, method.values())))
def test_a_drive_between_stops(method):
    scene = pendulum(constraints=[STOP], integrator=method, dt=5e-3)
    simulation = driven(scene, 0.6)
    states = list(simulation.run(scene.initial, 0.5))
    expected, count = bounced(0.5, 0.6)
    assert count > 1
    assert np.abs(numbers(states[-1]) - expected).max() < 1e-9
    assert max(x.q[0] for x in states) <= 0.71 + 1e-12


def stuck_and_slipping(duration, u):
    """The same motion with 3 N·m of friction instead of stops."""
    y, t, ways = np.array([0.7, 0.0, 3.0, 8.0]), 0.0, []
    while t < duration:
        pull = rates_by_hand(y, u)[1] * INERTIA
        is_free = abs(pull) > 3.0 or (bool(ways) and not ways[-1])
        way = math.copysign(1.0, pull) if is_free else 0.0
        ways.append(way)

        def rates(_, y, way=way):
            v, a, omega, speed, *_ = rates_by_hand(y, u)
            return [v, a - 3.0 * way / INERTIA, omega, speed] if way else [0.0, 0.0, omega, speed]

        def leaves(_, y, way=way):
            return y[1] if way else 3.0 - abs(rates_by_hand(y, u)[1]) * INERTIA

        leaves.terminal, leaves.direction = True, -way if way else -1.0
        options = {"rtol": 1e-13, "atol": 1e-13, "events": leaves}
        found = solve_ivp(rates, (t, duration), y, "DOP853", **options)
        t, y = found.t[-1], found.y[:, -1]
        y[1] = 0.0 if found.status else y[1]
    return y, ways


@pytest.mark.parametrize("method", METHODS, ids=lambda method: "_".join(map(str, method.values())))
def test_a_drive_against_dry_friction(method):
    scene = pendulum(constraints=[FRICTION], integrator=method, dt=5e-3)
    states = list(driven(scene, 0.6).run(scene.initial, 0.5))
    expected, ways = stuck_and_slipping(0.5, 0.6)
    assert 0.0 in ways and len(ways) > 2
    assert np.abs(numbers(states[-1]) - expected).max() < 1e-9


@pytest.mark.parametrize("name", ["rk4", "adams", "gauss_legendre", "dopri5"])
def test_checkpoints_keep_the_bits_through_events(name):
    scene = pendulum(constraints=[STOP, FRICTION], integrator={"type": name}, dt=2e-3)
    first, second = driven(scene, 0.6), driven(scene, 0.6)
    expected = list(driven(scene, 0.6).run(scene.initial, 0.3))
    run, found = first.run(scene.initial, 0.3), []
    for x in run:
        found.append(x)
        if len(found) % 30 == 0:
            second = driven(scene, 0.6)
            rest = list(second.run(first.checkpoint(), 0.3))
            for one, other in zip(rest, expected[len(found) :], strict=True):
                assert numbers(one).tobytes() == numbers(other).tobytes()
