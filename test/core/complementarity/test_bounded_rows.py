"""Stops, dry friction and limited drives by Gauss's principle."""

import gc
import time

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

from mbd_ros.core.complementarity.bounded_rows import BoundedRows
from mbd_ros.core.dynamics.composed_system import ComposedSystem
from mbd_ros.core.dynamics.mechanism import Mechanism, RigidRows
from mbd_ros.core.dynamics.open_chain import Aba
from mbd_ros.core.dynamics.tiers import build_system, tier_of
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.coupling_functions import Linear
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.optimization.box_qp import complementarity_residual
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowLayout
from mbd_ros.core.state import State
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.parts.stabilization.none import NoStabilization
from mbd_ros.scene.reading.part_entries import build_part

ARM = (ROOT / "config/robots/arm7.urdf").read_text(encoding="utf-8")
PENDULUM = (ROOT / "config/robots/pendulum.urdf").read_text(encoding="utf-8")
STOPS = {"type": "joint_stop", "joints": ["all"], "smoothed": True}
LOOP = {"type": "loop_closure", "frame_a": "base", "frame_b": "link7", "directions": "xz"}
COUPLED = {"joint4": Coupling("joint2", Linear(0.5))}


def arm(entries, *, torque=None, coupled=False, **options):
    robot = read_robot(ARM)
    parts = [build_part("constraints", entry, "test", robot) for entry in entries]
    forces = []
    if torque is not None:
        names = [joint.name for joint in robot.joints]
        table = {"joints": names, "times": [-1.0, 1e3], "torque": [torque.tolist()] * 2}
        forces = [build_part("forces", {"type": "prescribed_torque", **table}, "test", robot)]
    couplings = Couplings(robot, COUPLED if coupled else None)
    return build_system(robot, couplings, parts, Loads(7, forces), **options)


def near_the_stops(robot, rng):
    """A state with some joints at or beyond an end of their range."""
    lower = np.array([joint.lower for joint in robot.joints])
    upper = np.array([joint.upper for joint in robot.joints])
    share = rng.choice([-0.001, 0.001, 0.5, 0.999, 1.001], size=7)
    return State(0.0, lower + share * (upper - lower), rng.normal(size=7))


@pytest.mark.parametrize("seed", range(20))
def test_active_stops_agree_with_another_solver_of_the_primal_problem(seed):
    """min 1/2 (a - a_free)' M (a - a_free) subject to J a + b >= 0, by daqp."""
    qpsolvers = pytest.importorskip("qpsolvers")
    rng = np.random.default_rng(seed)
    torque = 60.0 * rng.normal(size=7)
    free, stopped = arm([], torque=torque), arm([STOPS], torque=torque)
    x = near_the_stops(free.robot, rng)
    M, a_free = free.mass(x.q).dense, free.evaluate(x).a
    J, b = stopped.bounded.constraints.conditions(stopped.k, x)
    expected = qpsolvers.solve_qp(M, -M @ a_free, -J, b, solver="daqp")
    found = stopped.evaluate(x)
    assert np.abs(found.a - expected).max() <= 1e-7 * (1.0 + np.abs(expected).max())
    assert (J @ found.a + b >= -1e-8 * (1.0 + np.abs(b))).all()
    assert (found.lam >= 0.0).all()
    assert M @ (found.a - a_free) == pytest.approx(J.T @ found.lam, abs=1e-7)


@pytest.mark.parametrize(
    "options", [{}, {"coupled": True}, {"coupled": True, "tier": "qp"}, {"tier": "qp"}]
)
def test_stops_agree_in_every_tier_below(options):
    """The same scene with couplings eliminated, as rows, and all rows in the QP."""
    rng = np.random.default_rng(3)
    torque = 60.0 * rng.normal(size=7)
    entries = [STOPS] if options.get("coupled") else [LOOP, STOPS]
    system = arm(entries, torque=torque, **options)
    other = arm(entries, torque=torque, coupled=options.get("coupled", False), backend="daqp")
    x = near_the_stops(system.robot, rng)
    y = other.reduce(x)
    full = other.expand(y)
    found, expected = system.evaluate(full), other.evaluate(full)
    assert np.abs(found.a - expected.a).max() <= 1e-9 * (1.0 + np.abs(expected.a).max())


