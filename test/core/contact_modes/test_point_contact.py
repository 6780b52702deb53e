"""One contact with friction, from event to event: open, sticking, slipping, and impacts."""

import numpy as np
import pytest
from mechanisms import floating_body, joint, link, scene_of, urdf
from places import ROOT
from point_contact import GRAVITY, block
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SceneError

ARM = (ROOT / "config/robots/arm7.urdf").read_text(encoding="utf-8")
POINT = urdf(
    *(link("world"), link("a"), link("b"), link("bob", 2.5)),
    joint("x", "prismatic", "world", "a", (1, 0, 0)),
    joint("y", "prismatic", "a", "b", (0, 1, 0)),
    joint("z", "prismatic", "b", "bob", (0, 0, 1)),
)


def contact(frame, mu, e=0.0, **more):
    at = {"frame": frame, "points": [more.get("point", [0, 0, 0])]}
    plane = {"half_space": more.get("normal", [0, 0, 1]), "xyz": more.get("xyz", [0, 0, 0])}
    entry = {"type": "rigid", "between": [at, plane], "friction": mu, "restitution": e}
    return str(entry).replace("'", "")


def on_an_incline(degrees, mu, v, duration, *, method="dopri5", dt=0.1):
    """Times, way uphill and across, and their rates, of a point on a plane."""
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    entry = contact("bob", mu, normal=[float(-s), 0, float(c)])
    scene = scene_of(f"contacts: [{entry}]\ndt: {dt}\nintegrator: {{type: {method}}}\n", POINT)
    axes = np.array(((c, 0.0, s), (0.0, 1.0, 0.0)))
    simulation = scene.simulation()
    states = list(simulation.run(State(0.0, np.zeros(3), v @ axes), duration))
    t = np.array([x.t for x in states])
    return t, *(np.array([axes @ getattr(x, name) for x in states]) for name in "qv")


@pytest.mark.parametrize(
    ("degrees", "mu", "v"),
    [(15, 0.3, 0.0), (30, 0.3, 0.0), (20, 0.5, 3.0), (30, 0.3, 3.0), (20, 0.5, -2.0)],
)
def test_a_block_on_an_incline_slips_and_sticks_as_in_closed_form(degrees, mu, v):
    t, q, _ = on_an_incline(degrees, mu, np.array((v, 0.0)), 2.0)
    assert q[:, 0] == pytest.approx(block(t, degrees, mu, v), abs=1e-9)
    assert np.abs(q[:, 1]).max() <= 1e-12


def turning_block(t, degrees=30.0, speed=2.0):
    """A point that starts across the slope, mu the tangent of its angle, by another solver."""
    s = np.sin(np.radians(degrees))

    def slope(t, y):
        v = y[2:]
        a = np.array((-GRAVITY * s, 0.0)) - GRAVITY * s * v / np.linalg.norm(v)
        return np.concatenate((v, a))

    start = (0.0, 0.0, 0.0, speed)
    return solve_ivp(slope, (0.0, t[-1]), start, "DOP853", t_eval=t, rtol=1e-13, atol=1e-14).y.T


def test_friction_is_isotropic_while_the_slip_turns():
    """v (1 + cos phi) stays; a pyramid along x and y keeps the speed across."""
    mu = float(np.tan(np.radians(30.0)))
    t, q, v = on_an_incline(30.0, mu, np.array((0.0, 2.0)), 1.5, method="dop853", dt=0.05)
    assert np.hypot(*v.T) - v[:, 0] == pytest.approx(2.0 + 0.0 * t, abs=1e-9)
    expected = turning_block(t)
    assert np.column_stack((q, v)) == pytest.approx(expected, abs=1e-8)


