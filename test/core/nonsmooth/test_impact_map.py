"""Impacts at the velocity level, against the dense system of all unknowns and closed forms."""

import itertools

import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from velocity_level import consistent, inertia, keeps, robot_of, system_of

from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.nonsmooth.impact_map import ImpactMap
from mbd_ros.core.rows.constraint import Constraint, Row, bilateral, unilateral
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError
from mbd_ros.parts.constraints.dry_friction import DryFriction

KINDS = ("arm", "coupled", "free", "loop")


class Wall(Constraint):
    """A row J v + rate >= 0 that is closed wherever the joints are."""

    rows = (Row("wall", "N"),)

    def __init__(self, J, e=0.0, rate=0.0):
        self.J, self.law = np.asarray(J, dtype=float)[None], unilateral(e)
        self.moves = np.array([rate])

    def jacobian(self, k, x):
        return self.J

    def rate(self, k, x):
        return self.moves


def walls_of(robot, rng, count, repeats=False):
    """Stops of joints on either side, each with its own restitution."""
    first = robot.model.nv - len(robot.joints)
    rows = np.zeros((count, robot.model.nv))
    joints = rng.permutation(len(robot.joints))[:count]
    if repeats:  # the same stop twice, or both of one joint
        joints = rng.integers(len(robot.joints), size=count)
    rows[np.arange(count), first + joints] = rng.choice([-1.0, 1.0], size=count)
    return [Wall(row, e) for row, e in zip(rows, rng.uniform(0.0, 1.0, count), strict=True)]


def pushed(M, hold, J, v, least):
    """Velocity and impulses >= least of rows J v >= 0, by trying which of them are exact."""
    for choice in itertools.product((False, True), repeat=len(J)):
        on = np.array(choice, dtype=bool)
        rows = np.concatenate((hold, J[on]))
        n, m = len(M), len(rows)
        K = np.block([[M, -rows.T], [rows, np.zeros((m, m))]])
        given = np.concatenate((M @ v + J[~on].T @ least[~on], np.zeros(m)))
        found = np.linalg.lstsq(K, given, rcond=1e-13)[0]
        p = least.copy()
        p[on] = found[n + len(hold) :]
        if (J @ found[:n] >= -1e-10).all() and (p - least >= -1e-10).all():
            return found[:n], p
    raise AssertionError("no choice of rows fits")


