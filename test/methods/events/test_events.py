"""Exact rows and guards: closed forms, orders through events, and equations by hand."""

import math
import re

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT
from scipy.integrate import solve_ivp

from mbd_ros.errors import SceneError

INERTIA = '<inertia ixx="{0}" iyy="{0}" izz="{0}" ixy="0" ixz="0" iyz="0"/>'
BALL = f"""<robot name="ball"><link name="ground"/><link name="ball"><inertial>
<mass value="2.0"/>{INERTIA.format(0.01)}</inertial></link>
<joint name="height" type="prismatic"><parent link="ground"/><child link="ball"/>
<axis xyz="0 0 1"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/></joint></robot>"""
G = 9.81
EXACT = {"type": "dop853", "tolerance": 1e-12}


def link(name, mass, length, turn):
    return f"""<link name="{name}"><inertial><origin xyz="{length / 2} 0 0"/>
<mass value="{mass}"/>{INERTIA.format(turn)}</inertial></link>"""


ARM = f"""<robot name="arm"><link name="ground"/>{link("upper", 2.0, 0.6, 0.08)}
{link("lower", 1.5, 0.5, 0.05)}
<joint name="shoulder" type="continuous"><parent link="ground"/><child link="upper"/>
<axis xyz="0 -1 0"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="lower"/>
<origin xyz="0.6 0 0"/><axis xyz="0 -1 0"/></joint></robot>"""


def ball(e, **sections):
    stop = f"{{type: joint_stop, joint: height, lower: 0.0, restitution: {e}}}"
    return scene_of(
        f"constraints: [{stop}]\ninitial: {{position: {{height: 1.0}}}}\n"
        + "".join(f"{key}: {value}\n" for key, value in sections.items()),
        BALL,
    )


def run(loaded, duration, integrator=EXACT, dt=0.05):
    simulation = loaded.simulation(integrator=integrator, dt=dt)
    return simulation, list(simulation.run(loaded.initial, duration))


@pytest.mark.parametrize("kind", ["rk4", "dopri5", "dop853"])
def test_a_ball_bounces_as_high_as_restitution_says_and_comes_to_rest_in_time(kind):
    """Heights e^(2 n) h, and rest after sqrt(2 h / g) (1 + e) / (1 - e)."""
    simulation, states = run(ball(0.8), 5.0, {"type": kind})
    fall = math.sqrt(2.0 / G)
    hits = [event for event in simulation.events if event.impulse.any()]
    assert len(hits) > 40
    for n, event in enumerate(hits[:25]):
        height = event.after.v[0] ** 2 / (2.0 * G)
        assert height == pytest.approx(0.8 ** (2 * n + 2), abs=1e-9)
        assert event.impulse[0] == pytest.approx(2.0 * (event.after.v - event.before.v)[0])
    first = [fall * (1.0 + 2.0 * sum(0.8**k for k in range(1, n + 1))) for n in range(25)]
    assert [event.t for event in hits[:25]] == pytest.approx(first, abs=1e-9)
    rest = simulation.events[-1]
    assert rest.t == pytest.approx(fall * 1.8 / 0.2, abs=1e-9)
    assert rest.after.mode == (0,) and rest.guards == ("height_joint_stop.force",)
    assert min(x.q[0] for x in states) >= -1e-9
    assert abs(states[-1].q[0]) <= 1e-15 and abs(states[-1].v[0]) <= 1e-15
    assert simulation.system.evaluate(states[-1]).lam == pytest.approx([2.0 * G])


@pytest.mark.parametrize(("e", "dt"), [(0.8, 0.2), (0.9, 0.05), (0.95, 0.01)])
def test_a_long_row_of_short_bounces_comes_to_rest(e, dt):
    """More of them than other events may follow one another within a thousandth of dt."""
    fall = math.sqrt(2.0 / G) * (1.0 + e) / (1.0 - e)
    simulation, states = run(ball(e), fall + 0.2, {"type": "rk4"}, dt)
    assert simulation.events[-1].t == pytest.approx(fall, abs=1e-9)
    assert simulation.events[-1].after.mode == (0,)
    assert abs(states[-1].q[0]) <= 1e-15 and abs(states[-1].v[0]) <= 1e-15


