"""Forward dynamics in all tiers: identities, other tiers, dense linear algebra."""

import re

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import wrenches_of
from places import ROOT
from systems import acceleration

from mbd_ros.core.dynamics.composed_system import ComposedSystem
from mbd_ros.core.dynamics.kkt import Kkt
from mbd_ros.core.dynamics.open_chain import Aba
from mbd_ros.core.dynamics.reduced import Mimic, Reduced
from mbd_ros.core.dynamics.tiers import build_system, tier_of
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SceneError, SolveError
from mbd_ros.methods.projection.assembly import assemble, project
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.reading.part_entries import build_part

SCENES = ROOT / "config/scenes"
COUPLED = ["prosthetic_arm", "prosthetic_leg"]
LOOPS = [
    "four_bar_leg",
    "benchmark/a02_four_bars_2",
    "benchmark/a03_andrews",
    "benchmark/a04_bricard",
]
PENDULUM = (ROOT / "config/robots/pendulum.urdf").read_text(encoding="utf-8")
ARM = (ROOT / "config/robots/arm7.urdf").read_text(encoding="utf-8")


def scene(name):
    return load_scene(SCENES / f"{name}.yaml")


def state(loaded, system, seed=0):
    """A consistent state near the initial one, moving."""
    rng = np.random.default_rng(seed)
    x = loaded.initial
    q = system.model.nq and pin.integrate(system.model, x.q, 0.05 * rng.normal(size=len(x.v)))
    y = system.reduce(State(x.t, q, x.v + rng.normal(size=len(x.v))))
    return assemble(system, y)


def with_parts(urdf, entries, tier="auto", **options):
    robot = read_robot(urdf)
    parts = [build_part("constraints", entry, "test", robot) for entry in entries]
    return build_system(robot, Couplings(robot), parts, Loads(robot.model.nv), tier, **options)


def drop_effort(loaded, size):
    """A torque on every joint, as the difference of two loads."""
    return build_part(
        "forces",
        {
            "type": "prescribed_torque",
            "joints": [joint.name for joint in loaded.robot.joints],
            "times": [-1.0, 10.0],
            "torque": [size.tolist()] * 2,
        },
        "test",
        loaded.robot,
    )


@pytest.mark.parametrize("name", [*COUPLED, *LOOPS])
def test_all_tiers_agree(name):
    loaded = scene(name)
    systems = {tier: loaded.system(solver={"type": tier}) for tier in ("auto", "kkt", "qp")}
    x = systems["auto"].expand(state(loaded, systems["auto"]))
    solutions = {tier: s.evaluate(x) for tier, s in systems.items()}
    expected = solutions["kkt"]
    size = 1.0 + np.abs(expected.a).max()
    for tier, found in solutions.items():
        assert np.abs(found.a - expected.a).max() <= 1e-9 * size, tier
        if name != "benchmark/a04_bricard":  # redundant: only the minimum norm is unique
            force = 1.0 + np.abs(expected.lam).max()
            assert np.abs(found.lam - expected.lam).max() <= 1e-9 * force, tier


@pytest.mark.parametrize(
    ("name", "tier"),
    [
        ("arm7", "aba"),
        ("prosthetic_arm", "reduced"),
        ("four_bar_leg", "kkt"),
        ("benchmark/a04_bricard", "kkt"),
    ],
)
def test_tier_is_the_cheapest_that_serves(name, tier):
    assert tier_of(scene(name).system()) == tier


@pytest.mark.parametrize("name", LOOPS)
def test_loops_agree_with_a_dense_least_squares_solution(name):
    """[M J'; J 0] [a; -lam] = [tau - h; -drift] by numpy's SVD, which gives the smallest norm."""
    loaded = scene(name)
    system = loaded.system()
    x = state(loaded, system)
    found = system.evaluate(x)
    M, J = system.mass(x.q).dense, system.jacobian(x.t, x.q)
    applied = system.applied(x.t, x.q, x.v)
    system.k.refresh(x.q, x.v)
    drift = system.constraints.accelerations(system.k, x)[1]
    free = np.linalg.solve(M, applied)
    A = J @ np.linalg.solve(M, J.T)
    lam = np.linalg.lstsq(A, -(J @ free + drift), rcond=1e-10)[0]
    a = free + np.linalg.solve(M, J.T @ lam)
    assert np.abs(found.a - a).max() <= 1e-9 * (1.0 + np.abs(a).max())
    assert np.abs(found.lam - lam).max() <= 1e-8 * (1.0 + np.abs(lam).max())
    assert np.abs(J @ found.a + drift).max() <= 1e-9 * (1.0 + np.abs(drift).max())


