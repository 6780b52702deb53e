"""Contact problems of the report: closed forms against scipy, and every package against them."""

import importlib
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mbd_ros.applications.report.contact import kind, ours
from mbd_ros.applications.report.contact import problems as closed_forms
from mbd_ros.applications.report.contact.kind import compose
from mbd_ros.applications.report.contact.problems import (
    Trace,
    damping_ratio,
    penetration,
    problems,
)
from mbd_ros.applications.report.peers.contenders import in_turn
from mbd_ros.applications.report.precision.converged import Choice

GRAVITY = 9.81
PROBLEMS = {problem.name: problem for problem in problems(quick=False)}
PEERS = {"MuJoCo": "mujoco", "Drake": "pydrake"}
DOP853 = Choice("plain", None, {"type": "dop853", "tolerance": 1e-11}, 1e-2)


@pytest.mark.parametrize("dt", [0.2, 0.02])
def test_a_ball_that_turns_12_rad_a_step_rolls_on_as_the_closed_form(dt):
    problem = PROBLEMS["sphere_backspin"]
    trace, _ = ours.OurContacts(problem, Choice("auto", None, {"type": "rk4"}, dt)).run(
        problem.times
    )
    assert problem.error(trace) < 1e-12


def slides(t, x, degrees, mu):
    """A block on a plane, sideways and downhill, by Coulomb's law."""
    angle, v = math.radians(degrees), x[2:]
    rub = mu * GRAVITY * math.cos(angle) * v / np.linalg.norm(v)
    return [*v, *(np.array([0.0, GRAVITY * math.sin(angle)]) - rub)]


def solved(start, degrees, mu, t):
    last = solve_ivp(slides, (0.0, t), start, "DOP853", args=(degrees, mu), rtol=1e-11, atol=1e-12)
    return last.y[:, -1]


@pytest.mark.parametrize("speed", [3.0, -0.5])
def test_a_block_that_brakes_is_known_until_it_stops(speed):
    found, v = closed_forms.incline(0.2, 15.0, 0.5, speed)
    known = solved([0.0, 0.0, 0.0, -speed], 15.0, 0.5, 0.2)
    assert (found, v) == pytest.approx((-known[1], -known[3]), abs=1e-9)


def test_a_block_that_stopped_stands_or_slides_back():
    stop = 3.0 / (GRAVITY * (math.sin(math.radians(20.0)) + 0.5 * math.cos(math.radians(20.0))))
    assert closed_forms.incline(2.0, 20.0, 0.5, 3.0) == (pytest.approx(1.5 * stop), 0.0)
    assert closed_forms.incline(2.0, 30.0, 0.3, 3.0)[1] < 0.0
    assert closed_forms.incline(3.0, 15.0, 0.3, 0.0) == (0.0, 0.0)


def test_a_bend_is_that_of_its_equation_of_motion():
    angle = math.radians(30.0)
    known = solved([0.0, 0.0, 2.0, 0.0], 30.0, math.tan(angle), 1.3)
    assert closed_forms.bend(1.3, 30.0, 2.0) == pytest.approx(known[:2], abs=1e-9)


def test_a_sphere_rolls_with_five_sevenths_of_its_speed():
    times = np.array([2.0, 2.5])
    ways = [closed_forms.rolling(t, 5.0, -60.0, 0.2, 0.1) for t in times]
    assert np.diff(ways) / np.diff(times) == pytest.approx((5.0 * 5.0 - 2.0 * 6.0) / 7.0)


def test_bounces_rise_to_their_heights_and_end():
    fall = math.sqrt(2.0 / GRAVITY)
    top = fall * (1.0 + 2.0 * 0.8 + 0.64)
    assert closed_forms.bounce(top, 1.0, 0.8) == pytest.approx(0.64**2)
    assert closed_forms.bounce(fall * 1.8 / 0.2 + 1e-6, 1.0, 0.8) == 0.0


def test_a_soft_contact_gives_back_what_its_damping_leaves():
    """A mass on a spring and damper that only pushes, until its force vanishes."""
    ratio = damping_ratio(0.8)

    def push(t, x):
        return -x[0] - 2.0 * ratio * x[1]

    push.terminal, push.direction = True, -1.0
    end = solve_ivp(
        lambda t, x: [x[1], push(t, x)], (0.0, 9.0), [-1e-12, -1.0], events=push, rtol=1e-10
    )
    assert end.y[1, -1] == pytest.approx(0.8, abs=1e-6)


