"""Inverse dynamics within bounds, against scipy, closed forms and forward dynamics."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import double_pendulum, floating_body, four_bar, four_bar_closure, scene_of
from scipy.optimize import lsq_linear

from mbd_ros import api
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.inputs import bound
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.optimization.least_norm import least_in_bounds
from mbd_ros.core.rows.constraint import box, cone, unilateral
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.methods.inverse_dynamics.efforts import Efforts, input_efforts, joint_efforts
from mbd_ros.parts.actuators.geared_motor import GearedMotor
from mbd_ros.parts.actuators.series_elastic import SeriesElastic
from mbd_ros.parts.constraints.dry_friction import DryFriction
from mbd_ros.parts.constraints.frame_anchor import FrameAnchor
from mbd_ros.parts.constraints.joint_stop import JointStop
from mbd_ros.parts.constraints.loop_closure import LoopClosure
from mbd_ros.parts.constraints.point_on_plane import PointOnPlane
from mbd_ros.parts.constraints.prescribed_motion import PrescribedMotion

STOPPED = """
robot: {gravity: [0.0, -9.81, 0.0]}
constraints:
  - {type: joint_stop, joint: joint_1, lower: -0.5, time_constant: 0.02, smoothed: true}
  - {type: dry_friction, joint: joint_2, limit: 0.3, smoothed: true}