@pytest.mark.parametrize("name", ["arm7", *COUPLED])
def test_inverse_dynamics_of_the_acceleration_returns_the_torque(name):
    loaded = scene(name)
    tau = np.random.default_rng(1).normal(size=loaded.robot.model.nv)
    system = loaded.system([drop_effort(loaded, tau)])
    y = state(loaded, system)
    z = acceleration(system, y.t, y.q, y.v)
    found = loaded.inverse_dynamics().solve(y.q, y.v, z)
    slopes = loaded.couplings.expand(system.expand(y).q, tau.copy(), tau.copy())
    expected, _ = loaded.couplings.reduce(tau.copy(), slopes)
    assert np.abs(found.tau - expected).max() <= 1e-9


def test_coupling_multipliers_are_those_of_inverse_dynamics():
    loaded = scene("prosthetic_leg")
    for tier in ("auto", "kkt"):
        system = loaded.system(solver={"type": tier})
        y = state(loaded, loaded.system())
        full = loaded.system().expand(y)
        _, a, _, lam, _ = system.evaluate(full)
        z = a[loaded.couplings.v_index]
        found = loaded.inverse_dynamics().solve(y.q, y.v, z)
        assert np.abs(found.multipliers - lam).max() <= 1e-9
        assert np.abs(found.tau).max() <= 1e-9


@pytest.mark.parametrize("name", LOOPS)
def test_constraint_forces_do_no_work(name):
    loaded = scene(name)
    system = loaded.system()
    for seed in range(5):
        x = state(loaded, system, seed)
        lam = system.evaluate(x).lam
        J = system.jacobian(x.t, x.q)
        powers = (J.T @ lam) * x.v
        assert abs(powers.sum()) <= 1e-10 * (np.abs(powers).sum() + 1e-3)


STRUT = {"type": "distance", "frame_a": "base", "frame_b": "link7", "distance": 0.9}


def test_duplicated_rows_share_the_force_and_change_nothing_else():
    once, thrice = with_parts(ARM, [STRUT]), with_parts(ARM, [STRUT] * 3)
    x = assemble(once, State(0.0, np.full(7, 0.3), np.ones(7)))
    one, three = once.evaluate(x), thrice.evaluate(x)
    assert np.abs(one.a - three.a).max() <= 1e-10 * np.abs(one.a).max()
    assert three.lam == pytest.approx(np.full(3, one.lam[0] / 3), rel=1e-10)


def test_a_row_that_nothing_moves_carries_nothing():
    idle = {"type": "loop_closure", "frame_a": "base", "frame_b": "link1", "directions": "x"}
    with_idle, without = with_parts(ARM, [idle, STRUT]), with_parts(ARM, [STRUT])
    x = assemble(without, State(0.0, np.full(7, 0.3), np.ones(7)))
    found, expected = with_idle.evaluate(x), without.evaluate(x)
    assert np.abs(with_idle.jacobian(0.0, x.q)[0]).max() <= 1e-15
    assert np.abs(found.a - expected.a).max() <= 1e-10 * np.abs(expected.a).max()
    assert found.lam == pytest.approx([0.0, *expected.lam], abs=1e-9)


def motion(**trajectory):
    return {"type": "prescribed_motion", "joint": "hinge", **trajectory}


def test_rows_that_contradict_each_other_are_refused():
    system = with_parts(
        PENDULUM, [motion(polynomial=[0.0, 1.0]), motion(polynomial=[0.0, 1.0, 1.0])]
    )
    with pytest.raises(
        SolveError, match=r"row prescribed_motion\.torque contradicts the other rows"
    ):
        system.evaluate(State(0.0, np.zeros(1), np.ones(1)))
    two = with_parts(ARM, [STRUT, {**STRUT, "distance": 0.5}])
    with pytest.raises(
        SolveError, match=r"cannot be assembled near this position: row distance.force#2"
    ):
        assemble(two, State(0.0, np.full(7, 0.3), np.zeros(7)))
    faster = with_parts(PENDULUM, [motion(polynomial=[0.0, 1.0]), motion(polynomial=[0.0, 2.0])])
    with pytest.raises(SolveError, match=r"no consistent velocity: row prescribed_motion\.torque"):
        assemble(faster, State(0.0, np.zeros(1), np.ones(1)))


