"""Explicit integrators against closed forms, exact cases and an independent solver."""

import math
from functools import cache

import numpy as np
import pytest
from integrators import Mass, distance, label, robot_system, solved, start
from scipy.special import ellipj, ellipk

from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, ModelError
from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.integration.runge_kutta import RK4
from mbd_ros.parts.integrators.adams import Adams
from mbd_ros.parts.integrators.dop853 import Dop853
from mbd_ros.parts.integrators.dopri5 import _TABLEAU as DOPRI5
from mbd_ros.parts.integrators.dopri5 import Dopri5
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.parts.integrators.semi_implicit_euler import SemiImplicitEuler

METHODS = [SemiImplicitEuler(), Rk4(), Dopri5(), Dop853(), *(Adams(order=k) for k in range(2, 9))]
ADAPTIVE = [Dopri5, Dop853]
EVERY = [*METHODS, *(kind(tolerance=1e-8) for kind in ADAPTIVE)]
DENSE = [(Rk4(), 3, 0.005), (Dopri5(), 4, 0.005), (Dop853(), 7, 0.02)]


AT_REST = State(0.0, np.zeros(1), np.zeros(1))


@cache
def swing(name, base, speed, t):
    """System, start and end of a free motion."""
    system = robot_system(name, base)
    x = start(system, speed)
    return system, x, solved(system, x, t)


def run(method, system, x, t, steps, u=None):
    stepper = method.prepare(system, (t - x.t) / steps)
    for _ in range(steps):
        x = stepper.step(x, u, t)
    return x


def run_adaptive(method, system, x, t, dt=1e-3):
    stepper, steps = method.prepare(system, dt), 0
    while x.t < t:
        x = stepper.step(x, None, t)
        steps += 1
    return x, steps


def pendulum(t, amplitude):
    """Angle and rate of the rod of pendulum.urdf, released at rest: elliptic functions."""
    frequency = math.sqrt(9.81 * 0.5 / (0.0833583 + 0.25))
    k = math.sin(0.5 * amplitude)
    sn, cn, _, _ = ellipj(ellipk(k * k) + frequency * t, k * k)
    return State(t, np.array([2 * math.asin(k * sn)]), np.array([2 * k * frequency * cn]))


@pytest.mark.parametrize(
    ("tableau", "order"), [(RK4, 4), (DOPRI5, 5), (DOP853, 8)], ids=["rk4", "dopri5", "dop853"]
)
def test_tableau_integrates_powers_of_time(tableau, order):
    """b c^(k-1) = 1 / k, and the same for every stage of the dense output up to its order."""
    c, n = tableau.a.sum(axis=1), tableau.stages
    for k in range(1, order + 1):
        assert tableau.a[n].dot(c ** (k - 1)) == pytest.approx(1 / k, abs=1e-14)
    for error in tableau.errors:  # an estimate of zero for what both methods solve
        weights = np.resize(error, len(c)) * (np.arange(len(c)) < len(error))
        for k in range(1, 4):
            assert weights.dot(c ** (k - 1)) == pytest.approx(0.0, abs=1e-14)
    dense = {4: 3, 5: 4, 8: 7}[order]
    for theta in (0.0, 0.2, 0.7, 1.0):
        for k in range(1, dense + 1):  # 4e-14: coefficients up to 527
            moment = tableau.weights(theta).dot(c ** (k - 1))
            assert moment == pytest.approx(theta**k / k, abs=4e-14)


@pytest.mark.parametrize("order", range(2, 9))
def test_adams_is_exact_for_polynomial_accelerations(order):
    """v is exact for t^(k-1) and q too, as far as the starter is: RK4 to t^3 and t^2."""
    for exact_in_q, most in ((False, 3 if order <= 5 else 7), (True, 2 if order <= 5 else 6)):
        n = min(order - 1, most)
        x = run(Adams(order=order), Mass(lambda t, q, v, n=n: t**n), AT_REST, 2.0, 40)
        assert x.v[0] == pytest.approx(2.0 ** (n + 1) / (n + 1), rel=1e-13)
        if exact_in_q:
            assert x.q[0] == pytest.approx(2.0 ** (n + 2) / (n + 1) / (n + 2), rel=1e-13)