def test_methods_keep_their_order_while_the_slip_turns():
    mu, errors = float(np.tan(np.radians(30.0))), []
    for dt in (0.05, 0.025):
        t, q, _ = on_an_incline(30.0, mu, np.array((0.0, 2.0)), 0.5, method="rk4", dt=dt)
        errors.append(np.abs(q - turning_block(t)[:, :2]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4.0, abs=0.25)


@pytest.mark.parametrize("mu", [0.1, 5.0])
def test_a_point_bounces_off_the_ground_with_friction(mu):
    """Flights in closed form; every impact takes mu (1 + e) v_n off the speed along the ground."""
    e, height, along = 0.6, 0.8, 2.0
    scene = scene_of(f"contacts: [{contact('bob', mu, e)}]\ndt: 0.05\n", POINT)
    simulation = scene.simulation()
    *_, x = simulation.run(
        State(0.0, np.array((0.0, 0.0, height)), np.array((along, 0.0, 0.0))), 1.5
    )
    t, way, fall = np.sqrt(2.0 * height / GRAVITY), 0.0, np.sqrt(2.0 * height * GRAVITY)
    way, up = along * t, fall
    while True:
        along = max(along - mu * (1.0 + e) * up, 0.0)
        up *= e
        flight = 2.0 * up / GRAVITY
        if t + flight > 1.5:
            break
        t, way = t + flight, way + along * flight
    late = 1.5 - t
    assert x.q == pytest.approx(
        [way + along * late, 0.0, up * late - 0.5 * GRAVITY * late**2], abs=1e-9
    )


LENGTH, MASS = 0.7, 1.3  # from the tip of a leaning rod to its centre of mass, and its mass
ABOUT_COM = MASS * LENGTH**2 / 3.0
LEANING = urdf(
    *(link("world"), link("a"), link("b")),
    link("pole", MASS, (0.0, 0.0, LENGTH), (ABOUT_COM, ABOUT_COM, 0.01)),
    joint("x", "prismatic", "world", "a", (1, 0, 0)),
    joint("z", "prismatic", "a", "b", (0, 0, 1)),
    joint("lean", "revolute", "b", "pole", (0, 1, 0)),
)


def pole_forces(angle, rate, way, mu):
    """x'', angle'', tangential and normal force of a tip that sticks (way 0) or slips."""
    s, c, m = np.sin(angle), np.cos(angle), MASS
    A = np.array(
        (
            (m, m * LENGTH * c, -1.0, 0.0),
            (0.0, -m * LENGTH * s, 0.0, -1.0),
            (0.0, ABOUT_COM, LENGTH * c, -LENGTH * s),
            (1.0, 0.0, 0.0, 0.0) if way == 0 else (0.0, 0.0, 1.0, mu * way),
        )
    )
    right = (m * LENGTH * rate**2 * s, m * LENGTH * rate**2 * c - m * GRAVITY, 0.0, 0.0)
    return np.linalg.solve(A, right)


def falling_pole(angle, mu, duration):
    """State after a fall from rest that sticks, slips, and then slips the other way."""

    def stuck(t, y):
        return y[1], pole_forces(*y, 0, mu)[1]

    def margin(t, y):
        _, _, friction, normal = pole_forces(*y, 0, mu)
        return mu * normal - abs(friction)

    options = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-14}
    first = solve_ivp(stuck, (0.0, duration), (angle, 0.0), dense_output=True, **options)
    times = np.linspace(1e-3, duration, 400)
    signs = [margin(t, first.sol(t)) for t in times]
    after = next(i for i, value in enumerate(signs) if value < 0.0)
    begins = brentq(lambda t: margin(t, first.sol(t)), times[after - 1], times[after], xtol=1e-15)
    at = first.sol(begins)
    way = -np.sign(pole_forces(*at, 0, mu)[2])

    def slipping(t, y):
        a, alpha, _, _ = pole_forces(y[2], y[3], way, mu)
        return y[1], a, y[3], alpha

    slips, turns = (0.0, 0.0, *at), []
    for _ in range(2):

        def ends(t, y, since=begins, way=way):
            return way * y[1] if t > since + 1e-6 else 1.0

        ends.terminal = True
        found = solve_ivp(slipping, (begins, duration), slips, events=ends, **options)
        turns.append(begins)
        begins, slips, way = found.t[-1], found.y[:, -1], -way
    assert begins == duration
    return turns, slips


