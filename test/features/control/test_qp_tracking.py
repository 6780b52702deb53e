"""Tracking within limits: closed forms, another QP solver, the conditions of an optimum."""

import numpy as np
import pinocchio as pin
import pytest
from controllers import (
    MECHANISMS,
    RATES,
    mechanism,
    situations,
    with_and_without_limits,
)

from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.robot import Joint
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.control.contract import EffortBox, Reference
from mbd_ros.methods.control.efforts import MotionLimits
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.parts.actuators.ideal import Ideal
from mbd_ros.parts.controllers.qp_tracking import QpTracking
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.parts.stabilization.none import NoStabilization
from mbd_ros.scene.reader import load_scene

KP, KD = 100.0, 20.0
NO_MEMORY = np.zeros(0)
each_mechanism = pytest.mark.parametrize("name", MECHANISMS)
each_kind = pytest.mark.parametrize("kind", RATES)


def free_box(n):
    return EffortBox(np.full(n, -np.inf), np.full(n, np.inf))


def wanted(joints, x, ref):
    return ref.a - KD * (joints.velocities(x) - ref.v) - KP * (joints.positions(x) - ref.q)


class Truth:
    """Accelerations as an affine function of efforts, by the plant that a simulation would use."""

    def __init__(self, scene, joints):
        robot = scene.robot
        rows = rigid(scene.constraints)
        drives = Ideal(robot, joints=list(joints.names), limit=1e9)
        loads = Loads(robot.model.nv, scene.forces, [drives])
        self.system = build_system(robot, scene.couplings, rows, loads)
        self.n = len(joints)
        self.own = [joint.v for joint in joints.joints]

    def __call__(self, x):
        a0 = self.system.evaluate(x, np.zeros(self.n)).a
        unit = [self.system.evaluate(x, u).a - a0 for u in np.eye(self.n)]
        return a0, np.array(unit).T


# ---------------------------------------------------------------------- without limits


def test_without_active_limits_it_is_computed_torque_in_closed_form():
    """G' M G z'' + G' (h + M dG z') = tau of a coupled arm, by rnea."""
    scene, joints = mechanism("prosthetic_arm")
    controller = QpTracking(joints, kp=KP, kd=KD, weight=[1.0, 2.0, 3.0, 4.0])
    model, data = scene.robot.model, scene.robot.model.createData()
    G = scene.couplings.jacobian(scene.robot.neutral())  # constant: a linear coupling
    for x, ref, _ in situations(scene, joints, np.random.default_rng(0), 100, "torque"):
        still = x._replace(v=0.3 * x.v)
        q = scene.couplings.positions(0.5 * x.q[scene.couplings.q_index] + 0.2)
        slow = State(0.0, q, still.v)
        near = Reference(joints.positions(slow), joints.velocities(slow), 0.3 * ref.a)
        control = controller.effort(slow, near, NO_MEMORY, free_box(4))
        a = G @ wanted(joints, slow, near)
        tau = G.T @ pin.rnea(model, data, slow.q, slow.v, a)
        np.testing.assert_allclose(control.effort, tau, rtol=1e-8, atol=1e-8)
        assert not control.active.any()
    assert controller.counts.solves == 0


@each_mechanism
def test_without_active_limits_the_plant_accelerates_as_wanted(name):
    scene, joints = mechanism(name)
    truth = Truth(scene, joints)
    controller = QpTracking(joints, position_limits=False, velocity_limits=False)
    for x, ref, _ in situations(scene, joints, np.random.default_rng(1), 50, "torque"):
        control = controller.effort(x, ref, NO_MEMORY, free_box(len(joints)))
        a0, A = truth(x)
        a, target = (a0 + A @ control.effort)[truth.own], wanted(joints, x, ref)
        np.testing.assert_allclose(a, target, rtol=0, atol=1e-8 * (1 + np.abs(target).max()))
        keeping = (a0 + A @ control.equivalent)[truth.own]
        rate = joints.velocities(x) - ref.v
        expected = ref.a - KP / KD * rate
        size = 1 + np.abs(expected).max()
        np.testing.assert_allclose(keeping, expected, rtol=0, atol=1e-8 * size)
        error = joints.positions(x) - ref.q
        np.testing.assert_allclose(control.s, rate + KP / KD * error, rtol=1e-12)