def test_toggle_position_is_finite_and_flagged():
    """Both cranks of the four-bars level: every link on one line, one degree of freedom more."""
    loaded = scene("benchmark/a02_four_bars_2")
    system = loaded.system()
    q = loaded.initial.q.copy()
    level = {"crank_0": np.pi / 2, "crank_1": np.pi / 2, "crank_2": np.pi / 2}
    for name, angle in {**level, "coupler_0": -np.pi / 2, "coupler_1": -np.pi / 2}.items():
        q[loaded.robot.joint(name).q] = np.sign(loaded.initial.v[0]) * -angle
    assert assemble(system, loaded.initial) is not None
    assert system.condition < 10.0
    x = project(system, State(0.0, q, loaded.initial.v))
    assert system.condition > 1e6
    assert np.abs(x.q - q).max() <= 1e-12
    solution = system.evaluate(x)
    assert np.isfinite(solution.a).all()
    assert np.isfinite(solution.lam).all()
    assert np.abs(solution.lam).max() <= 1e3  # tens of newtons hold the links


def test_hundred_bodies_closed_to_a_loop():
    loaded = load_scene(SCENES / "benchmark/x06_chain.yaml")
    robot = loaded.robot
    strut = {"type": "distance", "frame_a": "universe", "frame_b": "link_100", "distance": 0.5}
    part = build_part("constraints", strut, "test", robot)
    system = build_system(robot, Couplings(robot), [part], Loads(robot.model.nv))
    q = np.where(np.arange(100) % 2, 1.0, -1.0)
    q[0] = 0.5
    x = assemble(system, State(0.0, q, np.zeros(100)))
    _, a, _, lam, _ = system.evaluate(x)
    M, J = system.mass(x.q).dense, system.jacobian(0.0, x.q)
    left = M @ a - system.applied(0.0, x.q, x.v) - J.T @ lam
    assert np.abs(system.residual(0.0, x.q)).max() <= 1e-12
    assert np.abs(left).max() <= 1e-9
    assert abs(lam[0]) > 0.01


@pytest.mark.parametrize(
    ("tier", "message"),
    [
        ("aba", "solver aba takes no rows, the scene has joint_stop.torque"),
        ("reduced", "solver reduced takes couplings only, the scene has joint_stop.torque"),
        ("kkt", "solver kkt takes no bounded rows, the scene has joint_stop.torque"),
        ("simplex", "unknown solver type 'simplex', accepted: auto, aba, reduced, kkt, qp"),
    ],
)
def test_tier_that_cannot_serve_is_refused(tier, message):
    stop = {"type": "joint_stop", "joint": "hinge", "upper": 0.5, "lower": -0.5}
    with pytest.raises(ModelError, match=message):
        with_parts(PENDULUM, [stop], tier)


def test_solver_section_of_a_scene_names_the_file(tmp_path):
    file = tmp_path / "scene.yaml"
    urdf = ROOT / "config/robots/prosthetic_arm.urdf"
    file.write_text(
        f"robot: {{urdf: {urdf}}}\n"
        "couplings: {elbow: {parent: shoulder_flexion, factor: 1.0}}\n"
        "solver: {type: aba}\n",
        encoding="utf-8",
    )
    with pytest.raises(SceneError, match=r"scene\.yaml: solver: solver aba takes no rows"):
        load_scene(file).system()


@pytest.mark.parametrize("name", LOOPS)
def test_wrenches_of_the_constraints_are_their_generalized_force(name):
    """Sum of J_i' w_i over the bodies, with J_i at the point of attack, equals J' lam."""
    loaded = scene(name)
    system = loaded.system()
    x = state(loaded, system)
    lam = system.evaluate(x).lam
    J, model, data = system.jacobian(x.t, x.q), system.model, system.model.createData()
    pin.forwardKinematics(model, data, x.q)
    pin.computeJointJacobians(model, data, x.q)
    total = np.zeros(model.nv)
    wrenches = wrenches_of(system, x, lam)
    for frame, point, force, torque in wrenches:
        body = model.frames[loaded.robot.frame(frame)].parentJoint
        place = pin.SE3(np.eye(3), data.oMi[body].actInv(point))
        at_point = pin.getFrameJacobian(model, data, body, place, pin.LOCAL_WORLD_ALIGNED)
        total += at_point.T @ np.concatenate([force, torque])
    assert np.abs(total - J.T @ lam).max() <= 1e-10 * (1.0 + np.abs(lam).max())
    assert np.abs(sum(w.force for w in wrenches)).max() <= 1e-10 * (1.0 + np.abs(lam).max())