@pytest.mark.parametrize("coupled", [False, True])
def test_stop_that_is_out_of_reach_changes_no_bit(coupled):
    far = {"type": "joint_stop", "joints": ["all"], "lower": -50.0, "upper": 50.0}
    far["smoothed"] = True
    without, with_stops = arm([], coupled=coupled), arm([far], coupled=coupled)
    assert tier_of(with_stops) == f"qp over {without.tier}"
    x = State(0.0, np.full(7, 0.2), np.ones(7))
    found, expected = with_stops.evaluate(x), without.evaluate(x)
    assert np.array_equal(found.a, expected.a)
    assert not found.lam[-7:].any()
    assert with_stops.bounded.qp.statistics.solves == 0


def simulate(entries, duration, dt=1e-3, **trajectory):
    robot = f"robot: {{urdf: {ROOT / 'config/robots/pendulum.urdf'}}}\n"
    initial = f"initial: {{position: {{hinge: {trajectory.get('position', 0.0)}}}}}\n"
    loaded = scene_of(robot + f"constraints: [{entries}]\ndt: {dt}\n" + initial)
    simulation = loaded.simulation(integrator={"type": "rk4"})
    return simulation, list(simulation.run(loaded.initial, duration))


def test_pendulum_comes_to_rest_at_its_stop():
    stop = "{type: joint_stop, joint: hinge, lower: 0.2, upper: 3.0}"
    simulation, states = simulate(stop, 2.0, position=1.0)
    q = np.array([x.q[0] for x in states])
    assert q.min() >= 0.2 - 1e-9
    assert abs(q[-1] - 0.2) <= 1e-6
    assert abs(states[-1].v[0]) <= 1e-6
    lam = simulation.system.evaluate(states[-1]).lam
    free = simulation.system.applied(0.0, states[-1].q, states[-1].v)
    assert lam == pytest.approx(-free, rel=1e-3)
    assert lam[0] > 0.0


def test_dry_friction_sticks_below_its_limit_and_slides_at_it():
    """One joint: M a = tau - limit sign(v), or a = 0 at rest while |tau| <= limit."""
    robot = read_robot(PENDULUM)
    rub = build_part(
        "constraints", {"type": "dry_friction", "joint": "hinge", "limit": 2.0}, "t", robot
    )
    system = build_system(robot, Couplings(robot), [rub], Loads(1))
    for angle in np.linspace(-1.5, 1.5, 13):
        q, rest = np.array([angle]), np.zeros(1)
        pull, M = float(system.applied(0.0, q, rest)[0]), float(system.mass(q).dense[0, 0])
        _, a, _, lam, _ = system.evaluate(State(0.0, q, rest))
        if abs(pull) <= 2.0:
            assert (a[0], lam[0]) == pytest.approx((0.0, -pull), abs=1e-9)
        else:
            assert lam[0] == pytest.approx(-np.copysign(2.0, pull), abs=1e-9)
            assert a[0] == pytest.approx((pull + lam[0]) / M, abs=1e-9)
        lam = system.evaluate(State(0.0, q, np.array([5.0]))).lam
        assert lam[0] == pytest.approx(-2.0, abs=1e-9)


def test_drive_with_a_limit_follows_until_its_effort_ends():
    robot = read_robot(PENDULUM)
    trajectory = {"type": "prescribed_motion", "joint": "hinge", "polynomial": [0.4]}
    pull = None
    for limit, held in ((1e3, True), (0.01, False)):
        drive = build_part("constraints", {**trajectory, "limit": limit}, "t", robot)
        system = build_system(robot, Couplings(robot), [drive], Loads(1))
        x = State(0.0, np.array([0.4]), np.zeros(1))
        _, a, _, lam, _ = system.evaluate(x)
        pull = float(system.applied(x.t, x.q, x.v)[0])
        assert lam[0] == pytest.approx(-pull if held else -np.copysign(limit, pull), abs=1e-9)
        assert (abs(a[0]) <= 1e-9) == held


