"""Many contacts with friction from event to event, against closed forms."""

import numpy as np
import pytest
from mechanisms import joint, link, scene_of, urdf
from point_contact import block
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mbd_ros.core.state import State

GRAVITY = 9.81


def box_on_an_incline(degrees, mu, *, mass=2.0, half=(0.2, 0.15, 0.1), method="dopri5", dt=0.1):
    """Scene of a free box on its four lower corners, and axes uphill, across and out of it."""
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    a, b, h = half
    feet = [[x, y, -h] for x, y in ((a, b), (-a, b), (-a, -b), (a, -b))]
    moments = tuple(mass / 3.0 * n for n in (b * b + h * h, a * a + h * h, a * a + b * b))
    plane = {"half_space": [float(-s), 0.0, float(c)]}
    between = [{"frame": "box", "points": feet}, plane]
    contact = {"type": "rigid", "between": between, "friction": mu}
    text = str(contact).replace("'", "")
    text = (
        f"robot: {{base: floating}}\ncontacts: [{text}]\ndt: {dt}\nintegrator: {{type: {method}}}"
    )
    scene = scene_of(text + "\n", urdf(link("box", mass, moments=moments)))
    return scene, np.array(((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c)))


def lying(axes, degrees, height, velocity):
    """State of a box on its plane; velocities stand in axes of the body."""
    half = -np.radians(degrees) / 2.0
    turn = (0.0, np.sin(half), 0.0, np.cos(half))
    return State(0.0, np.array((*(height * axes[2]), *turn)), np.array((*velocity, 0, 0, 0.0)))


STOPS, SLIPS_BACK = (20, 0.5, 3.0), (30, 0.3, 3.0)


@pytest.mark.parametrize(
    ("degrees", "mu", "v", "method"),
    [
        *((*case, "dopri5") for case in ((15, 0.3, 0.0), (30, 0.3, 0.0), (15, 0.3, -0.5))),
        *((*STOPS, method) for method in ("dopri5", "dop853", "rk4", "gauss_legendre")),
        *((*SLIPS_BACK, method) for method in ("dopri5", "dop853", "rk4", "gauss_legendre")),
    ],
)
def test_a_box_on_four_corners_slips_stops_and_sticks_as_in_closed_form(degrees, mu, v, method):
    """All corners stop at once; the forces that they share have no solution of their own."""
    scene, axes = box_on_an_incline(degrees, mu, method=method)
    simulation = scene.simulation()
    states = list(simulation.run(lying(axes, degrees, 0.1, (v, 0.0, 0.0)), 2.0))
    t, q = np.array([x.t for x in states]), np.array([axes @ x.q[:3] for x in states])
    assert q[:, 0] == pytest.approx(block(t, degrees, mu, v), abs=1e-10)
    assert np.abs(q[:, 1:] - (0.0, 0.1)).max() <= 1e-12
    assert np.abs(states[-1].q[3:] - states[0].q[3:]).max() <= 1e-10


@pytest.mark.parametrize(
    ("method", "dt"),
    [
        ("rk4", 6e-3),
        ("dopri5", 0.02),
        ("dop853", 0.1),
        ("gauss_legendre", 0.01),
        ("filippov", 0.1),
    ],
)
def test_a_box_turns_down_the_slope_as_friction_is_isotropic(method, dt):
    """mu = tan of the slope, start across it: |v| + v_y stays, and speeds end at half."""
    scene, axes = box_on_an_incline(30.0, float(np.tan(np.radians(30.0))), method=method, dt=dt)
    states = list(scene.simulation().run(lying(axes, 30.0, 0.1, (0.0, 2.0, 0.0)), 2.0))
    v = np.array([x.v[:3] for x in states])
    assert np.hypot(v[:, 0], v[:, 1]) - v[:, 0] == pytest.approx(2.0, abs=1e-8)
    end = axes @ states[-1].q[:3]
    assert (end[1], -end[0]) == pytest.approx((0.5436260219320209, 1.847094802058398), abs=1e-8)
    assert v[-1, :2] == pytest.approx((-0.9999999918071172, 1.8102908960964688e-4), abs=1e-8)


GROUND = "{half_space: [0, 0, 1]}"


def scene_with(bodies, poses, contacts, *, method="dopri5", dt=0.05, twist=""):
    """Free bodies with contacts."""
    entries = ", ".join(f"{{type: rigid, {contact}}}" for contact in contacts)
    return scene_of(
        f"bodies: {{{bodies}}}\ninitial: {{pose: {{{poses}}}, twist: {{{twist}}}}}\n"
        f"contacts: [{entries}]\ndt: {dt}\nintegrator: {{type: {method}}}\n"
    )