def test_five_drives_of_three_freedoms_share_with_the_least_effort_in_any_metric():
    scene = load_scene("package://mbd_ros/config/scenes/four_bar_leg.yaml")
    joints = scene.controlled_joints()
    assert len(joints) == 5
    weight = np.array([1.0, 5.0, 0.2, 3.0, 1.0])
    controller = QpTracking(
        joints, weight=list(weight), position_limits=False, velocity_limits=False
    )
    limited, n = QpTracking(joints, weight=list(weight)), len(joints)
    for x, ref, box in situations(scene, joints, np.random.default_rng(2), 100, "rate"):
        control = controller.effort(x, ref, NO_MEMORY, free_box(n))
        r = joints.response(x)
        root = np.sqrt(weight)[:, None]
        target = root * (wanted(joints, x, ref) - r.a_free)[:, None]
        tau = np.linalg.pinv(root * r.mobility, rcond=1e-9) @ target
        np.testing.assert_allclose(control.effort, tau[:, 0], rtol=1e-8, atol=1e-7)
        effort = limited.effort(x, ref, NO_MEMORY, box).effort
        assert (box.lower <= effort).all() and (effort <= box.upper).all()
    assert limited.counts.failed == 0


# ---------------------------------------------------------------------- with limits


class Tally:
    """What many states gave."""

    def __init__(self):
        self.states = self.softened = self.compared = self.unmatched = 0
        self.row = self.least = self.effort = 0.0


def accept(tally, counts):
    assert counts.failed == counts.damped == 0
    assert tally.row <= 1e-9
    assert tally.least <= 1e-9
    assert tally.effort <= 1e-8
    assert tally.compared + tally.softened > 20
    assert tally.unmatched <= 0.01 * tally.compared


def checked(name, kind, seed, count):
    """Every answer: efforts in their box, rows kept or passed by the least, the optimum."""
    scene, joints = mechanism(name)
    truth, tally, weight = Truth(scene, joints), Tally(), np.linspace(1.0, 3.0, len(joints))
    controller = QpTracking(joints, kp=KP, kd=KD, weight=list(weight))
    rows = [joint.v for joint in controller._limits.joints]
    for x, ref, box in situations(scene, joints, np.random.default_rng(seed), count, kind):
        before = controller.counts
        tau = controller.effort(x, ref, NO_MEMORY, box).effort
        assert (box.lower <= tau).all() and (tau <= box.upper).all()
        motion = controller._limits.box(x)
        a0, A = truth(x)
        a = a0[rows] + A[rows] @ tau
        size = 1.0 + np.abs(a0[rows]) + np.abs(A[rows]) @ np.abs(tau)
        excess = np.maximum(a - motion.upper, 0.0) + np.minimum(a - motion.lower, 0.0)
        tally.states += 1
        M = np.linalg.inv(A[truth.own])
        if controller.counts.softened > before.softened:
            tally.softened += 1
            tally.least = max(tally.least, pull(A[rows], M, weight, excess, size, tau, box))
            continue
        tally.row = max(tally.row, float((np.abs(excess) / size).max()))
        if controller.counts.solves > before.solves:
            other = by_quadprog(
                a0, A, M, weight, wanted(joints, x, ref), truth.own, rows, box, motion
            )
            tally.compared += 1
            if other is None:  # rows that just fit: quadprog finds nothing
                tally.unmatched += 1
                continue
            difference = np.abs(tau - other).max() / (1.0 + np.abs(tau).max())
            tally.effort = max(tally.effort, float(difference))
    return tally, controller.counts


def pull(C, M, weight, excess, size, tau, box):
    """How far the least excess is from being that: its slope along what the box leaves free.

    Sum (excess / |row|)² is convex, so this slope is zero at the least alone. Row lengths are
    those in accelerations of the controlled joints in the root of their weights. Relative to the
    terms of a, as everywhere.
    """
    length = np.sqrt(((C @ M / np.sqrt(weight)) ** 2).sum(axis=1))
    pushes = C.T * (excess / length**2)
    slope, scale = (
        pushes.sum(axis=1),
        (np.abs(C.T) * size / length**2)[:, excess != 0.0].sum(axis=1),
    )
    held = ((tau <= box.lower) & (slope > 0)) | ((tau >= box.upper) & (slope < 0))
    assert np.abs(excess).max() > 0.0
    return float(np.where(held, 0.0, np.abs(slope) / scale).max())


def by_quadprog(a0, A, M, weight, target, own, rows, box, motion):
    """The same problem in accelerations of the controlled joints."""
    quadprog = pytest.importorskip("quadprog")
    C = np.vstack([M, A[rows] @ M])
    shift = np.concatenate([-M @ a0[own], a0[rows] - A[rows] @ (M @ a0[own])])
    low = np.concatenate([box.lower, motion.lower]) - shift
    high = np.concatenate([box.upper, motion.upper]) - shift
    scale = 1.0 / np.sqrt((C**2).sum(axis=1))
    G, b = np.vstack([C, -C]), np.concatenate([low, -high])
    scale = np.tile(scale, 2)
    try:
        a = quadprog.solve_qp(np.diag(weight), weight * target, (scale[:, None] * G).T, scale * b)[
            0
        ]
    except ValueError:
        return None
    return M @ (a - a0[own])


