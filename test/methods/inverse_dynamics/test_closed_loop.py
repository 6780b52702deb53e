"""Inverse dynamics with loops: exact where determined, of smallest norm where not, or refused."""

import numpy as np
import pinocchio as pin
import pytest
from inverse_dynamics import ARM, CHAIN
from mechanisms import floating_body, four_bar, four_bar_closure
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import NONE, State
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.methods.inverse_dynamics.efforts import joint_efforts
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.parts.actuators.ideal import Ideal
from mbd_ros.parts.constraints.frame_anchor import FrameAnchor
from mbd_ros.parts.constraints.loop_closure import LoopClosure
from mbd_ros.parts.constraints.prescribed_motion import PrescribedMotion
from mbd_ros.parts.forces.joint_friction import JointFriction
from mbd_ros.parts.forces.joint_spring import JointSpring

SCENES = ROOT / "config/scenes"


def inverse_of(robot, couplings, constraints, joints, *loads, **options):
    """The solver for efforts of joints."""
    efforts = joint_efforts(robot, joints)
    return ClosedLoopInverseDynamics(robot, couplings, constraints, efforts, *loads, **options)


def scene(name, *joints):
    """A scene with ideal actuators."""
    built = load_scene(SCENES / f"{name}.yaml")
    return built.holding(actuators=(Ideal(built.robot, joints=joints),) if joints else ())


def solver(built, *joints):
    """For a scene with other actuated joints than its own."""
    loads = list(built.wrenches.values())
    return inverse_of(built.robot, built.couplings, built.constraints, joints, loads, built.forces)


def command(t):
    return np.array([3.0 * np.sin(7.0 * t) + 1.0])


def simulated(built, duration=0.5):
    """States, accelerations and multipliers under `command`."""
    simulation = built.simulation()
    for x in simulation.run(built.initial, duration, command):
        now = simulation.system.evaluate(x, command(x.t))
        yield x, now.a, now.lam


def bars(lengths=(1.0, 2.0, 1.5, 2.0)):
    """A four-bar and its closure."""
    crank, coupler, rocker, ground = lengths
    robot = read_robot(four_bar(crank, coupler, rocker, ground), gravity=(0.0, -9.81, 0.0))
    return robot, LoopClosure(robot, **four_bar_closure(coupler, rocker))


def closed_bars(actuated, crank=0.9, rate=2.0, lengths=(1.0, 2.0, 1.5, 2.0), extra=()):
    """Solver, and a consistent moving state with its acceleration."""
    robot, closure = bars(lengths)
    inverse = inverse_of(robot, Couplings(robot), [closure, *extra], actuated)
    guess = State(0.0, np.array([crank, -0.9, 1.4]), np.zeros(3))
    q = inverse.motion.assemble(guess)
    only = np.array([True, False, False])
    x, a, _ = inverse.motion.close_loops(q, State(0.0, q, np.full(3, rate)), np.full(3, 5.0), only)
    return inverse, x, a


def allowed(robot, closure, x):
    """Orthonormal motions that a closure allows, one a column."""
    data = robot.model.createData()
    pin.computeJointJacobians(robot.model, data, x.q)
    return np.linalg.svd(closure.jacobian(Kinematics(robot, data), x))[2][2:].T


@pytest.mark.parametrize(
    ("name", "joint", "null_space"),
    [
        ("four_bar_leg", "knee_anterior", 0),
        ("four_bar_leg", "knee_posterior", 0),
        ("benchmark/a04_bricard", "theta_3", 1),
        ("benchmark/a03_andrews", "q1", 0),
    ],
)
def test_simulated_motion_gives_back_the_torque(name, joint, null_space):
    """Forward against inverse; multipliers of Bricard are those of smallest norm in both."""
    built = scene(name, joint)
    inverse = solver(built, joint)
    rows = {row.name for row in inverse.constraints.rows}
    duration = 0.01 if "andrews" in name else 0.5
    for x, a, lam in simulated(built, duration):
        found = inverse.solve(x, a)
        assert found.tau == pytest.approx(command(x.t), abs=1e-8)
        assert found.multipliers == pytest.approx(lam, rel=1e-8, abs=1e-8)
        assert found.null_space == null_space
        assert set(found.undetermined) == (rows if null_space else set())
        assert 1.0 <= found.condition < 1e3