def test_a_thousand_radians_a_second_into_a_stop_stay_inside():
    stop = "{type: joint_stop, joint: elbow, upper: 0.5, restitution: 0.9}"
    start = "initial: {velocity: {elbow: 1000.0}}\n"
    for kind in ("rk4", "dopri5", "dop853"):
        simulation, states = run(
            scene_of(f"constraints: [{stop}]\n{start}", ARM), 0.005, {"type": kind}, 1e-4
        )
        assert max(x.q[1] for x in states) <= 0.5 + 1e-9
        assert any(event.impulse.any() for event in simulation.events)


def test_two_stops_at_once_are_one_event():
    """Equal masses side by side: both gaps close together, and one impact ends both."""
    stop = "{{type: joint_stop, joint: {}, upper: 0.3, restitution: {}}}"
    loaded = scene_of(
        "robot: {urdf: package://mbd_ros/config/robots/benchmark/point_in_plane.urdf,"
        " gravity: [0.0, 0.0, 0.0]}\n"
        f"constraints: [{stop.format('x', 0.5)}, {stop.format('y', 0.25)}]\n"
        "initial: {velocity: {x: 2.0, y: 2.0}}\n"
    )
    simulation, states = run(loaded, 0.3, {"type": "rk4"}, 0.01)
    (event,) = simulation.events
    assert len(event.guards) == 2 and event.t == pytest.approx(0.15, abs=1e-12)
    assert event.after.v == pytest.approx([-1.0, -0.5], abs=1e-12)
    assert (event.impulse > 0.0).all()
    assert states[-1].q == pytest.approx([0.3 - 0.15, 0.3 - 0.075], abs=1e-12)


FRICTION, END, E = 3.0, 0.9, 0.4
ROWS = f"""robot: {{gravity: [0.0, 0.0, -{G}]}}
constraints:
- {{type: dry_friction, joint: shoulder, limit: {FRICTION}}}
- {{type: joint_stop, joint: elbow, upper: {END}, restitution: {E}}}
initial: {{position: {{shoulder: -1.2, elbow: 0.3}}, velocity: {{shoulder: 1.0, elbow: 2.0}}}}
"""
LAST = 1.1


def mass_and_bias(q, v):
    """M and h of the arm, by hand; angles count from the x axis upwards."""
    c, s = math.cos(q[1]), math.sin(q[1])
    far, near = 1.5 * 0.6 * 0.25, 1.5 * 0.25**2 + 0.05
    one = 2.0 * 0.3**2 + 0.08 + 1.5 * 0.6**2 + near
    M = np.array([[one + 2.0 * far * c, near + far * c], [near + far * c, near]])
    pull = 1.5 * G * 0.25 * math.cos(q[0] + q[1])
    h = [
        -far * s * (2.0 * v[0] + v[1]) * v[1]
        + G * (2.0 * 0.3 + 1.5 * 0.6) * math.cos(q[0])
        + pull,
        far * s * v[0] ** 2 + pull,
    ]
    return M, np.array(h)


def forces(y, slips, closed):
    """Accelerations, friction and the push of the stop, from one system of equations."""
    M, h = mass_and_bias(y[:2], y[2:])
    rows = [J for J, on in (([1.0, 0.0], not slips), ([0.0, -1.0], closed)) if on]
    J, push = np.array(rows).reshape(-1, 2), np.array([-slips * FRICTION, 0.0])
    whole = np.block([[M, -J.T], [J, np.zeros((len(J), len(J)))]])
    a = np.linalg.solve(whole, np.concatenate((push - h, np.zeros(len(J)))))
    lam = list(a[2:])
    return a[:2], (push[0] if slips else lam.pop(0)), (lam.pop(0) if closed else 0.0)