@pytest.mark.parametrize("package", list(PEERS))
@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        *(("incline_up_stick", 2e-2), ("bend", 2e-2), ("sphere_backspin", 5e-2)),
        *(("table", 1e-3), ("stack", 2e-2)),
    ],
)
def test_peers_run_the_same_problems(package, name, allowed):
    """Nobody has the wrong mass, friction, spin or order of feet."""
    pytest.importorskip(PEERS[package])
    assert finest(package, PROBLEMS[name]) < allowed


def finest(package, problem):
    def judge(trace):
        return kind.judged(problem, trace)

    module = importlib.import_module(kind._PEERS[PEERS[package]])
    records = in_turn(list(module.runs(problem, quick=True)), problem.times, judge, 1)
    return min(record["position"] for record in records if "stopped" not in record)


@pytest.mark.parametrize("name", ["bounce", "sphere"])
def test_scenes_are_the_problems(name):
    """Event-driven to the precision that is asked, so that no mass, radius or law is another."""
    problem = PROBLEMS[name]
    trace, _ = ours.OurContacts(problem, DOP853).run(problem.times)
    assert problem.error(trace) <= 10.0 * problem.demanded
    assert penetration(problem, trace) <= 1e-9


def test_a_run_is_judged_by_its_largest_error():
    problem = PROBLEMS["incline_slip"]
    x = np.zeros((len(problem.times), 1, 3))
    x[:, 0, 0] = [closed_forms.incline(t, 30.0, 0.3, 0.0)[0] for t in problem.times]
    x[:, 0, 2] = 0.05
    assert kind.judged(problem, Trace(x, x, x, np.zeros(1)))["position"] < 1e-12
    x[3, 0, 0] += 0.01
    x[-1, 0, 2] -= 1e-4
    record = kind.judged(problem, Trace(x, x, x, np.zeros(1)))
    assert record["position"] == pytest.approx(0.01)
    assert record["penetration"] == pytest.approx(1e-4)
    x[5] = np.nan
    assert kind.judged(problem, Trace(x, x, x, np.zeros(1))) == {"stopped": "far off"}


def planted(position, package="mbd_ros", **others):
    choice = {"integrator": {"type": "moreau_jean"}, "solver": "plain", "stabilization": None}
    costs = {"seconds": 1e-3, "spread": None, "configuration": position, "penetration": 1e-12}
    run = {"package": package, "setup": "moreau_jean", "dt": 1e-3, "position": position}
    return {**run, **costs, **choice, **others}


def outcome(*runs, demanded=1e-9):
    facts = {"span": 1.0, "unit": "m/s", "demanded": demanded, "quick": False, "agreement": 0.0}
    return {"runs": list(runs), "setups": [], **facts}


def test_an_error_above_what_is_asked_is_wrong():
    assert compose([("stuck_box", outcome(planted(1e-12)))]).wrong == []
    (line,) = compose([("stuck_box", outcome(planted(1e-6)))]).wrong
    assert "stuck_box" in line and "1.0e-06" in line
    stopped = {"package": "mbd_ros", "setup": "rk4", "dt": 1e-3, "stopped": "t = 1 s: why"}
    (line,) = compose([("stuck_box", outcome(planted(1e-12), stopped))]).wrong
    assert "why" in line and "rk4" in line


def test_a_box_stands_beside_those_of_peers_at_equal_creep():
    runs = [planted(1e-12), planted(1e-7, "MuJoCo", setup="soft"), planted(1e-2, "Drake")]
    section = compose([("stuck_box", outcome(*runs)), ("dropped_box", outcome(*runs))])
    table = next(table for table in section.tables if table.title.startswith("A box"))
    cells = {(row[0], row[1]): row[2:] for row in table.rows}
    assert cells["1e-6", "MuJoCo"][0] == "soft" and cells["1e-9", "MuJoCo"][0] == "-"
    assert cells["1e-11", "mbd_ros"] == ["moreau_jean", "0.001", "1", "1", "1.0e-12", "1.0e-12"]


def test_a_section_without_runs_says_so():
    assert "No contact" in compose([]).text[0]
    failed = compose([("bend", {"failed": "not installed on this worker: mujoco"})])
    assert "mujoco" in failed.text[1]


def test_only_packages_that_know_contact_take_part():
    """Exudyn is a peer of other kinds of the report."""
    asked = {name for item in kind.items([], quick=True) for name in item.spec["peers"]}
    assert asked <= set(PEERS.values())