integrator: {type: rk4}
dt: 0.001
"""
_HEAVY, _LIGHT = 1e5, 1e-4  # their squares are what is off
JOINTS = ("crank", "coupler", "rocker")


def bars():
    robot = read_robot(four_bar(), gravity=(0.0, -9.81, 0.0))
    return robot, LoopClosure(robot, **four_bar_closure())


def moving(inverse):
    """A consistent state of the bars and its acceleration."""
    q = inverse.motion.assemble(State(0.0, np.array([0.9, -0.9, 1.4]), np.zeros(3)))
    only = np.array([True, False, False])
    x, a, _ = inverse.motion.close_loops(q, State(0.0, q, np.full(3, 2.0)), np.full(3, 5.0), only)
    return x, a


def solved(efforts, constraints=(), with_bounds=True):
    robot, closure = bars()
    parts = robot, Couplings(robot), [closure, *constraints]
    inverse = ClosedLoopInverseDynamics(*parts, efforts(robot), with_bounds=with_bounds)
    return inverse.solve(*moving(inverse))


def limited(*limits, joints=JOINTS):
    return lambda robot: joint_efforts(robot, joints, limits)


def by_weights(A, b, cost, lower, upper):
    """The x of least |cost x| with A x = b in a box: a large weight in place of the equation."""
    stacked = np.concatenate((_HEAVY * A, np.diag(cost)))
    right = np.concatenate((_HEAVY * b, np.zeros(len(cost))))
    return lsq_linear(stacked, right, (lower, upper), method="bvls", tol=1e-15).x


@pytest.mark.parametrize("seed", range(40))
def test_least_in_bounds_equals_an_independent_solver(seed):
    """Random problems whose bounds can be kept: first group by weights, then the second."""
    rng = np.random.default_rng(seed)
    rows, n, first = 3, 8, int(rng.integers(2, 7))
    A, inside = rng.normal(size=(rows, n)), rng.normal(size=n)
    lower = inside - rng.exponential(0.7, n) * rng.choice([0.05, 1.0], n)
    upper = inside + rng.exponential(0.7, n) * rng.choice([0.05, 1.0], n)
    lower[rng.random(n) < 0.3], upper[rng.random(n) < 0.3] = -np.inf, np.inf
    b = A @ inside
    z, N = np.linalg.lstsq(A, b, rcond=None)[0], np.linalg.svd(A)[2][rows:].T
    least, is_within = least_in_bounds(z, N, (slice(0, first), slice(first, n)), lower, upper)
    assert is_within
    assert A @ least == pytest.approx(b, abs=1e-11)
    assert (lower <= least).all() and (least <= upper).all()
    expected = by_weights(A, b, np.where(np.arange(n) < first, 1.0, _LIGHT), lower, upper)
    assert least[:first] @ least[:first] == pytest.approx(
        expected[:first] @ expected[:first], rel=1e-6, abs=1e-7
    )
    rest = by_weights(
        A[:, first:],
        b - A[:, :first] @ least[:first],
        np.ones(n - first),
        lower[first:],
        upper[first:],
    )
    assert least[first:] == pytest.approx(rest, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_least_in_bounds_says_where_there_is_nothing_within(seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(3, 6))
    b = A @ np.full(6, 10.0) * rng.choice([-1.0, 1.0])
    ends = np.full(6, -1.0), np.full(6, 1.0)
    assert lsq_linear(A, b, ends).cost > 1e-3
    z, N = np.linalg.lstsq(A, b, rcond=None)[0], np.linalg.svd(A)[2][3:].T
    assert not least_in_bounds(z, N, (slice(0, 6),), *ends).is_within


def test_bounds_that_nothing_reaches_change_no_bit():
    free = solved(limited(np.inf, np.inf, np.inf), with_bounds=False)
    wide = solved(limited(1e3, 1e3, 1e3))
    assert np.array_equal(wide.tau, free.tau) and np.array_equal(
        wide.multipliers, free.multipliers
    )
    assert (wide.rank, wide.null_space) == (free.rank, free.null_space) == (3, 2)
    assert free.null_basis.shape == (5, 2)


def test_a_limited_motor_leaves_the_rest_to_the_others():
    """Of one freedom s . tau = c; with tau_0 at its limit the others share what is left."""
    free = solved(limited(np.inf, np.inf, np.inf), with_bounds=False)
    i = int(np.argmax(np.abs(free.tau)))
    limits = np.full(3, np.inf)
    limits[i] = 0.5 * abs(free.tau[i])
    found = solved(limited(*limits))
    s = free.tau / np.linalg.norm(free.tau)  # the smallest norm is along s
    expected = s * (s @ free.tau - s[i] * np.copysign(limits[i], free.tau[i])) / (1.0 - s[i] ** 2)
    expected[i] = np.copysign(limits[i], free.tau[i])
    assert found.tau == pytest.approx(expected, rel=1e-10)
    reached = np.r_[found.tau - free.tau, found.multipliers - free.multipliers]
    basis = np.linalg.qr(free.null_basis)[0]
    assert reached == pytest.approx(basis @ (basis.T @ reached), abs=1e-9)


def test_limits_that_are_too_small_are_refused_with_their_motors():
    with pytest.raises(SolveError, match=r"within the bounds of crank\.effort"):
        solved(limited(1.0, joints=("crank",)))
    with pytest.raises(ModelError, match="effort limits must be 3 numbers > 0"):
        solved(limited(1.0, -1.0, 1.0))


def test_limited_drive_keeps_its_limit():
    robot, _ = bars()
    harmonic = {"amplitude": 0.3, "angular_frequency": 4.0, "offset": 0.9}
    drive = PrescribedMotion(robot, joint="crank", harmonic=harmonic, limit=1.0)
    shared = solved(limited(np.inf, joints=("crank",)), [drive], with_bounds=False)
    found = solved(limited(np.inf, joints=("crank",)), [drive])
    assert shared.multipliers[2] == pytest.approx(shared.tau[0], rel=1e-9)
    whole, side = 2.0 * shared.tau[0], np.sign(shared.tau[0])
    assert (found.tau[0], found.multipliers[2]) == pytest.approx((whole - side, side), rel=1e-9)


def test_weights_and_targets_are_a_cost():
    """Weighted: min sum (w (u - target))^2 on s . u = c, by its closed form."""
    free = solved(limited(np.inf, np.inf, np.inf), with_bounds=False)
    weight, target = np.array([1.0, 2.0, 5.0]), np.array([0.5, -1.0, 3.0])

    def costly(robot):
        return joint_efforts(robot, JOINTS)._replace(weight=weight, target=target)

    found = solved(costly, with_bounds=False)
    s = free.tau
    share = s / weight**2
    expected = target + share * (s @ free.tau - s @ target) / (s @ share)
    assert found.tau == pytest.approx(expected, rel=1e-10)


def test_columns_of_inputs_may_be_any():
    """Two tendons that only pull, each on two joints: what they do along the only motion."""
    arms = np.array([[0.04, 0.0], [-0.03, 0.05], [0.0, 0.02]])

    def pull(k, x):
        return arms * (1.0 + 0.1 * np.cos(x.q[:, None]))

    robot, closure = bars()
    zero, ends = np.zeros(2), np.full(2, 1e4)
    tendons = Efforts(("long", "short"), pull, zero, ends, zero + 1.0, zero)
    parts = robot, Couplings(robot), [closure]
    inverse = ClosedLoopInverseDynamics(*parts, tendons, with_bounds=True)
    x, a = moving(inverse)
    found, B = inverse.solve(x, a), inverse.columns(x)
    tau = ClosedLoopInverseDynamics(*parts, joint_efforts(robot, JOINTS)).solve(x, a).tau
    assert tau @ (B @ found.tau) == pytest.approx(tau @ tau, rel=1e-9)
    assert (found.tau >= 0.0).all()
    assert found.rank == 3


def test_inputs_of_actuators_come_back_through_their_columns():
    """Forward under known inputs: a motor behind a gear that rubs, and an elastic drive."""
    robot, closure = bars()
    motor = GearedMotor(robot, joint="crank", ratio=20.0, viscous=1e-3, limit=9.0)
    spring = SeriesElastic(robot, joint="rocker", stiffness=30.0, damping=0.5)
    parts = robot, Couplings(robot), [closure]
    u = np.array([1.7, 0.4])
    for actuators, given in (((motor,), u[:1]), ((spring,), u[1:]), ((motor, spring), u)):
        efforts = input_efforts(robot, actuators)
        inverse = ClosedLoopInverseDynamics(*parts, efforts, with_bounds=True)
        x, _ = moving(inverse)
        loads, _ = bound(actuators)
        now = build_system(*parts, Loads(3, (), loads)).evaluate(x, given)
        found = inverse.solve(x, now.a)
        null = found.null_basis[: len(given)]
        off = found.tau - given
        assert found.null_space == len(given) - 1
        assert off - null @ (np.linalg.pinv(null) @ off) == pytest.approx(0.0 * off, abs=1e-9)
        assert np.linalg.norm(found.tau) <= np.linalg.norm(given) + 1e-9
    rubbing = GearedMotor(robot, joint="crank", ratio=20.0, efficiency=0.8)
    with pytest.raises(ModelError, match="the force of geared_motor is not affine in its inputs"):
        input_efforts(robot, (rubbing,))


@pytest.mark.parametrize("pressed", [True, False])
def test_stop_and_friction_push_as_forward_dynamics_says(pressed):
    """A motor of the crank beside a stop and dry friction: its torque from motion alone."""
    robot, closure = bars()
    probe = ClosedLoopInverseDynamics(robot, Couplings(robot), [closure], joint_efforts(robot, ()))
    q = probe.motion.assemble(State(0.0, np.array([0.9, -0.9, 1.4]), np.zeros(3)))
    stop = JointStop(robot, joint="crank", lower=float(q[0]) if pressed else -2.0)
    friction = DryFriction(robot, joint="rocker", limit=0.7)
    parts = [closure, stop, friction]
    system = build_system(robot, Couplings(robot), parts, Loads(3))
    x = State(0.0, q, np.zeros(3))
    if not pressed:
        x = probe.motion.project_motion(x._replace(v=np.array([1.0, 0.0, 0.0])), np.zeros(3))[0]
    solution = system.evaluate(x)
    inverse = ClosedLoopInverseDynamics(
        robot, Couplings(robot), parts, joint_efforts(robot, ("crank",)), with_bounds=True
    )
    found = inverse.solve(x, solution.a)
    names = [row.name for row in inverse.constraints.rows]
    if pressed:  # friction holds, too: what the motor need not do it does not
        assert found.tau == pytest.approx([0.0], abs=1e-7)
        assert found.multipliers[names.index("joint_stop.torque")] > 1.0
        assert abs(found.multipliers[names.index("dry_friction.torque")]) <= 0.7
    else:
        assert found.tau == pytest.approx([0.0], abs=1e-9)
        assert found.multipliers == pytest.approx(solution.lam, rel=1e-8, abs=1e-9)
        assert abs(found.multipliers[names.index("dry_friction.torque")]) == 0.7


def test_bounds_that_depend_on_the_state_are_those_of_the_state():
    robot, closure = bars()
    constant, varying = (DryFriction(robot, joint="rocker", limit=0.7) for _ in range(2))
    varying.law = box(lambda k, x: -0.5 * x.q[2], lambda k, x: 0.5 * x.q[2])
    found = []
    for friction in (varying, constant):
        efforts = joint_efforts(robot, ("crank",))
        parts = robot, Couplings(robot), [closure, friction]
        inverse = ClosedLoopInverseDynamics(*parts, efforts, with_bounds=True)
        x, a = moving(inverse)
        constant.law = box(-0.5 * x.q[2], 0.5 * x.q[2])
        found.append(inverse.solve(x, a))
    assert abs(found[0].multipliers[2]) == 0.5 * x.q[2]
    assert np.array_equal(found[0].tau, found[1].tau)


class OneSided(PointOnPlane):
    """A foot on the floor that only pushes."""

    law = unilateral()


class Gripping(FrameAnchor):
    """A point that holds within a cone."""

    law = cone(0.5)


def standing(x_feet, with_bounds=True, kind=OneSided):
    """A floating body at rest on frictionless feet under its trunk, and its motors."""
    robot = read_robot(floating_body(), base="floating")
    feet = [
        kind(
            robot,
            frame="trunk",
            point=(px, py, -0.5),
            plane_frame="universe",
            normal=(0, 0, 1),
            plane_point=(0, 0, -0.5),
        )
        for px, py in x_feet
    ]
    arms = joint_efforts(robot, [joint.name for joint in robot.joints])
    inverse = ClosedLoopInverseDynamics(
        robot, Couplings(robot), feet, arms, with_bounds=with_bounds
    )
    rest = State(0.0, robot.neutral(), np.zeros(8))
    return robot, inverse.solve(rest, np.zeros(8)), rest


def test_stance_shares_the_weight_between_feet_that_push():
    """Four feet, of smallest norm, against scipy; the same numbers without bounds."""
    feet = [(0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2)]
    robot, found, rest = standing(feet)
    data = robot.model.createData()
    needed = pin.rnea(robot.model, data, rest.q, rest.v, np.zeros(8))[:6]
    A = np.array([[1.0, py, -px] for px, py in feet]).T
    expected = by_weights(A, needed[[2, 3, 4]], np.ones(4), np.zeros(4), np.full(4, np.inf))
    assert found.multipliers == pytest.approx(expected, abs=1e-5)
    assert A @ found.multipliers == pytest.approx(needed[[2, 3, 4]], abs=1e-10)
    assert found.residual == pytest.approx(np.zeros(6), abs=0.0)
    assert found.null_space == 1
    assert len(found.undetermined) == 4


def test_feet_that_cannot_pull_leave_a_residual_to_the_base():
    """The mass centre is beyond the feet: bilateral feet pull, one-sided ones let it tip."""
    feet = [(0.3, 0.2), (0.3, -0.2), (0.6, 0.0)]
    robot, found, rest = standing(feet)
    needed = pin.rnea(robot.model, robot.model.createData(), rest.q, rest.v, np.zeros(8))
    assert (found.multipliers >= 0.0).all()
    pushes = sum(
        lam * np.array([0, 0, 1.0, py, -px, 0])
        for lam, (px, py) in zip(found.multipliers, feet, strict=True)
    )
    assert found.residual + pushes == pytest.approx(needed[:6], abs=1e-8)
    assert np.linalg.norm(found.residual) > 1.0
    M = pin.crba(robot.model, robot.model.createData(), rest.q)
    metric = np.linalg.inv(np.linalg.cholesky(M))[:, :6]  # the residual is the smallest in M^-1
    J = np.array([[0, 0, 1.0, py, -px, 0] for px, py in feet]).T
    least = lsq_linear(metric @ J, metric @ needed[:6], (0.0, np.inf), method="bvls", tol=1e-15)
    assert found.multipliers == pytest.approx(least.x, abs=1e-8)


class Slipping(Gripping):
    """A row that pushes along another direction than its own."""

    law, slips = box(-1.0, 1.0), True


def test_contacts_are_no_unknowns_and_rows_that_slip_are_refused_by_name():
    robot = read_robot(floating_body(), base="floating")
    where = {"frame": "trunk", "position": (0.0,) * 3, "kind": "point"}
    efforts = joint_efforts(robot, ())
    for kind, m in ((Gripping, 0), (Slipping, None)):
        parts = robot, Couplings(robot), [kind(robot, **where)], efforts
        assert not ClosedLoopInverseDynamics(*parts).constraints.rows
        if m is None:
            with pytest.raises(ModelError, match=r"row slipping.* but this row slips"):
                ClosedLoopInverseDynamics(*parts, with_bounds=True)
        else:
            assert not ClosedLoopInverseDynamics(*parts, with_bounds=True).constraints.rows


def test_a_recorded_motion_shows_what_a_stop_and_friction_did():
    """A passive pendulum that comes to its stop: no motor did anything, the stop did."""
    scene = api.Scene.of(scene_of(STOPPED, double_pendulum()))
    motion = scene.simulate(0.6)
    with_bounds, without = scene.inverse(motion, bounds=True), scene.inverse(motion)
    table = with_bounds["samples"]
    efforts = np.array([table[f"{joint}.effort"] for joint in ("joint_1", "joint_2")])
    pushed = np.abs(without["samples"]["joint_1.effort"])
    assert np.abs(efforts).max() <= 1e-6 * pushed.max()
    stops = [table[name] for name in dict(table.items()) if "stop" in name]
    assert max(each.max() for each in stops) > 1.0
    assert min(each.min() for each in stops) >= 0.0