def test_multipliers_of_bricard_are_orthogonal_to_the_null_space():
    built = scene("benchmark/a04_bricard", "theta_1")
    (closure,), data = built.constraints, built.robot.model.createData()
    inverse = solver(built, "theta_1")
    for x, a, _ in list(simulated(built, 0.3))[::6]:
        pin.computeJointJacobians(built.robot.model, data, x.q)
        U, s, _ = np.linalg.svd(closure.jacobian(Kinematics(built.robot, data), x))
        assert s[5] < 1e-10 < 1e-2 < s[4]
        lam = inverse.solve(x, a).multipliers
        assert abs(U[:, 5] @ lam) <= 1e-9 * np.linalg.norm(lam)


def test_two_actuators_on_one_motion_share_it_with_the_smallest_norm():
    """Closed form for one freedom: tau = s z'b / s's with z the motion and s its part in S."""
    inverse, x, a = closed_bars(("crank", "rocker"))
    robot, closure = bars()
    (z,) = allowed(robot, closure, x).T
    b = pin.rnea(robot.model, robot.model.createData(), x.q, x.v, a)
    s = z[[0, 2]]
    found = inverse.solve(x, a)
    assert found.tau == pytest.approx(s * (z @ b) / (s @ s), rel=1e-9)
    assert found.null_space == 1
    assert {"crank.effort", "rocker.effort"} < set(found.undetermined)
    alone = [closed_bars((joint,))[0].solve(x, a).tau[0] for joint in ("crank", "rocker")]
    assert np.linalg.norm(found.tau) < min(abs(tau) for tau in alone)
    assert closed_bars(("crank",))[0].solve(x, a).undetermined == ()


def test_bar_of_other_units_does_not_change_the_efforts():
    """Efforts do not depend on how constraints are written down: here on redundant copies."""
    robot, closure = bars()
    one, x, a = closed_bars(("crank", "rocker"))
    thrice = inverse_of(robot, Couplings(robot), [closure] * 3, one.efforts.names)
    first, again = one.solve(x, a), thrice.solve(x, a)
    assert again.tau == pytest.approx(first.tau, rel=1e-10)
    assert again.null_space == first.null_space + 4
    assert again.multipliers.reshape(3, 2).sum(axis=0) == pytest.approx(first.multipliers)
    assert again.multipliers.reshape(3, 2).std(axis=0) == pytest.approx(0.0, abs=1e-9)


def test_motion_that_nothing_drives_is_refused_with_its_joint():
    built = scene("four_bar_leg", "knee_anterior")
    x, a, _ = list(simulated(built, 0.1))[-1]
    ankle = built.robot.joint("ankle")
    faster = a.copy()
    faster[ankle.v] += 1.0
    with pytest.raises(SolveError, match=r"\(knee_anterior\) cannot .* along ankle; "):
        solver(built, "knee_anterior").solve(x, faster)
    torque = solver(built, "knee_anterior", "hip_flexion", "ankle").solve(x, faster).tau[2]
    assert abs(torque) > 1e-3
    with pytest.raises(SolveError, match=r"\(none\) cannot .* along .*knee_anterior"):
        solver(built).solve(x, a)
    hanging = closed_bars(())[0]
    rest = hanging.motion.assemble(State(0.0, np.array([0.9, -0.9, 1.4]), np.zeros(3)))
    with pytest.raises(SolveError, match="along .*crank"):
        hanging.solve(State(0.0, rest, np.zeros(3)), np.zeros(3))


def test_reach_says_what_the_actuators_cannot_move():
    built = scene("four_bar_leg")
    x = State(0.0, solver(built).motion.assemble(built.initial), built.initial.v)
    reach = solver(built, "knee_tibial").reach(x)
    assert (reach.freedom, reach.driven, reach.null_space) == (3, 1, 0)
    assert set(reach.undriven) == {"hip_flexion", "ankle"}
    whole = solver(built, "hip_flexion", "knee_tibial", "knee_anterior", "ankle").reach(x)
    assert (whole.driven, whole.undriven, whole.null_space) == (3, (), 1)
    assert {"knee_tibial.effort", "knee_anterior.effort"} < set(whole.undetermined)
    assert not {"hip_flexion.effort", "ankle.effort"} & set(whole.undetermined)


def arm_motion(couplings):
    rng = np.random.default_rng(3)
    for _ in range(20):
        z, rate, push = rng.uniform(-1.5, 1.5, (3, len(couplings.v_index)))
        q, v, a = np.zeros((3, 7))
        q[couplings.q_index], v[couplings.v_index], a[couplings.v_index] = z, rate, push
        couplings.expand(q, v, a)
        yield (z, rate, push), (State(0.0, q, v), a), list(rng.normal(size=(2, 6)))