@pytest.mark.parametrize("method", METHODS[1:], ids=label)
def test_pendulum_follows_its_closed_form(method):
    """2.5 rad, 3 s at 2 ms; rates of change up to 5 1/s, 40 for growth over three seconds."""
    system, amplitude = robot_system("pendulum"), 2.5
    x = run(method, system, State(0.0, np.array([amplitude]), np.zeros(1)), 3.0, 1500)
    exact = pendulum(3.0, amplitude)
    bound = max(40 * (5 * 0.002) ** method.order, 1e-11)
    assert distance(system, x, exact) < bound


@pytest.mark.parametrize(
    ("method", "steps"),
    list(zip(METHODS, [8000, 1000, 250, 80, 1000, 1000, 1000, 1000, 1000, 700, 600], strict=True)),
    ids=label,
)
def test_observed_order_of_convergence(method, steps):
    """Free swing of the 7-joint arm, up to 34 rad/s, against an independent solver."""
    system, x, end = swing("arm7", "fixed", 1.0, 0.5)
    coarse, fine = (
        distance(system, run(method, system, x, 0.5, n), end) for n in (steps, 2 * steps)
    )
    assert fine > 1e-10  # above the error of the reference
    assert math.log2(coarse / fine) == pytest.approx(method.order, abs=0.45)


@pytest.mark.parametrize("method", [Rk4(), Dopri5(), Dop853(), *METHODS[-3:]], ids=label)
def test_small_steps_reach_1e_9(method):
    system, x, end = swing("arm7", "fixed", 1.0, 0.5)
    steps = {4: 5000, 5: 1000, 8: 150}.get(method.order, 2600)
    steps = 2600 if isinstance(method, Adams) else steps
    assert distance(system, run(method, system, x, 0.5, steps), end) < 1e-9


@pytest.mark.parametrize(
    ("method", "steps"),
    [(SemiImplicitEuler(), 800), (Rk4(), 60), (Dopri5(), 20), (Dop853(), 10)],
    ids=["euler", "rk4", "dopri5", "dop853"],
)
def test_order_is_kept_on_a_floating_base(method, steps):
    """Spinning torso with a leg, against quaternions and an independent solver."""
    system, x, end = swing("prosthetic_leg", "floating", 5.0, 0.5)
    assert not system.chart.is_flat
    coarse, fine = (
        distance(system, run(method, system, x, 0.5, n), end) for n in (steps, 2 * steps)
    )
    assert fine > 1e-11
    assert math.log2(coarse / fine) == pytest.approx(method.order, abs=0.4)


def test_small_steps_on_a_floating_base_reach_the_reference():
    system, x, end = swing("prosthetic_leg", "floating", 5.0, 0.5)
    assert distance(system, run(Dop853(), system, x, 0.5, 200), end) < 1e-11
    assert distance(system, run(Rk4(), system, x, 0.5, 2000), end) < 1e-9


def test_energy_error_of_semi_implicit_euler_is_bounded_and_that_of_adams_grows():
    """A pendulum has a constant M: the method is symplectic there."""
    system = robot_system("pendulum")

    def worst(method, windows):
        stepper, x = method.prepare(system, 0.02), State(0.0, np.array([1.0]), np.zeros(1))
        first, found = system.energy(x), []
        for _ in range(windows):
            error = 0.0
            for _ in range(500):
                x = stepper.step(x, None)
                error = max(error, abs(system.energy(x) - first))
            found.append(error)
        return found

    bounded = worst(SemiImplicitEuler(), 10)
    assert max(bounded) < 1.02 * min(bounded)
    growing = worst(Adams(order=3), 10)
    assert growing[-1] > 5 * growing[0]


