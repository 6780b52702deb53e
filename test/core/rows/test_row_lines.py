"""What `check` says of rows that give way, and that it is so."""

import numpy as np
import pytest
from places import ROOT

import mbd_ros as mbd
from mbd_ros.core.state import State
from mbd_ros.methods.integration.linear_motion import fastest_rate
from mbd_ros.parts.integrators.rk4 import Rk4

PENDULUM = ROOT / "config/robots/pendulum.urdf"
FRICTION = {"type": "dry_friction", "joint": "hinge", "limit": 0.3, "time_constant": 0.05}


def lines(label, **sections):
    scene = mbd.scene_from({"robot": {"urdf": str(PENDULUM)}, **sections})
    return [line for line in scene.check().splitlines() if line.startswith(f"{label} ")]


@pytest.mark.parametrize(
    ("method", "cost"),
    [
        ("rk4", "Rk4 has order 2 in place of 4 in steps in which a row begins or ceases to act"),
        ("semi_implicit_euler", "SemiImplicitEuler has order 1 all the same"),
        (None, "Dopri5 has order 2 in place of 5"),
    ],
)
def test_check_says_what_smoothed_rows_cost_in_order(method, cost):
    chosen = {} if method is None else {"integrator": {"type": method}}
    (line,) = lines("smoothed", constraints=[FRICTION], **chosen)
    assert "hinge_dry_friction; solved for in every evaluation" in line
    assert cost in line
    assert not lines("exact", constraints=[FRICTION], **chosen)


def test_check_says_which_rows_are_exact():
    stop = {"type": "joint_stop", "joint": "hinge", "lower": -1.0}
    both = [stop, FRICTION]
    (line,) = lines("exact", constraints=both, integrator={"type": "gauss_legendre"})
    assert "hinge_joint_stop; steps end where rows begin and cease to act" in line
    assert "GaussLegendre keeps its order 4" in line
    (line,) = lines("smoothed", constraints=both)
    assert "hinge_dry_friction" in line and "joint_stop" not in line


def test_rows_that_never_give_way_have_no_such_line():
    anchored = {"type": "prescribed_motion", "joint": "hinge", "polynomial": [0.1]}
    assert not lines("smoothed") + lines("exact")
    assert not lines("smoothed", constraints=[anchored])


def test_friction_that_sticks_is_not_stiff():
    """What moves it is a difference quotient across its slip otherwise."""
    stuck = {"type": "dry_friction", "joint": "hinge", "limit": 50.0}
    start = {"position": {"hinge": 0.5}}
    assert not lines("warning", constraints=[stuck], initial=start)
    scene = mbd.scene_from({"robot": {"urdf": str(PENDULUM)}, "constraints": [stuck]})
    system = scene.system()
    assert fastest_rate(system, State(0.0, np.array([0.5]), np.zeros(1))) < 1e-2  # of rounding
    slipping = fastest_rate(system, State(0.0, np.array([0.0]), np.ones(1)))
    assert slipping == pytest.approx(fastest_rate(without(), scene.initial), rel=1e-6)


def without():
    return mbd.scene_from({"robot": {"urdf": str(PENDULUM)}}).system()


def test_smoothed_dry_friction_has_the_order_that_check_names():
    """The largest error of many runs that slip and stick, against shorter steps.

    A single run is no measure: its error depends on where in a step the row changes.
    """
    scene = mbd.scene_from({"robot": {"urdf": str(PENDULUM)}, "constraints": [FRICTION]})
    system, rng = scene.system(), np.random.default_rng(0)
    starts = [State(0.0, *rng.uniform((0.1, -1.0), (0.45, 1.0))[:, None]) for _ in range(6)]

    def ends(dt):
        for x in starts:
            stepper = Rk4().prepare(system, dt)
            for _ in range(round(0.3 / dt)):
                x = stepper.step(x, None)
            yield x

    exact = list(ends(3e-4))

    def error(dt):
        pairs = zip(ends(dt), exact, strict=True)
        return max(abs(x.q[0] - y.q[0]) + abs(x.v[0] - y.v[0]) for x, y in pairs)

    steps = np.array([0.02, 0.01, 0.005, 0.0025])
    slope = np.polyfit(np.log(steps), np.log([error(dt) for dt in steps]), 1)[0]
    assert 1.5 < slope < 2.7


def test_check_says_that_time_stepping_solves_for_rows_once_a_step():
    moreau_jean = {"type": "moreau_jean"}
    (line,) = lines("stepped", constraints=[FRICTION], integrator=moreau_jean)
    assert "hinge_dry_friction; solved for once a step of MoreauJean" in line
    assert not lines("smoothed", constraints=[FRICTION], integrator=moreau_jean)
