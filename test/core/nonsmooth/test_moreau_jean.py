"""Time-stepping with impacts, stick and stiff loads, against closed forms and scipy."""

import numpy as np
import pytest
from mechanisms import (
    chain,
    double_pendulum,
    joint,
    link,
    scene_of,
    urdf,
)
from scipy.integrate import solve_ivp

from mbd_ros.api import scene_from
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, SceneError

GRAVITY = 9.81
SLIDER = urdf(
    link("world"), link("box", 2.0), joint("slide", "prismatic", "world", "box", (1, 0, 0))
)
BALL = urdf(link("world"), link("ball", 2.0), joint("fall", "prismatic", "world", "ball"))
TWO = urdf(
    *(link("world"), link("one", 2.0), link("other", 3.0)),
    joint("first", "prismatic", "world", "one", (1, 0, 0)),
    joint("second", "prismatic", "world", "other", (1, 0, 0)),
)
"""Two boxes on one line."""


def run(text, description, start, duration, dt, theta=0.5):
    """States of all joints every dt."""
    scene = scene_of(f"integrator: {{type: moreau_jean, theta: {theta}}}\n{text}", description)
    x = State(0.0, *(np.array(each, dtype=float) for each in start))
    return list(scene.simulation(dt=dt).run(x, duration))


def observed_order(errors):
    return np.log2(errors[0] / errors[1])


SPRUNG = """
forces: [{type: joint_spring, joint: joint_2, stiffness: 3.0, damping: 0.4}]
"""


def rods(q2):
    """Mass matrix of two rods of 1 m and 1 kg, and its derivative by the second angle."""
    own = 1.0 / 12.0
    far = own + 0.25
    M12 = far + 0.5 * np.cos(q2)
    M = np.array([[own + 0.25 + far + 1.0 + np.cos(q2), M12], [M12, far]])
    return M, np.sin(q2) * np.array([[-1.0, -0.5], [-0.5, 0.0]])


def double_rods(t, x):
    """Lagrange's equations of two rods in a plane, a spring and a damper between them."""
    M, slope = rods(x[1])
    v = x[2:]
    torque = np.array([0.0, -3.0 * x[1] - 0.4 * v[1] + 0.5 * v @ slope @ v])
    return np.concatenate((v, np.linalg.solve(M, torque - v[1] * slope @ v)))


def geared_rods(t, x):
    """The same while the second angle is half of the first."""
    G = np.array([1.0, 0.5])
    M, slope = rods(0.5 * x[0])
    bent = 0.25 * G @ slope @ G * x[1] ** 2
    spring = -0.5 * (3.0 * 0.5 * x[0] + 0.4 * 0.5 * x[1])
    return np.array([x[1], (spring - bent) / (G @ M @ G)])


def solved(equations, start, duration):
    ends = solve_ivp(equations, (0.0, duration), start, "DOP853", rtol=1e-12, atol=1e-12)
    return ends.y[:, -1]


def test_smooth_motion_has_order_2():
    """Two rods with a spring and a damper, against Lagrange's equations."""
    expected = solved(double_rods, [0.3, 0.5, 2.0, -1.0], 1.0)
    errors = []
    for dt in (0.02, 0.01):
        x = run(SPRUNG, double_pendulum(), ([0.3, 0.5], [2.0, -1.0]), 1.0, dt)[-1]
        errors.append(np.abs(np.concatenate((x.q, x.v)) - expected).max())
    assert observed_order(errors) == pytest.approx(2.0, abs=0.25)


@pytest.mark.parametrize("tier", ["reduced", "kkt"])
def test_couplings_have_order_2(tier):
    """The same with the second joint coupled to the first, eliminated and as a row."""
    text = f"couplings: {{joint_2: {{parent: joint_1, factor: 0.5}}}}\nsolver: {{type: {tier}}}"
    expected = solved(geared_rods, [0.6, 2.0], 1.0)
    errors = []
    for dt in (0.02, 0.01):
        x = run(text + SPRUNG, double_pendulum(), ([0.6, 0.3], [2.0, 1.0]), 1.0, dt)[-1]
        assert x.q[1] == pytest.approx(0.5 * x.q[0], abs=1e-12)
        errors.append(np.abs(np.array([x.q[0], x.v[0]]) - expected).max())
    assert observed_order(errors) == pytest.approx(2.0, abs=0.25)