@pytest.mark.parametrize("kind", KINDS)
def test_impacts_agree_with_the_dense_system_of_all_unknowns(kind):
    """Poisson's compression and expansion, each by trying every set of rows that push."""
    rng = np.random.default_rng(5)
    robot, coupled, parts = robot_of(kind)
    for _ in range(20):
        walls = walls_of(robot, rng, min(3, len(robot.joints)))
        if coupled or parts:  # what is given back depends on how dependent stops share
            walls = [Wall(wall.J[0], 0.7) for wall in walls]
        system = system_of(robot, [*parts, *walls], coupled)
        q = pin.integrate(robot.model, robot.neutral(), rng.uniform(-1, 1, robot.model.nv))
        M, hold = inertia(robot, q), keeps(system)(q)
        v = consistent(M, hold, rng.normal(size=robot.model.nv))
        J = np.concatenate([wall.J for wall in walls])
        e = np.array([wall.law.restitution for wall in walls])
        compressed, p_c = pushed(M, hold, J, v, np.zeros(len(J)))
        expected, p_e = pushed(M, hold, J, compressed, e * p_c)
        slots = np.arange(len(system.layout.rows))
        found = ImpactMap(system).impact(State(0.0, q, v), slots.tolist())
        assert found.v == pytest.approx(expected, rel=1e-9, abs=1e-9)
        if not len(hold):
            assert found.p == pytest.approx(p_c + p_e, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_random_impacts_balance_and_gain_no_energy(kind):
    """M (v+ - v-) = J' p, bilateral rows kept: 2 500 impacts of each kind of robot."""
    rng = np.random.default_rng(7)
    robot, coupled, parts = robot_of(kind)
    for trial in range(25):
        walls = walls_of(robot, rng, min(5, len(robot.joints)), repeats=trial % 2 == 1)
        system = system_of(robot, [*parts, *walls], coupled)
        level, hold_at, data = ImpactMap(system), keeps(system), pin.Data(robot.model)
        slots = [block.slots.start for block in system.layout.yielding]
        wall_J = np.concatenate([wall.J for wall in walls])
        for _ in range(100):
            q = robot.neutral()
            q = pin.integrate(robot.model, q, rng.uniform(-1.5, 1.5, robot.model.nv))
            M, hold = np.array(pin.crba(robot.model, data, q)), hold_at(q)
            v = consistent(M, hold, rng.normal(size=robot.model.nv))
            touching = [slot for slot in slots if rng.random() < 0.7]
            after, p, _ = level.impact(State(0.0, q, v), touching)
            J = np.concatenate((hold, wall_J))
            size = np.abs(M).dot(np.abs(v) + np.abs(after)).max()
            assert np.abs(M @ (after - v) - J.T @ p).max() <= 1e-12 * size
            assert np.abs(hold @ after).max(initial=0.0) <= 1e-10
            assert after @ M @ after <= (1.0 + 1e-12) * (v @ M @ v)
            held = [slot in touching for slot in slots]
            assert (wall_J[held] @ after >= -1e-10).all()
            assert (p[slots] >= 0.0).all()


def test_momentum_of_a_free_flying_arm_is_kept():
    """Linear and angular momentum about the mass centre, 1e-12 of what the parts have."""
    rng = np.random.default_rng(3)
    robot, _, _ = robot_of("free")
    model, data = robot.model, pin.Data(robot.model)
    walls = walls_of(robot, rng, 2)
    level = ImpactMap(system_of(robot, walls))
    for _ in range(200):
        q = pin.integrate(model, robot.neutral(), rng.uniform(-2.0, 2.0, model.nv))
        v = rng.normal(size=model.nv)
        after, *_ = level.impact(State(0.0, q, v), [0, 1])
        before = pin.computeCentroidalMomentum(model, data, q, v).vector.copy()
        now = pin.computeCentroidalMomentum(model, data, q, after).vector.copy()
        assert np.abs(now - before).max() <= 1e-12 * (1.0 + np.abs(before).max())


def test_two_stops_hit_at_once_are_one_impact():
    """A double pendulum that stops in both joints: v+ = -e v-, whatever the masses."""
    robot = read_robot(mechanisms.double_pendulum())
    walls = [Wall([1.0, 0.0], 0.8), Wall([0.0, 1.0], 0.8)]
    q, v = np.array([0.4, 0.0]), np.array([-1.0, -2.0])
    p_c = -inertia(robot, q) @ v
    assert (p_c > 0.0).all()
    after, p, _ = ImpactMap(system_of(robot, walls)).impact(State(0.0, q, v), [0, 1])
    assert p == pytest.approx(1.8 * p_c, rel=1e-13)
    assert after == pytest.approx(-0.8 * v, rel=1e-12)


def test_stops_that_depend_on_one_another_share():
    """The same stop three times over does what one does, a third each."""
    robot = read_robot(mechanisms.double_pendulum())
    q, v = np.array([0.4, 1.0]), np.array([-1.0, 0.5])
    one = ImpactMap(system_of(robot, [Wall([1.0, 0.0], 0.6)])).impact(State(0.0, q, v), [0])
    walls = [Wall([1.0, 0.0], 0.6) for _ in range(3)]
    three = ImpactMap(system_of(robot, walls)).impact(State(0.0, q, v), [0, 1, 2])
    assert three.v == pytest.approx(one.v, rel=1e-12)
    assert three.p == pytest.approx(np.full(3, one.p[0] / 3.0), rel=1e-10)


def test_of_two_stops_of_one_joint_the_faster_one_pushes():
    """They depend on one another and move differently."""
    robot = read_robot(mechanisms.double_pendulum())
    walls = [Wall([1.0, 0.0], rate=-0.5), Wall([1.0, 0.0], rate=-2.0)]
    x = State(0.0, np.array([0.4, 1.0]), np.array([-1.0, 0.5]))
    after, p, _ = ImpactMap(system_of(robot, walls)).impact(x, [0, 1])
    assert after[0] == pytest.approx(2.0, rel=1e-9)
    assert p[0] == pytest.approx(0.0, abs=1e-9) and p[1] > 1.0


def test_bounded_forces_exert_no_impulse():
    """Dry friction of the same joint is not seen, nor rows that do not touch."""
    robot = read_robot(mechanisms.double_pendulum())
    rub = DryFriction(robot, joint="joint_1", limit=1e6)
    level = ImpactMap(system_of(robot, [rub, Wall([1.0, 0.0], 1.0), Wall([0.0, -1.0])]))
    x = State(0.0, np.array([0.4, 1.0]), np.array([-1.0, 0.5]))
    after, p, _ = level.impact(x, [0, 1])
    assert after[0] == pytest.approx(1.0, rel=1e-12)
    assert p[0] == p[2] == 0.0 < p[1]


def test_a_stop_that_moves_carries_the_joint_along():
    """Restitution is that of the velocity against the stop: v - w turns into -e (v - w)."""
    robot = read_robot(mechanisms.chain(1))
    level = ImpactMap(system_of(robot, [Wall([1.0], 0.5, rate=-3.0)]))
    after, *_ = level.impact(State(0.0, np.zeros(1), np.array([1.0])), [0])
    assert after == pytest.approx([3.0 + 0.5 * 2.0], rel=1e-13)


def test_a_stop_of_a_joint_that_rows_hold_is_refused_by_name():
    """Prescribed rows drive a joint into its stop: nothing can keep it from closing."""
    robot = read_robot(mechanisms.chain(2))
    drive = Wall([1.0, 0.0], rate=1.0)
    drive.law = bilateral()
    level = ImpactMap(system_of(robot, [drive, Wall([1.0, 0.0])]))
    with pytest.raises(SolveError, match="row wall.wall#2"):
        level.impact(State(0.0, np.zeros(2), np.array([-1.0, 0.3])), [1])
