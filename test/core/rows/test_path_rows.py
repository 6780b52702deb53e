"""Rows of paths: against closed forms, another constraint, and impacts by hand."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import floating_body, joint, link, urdf
from places import ROOT
from scipy.integrate import solve_ivp

from mbd_ros.api import scene_from
from mbd_ros.core.nonsmooth.impact_map import ImpactMap
from mbd_ros.core.state import State

ROBOTS = ROOT / "config/robots"
GRAVITY = 9.81
MASSES = 2.0, 3.0
ATWOOD = urdf(
    *(link("world"), link("one", MASSES[0]), link("other", MASSES[1])),
    joint("first", "prismatic", "world", "one", (0, 0, 1), (-0.1, 0.0, 0.0)),
    joint("second", "prismatic", "world", "other", (0, 0, 1), (0.1, 0.0, 0.0)),
)
OVER_THE_WHEEL = [
    {"frame": "one"},
    {"frame": "world", "xyz": [-0.1, 0.0, 5.0]},
    {"frame": "world", "xyz": [0.1, 0.0, 5.0]},
    {"frame": "other"},
]
LENGTH = 8.2  # 4 m to either mass, 0.2 m over the wheel


@pytest.mark.parametrize("kind", ["path_length", "rope"])
@pytest.mark.parametrize(
    "path", [{"points": OVER_THE_WHEEL}, {"joints": {"first": [10.2, -1.0], "second": -1.0}}]
)
def test_two_masses_on_a_rope_are_the_machine_of_atwood(path, kind):
    smooth = {"time_constant": 0.01} if kind == "rope" else {}
    row = {"type": kind, "path": path, "length": LENGTH, **smooth}
    start = {"position": {"first": 1.0, "second": 1.0}}
    scene = scene_from({"constraints": [row], "initial": start}, urdf=ATWOOD)
    now = scene.simulation().system.evaluate(scene.initial)
    a = GRAVITY * (MASSES[1] - MASSES[0]) / sum(MASSES)
    assert now.a == pytest.approx([a, -a], rel=1e-12)
    assert now.lam == pytest.approx([2.0 * GRAVITY * np.prod(MASSES) / sum(MASSES)], rel=1e-12)


def test_a_slack_rope_does_not_pull():
    row = {
        "type": "rope",
        "path": {"points": OVER_THE_WHEEL},
        "length": 9.0,
        "time_constant": 0.01,
    }
    start = {"position": {"first": 1.0, "second": 1.0}}
    scene = scene_from({"constraints": [row], "initial": start}, urdf=ATWOOD)
    now = scene.simulation().system.evaluate(scene.initial)
    assert now.a == pytest.approx([-GRAVITY, -GRAVITY])
    assert now.lam.tolist() == [0.0]


BARS = {
    "fixed": ("prosthetic_leg", ("femoral_pylon", [0.05, 0.0, 0.1]), ("foot", [0.1, 0.02, 0.0])),
    "floating": (floating_body(), ("left", [0.0, 0.1, -0.3]), ("right", [0.1, 0.1, -0.2])),
}


@pytest.mark.parametrize("base", BARS)
def test_a_straight_path_that_keeps_its_length_is_a_bar(base):
    """Same accelerations and reactions as `distance`, whose multiplier pushes."""
    description, *ends = BARS[base]
    a, b = ({"frame": frame, "xyz": point} for frame, point in ends)
    bar = {"type": "distance", "frame_a": a["frame"], "point_a": a["xyz"], "distance": 0.6}
    bar |= {"frame_b": b["frame"], "point_b": b["xyz"]}
    held = {"type": "path_length", "path": {"points": [a, b]}, "length": 0.6}
    one, other = (
        scene_from({"robot": {"base": base}, "constraints": [row]}, urdf=description)
        for row in (bar, held)
    )
    model, rng = one.robot.model, np.random.default_rng(1)
    for _ in range(5):
        q = pin.integrate(model, one.robot.neutral(), rng.uniform(-0.5, 0.5, model.nv))
        x = State(0.0, q, rng.normal(size=model.nv))
        expected, found = (scene.simulation().system.evaluate(x) for scene in (one, other))
        size = np.abs(expected.a).max()
        np.testing.assert_allclose(found.a, expected.a, atol=1e-11 * size)
        np.testing.assert_allclose(found.lam, -expected.lam, rtol=1e-10)


@pytest.mark.parametrize("restitution", [0.0, 0.7])
def test_a_rope_that_becomes_taut_takes_the_radial_velocity(restitution):
    """A point at 0.6, -0.8 on a rope of 1 m to the origin: v+ = v - (1 + e) (n . v) n."""
    path = {"points": [{"frame": "world"}, {"frame": "particle"}]}
    row = {"type": "rope", "path": path, "length": 1.0, "restitution": restitution}
    scene = scene_from({"constraints": [row]}, urdf=ROBOTS / "benchmark/point_in_plane.urdf")
    n, v = np.array([0.6, -0.8]), np.array([0.3, -2.0])
    x = State(0.0, n, v)
    found = ImpactMap(scene.system()).impact(x, [0])
    mass = pin.computeTotalMass(scene.robot.model)
    assert found.v == pytest.approx(v - (1.0 + restitution) * (n @ v) * n, abs=1e-12)
    assert found.p == pytest.approx([(1.0 + restitution) * mass * (n @ v)], abs=1e-12)


@pytest.mark.parametrize("restitution", [0.0, 0.7])
@pytest.mark.parametrize("method", [{"type": "dop853", "tolerance": 1e-12}, {"type": "rk4"}])
def test_a_mass_that_falls_into_its_rope_swings_on_as_by_hand(method, restitution):
    """1.2 s of a point on a rope of 1 m, in Cartesian coordinates by scipy between impacts."""
    path = {"points": [{"frame": "world"}, {"frame": "particle"}]}
    row = {"type": "rope", "path": path, "length": 1.0, "restitution": restitution}
    start = {"position": {"x": 0.6}}
    entries = {"constraints": [row], "gravity": [0.0, -GRAVITY, 0.0], "initial": start}
    given = {**entries, "integrator": method, "dt": 1e-3}
    simulation = scene_from(given, urdf=ROBOTS / "benchmark/point_in_plane.urdf").simulation()
    *_, end = simulation.run(State(0.0, np.array([0.6, 0.0]), np.zeros(2)), 1.2)
    y, hits = fallen(restitution, 1.2)
    assert hits[0] == pytest.approx(np.sqrt(1.6 / GRAVITY), rel=1e-12)
    assert [event.t for event in simulation.events] == pytest.approx(hits, abs=1e-9)
    assert np.concatenate((end.q, end.v)) == pytest.approx(y, abs=1e-9)


def fallen(e, duration):
    """Position and velocity at the end, and the times of impacts."""
    t, y, hits, taut = 0.0, np.array([0.6, 0.0, 0.0, 0.0]), [], False

    def swing(t, y):
        """The tension v.v - g y on a unit circle keeps the point there."""
        pull = (y[2:] @ y[2:] - GRAVITY * y[1]) / (y[:2] @ y[:2]) if taut else 0.0
        return np.concatenate((y[2:], -pull * y[:2] - [0.0, GRAVITY]))

    def reach(t, y):
        return y[:2] @ y[:2] - 1.0

    reach.terminal, reach.direction = True, 1.0
    while t < duration:
        events = None if taut else reach
        solved = solve_ivp(
            swing, (t, duration), y, "DOP853", rtol=1e-13, atol=1e-14, events=events
        )
        t, y = solved.t[-1], solved.y[:, -1]
        if t < duration:
            n = y[:2] / np.linalg.norm(y[:2])
            y = np.concatenate(((1.0 - 1e-15) * n, y[2:] - (1.0 + e) * (n @ y[2:]) * n))
            taut = e == 0.0
            hits.append(t)
    return y, hits