@pytest.mark.parametrize(("method", "dt"), [("dopri5", 5e-3), ("dop853", 0.02), ("rk4", 2.5e-3)])
def test_the_tip_of_a_falling_pole_sticks_and_then_slips(method, dt):
    """Against equations by hand: the normal force depends on the friction and the other way."""
    mu, duration = 0.35, 0.55
    turns, expected = falling_pole(0.4, mu, duration)
    scene = scene_of(f"contacts: [{contact('pole', mu)}]\ndt: {dt}\n", LEANING)
    simulation = scene.simulation(integrator={"type": method})
    start = State(0.0, np.array((0.0, 0.0, 0.4)), np.zeros(3))
    *_, x = simulation.run(start, duration)
    assert x.q[[0, 2]] == pytest.approx(expected[[0, 2]], abs=1e-9)
    assert x.v[[0, 2]] == pytest.approx(expected[[1, 3]], abs=1e-8)
    assert abs(x.q[1]) <= 1e-12
    assert [event.t for event in simulation.events] == pytest.approx(turns, abs=1e-9)


def test_the_multipliers_of_the_pole_are_the_forces_by_hand():
    mu, scene = 0.35, None
    scene = scene_of(f"contacts: [{contact('pole', mu)}]\n", LEANING)
    system = scene.system()
    for slip, angle, rate in ((0.0, 0.2, 0.1), (0.3, 0.9, 1.0), (-0.3, 0.9, 1.0)):
        now = system.evaluate(State(0.0, np.array((0.0, 0.0, angle)), np.array((slip, 0.0, rate))))
        a, alpha, friction, normal = pole_forces(angle, rate, np.sign(slip), mu)
        assert now.a == pytest.approx([a, 0.0, alpha], abs=1e-10)
        forces = np.zeros(3)
        (part,) = scene.constraints
        k = Kinematics(scene.robot)
        k.refresh(now.x.q, now.x.v)
        forces = part.jacobian(k, now.x).T @ now.lam
        assert forces[:2] == pytest.approx([friction, normal], abs=1e-9)


ROBOTS = {
    "arm": (ARM, "fixed", "flange", -0.05, np.array((0.0, 0.6, 0.0, -1.2, 0.0, 1.0, 0.0))),
    "free": (floating_body(), "floating", "left", -0.45, None),
}


@pytest.mark.parametrize("kind", ROBOTS)
def test_laws_hold_along_the_motion_of_a_robot_that_strikes_the_ground(kind):
    """Gap, cone and direction of friction at every sample; energy falls but for the loads."""
    text, base, frame, ground, q = ROBOTS[kind]
    mu, e = 0.4, 0.3
    at = f"[0, 0, {ground}]"
    entry = contact(frame, mu, e, xyz=at, point="[0, 0, -0.1]")
    scene = scene_of(f"robot: {{base: {base}}}\ncontacts: [{entry}]\ndt: 0.01\n", text)
    simulation = scene.simulation(integrator={"type": "dop853"})
    start = scene.initial if q is None else scene.initial._replace(q=q)
    system, (part,) = simulation.system, scene.constraints
    k, touched, energy = Kinematics(scene.robot), 0, []
    for x in simulation.run(start, 0.8):
        now = system.evaluate(x)
        k.refresh(x.q, x.v)
        gap, lam = part.residual(k, x)[0], now.lam
        slip = (part.jacobian(k, x) @ x.v)[1:]
        assert gap >= -1e-9 and lam[0] >= 0.0
        assert np.linalg.norm(lam[1:]) <= mu * lam[0] * (1.0 + 1e-9)
        if lam[0] > 0.0 and np.linalg.norm(slip) > 1e-6:
            along = slip / np.linalg.norm(slip)
            assert lam[1:] == pytest.approx(-mu * lam[0] * along, abs=1e-6 * lam[0])
        touched += bool(lam[0] > 0.0)
        energy.append(system.energy(x))
    assert touched or any(event.impulse.any() for event in simulation.events)
    assert np.diff(energy).max() <= 1e-7 * np.ptp(energy)