def test_rows_that_hold_have_order_2():
    """A mass on two rails and a bar is a pendulum."""
    rails = urdf(
        *(link("world"), link("cart"), link("bob", 1.0)),
        joint("x", "prismatic", "world", "cart", (1, 0, 0)),
        joint("z", "prismatic", "cart", "bob", (0, 0, 1)),
    )
    bar = "constraints: [{type: distance, frame_a: world, frame_b: bob, distance: 1.0}]"
    angle, _ = solved(lambda t, x: [x[1], -GRAVITY * np.sin(x[0])], [1.2, 0.5], 1.0)
    errors = []
    for dt in (0.02, 0.01):
        start = [np.sin(1.2), -np.cos(1.2)], [0.5 * np.cos(1.2), 0.5 * np.sin(1.2)]
        x = run(bar, rails, start, 1.0, dt)[-1]
        errors.append(np.abs(x.q - [np.sin(angle), -np.cos(angle)]).max())
        assert x.v @ x.q == pytest.approx(0.0, abs=1e-12)
    assert observed_order(errors) == pytest.approx(2.0, abs=0.25)


def test_a_ball_bounces_to_its_heights_and_comes_to_rest():
    """Heights of e = 0.8 are those of e^2; the bounces add up to a finite time."""
    stop = "constraints: [{type: joint_stop, joint: fall, lower: 0.0, restitution: 0.8}]"
    states = run(stop, BALL, ([1.0], [0.0]), 4.2, 2e-3)
    z, v = np.array([(x.q[0], x.v[0]) for x in states]).T
    tops = np.flatnonzero((v[:-1] > 0.0) & (v[1:] <= 0.0))
    resolution = GRAVITY * 2e-3**2
    assert z[tops][:8] == pytest.approx(0.64 ** np.arange(1, 9), abs=resolution)
    assert z.min() >= -1e-12
    rest = np.sqrt(2.0 / GRAVITY) * (1.0 + 2.0 * 0.8 / 0.2)
    late = [x for x in states if x.t > rest + 0.02]
    assert late and all(abs(x.q[0]) <= 1e-12 and abs(x.v[0]) <= 1e-12 for x in late)


def bouncing_pendulum(start, duration, stop, e):
    """A rod under gravity that hits a stop, by events of scipy."""

    def fall(t, x):
        return [x[1], 1.5 * GRAVITY * np.cos(x[0])]

    def gap(t, x):
        return stop - x[0]

    gap.terminal, gap.direction = True, -1.0
    t, x = 0.0, np.array(start)
    while t < duration:
        part = solve_ivp(fall, (t, duration), x, "DOP853", events=gap, rtol=1e-12, atol=1e-12)
        t, x = part.t[-1], part.y[:, -1].copy()
        if part.status == 1:
            x = np.array([stop, -e * x[1]])
    return x


def test_a_pendulum_on_a_stop_converges_to_the_solution_from_event_to_event():
    """Three hits with e = 0.6; the rod turns about y, so that it falls."""
    swing = urdf(
        link("world"),
        link("rod", 1.0, (0.5, 0.0, 0.0), (1e-9, 1.0 / 12.0, 1.0 / 12.0)),
        joint("hinge", "revolute", "world", "rod", (0, 1, 0)),
    )
    stop = "constraints: [{type: joint_stop, joint: hinge, upper: 1.0, restitution: 0.6}]"
    expected = bouncing_pendulum([-0.2, 0.0], 1.5, 1.0, 0.6)
    errors = []
    for dt in (4e-3, 2e-3, 1e-3):
        states = run(stop, swing, ([-0.2], [0.0]), 1.5, dt)
        assert max(x.q[0] for x in states) <= 1.0 + 1e-12
        errors.append(np.abs(np.concatenate((states[-1].q, states[-1].v)) - expected).max())
    assert errors[-1] < errors[0] / 3.0 and errors[-1] <= 1e-3


def test_an_arm_between_stops_converges_to_the_motion_from_event_to_event():
    """Seven joints with stops, three of them with dry friction: two formulations of one motion."""
    rubbing = [{"type": "dry_friction", "joint": f"joint{i}", "limit": 1.0} for i in (1, 3, 5)]
    stops = {"type": "joint_stop", "joints": ["all"], "restitution": 0.5}
    scene = scene_from({"constraints": [stops, *rubbing]}, urdf="arm7")
    x = State(0.0, np.full(7, 0.3), np.array([3.0, -2.0, 4.0, 2.0, -4.0, 3.0, -3.0]))
    exact = scene.simulation(integrator={"type": "dop853", "tolerance": 1e-9}, dt=0.1)
    expected = list(exact.run(x, 0.4))[-1]
    assert len(exact.events) >= 5
    errors = []
    for dt in (8e-3, 1e-3):
        stepped = scene.simulation(integrator={"type": "moreau_jean"}, dt=dt)
        errors.append(np.abs(list(stepped.run(x, 0.4))[-1].q - expected.q).max())
    assert errors[1] <= min(3e-3, errors[0] / 3.0)