@each_kind
@each_mechanism
def test_every_limit_is_kept_or_passed_by_the_least_and_the_answer_is_the_optimum(name, kind):
    accept(*checked(name, kind, 3, 400))


@pytest.mark.soak
@each_mechanism
def test_a_hundred_thousand_random_states(name):
    for kind in RATES:
        accept(*checked(name, kind, 4, 11_500))


@pytest.mark.soak
@pytest.mark.alone
@each_kind
@each_mechanism
def test_a_solve_takes_less_than_ten_times_the_tier_without(name, kind):
    scene, joints = mechanism(name)
    given = list(situations(scene, joints, np.random.default_rng(5), 2000, kind))
    spent, without, _ = with_and_without_limits(joints, given)
    assert np.percentile(spent, 99) <= 10.0 * np.median(without)


# ---------------------------------------------------------------------- in closed loop

START = {"prosthetic_arm": [0.3, 0.2, 0.0, 0.0], "arm7": [0.0] * 7}
BEYOND = {
    "prosthetic_arm": [3.0, 0.5, 0.3, -2.0],  # the shoulder takes the elbow to its end
    "four_bar_leg": [1.0, 0.3, 1.5],
    "arm7": [0.0, 4.0, 0.0, -5.0, 0.0, 0.0, 0.0],
}


def driven_beyond(name, period, horizon=None, rate=np.inf, duration=1.5):
    """Largest excess of position and velocity of any joint, the limits that acted, the counts."""
    scene, joints = mechanism(name)
    truth, n, robot = Truth(scene, joints), len(joints), scene.robot
    controller = QpTracking(joints, kp=400.0, kd=40.0, horizon=horizon or period)
    plant = Simulation(truth.system, Rk4(), NoStabilization(), 0.5 * period)
    q = scene.couplings.positions(np.array(START[name])) if name in START else scene.initial.q
    y = plant.start(State(0.0, q, np.zeros(robot.model.nv)))
    limit = np.array([joint.max_effort for joint in joints.joints])
    ref, sent = Reference(np.array(BEYOND[name]), np.zeros(n), np.zeros(n)), np.zeros(n)
    lower, upper, fastest = (
        np.array([getattr(joint, key) for joint in robot.joints])
        for key in ("lower", "upper", "max_velocity")
    )
    worst, acted = np.zeros(2), np.zeros(len(controller.limit_names), dtype=bool)
    for k in range(round(duration / period)):
        x = truth.system.expand(y)
        worst[0] = max(worst[0], (x.q - upper).max(), (lower - x.q).max())
        worst[1] = max(worst[1], (np.abs(x.v) - fastest).max())
        step = rate * limit * period
        box = EffortBox(np.maximum(-limit, sent - step), np.minimum(limit, sent + step))
        control = controller.effort(x, ref, NO_MEMORY, box)
        sent, acted = control.effort, acted | control.active
        y = plant.advance(y, sent, (k + 1) * period)
    names = {name for name, flag in zip(controller.limit_names, acted, strict=True) if flag}
    return worst, names, controller.counts, x


@each_mechanism
def test_an_unreachable_reference_ends_at_the_position_limit(name):
    """What is passed is the change of the acceleration while an effort is held: O(period^2)."""
    coarse, *_ = driven_beyond(name, 4e-3)
    worst, names, counts, x = driven_beyond(name, 2e-3)
    assert worst[0] <= 2e-4  # [rad], at up to 8 rad/s
    assert worst[1] <= 1e-2  # [rad/s]
    assert worst[1] <= 0.35 * coarse[1]
    assert counts.softened == counts.failed == counts.damped == 0
    assert counts.qp <= 0.1 * counts.solves  # the same limits act for long
    held = {
        "prosthetic_arm": {"position shoulder_flexion", "position wrist_flexion"},
        "four_bar_leg": {"position ankle", "position knee_anterior"},
        "arm7": {"position joint2", "position joint4"},
    }[name]
    assert held <= names
    scene, _ = mechanism(name)
    ends = [scene.robot.joint(one.removeprefix("position ")) for one in held]
    assert all(min(abs(x.q[j.q] - j.lower), abs(x.q[j.q] - j.upper)) <= 1e-3 for j in ends)