def test_a_contact_beside_a_stop_and_dry_friction_comes_to_rest_on_all_of_them():
    """Bounces of both accumulate; at rest more rows hold than coordinates are left to hold."""
    touching = contact("bob", 0.3, 0.8, normal=[0.2, 0, 1])
    rows = [
        "{type: joint_stop, joint: x, lower: -5.0, upper: 0.5}",
        "{type: dry_friction, joint: y, limit: 1.0}",
    ]
    rows = f"constraints: [{', '.join(rows)}]\ncontacts: [{touching}]\n"
    scene = scene_of(f"{rows}dt: 0.05\n", POINT)
    simulation = scene.simulation()
    start = State(0.0, np.array((0.0, 0.0, 1.0)), np.array((1.0, 2.0, 0.0)))
    *_, x = simulation.run(start, 5.0)
    assert x.q[[0, 2]] == pytest.approx([0.5, -0.1], abs=1e-9)
    assert np.abs(x.v).max() <= 1e-12
    lam = simulation.system.evaluate(x).lam
    n = np.array((0.2, 0.0, 1.0)) / np.hypot(0.2, 1.0)
    (*_, part), k = scene.constraints, Kinematics(scene.robot)
    k.refresh(x.q, x.v)
    stop, dry, *touch = lam
    push = part.jacobian(k, x).T @ touch + np.array((-stop, dry, -2.5 * GRAVITY))
    assert push == pytest.approx(np.zeros(3), abs=1e-9) and touch[0] > 0.0 and stop >= 0.0
    assert np.linalg.norm(touch[1:]) <= 0.3 * touch[0] and abs(n @ x.q) <= 1e-9


def test_what_a_contact_cannot_do_is_refused_by_name():
    one = scene_of(f"contacts: [{contact('bob', 0.1)}]", POINT)
    with pytest.raises((SceneError, ModelError), match="semi_implicit_euler|SemiImplicitEuler"):
        one.simulation(integrator={"type": "semi_implicit_euler"})
    with pytest.raises(SceneError, match="normal"):
        scene_of(f"contacts: [{contact('bob', 0.1, normal=[0, 0, 0])}]", POINT)
    with pytest.raises(SceneError, match="restitution"):
        scene_of(f"contacts: [{contact('bob', 0.1, 1.5)}]", POINT)


@pytest.mark.parametrize(("angle", "rate"), [(0.5, 0.0), (0.8, 1.5), (1.0, -0.5)])
def test_friction_that_jams_a_rod_ends_its_slip_by_an_impulse_without_collision(angle, rate):
    """Painlevé: backwards, more normal force makes the tip sink faster; by hand the tip stops."""
    mu, speed = 2.5, -1.0
    assert pole_forces(angle, rate, np.sign(speed), mu)[3] < 0.0  # no force is consistent
    scene = scene_of(f"contacts: [{contact('pole', mu, 0.5)}]\ndt: 0.001\n", LEANING)
    simulation = scene.simulation()
    start = State(0.0, np.array((0.0, 0.0, angle)), np.array((speed, 0.0, rate)))
    next(simulation.run(start, 0.01))
    (event,) = simulation.events
    s, c = np.sin(angle), np.cos(angle)
    levers = np.array((LENGTH * c, -LENGTH * s))  # of tangential and normal impulse
    mobility = np.eye(2) / MASS + np.outer(levers, levers) / ABOUT_COM
    impulse = np.linalg.solve(mobility, (-speed, 0.0))
    assert abs(impulse[0]) <= mu * impulse[1]
    assert event.impulse == pytest.approx((impulse[1], impulse[0], 0.0), abs=1e-9)
    after = (0.0, 0.0, rate - levers @ impulse / ABOUT_COM)
    assert event.after.v == pytest.approx(after, abs=1e-9)


def test_a_rod_jams_only_where_friction_couples_that_strongly():
    """Forwards, and with less friction, the same rod goes on without an impulse."""
    for mu, speed in ((2.5, 1.0), (0.5, -1.0)):
        scene = scene_of(f"contacts: [{contact('pole', mu)}]\ndt: 0.001\n", LEANING)
        simulation = scene.simulation()
        next(simulation.run(State(0.0, np.array((0, 0, 0.8)), np.array((speed, 0, 0.0))), 0.01))
        assert not simulation.events
