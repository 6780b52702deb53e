"""Gains along a plan: their equations, and motions that they lead back."""

from functools import cache

import cart_pole
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are
from standing_plan import standing

from mbd_ros import load_scene
from mbd_ros.cli import main
from mbd_ros.core.state import State
from mbd_ros.errors import DataError, ModelError
from mbd_ros.features.control.regulator import read_reference, riccati_backwards, riccati_steady
from mbd_ros.files.plan import read_plan
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.methods.control.contract import EffortBox, Reference
from mbd_ros.methods.control.tracking_plan import IndependentSlopes, TrackingPlan
from mbd_ros.parts.controllers.trajectory_tracking import TrajectoryTracking


def motion_of(times, x, u, joints, inputs):
    """A result with the motion of some joints and efforts, all shape (n, ..)."""
    columns = [Column("time", times, "s")]
    for i, name in enumerate(joints):
        columns.append(Column(f"{name}.position", x[:, i]))
        columns.append(Column(f"{name}.velocity", x[:, len(joints) + i]))
    columns += [Column(f"{name}.effort", u[:, i]) for i, name in enumerate(inputs)]
    return Result({MAIN: Table(columns)})


@cache
def swing_up():
    times, x, u = cart_pole.swing_up(200, 8)
    return motion_of(times, x, u[:, None], ("cart", "pole"), ("cart",))


@cache
def followed():
    """The plan of the swing-up, whose pole stands up at its end."""
    return read_plan(load_scene("cart_pole").follow(swing_up(), tube=24))


# ---------------------------------------------------------------------- equations


def random_loop(rng, m=4, k=2):
    A, B = rng.normal(size=(m, m)), rng.normal(size=(m, k))
    half = rng.normal(size=(m, m))
    return A, B, half @ half.T + np.eye(m), np.diag(rng.uniform(0.1, 10.0, k))


def test_the_steady_cost_is_that_of_an_independent_solver():
    rng = np.random.default_rng(0)
    for _ in range(10):
        A, B, Q, R = random_loop(rng)
        np.testing.assert_allclose(
            riccati_steady(A, B, Q, R), solve_continuous_are(A, B, Q, R), rtol=1e-8, atol=1e-10
        )
    A[:, 0], A[0, 0], B[0] = 0.0, 1.0, 0.0
    A[0, 1:] = 0.0  # grows, and no input moves it
    assert riccati_steady(A, B, Q, R) is None


def test_the_cost_to_go_follows_its_equation_between_samples():
    """Against an integrator at 1e-10 of the equation itself, with slopes that change."""
    rng = np.random.default_rng(1)
    A, B, Q, R = random_loop(rng)
    times = np.linspace(0.0, 1.0, 11)
    As = A + times[:, None, None] * rng.normal(size=A.shape)
    Bs = np.stack([B] * len(times))

    def rate(t, S):
        S = S.reshape(4, 4)
        a = np.array([[np.interp(t, times, As[:, i, j]) for j in range(4)] for i in range(4)])
        return -(a.T @ S + S @ a - S @ B @ np.linalg.solve(R, B.T @ S) + Q).ravel()

    found = riccati_backwards(times, As, Bs, Q, R, Q)
    exact = solve_ivp(rate, (1.0, 0.0), Q.ravel(), rtol=1e-10, atol=1e-10, max_step=0.1)
    np.testing.assert_allclose(found[0], exact.y[:, -1].reshape(4, 4), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["controlled_four_bar", "controlled_arm"])
def test_linear_motion_is_the_slope_of_the_motion_itself(name):
    """Central differences of 20 ms of simulation; loops and couplings say the other joints."""
    scene = load_scene(name).with_(constraints=_closures(name))
    simulation = scene.simulation(integrator={"type": "dop853", "tolerance": 1e-12}, dt=0.02)
    system, rng = simulation.system, np.random.default_rng(2)
    start = scene.initial._replace(v=0.3 * rng.normal(size=scene.robot.model.nv))
    y = simulation.start(start)
    u, slopes = 0.1 * rng.normal(size=len(scene.actuated)), IndependentSlopes(system, [y])
    A, B = slopes.at(y, u)
    d, at = len(slopes.chosen), slopes.chosen

    def rates(e, du):
        """Rates of the independent state at a consistent state beside y."""
        moved, a = slopes.beside(y, e), np.zeros(system.nv)
        system.accelerator()(moved.t, moved.q, moved.v, u + du, a)
        return np.concatenate([moved.v[at], a[at]])

    h, none = 1e-5, np.zeros(len(u))
    steps = h * np.eye(2 * d)
    by_e = [(rates(e, none) - rates(-e, none)) / (2 * h) for e in steps]
    by_u = [(rates(0 * steps[0], e) - rates(0 * steps[0], -e)) / 2 for e in np.eye(len(u))]
    np.testing.assert_allclose(A, np.transpose(by_e), rtol=1e-5, atol=1e-5 * np.abs(A).max())
    np.testing.assert_allclose(B, np.transpose(by_u), rtol=1e-5, atol=1e-6 * np.abs(B).max())