@pytest.mark.parametrize("name", ["prosthetic_arm", "arm7"])
def test_torques_that_take_time_to_turn_round_need_a_horizon(name):
    """Full torque is reversed in 50 ms: looking one period ahead is too late, 20 ms will do."""
    late, _, softened, _ = driven_beyond(name, 2e-3, rate=40.0)
    worst, _, counts, _ = driven_beyond(name, 2e-3, horizon=0.02, rate=40.0)
    assert late[1] > 0.5
    assert softened.softened > counts.softened
    assert worst[0] <= 1e-4
    assert worst[1] <= 2e-3


# ---------------------------------------------------------------------- limits of motion

JOINT = Joint("j", "j", "revolute", 0, 0, -1.0, 2.0, 3.0, 1.0)
H, BRAKING = 0.01, 0.2
B = 3.0 / BRAKING


def limits(joint=JOINT, **given):
    kept = {"horizon": H, "braking": BRAKING, "margin": 0.0, "position": True, "velocity": True}
    return MotionLimits([joint], **{**kept, **given})


def at(motion, q, v):
    box = motion.box(State(0.0, np.array([q]), np.array([v])))
    return float(box.lower[0]), float(box.upper[0])


@pytest.mark.parametrize("side", [pytest.param(1.0, marks=pytest.mark.soak), -1.0])
def test_held_exactly_no_limit_is_passed_and_no_braking_exceeds_its_value(side):
    """Always the largest (smallest) acceleration, and random ones, from everywhere within."""
    rng, motion = np.random.default_rng(0), limits()
    for _ in range(300):
        q, v = rng.uniform(-1.0, 2.0), rng.uniform(-3.0, 3.0)
        if v > np.sqrt(2 * B * (2.0 - q)) or v < -np.sqrt(2 * B * (q + 1.0)):
            continue  # beyond what braking can hold
        is_random = rng.random() < 0.5
        for _ in range(200):
            lower, upper = at(motion, q, v)
            assert lower <= upper
            a = upper if side > 0 else lower
            a = float(np.clip(rng.normal() * 100.0, lower, upper)) if is_random else a
            assert upper >= -B * 1.000001 and lower <= B * 1.000001  # roots near the limit
            turn = min(max(-v / a, 0.0), H) if a else 0.0  # where the joint is furthest
            furthest = q + v * turn + 0.5 * a * turn**2
            q, v = q + H * v + 0.5 * H * H * a, v + H * a
            for one in (q, furthest):
                assert -1.0 - 1e-9 <= one <= 2.0 + 1e-9
            assert abs(v) <= 3.0 + 1e-9
        if not is_random:
            assert q == pytest.approx(2.0 if side > 0 else -1.0, abs=0.5 * B * H * H)


@pytest.mark.parametrize(
    ("q", "v"), [(2.3, 0.0), (2.1, 2.0), (-1.4, -1.0), (0.5, 4.0), (2.2, 5.0)]
)
def test_from_beyond_a_limit_a_joint_is_sent_back_without_a_blow(q, v):
    motion = limits()
    for _ in range(600):
        lower, upper = at(motion, q, v)
        a = min(max(0.0, lower), upper)
        assert abs(a) <= 2.0 * B + 1e-9
        q, v = q + H * v + 0.5 * H * H * a, v + H * a
    assert -1.0 - 1e-3 <= q <= 2.0 + 1e-3
    assert abs(v) <= 3.0 + 1e-9


def test_limits_that_are_not_kept_or_do_not_exist_are_infinite():
    assert at(limits(position=False), 5.0, 0.0) == pytest.approx((-300.0, 300.0))
    assert at(limits(velocity=False), 0.5, 9.0)[1] < 0.0
    assert not limits(position=False, velocity=False).joints
    endless = Joint("j", "j", "continuous", 0, 0, -np.inf, np.inf, np.inf, 1.0)
    assert not limits(endless).joints
    slow = Joint("j", "j", "revolute", 0, 0, -1.0, 1.0, np.inf, 1.0)
    assert at(limits(slow), 0.999999, 10.0)[1] == pytest.approx(-2.0 * 2.0 / BRAKING**2)


def test_a_margin_moves_the_position_limits():
    assert at(limits(margin=0.1), 1.7, 0.5) == pytest.approx(at(limits(), 1.8, 0.5))
    narrow = Joint("j", "j", "revolute", 0, 0, -0.01, 0.01, 3.0, 1.0)
    lower, upper = at(limits(narrow), 0.0, 3.0)
    assert lower <= upper < 0.0


# ---------------------------------------------------------------------- what goes wrong


