"""What events ask of steppers: steps taken again, other accelerations, states inside a step."""

import math

import numpy as np
import pytest
from integrators import Mass, distance, label, robot_system, solved, start

from mbd_ros.core.state import State
from mbd_ros.errors import ModelError
from mbd_ros.parts.integrators.adams import Adams
from mbd_ros.parts.integrators.dop853 import Dop853
from mbd_ros.parts.integrators.dopri5 import Dopri5
from mbd_ros.parts.integrators.gauss_legendre import GaussLegendre
from mbd_ros.parts.integrators.generalized_alpha import GeneralizedAlpha
from mbd_ros.parts.integrators.rattle import Rattle
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.parts.integrators.semi_implicit_euler import SemiImplicitEuler
from mbd_ros.parts.integrators.shake import Shake

GAUSS = [GaussLegendre(stages=k) for k in (1, 2, 3)]
ONE_STEP = [Rk4(), Dopri5(), Dop853(), Dopri5(tolerance=1e-7), Dop853(tolerance=1e-7), *GAUSS]
ADAMS = [Adams(order=k) for k in (2, 4, 5, 8)]
EVERY = [*((m, base) for m in ONE_STEP for base in ("fixed", "floating"))]
EVERY += [(m, "fixed") for m in ADAMS]


def stepped(method, base, dt=2e-3, count=12):
    """A stepper with its system, the state before its last step and that after it."""
    system = robot_system("pendulum", base)
    stepper, x = method.prepare(system, dt), start(system, 1.0)
    after = stepper.step(x, None)
    for _ in range(count):
        x, after = after, stepper.step(after, None)
    return system, stepper, x, after


def one_step(method, system, x, h):
    """A step of this length by a new stepper; Adams takes it with its starter."""
    kind = method
    if isinstance(method, Adams):
        kind = Rk4() if method.order <= 5 else Dop853()
    elif getattr(method, "stages", None) is None:
        kind = type(method)()  # adaptive ones choose a shorter first step
    return kind.prepare(system, h).step(x, None, x.t + h)


@pytest.mark.parametrize(("method", "base"), EVERY, ids=label)
def test_a_step_taken_again_is_that_of_the_method(method, base):
    system, stepper, x, after = stepped(method, base)
    for part in (0.5, 1e-3, 0.9):
        h = part * (after.t - x.t)
        again = stepper.again(h, x.t + h)
        assert again.t == x.t + h
        assert distance(system, again, one_step(method, system, x, h)) < 1e-11
        assert stepper.interpolate(again.t) is again
    after = stepper.step(again, None, again.t + 1e-4)
    assert distance(system, after, one_step(method, system, again, 1e-4)) < 1e-11


@pytest.mark.parametrize(("method", "base"), EVERY, ids=label)
def test_a_search_that_finds_nothing_leaves_the_motion_as_it_is(method, base):
    _, stepper, x, after = stepped(method, base)
    _, other, _, same = stepped(method, base)
    stepper.again(0.5 * (after.t - x.t), 0.5 * (after.t + x.t))
    if not isinstance(method, Adams):  # it goes on from a step of its starter
        stepper.again(after.t - x.t, after.t)
    end = after.t + 1e-4
    one, two = stepper.step(after, None, end), other.step(same, None, end)
    assert one.q == pytest.approx(two.q, abs=1e-12) and one.v == pytest.approx(two.v, abs=1e-12)


@pytest.mark.parametrize("method", ADAMS, ids=label)
def test_adams_forgets_what_was_before_a_jump(method):
    """Also where a stabilization puts the state that follows the jump onto rows."""
    system, stepper, x, after = stepped(method, "fixed")
    h = 0.5 * (after.t - x.t)
    struck = stepper.again(h, x.t + h)._replace(v=-x.v)
    stepper.continue_from(struck)
    step = stepper.step(struck, None)
    assert distance(system, step, one_step(method, system, struck, step.t - struck.t)) < 1e-13


@pytest.mark.parametrize(("method", "base"), EVERY, ids=label)
def test_other_accelerations_count_from_the_next_step_on(method, base):
    system, stepper, _, after = stepped(method, base)

    def accelerate(t, q, v, u, out):
        out[...] = 1.0 - v

    class Other:
        chart, nv, model, robot = system.chart, system.nv, system.model, system.robot

        def accelerator(self):
            return accelerate

        def derivatives(self, x, u, inputs):
            from mbd_ros.core.dynamics.linearization import Linearization

            return Linearization(self).derivatives(accelerate, x, u, inputs=inputs)

    stepper.follow(accelerate, (1, 0))
    step = stepper.step(after, None, after.t + 1e-4)
    fresh = method.prepare(Other(), 2e-3).step(after, None, after.t + 1e-4)
    assert distance(system, step, fresh) < 1e-13
    expected = 1.0 + (after.v - 1.0) * math.exp(-1e-4)  # of v' = 1 - v
    assert step.v == pytest.approx(expected, abs=1e-11 if method.order > 2 else 1e-9)
    assert step.mode == stepper.interpolate(after.t + 5e-5).mode == (1, 0)
    assert stepper.step(step, None).mode == (1, 0)


@pytest.mark.parametrize(
    ("method", "base", "order", "h"),
    [
        *((GAUSS[k - 1], base, k, 0.005 * k) for k in (1, 2, 3) for base in ("fixed", "floating")),
        *((Adams(order=k), "fixed", k, 0.002 * k) for k in (3, 4, 6)),
    ],
    ids=label,
)
def test_states_inside_a_step_have_their_order(method, base, order, h):
    """Against an independent solver, from the start of the step."""

    def error(h):
        system, stepper, x, _ = stepped(method, base, h)
        inside = (0.31, 0.5, 0.83)
        there = (
            (stepper.interpolate(x.t + s * h), solved(system, x, x.t + s * h)) for s in inside
        )
        return max(distance(system, *pair) for pair in there)

    assert method.dense
    assert math.log2(error(h) / error(h / 2)) > order + 0.35  # order + 1 for one step


@pytest.mark.parametrize(("method", "base"), EVERY, ids=label)
def test_states_inside_a_step_meet_both_ends(method, base):
    system, stepper, x, after = stepped(method, base)
    assert distance(system, stepper.interpolate(x.t), x) < 1e-13
    assert stepper.interpolate(after.t) is after
    near = stepper.interpolate(after.t - 1e-12)
    assert distance(system, near, after) < 1e-10
    for t in (x.t - 1e-6, after.t + 1e-6):
        with pytest.raises(ModelError, match="outside the last step"):
            stepper.interpolate(t)


def test_a_parabola_inside_a_step_is_exact():
    """What a thrown mass does between two states: its highest point, too, of every method."""
    for method in [*ADAMS, Rk4(), Dopri5(), Dop853()]:
        stepper = method.prepare(Mass(lambda t, q, v: -8.0), 0.125)
        x = State(0.0, np.zeros(1), np.array([0.5]))
        stepper.step(x, None)
        top = stepper.interpolate(0.0625)
        assert (top.q[0], top.v[0]) == pytest.approx((0.015625, 0.0), abs=1e-14)


def test_methods_say_whether_their_steps_end_at_events():
    no = [GeneralizedAlpha, Rattle, Shake, SemiImplicitEuler]
    assert all(method.event_driven for method in [*ONE_STEP, *ADAMS])
    assert not any(method.event_driven for method in no)