def test_a_box_that_falls_flat_bounces_on_all_corners_until_the_end_of_infinitely_many():
    """Times of C03 for each corner: first impacts, rest after sqrt(2 h/g) (1 + e)/(1 - e)."""
    e, feet = 0.5, "[[0.2, 0.1, -0.1], [-0.2, 0.1, -0.1], [-0.2, -0.1, -0.1], [0.2, -0.1, -0.1]]"
    between = f"between: [{{frame: b, points: {feet}}}, {GROUND}], friction: 0.5, restitution: {e}"
    scene = scene_with(
        "b: {shape: {box: [0.4, 0.2, 0.2]}, mass: 3.0}", "b: {xyz: [0, 0, 1.1]}", [between]
    )
    simulation = scene.simulation()
    *_, x = simulation.run(scene.initial, 5.0)
    first = np.sqrt(2.0 / GRAVITY)
    n = np.arange(15)
    times = first * (1.0 + 2.0 * e * (1.0 - e**n) / (1.0 - e))
    events = simulation.events
    assert [event.t for event in events[:15]] == pytest.approx(times, abs=1e-9)
    assert all(len(event.guards) == 4 for event in events[:15])
    assert events[-1].t == pytest.approx(first * (1.0 + e) / (1.0 - e), abs=1e-9)
    assert x.q[:3] == pytest.approx((0.0, 0.0, 0.1), abs=1e-12) and np.abs(x.v).max() <= 1e-12
    assert simulation.system.evaluate(x).lam[::3].sum() == pytest.approx(3.0 * GRAVITY, rel=1e-12)


def feet_of(body, half, height):
    corners = [
        [x, y, -height] for x, y in ((half, half), (-half, half), (-half, -half), (half, -half))
    ]
    return f"{{frame: {body}, points: {corners}}}"


def test_forces_between_boxes_of_a_stack_are_their_weights():
    masses, planes = (
        (1.0, 1.0, 1.0e6),
        (GROUND, *(f"{{frame: b{i}, half_space: [0, 0, 1], xyz: [0, 0, 0.1]}}" for i in (0, 1))),
    )
    scene = scene_with(
        ", ".join(
            f"b{i}: {{shape: {{box: [0.4, 0.4, 0.2]}}, mass: {m}}}" for i, m in enumerate(masses)
        ),
        ", ".join(f"b{i}: {{xyz: [0, 0, {0.1 + 0.2 * i}]}}" for i in range(3)),
        [
            f"between: [{feet_of(f'b{i}', 0.2, 0.1)}, {plane}], friction: 0.5"
            for i, plane in enumerate(planes)
        ],
    )
    simulation = scene.simulation()
    first, *_, last = simulation.run(scene.initial, 1.0)
    sums = simulation.system.evaluate(last).lam.reshape(3, 4, 3).sum(axis=1)
    assert sums[:, 0] == pytest.approx((9810019.62, 9810009.81, 9810000.0), rel=1e-9)
    assert np.abs(sums[:, 1:]).max() <= 0.1  # N, of ten millions
    assert np.abs(last.q - first.q).max() <= 1e-9 and not simulation.events


def test_legs_of_a_table_share_its_load_with_the_least_norm():
    sx, sy, half = 0.5, -0.25, 0.5
    top = "{frame: table, half_space: [0, 0, 1], xyz: [0, 0, 0.05]}"
    scene = scene_with(
        "table: {shape: {box: [1, 1, 0.1]}, mass: 4.0}, "
        "load: {shape: {box: [0.1, 0.1, 0.1]}, mass: 1.0}",
        f"table: {{xyz: [0, 0, 0.4]}}, load: {{xyz: [{sx * half}, {sy * half}, 0.5]}}",
        [
            f"between: [{feet_of('table', half, 0.4)}, {GROUND}], friction: 0.5",
            f"between: [{feet_of('load', 0.05, 0.05)}, {top}], friction: 0.5",
        ],
    )
    simulation = scene.simulation()
    *_, x = simulation.run(scene.initial, 0.5)
    lam = simulation.system.evaluate(x).lam.reshape(2, 4, 3)
    assert lam[0, :, 0] == pytest.approx((12.875625, 10.423125, 11.649375, 14.101875), rel=1e-9)
    assert lam[1, :, 0] == pytest.approx(GRAVITY / 4.0, rel=1e-9)
    assert np.abs(lam[:, :, 1:]).max() <= 1e-9


def spinning(t_end, speed, spin, mu, half, mass):
    """A box that slides and spins on four corners at equal loads in the plane, by scipy.

    Its centre of mass is so low that friction tips nothing; corners stand at +-half.
    """
    x, y = half
    corners = np.array(((x, y), (-x, y), (-x, -y), (x, -y)))
    moment = mass / 3.0 * (x * x + y * y)

    def slope(t, s):
        v, omega, angle = s[2:4], s[4], s[5]
        c, sn = np.cos(angle), np.sin(angle)
        r = corners @ np.array(((c, sn), (-sn, c)))
        slips = v + omega * np.column_stack((-r[:, 1], r[:, 0]))
        force = -mu * mass * GRAVITY / 4.0 * slips / np.linalg.norm(slips, axis=1)[:, None]
        torque = (r[:, 0] * force[:, 1] - r[:, 1] * force[:, 0]).sum()
        return (*v, *(force.sum(axis=0) / mass), torque / moment, omega)

    start = (0.0, 0.0, speed, 0.0, spin, 0.0)
    found = solve_ivp(slope, (0.0, t_end), start, "DOP853", rtol=1e-12, atol=1e-13)
    return found.y[:, -1]