@pytest.mark.parametrize(("method", "order", "h"), DENSE, ids=["rk4", "dopri5", "dop853"])
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_dense_output_has_its_order(method, order, h, base):
    """Error inside one step falls as h^(order + 1)."""
    name, h = ("arm7", 2 * h) if base == "fixed" else ("prosthetic_leg", h)
    system = robot_system(name, base)
    x = start(system, 1.0 if base == "fixed" else 5.0)
    inside = (0.31, 0.5, 0.83)

    def error(h):
        stepper = method.prepare(system, h)
        stepper.step(x, None)
        return max(
            distance(system, stepper.interpolate(s * h), solved(system, x, s * h)) for s in inside
        )

    assert method.dense
    assert math.log2(error(h) / error(h / 2)) == pytest.approx(order + 1, abs=0.65)


@pytest.mark.parametrize("method", [Rk4(), Dopri5(), Dopri5(tolerance=1e-7), Dop853()], ids=label)
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_dense_output_meets_both_ends(method, base):
    system = robot_system("pendulum", base)
    stepper, x = method.prepare(system, 0.01), start(system, 2.0)
    y = stepper.step(x, None)
    assert distance(system, stepper.interpolate(x.t), x) < 1e-14
    assert stepper.interpolate(y.t) is y
    near = stepper.interpolate(y.t * (1 - 1e-12))
    assert distance(system, near, y) < 1e-11  # 1e-14 s at some m/s^2
    for t in (x.t - 1e-6, y.t + 1e-6):
        with pytest.raises(ModelError, match="outside the last step"):
            stepper.interpolate(t)


@pytest.mark.parametrize(
    ("method", "step", "dense"), [(Rk4(), 4, 1), (Dopri5(), 6, 1), (Dop853(), 12, 4)]
)
def test_dense_output_costs_only_who_asks(method, step, dense):
    system = robot_system("arm7")
    stepper, x = method.prepare(system, 1e-3), start(system, 1.0)
    counts = [system.evaluations]

    def count():
        counts.append(system.evaluations)
        return counts[-1] - counts[-2]

    x = stepper.step(x, None)
    assert count() == step
    stepper.interpolate(4e-4)
    stepper.interpolate(6e-4)
    assert count() == dense
    x = stepper.step(x, None)
    assert count() == step - 1  # the acceleration at the end was already there
    stepper.step(x, None)
    assert count() == step


@pytest.mark.parametrize("kind", ADAPTIVE)
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_error_follows_the_tolerance(kind, base):
    """Error of the whole swing over tolerance stays within two decades; 1e3 steps amplify it."""
    case = ("arm7", "fixed", 1.0, 0.5) if base == "fixed" else ("prosthetic_leg", base, 5.0, 0.5)
    system, x, end = swing(*case)
    errors, counts = [], []
    for tolerance in (1e-6, 1e-8, 1e-10):
        y, steps = run_adaptive(kind(tolerance=tolerance), system, x, 0.5)
        assert y.t == 0.5
        errors.append(distance(system, y, end))
        counts.append(steps)
        assert errors[-1] < 1e3 * tolerance
    assert counts == sorted(counts)
    assert math.log(errors[0] / errors[-1], 1e4) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("kind", ADAPTIVE)
def test_adaptive_step_is_its_own(kind):
    """dt is neither a shortest nor a longest step."""
    system, x, _ = swing("arm7", "fixed", 1.0, 0.5)
    counts = [run_adaptive(kind(tolerance=1e-8), system, x, 0.5, dt)[1] for dt in (1e-4, 0.2)]
    assert counts[0] == pytest.approx(counts[1], rel=0.15)
    slow = State(0.0, np.array([1e-3]), np.zeros(1))
    y = kind(tolerance=1e-3).prepare(Mass(lambda t, q, v: -q), 1e-3)
    for _ in range(9):
        slow = y.step(slow, None)
    assert slow.t > 0.5