@pytest.mark.parametrize("name", ["arm7", *COUPLED, *LOOPS])
def test_an_evaluation_is_a_value_whose_response_ends_with_the_next_one(name):
    """Its arrays stay, accelerations are affine in forces, and a stale response says so."""
    loaded = scene(name)
    system, rng = loaded.system(), np.random.default_rng(8)
    x, other = (system.expand(state(loaded, system, seed)) for seed in (0, 1))
    now = system.evaluate(x)
    kept = [values.copy() for values in (now.a, now.lam)]
    forces = rng.normal(size=(loaded.robot.model.nv, 2))
    added = now.respond(forces)
    pushed = loaded.system([drop_effort(loaded, forces[:, 0])]).evaluate(x)
    size = 1.0 + np.abs(pushed.a).max()
    assert np.abs(pushed.a - now.a - added[:, 0]).max() <= 1e-8 * size
    assert now.zdot.size == 0
    system.evaluate(other)
    assert np.array_equal(now.a, kept[0]) and np.array_equal(now.lam, kept[1])
    with pytest.raises(SolveError, match="after a later evaluation"):
        now.respond(forces)


@pytest.mark.parametrize("name", ["arm7", *COUPLED])
def test_the_mass_is_an_operator_that_stays(name):
    """Products and solutions are those of its entries, also after the system went elsewhere."""
    loaded = scene(name)
    system, rng = loaded.system(), np.random.default_rng(4)
    y, other = state(loaded, system), state(loaded, system, 3)
    mass, dense = system.mass(y.q), system.mass(y.q).dense.copy()
    system.mass(other.q)
    for force in (rng.normal(size=system.nv), rng.normal(size=(system.nv, 1))):
        assert np.array_equal(mass.dot(force), dense.dot(force))
        assert mass.solve(force).shape == force.shape
        assert dense.dot(mass.solve(force)) == pytest.approx(force, abs=1e-9)


@pytest.mark.parametrize("name", ["arm7", *COUPLED, *LOOPS])
def test_values_accelerators_and_other_loads_agree(name):
    """One acceleration by value and by writing; under other loads by a system built for them."""
    loaded = scene(name)
    system = loaded.system()
    y = state(loaded, system)
    x = system.expand(y)
    now, a = system.evaluate(x), acceleration(system, y.t, y.q, y.v)
    assert np.array_equal(system.lift(y, a), now.a)
    force = drop_effort(loaded, np.ones(loaded.robot.model.nv))
    pushed = system.with_loads(Loads(loaded.robot.model.nv, [*system.loads.forces, force]))
    expected = loaded.system([force]).evaluate(x).a
    assert np.array_equal(pushed.evaluate(x).a, expected)
    assert np.array_equal(system.evaluate(x).a, now.a)


def test_derivatives_by_inputs_are_those_of_the_forces():
    """The arm with its drives: a by u is M^-1 B."""
    loaded = scene("arm7")
    drive = build_part("actuators", {"type": "ideal", "joints": ["joint2"]}, "test", loaded.robot)
    system = loaded.system()
    driven = system.with_loads(Loads(7, (), [drive]))
    y = state(loaded, driven)
    by_u = driven.derivatives(y, np.array([0.3])).u
    column = np.eye(7)[:, [loaded.robot.joint("joint2").v]]
    assert by_u == pytest.approx(driven.mass(y.q).solve(column), rel=1e-6, abs=1e-6)
    assert driven.derivatives(y, inputs=False).u.shape == (7, 0)


def test_no_tier_inherits_from_another_and_nothing_swaps_loads():
    """Systems are composed; loads, gains and rows are arguments of building."""
    assert all(t.__bases__ == (object,) for t in (Aba, Kkt, Reduced, Mimic, ComposedSystem))
    for file in (ROOT / "mbd_ros").rglob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert not re.search(r"system\.(loads|bounded|constraints) = ", text), file
        assert not file.name.startswith("mass") or "linalg.eig" not in text, file