@pytest.mark.parametrize("laws", [{}, CHAIN])
def test_open_and_coupled_chains_equal_the_reduced_equations(laws):
    """Without loops it is `InverseDynamics`: torques, and couplings as rows their multipliers."""
    robot = read_robot(ARM)
    couplings = Couplings(robot, laws)
    loads = [
        ExternalWrench(robot, frame="flange", expressed_in="base"),
        ExternalWrench(robot, frame="link3", point=(0.1, 0.0, 0.2)),
    ]
    forces = [
        JointSpring(robot, joint="joint1", stiffness=7.0, rest=0.3, damping=0.2),
        JointFriction(robot, joint="joint5", coulomb=0.4, viscous=0.1),
    ]
    reduced = InverseDynamics(robot, couplings, loads, forces)
    rows = inverse_of(robot, couplings, (), couplings.independent, loads, forces)
    for independent, every, wrenches in arm_motion(couplings):
        expected, found = reduced.solve(*independent, wrenches), rows.solve(*every, wrenches)
        scale = np.abs(expected.tau).max()
        assert found.tau == pytest.approx(expected.tau, rel=1e-12, abs=1e-12 * scale)
        assert found.multipliers == pytest.approx(expected.multipliers, abs=1e-12 * scale)
        assert (found.null_space, found.undetermined) == (0, ())


def test_power_of_efforts_loads_and_forces_is_the_rise_of_the_energy():
    """Sum tau v + w . twist + f . v = dE/dt, the latter by differences along v and a."""
    built = scene("four_bar_leg", "knee_anterior")
    robot, rng = built.robot, np.random.default_rng(4)
    load = ExternalWrench(robot, frame="foot", expressed_in="world")
    joints = ("hip_flexion", "knee_anterior", "ankle")
    inverse = inverse_of(robot, built.couplings, built.constraints, joints, [load], built.forces)
    model, data, h = robot.model, robot.model.createData(), 1e-4
    at = [robot.joint(name).v for name in joints]
    for x, a, _ in list(simulated(built, 0.4))[::20]:
        x, a = inverse.project_motion(x._replace(v=3.0 * x.v), a + rng.normal(size=5))
        wrench = rng.normal(size=6) * 50.0
        tau = inverse.solve(x, a, [wrench]).tau

        def energy(t, x=x, a=a):
            q, v = x.q + t * x.v + 0.5 * t * t * a, x.v + t * a
            return pin.computeMechanicalEnergy(model, data, q, v)

        rise = (energy(-2 * h) - 8 * energy(-h) + 8 * energy(h) - energy(2 * h)) / (12 * h)
        pin.forwardKinematics(model, data, x.q, x.v)
        twist = pin.getFrameVelocity(model, data, robot.frame("foot"), pin.WORLD).vector
        passive = sum(
            force.force(Kinematics(robot, data), x, NONE) @ x.v for force in built.forces
        )
        assert tau @ x.v[at] + wrench @ twist + passive == pytest.approx(rise, abs=1e-8)


def driven_bars(limit=np.inf):
    robot, closure = bars()
    law = {"amplitude": 0.3, "angular_frequency": 4.0, "offset": 0.9}
    return robot, closure, PrescribedMotion(robot, joint="crank", harmonic=law, limit=limit)


def test_multiplier_of_a_drive_is_its_effort():
    robot, closure, drive = driven_bars()
    system = build_system(robot, Couplings(robot), [closure, drive], Loads(3))
    inverse, x, a = closed_bars((), extra=[drive])
    crank, _, _ = closed_bars(("crank",))
    expected = crank.solve(x, a)
    found = inverse.solve(x._replace(t=123.0), a)  # off its motion, which demands nothing
    assert inverse.constraints.rows[2].name == "prescribed_motion.torque"
    assert found.multipliers == pytest.approx([*expected.multipliers, *expected.tau], rel=1e-9)
    assert found.null_space == 0
    start = State(0.0, inverse.motion.assemble(x._replace(q=np.array([0.9, -0.9, 1.4]))), x.v)
    moving, _ = closed_bars(("crank",), rate=1.2)[1:]
    solution = system.evaluate(State(0.0, start.q, moving.v))
    found = inverse.solve(State(0.0, start.q, moving.v), solution.a)
    assert found.multipliers == pytest.approx(solution.lam, rel=1e-8)


def test_limited_drive_and_actuator_of_one_joint_share_its_effort():
    _, _, drive = driven_bars(limit=1.0)
    alone, x, a = closed_bars(("crank",))
    both, _, _ = closed_bars(("crank",), extra=[drive])
    tau, found = alone.solve(x, a).tau[0], both.solve(x, a)
    assert (found.tau[0], found.multipliers[2]) == pytest.approx((tau / 2, tau / 2), rel=1e-9)
    assert found.undetermined == ("crank.effort", "prescribed_motion.torque")