def test_a_box_slides_and_spins_as_an_independent_integration_says():
    """Feet in the height of the centre of mass share its weight equally; four slips turn."""
    half, mu, mass = (0.2, 0.15), 0.3, 2.0
    feet = [[a * half[0], b * half[1], 0.0] for a, b in ((1, 1), (-1, 1), (-1, -1), (1, -1))]
    scene = scene_with(
        f"b: {{shape: {{box: [0.4, 0.3, 0.0001]}}, mass: {mass}}}",
        "b: {xyz: [0, 0, 0]}",
        [f"between: [{{frame: b, points: {feet}}}, {GROUND}], friction: {mu}"],
        **{"method": "dop853", "dt": 0.02},
        twist="b: {linear: [1, 0, 0], angular: [0, 0, 3]}",
    )
    simulation = scene.simulation()
    t = 0.34  # 0.02 s before it stops
    *_, x = simulation.run(scene.initial, t)
    expected = spinning(t, 1.0, 3.0, mu, half, mass)
    assert x.q[:2] == pytest.approx(expected[:2], abs=1e-9)
    assert x.v[5] == pytest.approx(expected[4], abs=1e-8)
    *_, x = simulation.run(x, 0.1)
    assert np.abs(x.v).max() <= 1e-12 and len(simulation.events) == 1


def test_a_box_on_a_plate_that_tilts_slips_when_no_share_of_its_forces_is_left():
    """It slips at g s - w^2 x = mu (g c - w^2 h); the share of least norm breaks laws before."""
    mu, omega, height = 0.6, 0.5, 0.1
    plate = urdf(
        *(link("world"), link("plate", 1.0)),
        joint("tilt", "revolute", "world", "plate", (0, 1, 0)),
    )
    scene = scene_of(
        "bodies: {b: {shape: {box: [0.4, 0.4, 0.2]}, mass: 2.0}}\n"
        f"initial: {{pose: {{b: {{xyz: [0.1, 0, {height}]}}}}, velocity: {{tilt: {-omega}}},\n"
        f"  twist: {{b: {{linear: [{-omega * height}, 0, {omega * 0.1}], "
        f"angular: [0, {-omega}, 0]}}}}}}\n"
        f"constraints: [{{type: prescribed_motion, joint: tilt, polynomial: [0.0, {-omega}]}}]\n"
        f"contacts: [{{type: rigid, friction: {mu}, between: [{feet_of('b', 0.2, 0.1)}, "
        "{frame: plate, half_space: [0, 0, 1]}]}]\ndt: 0.05\nintegrator: {type: dopri5}\n",
        plate,
    )
    simulation = scene.simulation()
    for _ in simulation.run(scene.initial, 1.3):
        pass

    def excess(t):
        angle = omega * t
        normal = GRAVITY * np.cos(angle) - omega**2 * height
        return GRAVITY * np.sin(angle) - omega**2 * 0.1 - mu * normal

    (event,) = simulation.events
    assert event.t == pytest.approx(brentq(excess, 0.1, 1.5, xtol=1e-14), abs=1e-9)


def test_a_ball_meets_another_one_before_it_falls_on_the_ground():
    """One long step ends below the ground, behind the place where the balls met and parted."""
    scene = scene_of(
        "bodies:\n"
        "  fast: {shape: {sphere: 0.1}, mass: 1.0, pose: {xyz: [0.0, 0.0, 1.0]}}\n"
        "  slow: {shape: {sphere: 0.1}, mass: 1.0, pose: {xyz: [0.5, 0.0, 1.0]}}\n"
        "contacts:\n"
        "- {type: rigid, between: [fast, slow], friction: 0.0, restitution: 1.0}\n"
        "- {type: rigid, between: [fast, ground], friction: 0.0}\n"
        "initial: {twist: {fast: {linear: [9.0, 0.0, 0.0]}}}\n"
        "dt: 1.0\n"
    )
    simulation = scene.simulation()
    list(simulation.run(scene.initial, 1.0))
    assert simulation.events[0].t == pytest.approx(0.3 / 9.0, abs=1e-12)
    assert simulation.events[0].after.v[6] == pytest.approx(9.0, abs=1e-12)


def test_forces_of_a_state_that_is_not_finite_are_none():
    """A simulation that diverges is to say so itself, with joint and time."""
    from mbd_ros.core.optimization.least_norm import balanced, least_balanced

    A = np.full((3, 3), np.nan)
    for solve in (balanced, least_balanced):
        assert np.isnan(solve(A, np.ones(3), np.ones(3))[0]).all()