def test_dry_friction_stops_a_box_and_holds_it_without_creep():
    """v^2 / 2 a of way; then a force below the limit moves it by nothing."""
    friction = "constraints: [{type: dry_friction, joint: slide, limit: 3.0}]\n"
    states = run(friction, SLIDER, ([0.0], [1.0]), 0.8, 2e-3)
    assert states[-1].q[0] == pytest.approx(1.0 / 3.0, abs=1e-5)
    pull = "forces: [{type: joint_torque, joint: slide, torque: 2.9}]\n"
    held = run(friction + pull, SLIDER, ([0.0], [0.0]), 1.0, 1e-2)
    assert max(abs(x.q[0]) for x in held) <= 1e-15
    pull = "forces: [{type: joint_torque, joint: slide, torque: 3.5}]\n"
    slides = run(friction + pull, SLIDER, ([0.0], [0.0]), 1.0, 1e-2)
    assert slides[-1].q[0] == pytest.approx(0.5 * 0.25, rel=1e-12)


def test_a_drive_in_its_limit_accelerates_by_it():
    """It starts 1 m behind a standing target; 4 N on 2 kg."""
    drive = (
        "constraints: [{type: prescribed_motion, joint: slide, polynomial: [1.0], limit: 4.0, "
        "time_constant: 0.02}]"
    )
    states = run(drive, SLIDER, ([0.0], [0.0]), 0.5, 1e-3)
    assert states[-1].q[0] == pytest.approx(0.25, rel=1e-12)
    end = run(drive.replace("4.0", "400.0"), SLIDER, ([0.0], [0.0]), 0.5, 1e-3)[-1]
    assert end.q[0] == pytest.approx(1.0, abs=1e-4)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of the explicit step that diverges
@pytest.mark.parametrize("stiffness", [1e4, 1e8, 1e12])
@pytest.mark.parametrize("theta", [0.5, 1.0])
def test_a_stiff_spring_does_not_limit_the_step(stiffness, theta):
    """Two boxes on a spring that a force pulls; explicit steps need dt < 2 / omega."""
    text = (
        f"forces:\n- {{type: point_spring, frame_a: one, frame_b: other, stiffness: {stiffness},"
        " length: 1.0}\n- {type: joint_torque, joint: first, torque: 10.0}\n"
    )
    start, dt = ([0.0, 1.001], [0.0, 0.0]), 2e-2
    states = run(text, TWO, start, 1.0, dt, theta)
    centre = (2.0 * states[-1].q[0] + 3.0 * states[-1].q[1]) / 5.0
    expected = 3.0 * 1.001 / 5.0 + 0.5 * 2.0 * (1.0 if theta == 0.5 else 1.0 + dt)
    assert centre == pytest.approx(expected, rel=1e-6)
    stretch = [abs(x.q[1] - x.q[0] - 1.0) for x in states]
    assert max(stretch) <= 1.1e-3 + 2.0 * 10.0 / stiffness
    if theta == 1.0 and stiffness > 1e7:
        assert stretch[-1] <= 1e-6
    if stiffness > 1e7:
        scene = scene_of(f"integrator: {{type: rk4}}\n{text}", TWO)
        with pytest.raises(DivergedError):
            list(scene.simulation(dt=dt).run(State(0.0, *map(np.array, start)), 20.0))


def test_a_fast_joint_stays_inside_its_stop():
    """1 000 rad/s, of which a step would take it 1 rad beyond."""
    for bounce in (0.0, 0.7):
        stop = (
            "constraints: [{type: joint_stop, joints: [joint_1, joint_2], lower: -0.5, "
            f"upper: 0.5, restitution: {bounce}}}]"
        )
        states = run(stop, chain(2), ([0.0, 0.1], [1000.0, -900.0]), 0.05, 1e-3)
        assert max(np.abs(x.q).max() for x in states) <= 0.5 + 1e-9


def test_stops_of_coupled_joints_act_together():
    """The second joint turns half as far: its stop is closed earlier, or at the same time."""
    coupled = "couplings: {joint_2: {parent: joint_1, factor: 0.5}}\n"
    for end in (0.25, 0.2):
        stops = (
            "constraints:\n- {type: joint_stop, joint: joint_1, upper: 0.5}\n"
            f"- {{type: joint_stop, joint: joint_2, upper: {end}}}\n"
        )
        states = run(coupled + stops, chain(2), ([0.0, 0.0], [3.0, 1.5]), 0.4, 5e-3)
        assert states[-1].q == pytest.approx([2.0 * end, end], abs=1e-9)
        assert max(x.q[1] for x in states) <= end + 1e-9