def test_inconsistent_motion_is_refused_with_its_row_and_can_be_repaired():
    inverse, x, a = closed_bars(("crank",))
    name = inverse.constraints.rows[0].name
    bent, off = np.array([0.0, 1e-4, 0.0]), np.array([0.0, 0.01, 0.0])
    for motion, words in (
        ((x._replace(q=x.q + bent), a), "open"),
        ((x._replace(v=x.v + off), a), "velocity leaves row"),
        ((x, a + off), "acceleration leaves row"),
        ((x, a * np.nan), "not finite"),
    ):
        with pytest.raises(SolveError, match=words):
            inverse.solve(*motion)
    with pytest.raises(SolveError, match=f"row {name[:-1]}"):
        inverse.solve(x._replace(q=x.q + bent), a)
    robot, closure = bars()
    noisy = State(0.0, x.q + bent, x.v + off)
    y, b = inverse.project_motion(noisy, a + 30 * off)
    M, Z = pin.crba(robot.model, robot.model.createData(), y.q), allowed(robot, closure, y)
    assert Z.T @ M @ (y.v - noisy.v) == pytest.approx(0.0, abs=1e-12)
    assert Z.T @ M @ (b - a - 30 * off) == pytest.approx(0.0, abs=1e-11)
    assert Z.T @ M @ (y.q - noisy.q) == pytest.approx(0.0, abs=1e-7)  # M of the start
    assert np.isfinite(inverse.solve(y, b).tau).all()
    again, c = inverse.project_motion(y, b)
    assert again.q == pytest.approx(y.q, abs=1e-12)
    assert np.r_[again.v, c] == pytest.approx(np.r_[y.v, b], abs=1e-10)


@pytest.mark.parametrize("angle", [1e-2, 1e-4, 1e-5])
def test_near_a_toggle_the_condition_says_so_and_torques_stay_right(angle):
    """A parallelogram folds flat at 0; the crank torque is known from its one freedom."""
    lengths = (1.0, 2.0, 1.0, 2.0)
    robot, closure = bars(lengths)
    inverse = inverse_of(robot, Couplings(robot), [closure], ("crank",))
    x = State(0.0, np.array([angle, -angle, angle]), np.array([2.0, -2.0, 2.0]))
    a = np.array([5.0, -5.0, 5.0])
    b = pin.rnea(robot.model, robot.model.createData(), x.q, x.v, a)
    found = inverse.solve(x, a)
    assert found.tau == pytest.approx([b[0] - b[1] + b[2]], rel=1e-8)
    assert found.condition > 0.1 / angle
    assert np.isfinite(found.multipliers).all()


def test_motion_out_of_reach_at_a_toggle_is_refused_as_such():
    robot, closure = bars((1.0, 2.0, 1.0, 2.0))
    inverse = inverse_of(robot, Couplings(robot), [closure], ("crank",))
    flat = State(0.0, np.zeros(3), np.array([2.0, -2.0, 2.0]))
    with pytest.raises(SolveError, match="along .*coupler.* at a toggle"):
        inverse.solve(flat, np.array([5.0, -5.0, 5.0]))


def test_at_a_toggle_nothing_is_infinite_and_the_branch_is_kept():
    lengths = (1.0, 2.0, 1.0, 2.0)
    robot, closure = bars(lengths)
    inverse = inverse_of(robot, Couplings(robot), [closure], ("crank", "coupler"))
    flat = State(0.0, np.zeros(3), np.array([2.0, -2.0, 2.0]))
    found = inverse.solve(*inverse.project_motion(flat, np.zeros(3)))
    assert np.isfinite([*found.tau, *found.multipliers]).all()
    only, q = np.array([True, False, False]), np.array([0.3, -0.3, 0.3])
    for crank in np.linspace(0.3, -0.3, 61):  # 0 among them
        measured = State(0.0, np.array([crank, np.nan, np.nan]), np.full(3, np.nan))
        x, _, _ = inverse.motion.close_loops(q, measured, np.full(3, np.nan), only)
        assert closure_gap(robot, closure, x) <= 1e-12
        q = x.q


def closure_gap(robot, closure, x):
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, x.q)
    return np.abs(closure.residual(Kinematics(robot, data), x)).max()


