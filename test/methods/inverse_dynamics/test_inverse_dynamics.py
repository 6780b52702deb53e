"""Identities of coupled inverse dynamics: multipliers, power, parts, batches, memory."""

import gc
import sys
import tracemalloc

import numpy as np
import pinocchio as pin
import pytest
from inverse_dynamics import ARM, CHAIN, CONFIG

from mbd_ros.api import load_scene
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.external_loads import ExternalWrench
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import NONE, State
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.parts.forces.joint_friction import JointFriction
from mbd_ros.parts.forces.joint_spring import JointSpring


def arm(coupled=True, loaded=True, sprung=True, base="fixed"):
    """Solver of a 7-joint arm, its robot, and as many wrenches as it takes."""
    robot = read_robot(ARM, base=base)
    couplings = Couplings(robot, CHAIN if coupled else None)
    loads = [
        ExternalWrench(robot, frame="flange", expressed_in="base"),
        ExternalWrench(robot, frame="link3", point=(0.1, 0.0, 0.2)),
    ]
    forces = [
        JointSpring(robot, joint="joint1", stiffness=7.0, rest=0.3, damping=0.2),
        JointFriction(robot, joint="joint5", coulomb=0.4, viscous=0.1),
    ]
    inverse = InverseDynamics(robot, couplings, loads * loaded, forces * sprung)
    return inverse, robot, 2 * loaded


def samples(inverse, n, wrenches, seed=0):
    """Random z, z', z'' and wrenches, one sample a row."""
    rng, size = np.random.default_rng(seed), len(inverse.couplings.v_index)
    z, v, a = rng.uniform(-1.5, 1.5, (3, n, size))
    return z, v, a, [rng.normal(size=(n, 6)) for _ in range(wrenches)]


def constraint_rows(robot, couplings, laws, q):
    """One row a dependent joint: +1 there, -f' at its direct parent."""
    Jc = np.zeros((len(couplings.dependent), robot.model.nv))
    for row, name in enumerate(couplings.dependent):
        parent = robot.joint(couplings.parents[name])
        Jc[row, robot.joint(name).v] = 1.0
        Jc[row, parent.v] = -laws[name].function(float(q[parent.q]))[1]
    return Jc


def test_torques_and_multipliers_balance_the_equation_of_all_joints():
    """The equation rnea(q, v, a) = B tau_z + Jc' lam + sum J' w + f, every term by other means."""
    inverse, robot, _ = arm()
    couplings, model, data = inverse.couplings, robot.model, robot.model.createData()
    *motion, wrenches = samples(inverse, 20, 2)
    for z, rate, push, *loads in zip(*motion, *wrenches, strict=True):
        tau, lam, *_ = inverse.solve(z, rate, push, loads)
        q, v, a = np.zeros((3, 7))
        q[couplings.q_index], v[couplings.v_index], a[couplings.v_index] = z, rate, push
        couplings.expand(q, v, a)
        Jc = constraint_rows(robot, couplings, CHAIN, q)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        external = np.zeros(7)
        for load, w in zip(inverse.wrenches, loads, strict=True):
            at = data.oMf[robot.frame(load.expressed_in)]
            about = at * pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.2]) * (load.frame == "link3"))
            J = pin.getFrameJacobian(model, data, robot.frame(load.frame), pin.WORLD)
            external += J.T @ about.act(pin.Force(w)).vector
        for force in inverse.forces:
            external += force.force(Kinematics(robot, data), State(0.0, q, v), NONE)
        right = np.eye(7)[:, couplings.v_index] @ tau + Jc.T @ lam + external
        assert pin.rnea(model, data, q, v, a) == pytest.approx(right, abs=1e-11)
        assert Jc @ v == pytest.approx(np.zeros(4), abs=1e-12)


def smooth(seed, size):
    """A random smooth motion: order of derivative, time -> (size,)."""
    rng = np.random.default_rng(seed)
    w, phase = rng.uniform(1, 6, (2, size, 3))
    amplitude = rng.uniform(0.05, 0.3, (size, 3))

    def motion(t, order=0):
        return (amplitude * w**order * np.sin(w * t + phase + order * np.pi / 2)).sum(axis=1)

    return motion