def test_what_it_cannot_do_is_refused():
    for theta in (0.49, 1.01):
        with pytest.raises(SceneError, match="integrator.theta"):
            scene_of(f"integrator: {{type: moreau_jean, theta: {theta}}}", SLIDER)


POINT = urdf(
    *(link("world"), link("a"), link("b"), link("bob", 2.0)),
    joint("x", "prismatic", "world", "a", (1, 0, 0)),
    joint("y", "prismatic", "a", "b", (0, 1, 0)),
    joint("z", "prismatic", "b", "bob", (0, 0, 1)),
)


def on_an_incline(degrees, friction, start, duration, dt):
    """A point on a plane that falls towards -x."""
    tilt = np.deg2rad(degrees)
    down = [-GRAVITY * np.sin(tilt), 0.0, -GRAVITY * np.cos(tilt)]
    text = (
        f"robot: {{gravity: {[float(g) for g in down]}}}\n"
        "contacts: [{type: rigid, between: [{frame: bob, sphere: 0}, ground], "
        f"friction: {friction}}}]"
    )
    return run(text, POINT, start, duration, dt)


def test_a_point_that_turns_downhill_slides_with_order_2():
    """mu = tan 30 deg: v (1 + cos phi) stays what it is, phi from the steepest way down."""
    errors = []
    for dt in (4e-3, 2e-3):
        mu = float(np.tan(np.deg2rad(30.0)))
        states = on_an_incline(30.0, mu, (np.zeros(3), [0.0, 1.0, 0.0]), 0.5, dt)
        kept = [np.hypot(*x.v[:2]) - x.v[0] for x in states]
        errors.append(np.abs(np.array(kept) - 1.0).max())
        assert max(abs(x.q[2]) for x in states) <= 1e-12
    assert errors[0] <= 1e-4 and observed_order(errors) == pytest.approx(2.0, abs=0.25)


@pytest.mark.parametrize(("mu", "speed"), [(0.3, 0.0), (0.3, 2.0), (0.2, 2.0)])
def test_a_block_on_an_incline_sticks_and_slips(mu, speed):
    """15 degrees, uphill at first: closed forms of the way up, and of what follows."""
    tilt, duration, dt = np.deg2rad(15.0), 1.2, 4e-3
    states = on_an_incline(15.0, mu, (np.zeros(3), [speed, 0.0, 0.0]), duration, dt)
    up, down = (GRAVITY * (np.sin(tilt) + s * mu * np.cos(tilt)) for s in (1.0, -1.0))
    top, late = speed**2 / (2.0 * up), duration - speed / up
    slides = max(down, 0.0)
    expected = top - 0.5 * slides * late**2
    assert states[-1].q[0] == pytest.approx(expected, abs=4.0 * up * dt * dt + slides * late * dt)
    if not slides:
        rest = [x.q[0] for x in states if x.t > speed / up + dt]
        assert np.ptp(rest) <= 1e-15


def test_a_stiff_series_elastic_drive_does_not_limit_the_step():
    """A spring of 1e9 N·m/rad turns rotor and rod into one body; steps of 10 ms."""
    swing = urdf(
        link("world"),
        link("rod", 1.0, (0.0, 0.0, -0.5), (1.0 / 12.0, 1.0 / 12.0, 1e-9)),
        joint("hinge", "revolute", "world", "rod", (0, 1, 0)),
    )
    drive = {"type": "series_elastic_drive", "joint": "hinge", "name": "drive", "ratio": 5.0}
    drive |= {"stiffness": 1e9, "rotor_inertia": 2e-3}
    first = {"position": {"hinge": 0.7}, "internal": {"drive": {"angle": 3.5, "speed": 0.0}}}
    integrator = {"type": "moreau_jean"}
    scene = scene_from(
        {"actuators": [drive], "initial": first, "integrator": integrator}, urdf=swing
    )
    inertia, weight = 1.0 / 3.0 + 25.0 * 2e-3, 0.5 * GRAVITY
    angle, rate = solved(lambda t, x: [x[1], -weight * np.sin(x[0]) / inertia], [0.7, 0.0], 1.0)
    errors = []
    for dt in (0.02, 0.01):
        x = list(scene.simulation(dt=dt).run(scene.initial, 1.0))[-1]
        assert x.z == pytest.approx([5.0 * x.q[0], 5.0 * x.v[0]], abs=1e-3)
        errors.append(max(abs(x.q[0] - angle), abs(x.v[0] - rate)))
    assert errors[1] <= 1e-3 and observed_order(errors) == pytest.approx(2.0, abs=0.25)