def piece(t, y, slips, closed):
    """A smooth piece of the motion up to its first event, and what ends it."""
    ends = {
        "stop": (lambda t, y: forces(y, slips, closed)[2]) if closed else lambda t, y: END - y[1]
    }
    if slips:
        ends["stick"] = lambda t, y: slips * y[2]
    else:
        ends["slip"] = lambda t, y: FRICTION - abs(forces(y, slips, closed)[1])
    for end in ends.values():
        end.terminal, end.direction = True, -1
    accurate = {"rtol": 1e-13, "atol": 1e-13, "max_step": 0.01}
    found = solve_ivp(
        lambda t, y: [*y[2:], *forces(y, slips, closed)[0]],
        (t, LAST),
        y,
        "DOP853",
        events=list(ends.values()),
        **accurate,
    )
    what = [name for name, at in zip(ends, found.t_events, strict=True) if len(at)]
    return found.t[-1], found.y[:, -1].copy(), what[0] if what else ""


def by_hand():
    """Pieces of smooth motion by scipy; each mode is an equation of its own."""
    t, y, slips, closed, times = 0.0, np.array([-1.2, 0.3, 1.0, 2.0]), 1.0, False, []
    while True:
        t, y, what = piece(t, y, slips, closed)
        if not what:
            return y, times
        times.append(t)
        if what == "stop" and not closed:
            response = np.linalg.solve(mass_and_bias(y[:2], y[2:])[0], [0.0, -1.0])
            y[1], y[2:] = END, y[2:] + response * (1.0 + E) * y[3] / -response[1]
            slips = math.copysign(1.0, y[2])
        elif what == "stop":
            closed = False
        elif what == "stick":
            y[2] = 0.0
            held = forces(y, 0.0, closed)[1]
            slips = 0.0 if abs(held) <= FRICTION else -slips
        else:
            slips = -math.copysign(1.0, forces(y, slips, closed)[1])


@pytest.fixture(scope="module")
def reference():
    return by_hand()


@pytest.mark.parametrize(
    ("kind", "counts", "order"),
    [
        ("rk4", (150, 200, 250, 300, 400, 500), 4),
        ("dopri5", (70, 90, 110, 140, 180, 220), 5),
        ("dop853", (14, 17, 20, 24, 28, 32, 36, 40), 8),
    ],
)
def test_order_holds_through_stops_and_dry_friction(reference, kind, counts, order):
    """Slope over several steps, since the first few are off by how events fall into steps."""
    loaded, (y, times) = scene_of(ROWS, ARM), reference
    steps, errors = LAST / np.array(counts), []
    for dt in steps:
        simulation, states = run(loaded, LAST, {"type": kind}, dt)
        assert len(simulation.events) == len(times)
        errors.append(np.abs([*states[-1].q, *states[-1].v] - y).max())
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.25)
    assert errors[-1] <= 1e-7


def test_adaptive_steps_reach_the_reference(reference):
    y, times = reference
    simulation, states = run(scene_of(ROWS, ARM), LAST)
    assert [*states[-1].q, *states[-1].v] == pytest.approx(y, abs=1e-9)
    assert [event.t for event in simulation.events] == pytest.approx(times, abs=1e-10)


def test_methods_without_events_refuse_exact_rows_by_name():
    with pytest.raises(SceneError, match=r"Rattle .*events.*height_joint_stop.*smoothed: true"):
        ball(0.5).simulation(integrator={"type": "rattle"})