@pytest.mark.parametrize("kind", ADAPTIVE)
def test_an_end_does_not_shorten_later_steps(kind):
    system, x = robot_system("pendulum"), State(0.0, np.array([1.0]), np.zeros(1))
    stepper = kind(tolerance=1e-6).prepare(system, 0.01)
    for _ in range(8):
        before, x = x, stepper.step(x, None)
    natural = x.t - before.t
    end = x.t + 1e-5
    x = stepper.step(x, None, end)
    assert x.t == end
    assert stepper.step(x, None).t - end > 0.6 * natural
    assert stepper.step(x, None, end) is x


@pytest.mark.parametrize("method", EVERY, ids=label)
def test_state_and_command_of_a_step_count_and_nothing_else(method):
    """After a changed state or command, also one changed in place, as from a fresh start."""
    system = robot_system("arm7", driven=True)
    stepper, x, u = method.prepare(system, 1e-3), start(system, 1.0), np.array([0.3])
    for _ in range(12):
        x = stepper.step(x, u)
    if method.dense:
        stepper.interpolate(x.t - 1e-5)  # brings in the acceleration at the end
    u[0] = -2.0
    x = first_alike(method, system, stepper, x, u)
    x = first_alike(method, system, stepper, State(x.t, x.q, x.v + 0.1), u)
    x = first_alike(method, system, stepper, x, np.array([5.0]))
    x = first_alike(method, system, stepper, x, None)
    stepper.restart()
    first_alike(method, system, stepper, x, None)


def first_alike(method, system, stepper, x, u):
    """The next state, which must be that of a new stepper."""
    # Adaptive steppers differ in their step length, but not up to so near an end.
    end = x.t + (1e-4 if getattr(method, "tolerance", None) else 1e-3)
    y, fresh = stepper.step(x, u, end), method.prepare(system, 1e-3).step(x, u, end)
    assert y.t == fresh.t == end
    assert distance(system, y, fresh) < 1e-13
    return y


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_adams_takes_one_evaluation_a_step_and_starts_again_after_a_new_command(order):
    system = robot_system("arm7", driven=True)
    stepper, x, u = Adams(order=order).prepare(system, 1e-4), start(system, 1.0), np.zeros(1)
    costs = []
    for k in range(60):
        u[0] = 0.0 if k < 30 else 1.0
        before = system.evaluations
        x = stepper.step(x, u)
        costs.append(system.evaluations - before)
    starter = 4 if order <= 5 else 12
    assert costs == ([starter] * (order - 1) + [1] * (31 - order)) * 2


@pytest.mark.parametrize("method", EVERY, ids=label)
def test_steps_end_where_the_simulation_ends(method):
    system, x = robot_system("pendulum"), State(0.1, np.array([1.0]), np.zeros(1))
    stepper, times = method.prepare(system, 0.01), [x.t]
    for _ in range(40):  # more than enough
        x = stepper.step(x, None, 0.1775)
        times.append(x.t)
    assert max(times) == x.t == 0.1775
    if not getattr(method, "tolerance", None):
        assert np.diff(times[:8]) == pytest.approx(0.01, abs=1e-15)
        assert times[8:] == [0.1775] * 33
        again = method.prepare(system, 0.01)
        y = State(0.1, np.array([1.0]), np.zeros(1))
        for _ in range(7):
            y = again.step(y, None)
        short = method.prepare(system, 0.1775 - y.t).step(y, None)
        assert distance(system, x, short) < 1e-14


@pytest.mark.parametrize("method", METHODS, ids=label)
def test_rounding_of_time_leaves_no_sliver(method):
    """Ten steps of 0.1 s end at 0.9999999999999999 s."""
    stepper, x = method.prepare(Mass(lambda t, q, v: 1.0), 0.1), AT_REST
    for _ in range(10):
        x = stepper.step(x, None, 1.0)
    assert x.t == 1.0
    assert x.v[0] == pytest.approx(1.0, abs=1e-14)