def test_rows_that_act_are_found_without_the_qp():
    system = arm([STOPS])
    q = np.zeros(7)
    q[1] = system.robot.joints[1].upper + 1e-3
    for _ in range(10):
        system.evaluate(State(0.0, q, np.zeros(7)))
    assert system.bounded.acts
    assert system.bounded.qp.statistics.solves == 0


@pytest.mark.parametrize("coupled", [False, True])
def test_an_evaluation_does_not_depend_on_those_before(coupled):
    """Stops and stiction on the same joints, in 1000 random orders: the same bits."""
    rng = np.random.default_rng(5)
    torque, names = 40.0 * rng.normal(size=7), [f"joint{i}" for i in range(1, 8)]
    stuck = [
        {"type": "dry_friction", "joint": name, "limit": 20.0, "smoothed": True} for name in names
    ]
    system = arm([STOPS, *stuck], torque=torque, coupled=coupled)
    states = [near_the_stops(system.robot, rng) for _ in range(10)]
    states = [system.expand(system.reduce(x)) for x in states]
    first = [system.evaluate(x) for x in states]
    solves = system.bounded.qp.statistics.solves
    assert solves > 0 or not coupled
    for i in rng.integers(len(states), size=1000):
        again = system.evaluate(states[i])
        assert np.array_equal(again.a, first[i].a)
        assert np.array_equal(again.lam, first[i].lam)


class AlwaysQp(BoundedRows):
    """Every evaluation through ProxQP, warm from the last one, and timed."""

    def __init__(self, *args):
        super().__init__(*args)
        self.costs = []  # s of CPU

    def _multipliers(self, A, w, lower, upper):
        begin = time.thread_time()
        lam = self.qp.solve(A, w, lower, upper)
        self.costs.append(time.thread_time() - begin)
        assert complementarity_residual(A, w, lower, upper, lam) <= 1e-9
        return lam


def swing_through_proxqp(duration):
    """A 7-joint arm that falls, with stiction in every joint and stops that it runs into."""
    robot = read_robot(ARM)
    names = [joint.name for joint in robot.joints]
    entries = [
        {"type": "dry_friction", "joint": name, "limit": 2.0, "smoothed": True} for name in names
    ]
    stops = {"type": "joint_stop", "joints": names, "lower": -0.6, "upper": 0.6}
    stops["smoothed"] = True
    parts = [build_part("constraints", entry, "test", robot) for entry in [*entries, stops]]
    layout, mechanism = RowLayout(parts), Mechanism(robot, Loads(7))
    bounded = AlwaysQp(ConstraintRows(layout.blocks, 7), 7)
    no_rows = RigidRows(mechanism, ConstraintRows((), 7))
    system = ComposedSystem(
        Aba(mechanism), no_rows, no_rows, bounded, None, layout, Internals(()), build_system
    )
    simulation = Simulation(system, Rk4(), NoStabilization(), 1e-3)
    x = State(0.0, np.full(7, 0.3), np.array([3.0, -2.0, 4.0, 2.0, -4.0, 3.0, -3.0]))
    gc.disable()  # a collection of what pytest holds takes 10 ms, wherever it happens
    try:
        states = list(simulation.run(x, duration))
    finally:
        gc.enable()
    q = np.array([state.q for state in states])
    assert np.abs(q).max() <= 0.6 + 1e-6
    assert (np.abs(q[-1]) > 0.59).any()
    return bounded


def test_proxqp_along_a_swing_is_never_wrong():
    bounded = swing_through_proxqp(0.4)
    solves, _, damped, failed = bounded.qp.statistics
    assert solves >= 1500
    assert (damped, failed) == (0, 0)


@pytest.mark.soak
@pytest.mark.alone
def test_proxqp_along_thirty_thousand_evaluations_is_never_wrong_nor_late():
    bounded = swing_through_proxqp(7.6)
    solves, _, damped, failed = bounded.qp.statistics
    assert solves >= 30_000
    assert (damped, failed) == (0, 0)
    assert max(bounded.costs) <= 100.0 * np.median(bounded.costs)