def test_a_guard_and_a_reset_of_ones_own():
    """The escapement of the page: 1 kg on 4 N/m passes the middle upwards once in a period."""
    page = (ROOT / "docs/extend.md").read_text(encoding="utf-8")
    (code,) = re.findall(r"^```python\n# escapement.py\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    exec(code, found := {})
    loaded = scene_of(
        "robot: {urdf: package://mbd_ros/config/robots/benchmark/point_in_plane.urdf,"
        " gravity: [0.0, 0.0, 0.0]}\n"
        "forces: [{type: joint_spring, joint: x, stiffness: 4.0}]\n"
        "initial: {position: {x: 0.5}}\n"
    )
    clock = found["Escapement"](loaded.robot, joint="x", speed=0.1)
    simulation = loaded.simulation(integrator=EXACT, dt=0.05, forces=(clock,))
    states = list(simulation.run(loaded.initial, 10.0))
    upwards = np.array([event.t for event in simulation.events])
    assert upwards == pytest.approx([(0.75 + n) * math.pi for n in range(3)], abs=1e-9)
    speeds = [(event.before.v[0], event.after.v[0]) for event in simulation.events]
    assert np.array(speeds) == pytest.approx(
        np.array([(1.0 + 0.1 * n, 1.1 + 0.1 * n) for n in range(3)]), abs=1e-9
    )
    x, since = states[-1], 10.0 - 2.75 * math.pi
    assert x.q[0] == pytest.approx(1.3 * math.sin(2.0 * since) / 2.0, abs=1e-9)
    with pytest.raises(SceneError, match=r"Rattle does not stop at events.*: escapement"):
        loaded.simulation(integrator={"type": "rattle"}, forces=(clock,))


def test_surfaces_and_rows_that_begin_together_move_as_surfaces_alone():
    """Friction in y as a row, and as a second relay; the relay in x pushes y, too."""
    head = (
        "robot: {urdf: package://mbd_ros/config/robots/benchmark/point_in_plane.urdf,"
        " gravity: [0.0, 0.0, 0.0]}\n"
        "initial: {velocity: {x: 1.0, y: 0.5}}\nintegrator: {type: filippov}\n"
    )
    relay = "- {{type: switching_force, velocity: {{{0}: [0.0, 1.0]}}, above: {1}, below: {2}}}\n"
    pushing = relay.format("x", "{x: -2.0, y: 0.5}", "{x: 2.0, y: -0.5}")
    friction = relay.format("y", "{y: -1.0}", "{y: 1.0}")
    row = "constraints:\n- {type: dry_friction, joint: y, limit: 1.0}\n"
    one = run(scene_of(f"{head}forces:\n{pushing}{friction}"), 2.0, None, 0.05)
    other = run(scene_of(f"{head}{row}forces:\n{pushing}"), 2.0, None, 0.05)
    assert one[0].events[-1].after.mode == other[0].events[-1].after.mode == (0, 0)
    for x, y in zip(one[1], other[1], strict=True):
        assert [*x.q, *x.v] == pytest.approx([*y.q, *y.v], abs=1e-12)


def test_a_gap_that_opens_by_less_than_rounding_closes_again():
    """A coupled arm on two stops that come to rest one on the other's bounces."""
    robots = "package://mbd_ros/config/robots"
    loaded = scene_of(
        f"""robot: {{urdf: {robots}/arm7.urdf}}
couplings: {{joint4: {{parent: joint2, factor: 0.5}}}}
constraints:
- {{type: joint_stop, joint: joint2, upper: 0.55, restitution: 0.3}}
- {{type: joint_stop, joint: joint6, upper: 0.2}}
- {{type: dry_friction, joint: joint1, limit: 2.0}}
initial: {{position: {{joint2: 0.5}}, velocity: {{joint1: 1.0, joint3: -2.0}}}}
"""
    )
    simulation, states = run(loaded, 0.4, {"type": "dop853", "tolerance": 1e-11}, 0.02)
    assert max(x.q[1] for x in states) <= 0.55 + 1e-12
    assert min(x.q[5] for x in states) >= loaded.robot.joint("joint6").lower - 1e-12
    assert len(simulation.events) > 20