@pytest.mark.parametrize(
    ("method", "base"),
    [
        *((method, "fixed") for method in EVERY),
        *((method, "floating") for method in EVERY if not isinstance(method, Adams)),
    ],
    ids=label,
)
def test_states_are_values(method, base):
    """No later step and no interpolation writes into a state."""
    system = robot_system("pendulum", base)
    stepper, x = method.prepare(system, 1e-3), start(system, 1.0)
    kept = [x]
    for _ in range(20):
        x = stepper.step(x, None)
        kept.append(x)
        if method.dense:
            kept.append(stepper.interpolate(x.t - 1e-4))
    copies = [(y.q.copy(), y.v.copy()) for y in kept]
    for _ in range(20):
        x = stepper.step(x, None)
    for y, (q, v) in zip(kept, copies, strict=True):
        assert np.array_equal(y.q, q) and np.array_equal(y.v, v)
        assert np.isfinite(q).all() and y.t <= x.t


@pytest.mark.parametrize("method", METHODS[1:4], ids=label)
def test_a_repeated_step_from_an_older_state_is_the_same(method):
    system = robot_system("arm7")
    stepper, x = method.prepare(system, 1e-3), start(system, 1.0)
    y = stepper.step(x, None)
    first = stepper.step(y, None)
    second = stepper.step(y, None)
    assert np.array_equal(first.q, second.q) and np.array_equal(first.v, second.v)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # numpy's, on the way to infinity
@pytest.mark.parametrize("kind", ADAPTIVE)
def test_a_motion_that_blows_up_is_reported(kind):
    """v' = v^2 from 1 m/s is 1 / (1 - t)."""
    stepper = kind(tolerance=1e-8).prepare(Mass(lambda t, q, v: v * v), 1e-2)
    times = []

    def march(x):
        while x.t < 2.0:
            x = stepper.step(x, None, 2.0)
            times.append(x.t)

    with pytest.raises(DivergedError) as caught:
        march(State(0.0, np.zeros(1), np.ones(1)))
    assert times[-1] == pytest.approx(1.0, abs=1e-6)
    assert "tolerance 1e-08" in str(caught.value) and "velocity 0" in str(caught.value)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_not_a_number_is_no_step():
    stepper = Dopri5(tolerance=1e-6).prepare(Mass(lambda t, q, v: math.nan if t else 1.0), 1e-2)
    with pytest.raises(DivergedError, match="no step from t = 0 s"):
        stepper.step(AT_REST, None)


def test_adams_refuses_a_floating_base():
    with pytest.raises(ModelError, match=r"bodies \(the floating base\), use rk4, dopri5 or dop"):
        Adams().prepare(robot_system("pendulum", "floating"), 1e-3)


@pytest.mark.parametrize(
    ("kind", "values", "message"),
    [
        *((Adams, {"order": k}, f"order {k} is outside 2 .. 8") for k in (-1, 0, 1, 9)),
        *((k, {"tolerance": 0.0}, "tolerance 0 is outside 1e-13 .. 0.1") for k in ADAPTIVE),
        *((k, {"tolerance": -1e-6}, "tolerance -1e-06 is outside") for k in ADAPTIVE),
        *((k, {"tolerance": math.nan}, "tolerance nan is outside") for k in ADAPTIVE),
        *((k, {"tolerance": math.inf}, "tolerance inf is outside") for k in ADAPTIVE),
    ],
)
def test_values_that_make_no_sense_are_refused(kind, values, message):
    with pytest.raises(ModelError) as caught:
        kind(**values)
    assert message in str(caught.value)


@pytest.mark.parametrize("kind", [SemiImplicitEuler, Rk4, Dopri5, Dop853, Adams])
def test_the_example_builds(kind):
    system = robot_system("pendulum")
    x = State(0.0, np.array([1.0]), np.zeros(1))
    y = kind(**kind.example).prepare(system, 1e-3).step(x, None, 1e-3)
    assert 0.0 < y.t <= 1e-3 and y.v[0] < 0.0