@pytest.mark.parametrize("name", ["prosthetic_leg_stance", "prosthetic_arm", "arm7"])
@pytest.mark.parametrize("seed", range(3))
def test_power_balances_and_coupling_forces_do_no_work(name, seed):
    """Joint power = d/dt (kinetic + potential) - external power, by fourth-order differences."""
    scene = load_scene(CONFIG / f"scenes/{name}.yaml")
    robot, couplings, inverse = scene.robot, scene.couplings, scene.inverse_dynamics()
    model, data = robot.model, robot.model.createData()
    size, h = len(couplings.v_index), 1e-5
    motion, push = smooth(seed, size), smooth(seed + 9, 6)
    offset = np.array([0.3, -0.9, 0.0] if size == 3 else np.full(size, 0.2))

    def at(t):
        rows = np.zeros((3, model.nv))
        for row, order, index in zip(
            rows, range(3), (couplings.q_index, *[couplings.v_index] * 2), strict=True
        ):
            row[index] = motion(t, order) + offset * (order == 0)
        couplings.expand(*rows)
        return rows

    def energy(t):
        q, v, _ = at(t)
        return pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(
            model, data, q
        )

    balance, coupling, scale, total = [], [], [], []
    for t in np.linspace(0.0, 2.0, 40):
        wrenches = [300.0 * push(t) + 2000.0] * len(scene.wrenches)  # above the threshold
        z, rate, acceleration = (motion(t, k) + offset * (k == 0) for k in range(3))
        tau, lam, *_ = inverse.solve(z, rate, acceleration, wrenches)
        q, v, a = at(t)
        full = pin.rnea(model, data, q, v, a)
        pin.forwardKinematics(model, data, q, v)
        external = 0.0
        for load, w in zip(scene.wrenches.values(), wrenches, strict=True):
            frame = robot.frame(load.frame)  # given in the world, about its origin
            external += w @ pin.getFrameVelocity(model, data, frame, pin.WORLD).vector
        before2, before, after, after2 = (energy(t + k * h) for k in (-2, -1, 1, 2))
        rise = (before2 - 8 * before + 8 * after - after2) / (12 * h)
        balance.append(tau @ rate + external - rise)
        coupling.append(v @ full - external - tau @ rate)
        scale.append(abs(tau @ rate) + abs(external) + abs(rise))
        total.append(np.abs(v * full).sum() + abs(external))
        assert len(lam) == len(couplings.dependent)
    assert np.abs(balance).max() <= 1e-6 * max(scale)
    assert np.abs(coupling).max() <= 1e-10 * max(total)


@pytest.mark.parametrize("coupled", [False, True])
@pytest.mark.parametrize("loaded", [False, True])
@pytest.mark.parametrize("sprung", [False, True])
@pytest.mark.parametrize("n", [0, 1, 5])
def test_batch_equals_sample_by_sample(coupled, loaded, sprung, n):
    inverse, _, wrenches = arm(coupled, loaded, sprung)
    z, v, a, loads = samples(inverse, n, wrenches)
    for given in {0, wrenches}:
        batch = inverse.batch(z, v, a, loads[:given])
        assert batch.tau.shape == (n, z.shape[1])
        assert batch.multipliers.shape == (n, 7 - z.shape[1])
        for i in range(n):
            one = inverse.solve(z[i], v[i], a[i], [w[i] for w in loads[:given]])
            assert batch.tau[i] == pytest.approx(one.tau, rel=1e-12, abs=1e-12)
            assert batch.multipliers[i] == pytest.approx(one.multipliers, rel=1e-12, abs=1e-12)


def test_batch_longer_than_its_chunks_and_with_a_floating_base():
    inverse, robot, _ = arm(loaded=False, sprung=False, base="floating")
    n, rng = 4100, np.random.default_rng(1)
    z = np.array([pin.neutral(robot.model)[inverse.couplings.q_index]] * n)
    z[:, 7:] = rng.uniform(-1, 1, (n, z.shape[1] - 7))
    z[:, 3:7] = rng.normal(size=(n, 4))
    z[:, 3:7] /= np.linalg.norm(z[:, 3:7], axis=1)[:, None]
    v, a = rng.normal(size=(2, n, z.shape[1] - 1))
    batch = inverse.batch(z, v, a)
    for i in (0, 2047, 2048, 4095, 4096, 4099):
        one = inverse.solve(z[i], v[i], a[i])
        assert batch.tau[i] == pytest.approx(one.tau, rel=1e-12, abs=1e-10)
        assert batch.multipliers[i] == pytest.approx(one.multipliers, rel=1e-12, abs=1e-10)