def _closures(name):
    if name == "controlled_arm":
        return []
    return [
        dict(one) for one in load_scene(name).entries["constraints"] if "stop" not in one["type"]
    ]


# ---------------------------------------------------------------------- motions


@pytest.mark.soak
def test_a_hundred_disturbances_within_the_tube_return_to_the_plan():
    """By equations of the cart-pole written by hand, inputs held for 4 ms."""
    plan, rng = followed(), np.random.default_rng(3)
    assert plan.level > 0.1
    i, ways = rng.integers(0, 190, 100), rng.normal(size=(100, 4))
    costs = np.einsum("ni,nij,nj->n", ways, plan.cost[i], ways)
    sizes = np.sqrt(plan.level * rng.uniform(0.5, 1.0, 100) / costs)
    t = plan.times[i]
    x = np.concatenate([plan.q[i], plan.v[i]], axis=1) + sizes[:, None] * ways
    assert np.abs(sizes[:, None] * ways)[:, 1].max() > 0.1  # rad: it is not too narrow to matter
    for _ in range(750):
        wanted = [plan.at(one) for one in t]
        pairs = zip(x, wanted, strict=True)
        u = [w.u[0] - w.gain[0].dot(one - np.concatenate([w.q, w.v])) for one, w in pairs]
        held = np.clip(u, -20.0, 20.0)
        x = cart_pole.runge_kutta(lambda y, held=held: cart_pole.rates(y, held), x.T, 4e-3).T
        t = t + 4e-3
    assert np.abs(x - cart_pole.END).max() < 1e-3


def test_outside_of_the_tube_it_says_so_and_inside_not():
    scene, plan = load_scene("cart_pole"), followed()
    law = TrajectoryTracking(scene.controlled_joints(), plan=plan)
    begin, zero = plan.at(0.0), np.zeros(1)
    box, ref = EffortBox(-np.full(1, 20.0), np.full(1, 20.0)), Reference(zero, zero, zero)
    way = np.array([0.0, 1.0, 0.0, 0.0])
    size = np.sqrt(plan.level / way.dot(begin.cost).dot(way))
    for factor, warned in ((0.9, False), (1.1, True)):
        x = State(0.0, begin.q + factor * size * way[:2], begin.v)
        control = law.effort(x, ref, law.begin(), box)
        np.testing.assert_allclose(control.effort, begin.u - begin.gain[:, 1] * factor * size)
        assert bool(law.warnings()) == warned
        assert law.share == pytest.approx(factor**2)


def test_a_plan_survives_its_file_and_refuses_other_joints(tmp_path):
    result = load_scene("cart_pole").follow(swing_up(), tube=0)
    result.to(tmp_path / "plan.npz")
    plan = read_plan(tmp_path / "plan.npz")
    for name in ("q", "v", "u", "gain", "cost", "times"):
        np.testing.assert_array_equal(getattr(plan, name), getattr(read_plan(result), name))
    with pytest.raises(ModelError, match=r"cart, pole .* are not those of the scene"):
        TrajectoryTracking(load_scene("controlled_arm").controlled_joints(), plan=plan)
    with pytest.raises(ModelError, match="plan is missing"):
        TrajectoryTracking(load_scene("cart_pole").controlled_joints())
    with pytest.raises(DataError, match="holds no plan"):
        read_plan(swing_up())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"times": np.array([0.0, np.inf])}, "times must be two or more, finite"),
        ({"gain": np.full((2, 1, 2), 1e300)}, "gain is not finite, or beyond a size of 1e.30"),
        ({"cost": np.full((2, 2, 2), np.nan)}, "cost is not finite"),
    ],
)
def test_plans_of_numbers_that_lead_nowhere_are_refused(changes, message):
    plan = standing(("slide",))
    fields = {name: getattr(plan, name) for name in ("times", "q", "v", "u", "gain", "cost")}
    with pytest.raises(ModelError, match=message):
        TrackingPlan(plan.joints, plan.inputs, **fields | changes)