def test_joints_that_nobody_measures_follow_from_the_loops_on_their_branch():
    built = scene("four_bar_leg", "knee_anterior")
    inverse = solver(built, "knee_anterior")
    known = ("hip_flexion", "knee_posterior", "ankle")
    measured = np.zeros(5, dtype=bool)
    measured[[built.robot.joint(name).v for name in known]] = True
    q = inverse.motion.assemble(built.initial)
    for x, a, _ in list(simulated(built, 0.5))[::50]:  # far apart: strides in between
        hidden = [np.where(measured, values, np.nan) for values in (x.q, x.v, a)]
        y, b, _ = inverse.motion.close_loops(q, State(x.t, *hidden[:2]), hidden[2], measured)
        assert y.q == pytest.approx(x.q, abs=1e-11)
        assert np.r_[y.v, b] == pytest.approx(np.r_[x.v, a], rel=1e-9, abs=1e-9)
        q = y.q
    assert inverse.motion.undetermined(x, measured) == ()
    measured[built.robot.joint("ankle").v] = False
    assert inverse.motion.undetermined(x, measured) == ("ankle",)
    measured[built.robot.joint("knee_posterior").v] = False
    loose = inverse.motion.undetermined(x, measured)
    assert set(loose) == {"ankle", "knee_anterior", "knee_posterior", "knee_tibial"}


def test_anchored_floating_base_has_no_residual_and_a_free_one_all_it_would_need():
    """At rest the anchor carries the weight; released, the base would have to."""
    robot = read_robot(floating_body(), base="floating")
    arms = [joint.name for joint in robot.joints]
    anchor = FrameAnchor(robot, frame="trunk", position=(0.0,) * 3, orientation=(0.0,) * 3)
    rest, zero = State(0.0, robot.neutral(), np.zeros(8)), np.zeros(8)
    held = inverse_of(robot, Couplings(robot), [anchor], arms)
    found = held.solve(rest, zero)
    weight = 9.81 * sum(inertia.mass for inertia in robot.model.inertias)
    assert found.multipliers[:3] == pytest.approx([0.0, 0.0, weight], abs=1e-9)
    free = inverse_of(robot, Couplings(robot), [], arms)
    assert free.reach(rest).undriven == ("the floating base",)
    assert found.residual == pytest.approx(np.zeros(6), abs=0.0)
    rng = np.random.default_rng(5)
    x, a = (
        State(0.0, pin.integrate(robot.model, rest.q, rng.normal(size=8)), rng.normal(size=8)),
        rng.normal(size=8),
    )
    needed = pin.rnea(robot.model, robot.model.createData(), x.q, x.v, a)
    found = free.solve(x, a)
    assert np.r_[found.residual, found.tau] == pytest.approx(needed, rel=1e-12, abs=1e-12)
    whole = InverseDynamics(robot, Couplings(robot)).solve(x.q, x.v, a)
    assert np.array_equal(whole.residual, needed[:6])


def test_repeated_and_unknown_actuators_are_refused():
    robot, closure = bars()
    for joints, words in ((("crank", "crank"), "must differ"), (("knee",), "no joint 'knee'")):
        with pytest.raises(ModelError, match=words):
            inverse_of(robot, Couplings(robot), [closure], joints)


@pytest.mark.parametrize(
    "name", ["four_bar_leg", "benchmark/a04_bricard", "benchmark/a03_andrews"]
)
@pytest.mark.parametrize("with_bounds", [False, True])
def test_no_result_depends_on_what_was_solved_before(name, with_bounds):
    """1 000 evaluations in random order give the bits of a new solver, the noisy ones too."""
    built, rng = load_scene(SCENES / f"{name}.yaml"), np.random.default_rng(6)
    joints = len(built.couplings.v_index)
    begin = built.closed_loop().motion.assemble(built.initial)[built.couplings.q_index]
    moves = [
        (begin + 1e-3 * size * rng.normal(size=joints), *(size * rng.normal(size=(2, joints))))
        for size in (1e-3, 1e-2, 0.1, 1.0)
    ]
    actuated = built.holding(actuators=(Ideal(built.robot, joints=built.couplings.independent),))

    def bits(solver, move):
        try:
            found = solver.solve(*move)
        except SolveError as error:
            return str(error)
        return tuple(found.tau) + tuple(found.multipliers) + (found.condition, solver.correction)

    fresh = [bits(actuated.inverse_dynamics(with_bounds=with_bounds), move) for move in moves]
    used = actuated.inverse_dynamics(with_bounds=with_bounds)
    assert sum(isinstance(each, tuple) for each in fresh) >= 2
    for i in rng.integers(len(moves), size=170):
        assert bits(used, moves[i]) == fresh[i]