@pytest.mark.parametrize("coupled", [False, True])
def test_parts_sum_to_the_total_and_each_is_what_it_is_called(coupled):
    inverse, robot, _ = arm(coupled)
    z, v, a, loads = (x[0] if isinstance(x, np.ndarray) else x for x in samples(inverse, 1, 2))
    loads, zero, none = [w[0] for w in loads], np.zeros_like(v), [np.zeros(6)] * 2
    parts = inverse.components(z, v, a, loads)
    assert sum(parts) == pytest.approx(inverse.solve(z, v, a, loads).tau, abs=1e-12)
    q, rates = np.zeros(7), np.zeros((2, 7))
    q[inverse.couplings.q_index] = z
    inverse.couplings.expand(q, *rates)
    G, data = inverse.couplings.jacobian(q), robot.model.createData()
    gravity = G.T @ pin.computeGeneralizedGravity(robot.model, data, q)
    mass = G.T @ pin.crba(robot.model, data, q, pin.Convention.WORLD) @ G
    assert parts.gravity == pytest.approx(gravity, abs=1e-12)
    assert parts.inertial == pytest.approx(mass @ a, abs=1e-12)
    faster, still = inverse.components(z, 3 * v, a, none), inverse.components(z, zero, a, none)
    assert faster.coriolis == pytest.approx(9 * parts.coriolis, abs=1e-10)
    assert not still.coriolis.any()


def test_spring_at_rest_offset_is_held_by_the_actuator():
    """A spring that pulls a joint up by 7 N·m lets its actuator pull 7 N·m less."""
    robot, zero = read_robot(ARM), np.zeros(7)
    spring = JointSpring(robot, joint="joint1", stiffness=10.0, rest=0.7)
    free = InverseDynamics(robot, Couplings(robot)).solve(zero, zero, zero).tau
    held = InverseDynamics(robot, Couplings(robot), forces=[spring]).solve(zero, zero, zero).tau
    assert held - free == pytest.approx(np.r_[-7.0, np.zeros(6)], abs=1e-12)


def test_results_are_fresh_and_arguments_stay_as_they_were():
    inverse, _, wrenches = arm()
    z, v, a, loads = samples(inverse, 2, wrenches)
    given = [x.copy() for x in (z, v, a, *loads)]
    first = inverse.solve(z[0], v[0], a[0], [w[0] for w in loads])
    kept = [x.copy() for x in first[:2]]
    inverse.solve(z[1], v[1], a[1], [w[1] for w in loads])
    inverse.components(z[1], v[1], a[1], [w[1] for w in loads])
    inverse.batch(z, v, a, loads)
    assert all(np.array_equal(x, y) for x, y in zip(first[:2], kept, strict=True))
    assert all(np.array_equal(x, y) for x, y in zip((z, v, a, *loads), given, strict=True))


def long_chain(joints):
    """A solver for a chain in which every second joint follows the one before."""
    link = (
        '<link name="l{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" '
        'ixz="0" iyz="0"/></inertial></link><joint name="j{0}" type="revolute"><parent '
        'link="l{1}"/><child link="l{0}"/><axis xyz="0 1 0"/><limit effort="1" velocity="1"/>'
    )
    mimic = '<mimic joint="j{1}" multiplier="0.5"/>'
    parts = [
        (link + (mimic if i % 2 == 0 else "") + "</joint>").format(i, i - 1)
        for i in range(1, joints + 1)
    ]
    robot = read_robot(f'<robot name="a"><link name="l0"/>{"".join(parts)}</robot>')
    load = ExternalWrench(robot, frame=f"l{joints}", expressed_in="l0")
    return InverseDynamics(robot, Couplings(robot), [load])


def test_call_allocates_its_result_only_and_keeps_nothing():
    """Of arrays: what rnea returns and what we return, each as long as all joints together."""
    joints, array = 100, 100 * 8
    inverse = long_chain(joints)
    x, loads = np.full(joints // 2, 0.01), [np.ones(6)]
    gc.collect()
    tracemalloc.start()
    inverse.solve(x, x, x, loads)
    tracemalloc.reset_peak()
    before = tracemalloc.get_traced_memory()[0]
    inverse.solve(x, x, x, loads)
    peak = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    assert 2 * array <= peak < 3 * array
    small, z = arm()[0], np.ones(3)
    pair = [np.ones(6)] * 2
    for _ in range(10_000):  # until the interpreter has adapted to the calls
        small.solve(z, z, z, pair)
    gc.collect()
    blocks = sys.getallocatedblocks()
    for _ in range(10_000):
        small.solve(z, z, z, pair)
    gc.collect()
    assert abs(sys.getallocatedblocks() - blocks) < 50
