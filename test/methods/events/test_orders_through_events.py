"""Methods keep their order through stops and dry friction, on an arm written out by hand."""

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import mbd_ros as mbd
from mbd_ros.parts.integrators.adams import Adams
from mbd_ros.parts.integrators.gauss_legendre import GaussLegendre

M1, M2, I1, I2, L1, C1, C2, G = 1.3, 0.8, 0.05, 0.02, 0.6, 0.3, 0.25, 9.81
LOWER, E, FRICTION, SPAN = -0.35, 0.7, 0.35, 0.9  # s
SHOWN = [0.3, 0.6, 0.9]
START = np.array([0.9, 0.4, 0.0, 1.5])


def body(name, mass, centre, inertia):
    return (
        f'<link name="{name}"><inertial><origin xyz="0 0 {-centre}"/><mass value="{mass}"/>'
        f'<inertia ixx="1" iyy="{inertia}" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    )


def hinge(name, parent, child, length):
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {-length}"/><axis xyz="0 1 0"/></joint>'
    )


URDF = (
    f'<robot name="arm"><link name="world"/>{body("upper", M1, C1, I1)}{body("lower", M2, C2, I2)}'
    f"{hinge('shoulder', 'world', 'upper', 0.0)}{hinge('elbow', 'upper', 'lower', L1)}</robot>"
)
SECTIONS = {
    "constraints": [
        {"type": "joint_stop", "joint": "shoulder", "lower": LOWER, "restitution": E},
        {"type": "dry_friction", "joint": "elbow", "limit": FRICTION},
    ],
    "initial": {
        "position": {"shoulder": START[0], "elbow": START[1]},
        "velocity": {"shoulder": START[2], "elbow": START[3]},
    },
}


def mass(q):
    coupling = M2 * L1 * C2 * math.cos(q[1])
    both = M2 * C2 * C2 + I2 + coupling
    first = M1 * C1 * C1 + I1 + M2 * (L1 * L1 + C2 * C2) + 2.0 * coupling + I2
    return np.array([[first, both], [both, M2 * C2 * C2 + I2]])


def pull(q, v):
    """Gravity and centrifugal forces: M a = friction - pull."""
    c, sum_ = M2 * L1 * C2 * math.sin(q[1]), math.sin(q[0] + q[1])
    weight = M2 * G * C2 * sum_
    return np.array(
        [
            (M1 * C1 + M2 * L1) * G * math.sin(q[0]) + weight - c * (2.0 * v[0] + v[1]) * v[1],
            weight + c * v[0] * v[0],
        ]
    )


def holding(y):
    """Torque that holds the elbow."""
    M, h = mass(y[:2]), pull(y[:2], y[2:])
    return -M[1, 0] * h[0] / M[0, 0] + h[1]


def rate(way):
    """y' while the elbow slips forwards (1), backwards (-1) or sticks (0)."""

    def f(t, y):
        q, v = y[:2], y[2:]
        friction = np.array([0.0, holding(y) if way == 0 else -way * FRICTION])
        return np.concatenate([v, np.linalg.solve(mass(q), friction - pull(q, v))])

    return f


def next_way(y):
    if abs(y[3]) > 1e-12:
        return int(math.copysign(1, y[3]))
    needed = holding(y)
    return 0 if abs(needed) <= FRICTION else -int(math.copysign(1, needed))


@cache
def exact():
    """States at `SHOWN`, and how often the stop was hit and the elbow stuck or broke loose."""
    t, y, way, counts, shown = 0.0, START.copy(), 1, [0, 0], []
    while t < SPAN:
        closes = lambda t, y: y[0] - LOWER  # noqa: E731
        changes = [lambda t, y: FRICTION - abs(holding(y)), lambda t, y: y[3]][way != 0]
        closes.direction, changes.direction = -1.0, -1.0 if way >= 0 else 1.0
        for event in (closes, changes):
            event.terminal = True
        options = {"method": "DOP853", "rtol": 2.3e-14, "atol": 1e-15, "max_step": 0.02}
        end = SHOWN[len(shown)]
        found = solve_ivp(rate(way), (t, end), y, events=[closes, changes], **options)
        t, y = found.t[-1], found.y[:, -1].copy()
        if found.t_events[0].size:
            response = np.linalg.inv(mass(y[:2]))[:, 0]
            y[2:] -= (1.0 + E) * y[2] * response / response[0]
            y[0], counts[0] = LOWER, counts[0] + 1
            way = next_way(y)
        elif found.t_events[1].size:
            y[3], counts[1] = 0.0, counts[1] + 1
            way = next_way(y) if way else -int(math.copysign(1, holding(y)))  # what sticks breaks
        else:
            shown.append(y)
    return np.array(shown), tuple(counts)


def error(method, dt):
    scene = mbd.scene_from({**SECTIONS, "integrator": method, "dt": dt}, urdf=URDF)
    simulation = scene.simulation()
    states = list(simulation.run(scene.initial, SPAN))
    chosen = [states[(len(states) - 1) * (k + 1) // len(SHOWN)] for k in range(len(SHOWN))]
    found = np.array([np.concatenate([x.q, x.v]) for x in chosen])
    return float(np.linalg.norm(found - exact()[0]))


def test_the_arm_hits_its_stop_slips_and_sticks():
    counts = exact()[1]
    assert counts[0] >= 1 and counts[1] >= 2, counts


@pytest.mark.parametrize(
    ("method", "order", "longest", "count"),
    [
        ({"type": "adams", "order": 3}, 3, 0.003, 6),
        ({"type": "adams", "order": 6}, 6, 0.004, 6),
        ({"type": "gauss_legendre", "stages": 1}, 2, 0.01, 6),
        ({"type": "gauss_legendre", "stages": 2}, 4, 0.02, 8),
        ({"type": "gauss_legendre", "stages": 3}, 6, 0.04, 8),
    ],
    ids=lambda value: "-".join(map(str, value.values())) if isinstance(value, dict) else None,
)
def test_observed_order_through_events(method, order, longest, count):
    """The slope over steps of many lengths: where events fall in a step differs for each."""
    parts = [round(SHOWN[0] / longest * 2.0 ** (k / 3.0)) for k in range(count)]
    steps = SHOWN[0] / np.array(parts)
    errors = np.array([error(method, dt) for dt in steps])
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.25), errors


@pytest.mark.parametrize(
    ("method", "dt"),
    [({"type": "adams", "order": 6}, 6e-4), ({"type": "gauss_legendre", "stages": 3}, 5e-3)],
    ids=lambda value: value["type"] if isinstance(value, dict) else None,
)
def test_small_steps_reach_what_doubles_hold(method, dt):
    assert error(method, dt) < 1e-9


def test_both_are_event_driven():
    assert Adams.event_driven and GaussLegendre.event_driven