def test_the_command_writes_a_plan_and_says_its_tube(tmp_path, capsys):
    swing_up().to(tmp_path / "motion.csv")
    words = ["follow", "cart_pole", str(tmp_path / "motion.csv"), "--tube", "4"]
    assert main([*words, "-o", str(tmp_path / "plan.npz")]) == 0
    said = capsys.readouterr().out
    assert "202 samples, gains of cart" in said
    assert "tube: cost to go below" in said
    assert main([*words, "-o", str(tmp_path / "plan.csv")]) == 2
    assert main([*words, "-o", str(tmp_path / "plan.npz"), "--position", "0"]) == 2
    assert "position: 0 must be finite and > 0" in capsys.readouterr().err
    assert main([*words[:-1], "1000000000", "-o", str(tmp_path / "plan.npz")]) == 2
    assert "tube: 1000000000 disturbances, accepted are 0 .. 100000" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ("free_flyer", "fixed bases"),
        ("muscle_arm", "internal states"),
        ("prosthetic_arm", "the scene has none"),
    ],
)
def test_scenes_that_no_gains_lead_are_refused(scene, message):
    with pytest.raises(DataError, match=message):
        load_scene(scene).follow(swing_up())


def test_a_motion_without_efforts_is_refused():
    table = swing_up()[MAIN]
    bare = Table([column for column in table.columns if column.name != "cart.effort"])
    with pytest.raises(DataError, match="samples with efforts of cart"):
        load_scene("cart_pole").follow(Result({MAIN: bare}))


# ---------------------------------------------------------------------- a step that repeats


def struck(simulation, plan, x, period):
    """The state of all joints after the strike that ends a step from x, under the plan."""
    at = [[joint.name for joint in simulation.system.robot.joints].index(n) for n in plan.joints]
    y = simulation.start(x)
    simulation.stepper.take_events()
    for k in range(round(1.5 * plan.end / period)):
        x, wanted = simulation.system.expand(y), plan.at(k * period)
        e = np.concatenate([x.q[at] - wanted.q, x.v[at] - wanted.v])
        u = np.clip(wanted.u - wanted.gain.dot(e), -100.0, 100.0)
        y = simulation.advance(y, u, (k + 1) * period)
        for event in simulation.stepper.take_events():
            return event.after, at
    raise AssertionError("no strike")


@cache
def followed_step():
    """The biped, its step, and the plan that follows it."""
    scene = load_scene("five_link_biped")
    step = scene.predict("biped_step")
    return scene, step, read_plan(scene.follow(step))


@pytest.mark.soak
def test_the_tube_of_a_step_is_as_wide_as_it_is_said():
    _, _, plan = followed_step()
    ways = np.random.default_rng(0).normal(size=(1000, 10))
    costs = np.einsum("ni,ij,nj->n", ways, plan.cost[0], ways)
    e = ways * np.sqrt(plan.level / costs)[:, None]
    assert np.sqrt((e[:, :5] ** 2).mean()) > 0.01  # rad
    assert np.sqrt((e[:, 5:] ** 2).mean()) > 0.015  # rad/s


@pytest.mark.soak
@pytest.mark.parametrize("seed", [1, 2, 3, 4, 5])
def test_a_hundred_disturbed_steps_of_the_biped_return_to_the_plan(seed):
    """Events and impacts of the scene, torques held for 1 ms: the foot neither slips nor lifts,
    the next step begins in the tube, and most nearer to the plan than this one did."""
    scene, step, plan = followed_step()
    motion, rng = read_reference(scene, step), np.random.default_rng(seed)
    slopes = IndependentSlopes(scene.phased_system().systems[0], motion.states)
    simulation = scene.simulation(integrator={"type": "dop853", "tolerance": 1e-8})
    costs = []
    for _ in range(100):
        way = rng.normal(size=10)
        size = np.sqrt(plan.level * rng.uniform(0.5, 1.0) / way.dot(plan.cost[0]).dot(way))
        x, at = struck(simulation, plan, slopes.beside(motion.states[0], size * way), 1e-3)
        e = np.concatenate([x.q[at] - plan.q[0], x.v[at] - plan.v[0]])
        costs.append(e.dot(plan.cost[0]).dot(e))
    assert max(costs) < plan.level
    assert np.median(costs) < 0.6 * plan.level