@pytest.mark.parametrize(
    ("gains", "message"),
    [
        ({"kp": 0.0}, "kp 0.0 must be finite and > 0"),
        ({"kd": [1.0, 2.0]}, "kd has 2 values; accepted: one, or one a joint (4)"),
        ({"weight": -1.0}, "weight -1.0 must be finite and > 0"),
        ({"horizon": 0.0}, "horizon 0 s must be finite and > 0"),
        ({"braking": 0.001}, "braking 0.001 s must be finite and >= the horizon, 0.02 s"),
        ({"position_margin": -0.1}, "position_margin -0.1 must be finite and >= 0"),
        (
            {"position_margin": 0.7},
            "position_margin 0.7 leaves nothing of the range of shoulder_flexion, -0.1 to 1.24",
        ),
    ],
)
def test_a_gain_that_is_refused_is_named(gains, message):
    _, joints = mechanism("prosthetic_arm")
    with pytest.raises(ModelError) as caught:
        QpTracking(joints, **gains)
    assert str(caught.value) == message


def test_what_is_not_finite_is_an_error_and_nothing_else_is():
    scene, joints = mechanism("prosthetic_arm")
    controller, n = QpTracking(joints), 4
    ((x, ref, box),) = situations(scene, joints, np.random.default_rng(0), 1, "any_rate")
    bad = np.array([np.nan, 0.0, 0.0, 0.0])
    with pytest.raises(SolveError, match="state, reference or dynamics are not finite"):
        controller.effort(x, ref._replace(q=bad), NO_MEMORY, box)
    for empty in (EffortBox(bad, box.upper), EffortBox(box.upper + 1.0, box.upper)):
        with pytest.raises(SolveError, match="effort limits are not a number, or"):
            controller.effort(x, ref, NO_MEMORY, empty)
    wild = Reference(np.full(n, 1e9), np.zeros(n), np.full(n, -1e12))
    for _ in range(2):
        effort = controller.effort(x, wild, NO_MEMORY, box).effort
        assert (box.lower <= effort).all() and (effort <= box.upper).all()
    still = EffortBox(box.lower, box.lower)
    assert np.array_equal(controller.effort(x, ref, NO_MEMORY, still).effort, box.lower)
    assert controller.counts.failed == 0
    assert controller.details()["qp failed"] == "0"


def test_where_no_rung_answers_the_command_is_clipped_and_counted(monkeypatch):
    scene, joints = mechanism("prosthetic_arm")
    controller = QpTracking(joints)
    ((x, ref, box),) = situations(scene, joints, np.random.default_rng(0), 1, "any_rate")

    def fails(*_):
        raise np.linalg.LinAlgError("singular")

    monkeypatch.setattr(np.linalg, "inv", fails)
    control = controller.effort(x, ref, NO_MEMORY, box)
    assert controller.counts.failed == 1
    assert (box.lower <= control.effort).all() and (control.effort <= box.upper).all()
    assert control.active[:4].any() and not control.active[4:].any()


def test_limits_that_act_are_named():
    scene, joints = mechanism("prosthetic_arm")
    controller = QpTracking(joints, kp=400.0, kd=40.0)
    n, names = 4, controller.limit_names
    assert len(names) == 4 + 5 + 5
    still = State(0.0, scene.couplings.positions(np.array([0.3, 0.0, 0.0, 0.86])), np.zeros(5))
    ref = Reference(np.array([0.3, 0.0, 0.0, 0.9]), np.zeros(n), np.zeros(n))
    held = controller.effort(
        still._replace(v=np.array([0, 0, 0, 0, 0.55])), ref, NO_MEMORY, free_box(n)
    )
    assert [names[i] for i in held.active.nonzero()[0]] == ["position wrist_flexion"]
    fast = State(0.0, scene.couplings.positions(np.array([0.3, 0.0, 0.0, 0.0])), np.zeros(5))
    ref = Reference(np.array([0.3, 0.0, 1.5, 0.0]), np.zeros(n), np.zeros(n))
    held = controller.effort(
        fast._replace(v=np.array([0, 0, 0, 2.99, 0])), ref, NO_MEMORY, free_box(n)
    )
    assert [names[i] for i in held.active.nonzero()[0]] == ["velocity wrist_rotation"]
    weak = EffortBox(np.array([-0.5, -60.0, -2.0, -4.0]), np.array([0.5, 60.0, 2.0, 4.0]))
    held = controller.effort(still, ref, NO_MEMORY, weak)
    assert "torque shoulder_flexion" in [names[i] for i in held.active.nonzero()[0]]
