"""Projection of measured states, against other QP solvers on the same problem."""

import numpy as np
import pytest
import qpsolvers
from state_projection import ARM, FOUR_BAR, LEG, measured, nearest_in_z, projector

from mbd_ros.core.model.coupling_functions import Linear, Polynomial
from mbd_ros.core.model.couplings import CoupledPair
from mbd_ros.core.optimization.box_qp import Statistics
from mbd_ros.core.optimization.move_qp import ComplementarityProblem
from mbd_ros.errors import SolveError
from mbd_ros.methods.projection.coupled_joints import CoupledJoints
from mbd_ros.methods.projection.state_projection import StateProjector

BRICARD = "benchmark/a04_bricard"
INFINITE = 1e20


def leg_state(scene, z=(0.3, -0.8, 0.1), w=(0.5, -2.0, 1.0)):
    """A consistent state of a scene with couplings only."""
    q, v = np.zeros(scene.robot.model.nv), np.zeros(scene.robot.model.nv)
    q[scene.couplings.q_index], v[scene.couplings.v_index] = z, w
    scene.couplings.expand(q, v, np.zeros_like(q))
    return q, v


def nearest_by_daqp(system, x, W, lower, upper):
    """Oracle 2: all joints, Jacobian by differences of g, the bounds in the QP, by DAQP."""
    q, n, h = x.q.copy(), len(x.q), 1e-6

    def jacobian(q):
        columns = [
            (system.residual(0.0, q + h * e) - system.residual(0.0, q - h * e)) / (2 * h)
            for e in np.eye(n)
        ]
        return np.array(columns).T

    for _ in range(300):
        J = jacobian(q)
        problem = qpsolvers.Problem(
            W, W @ (q - x.q), A=J, b=-system.residual(0.0, q), lb=lower - q, ub=upper - q
        )
        found = qpsolvers.solve_problem(problem, solver="daqp", primal_tol=1e-13, dual_tol=1e-13)
        step = found.x
        q = q + step * min(1.0, 0.2 / np.abs(step).max())
        if np.abs(step).max() < 1e-11:
            break
    J = jacobian(q)
    low = np.where(q < lower + 1e-9, 0.0, -INFINITE)
    high = np.where(q > upper - 1e-9, 0.0, INFINITE)
    problem = qpsolvers.Problem(W, -W @ x.v, A=J, b=np.zeros(len(J)), lb=low, ub=high)
    return q, qpsolvers.solve_problem(problem, solver="daqp", primal_tol=1e-13).x


def assert_consistent(projector, found, m):
    """On the manifold, within the limits, optimal with its multipliers."""
    system, x = projector.system, found.x
    assert np.abs(system.residual(0.0, x.q)).max(initial=0.0) <= 1e-12
    J = system.jacobian(0.0, x.q)
    assert np.abs(J @ x.v).max(initial=0.0) <= 1e-12 * (1.0 + np.abs(m.x.v).max())
    assert (x.q >= projector.lower).all() and (x.q <= projector.upper).all()
    W = projector.prepare(m).metric.W
    pull = W @ (x.q - m.x.q)
    left = pull - J.T @ found.multipliers - found.limit_multipliers
    assert np.abs(left).max() <= 1e-8 * np.abs(pull).max() + 1e-11
    for mu, q, low, high in zip(
        found.limit_multipliers, x.q, projector.lower, projector.upper, strict=True
    ):
        assert mu == 0.0 or (mu > 0 and q < low + 1e-9) or (mu < 0 and q > high - 1e-9)


# ---------------------------------------------------------------------- against other solvers


@pytest.mark.parametrize(
    ("missing", "bias", "lacks_velocity"),
    [
        ((), 0.0, None),
        ((), 0.004, None),
        (("knee_slide_x",), 0.004, None),
        (("knee_slide_x", "knee_slide_y"), 0.0, None),
        ((), 0.002, ("knee_slide_x", "knee_slide_y")),
    ],
)
@pytest.mark.parametrize("at_limit", [False, True])
def test_leg_equals_an_independent_solve(missing, bias, lacks_velocity, at_limit):
    """Noise on all joints, biased and dropped dependent joints, two limits acting."""
    scene, ours = projector(LEG)
    rng = np.random.default_rng(1)
    size = np.array([1e-2 if j.kind == "revolute" else 1e-3 for j in scene.robot.joints])
    acted = 0
    for _ in range(40):
        q, v = leg_state(scene, (0.3, 0.0, 0.52) if at_limit else (0.3, -0.8, 0.1))
        q = q + size * rng.normal(size=5)
        v = v + size * rng.normal(size=5)
        q[scene.robot.joint("knee_slide_y").q] += bias
        m = measured(q, v, missing, scene, lacks_velocity)
        found = ours.project(m)
        expected_q, expected_v = nearest_in_z(scene, ours.system, m, ours.lower, ours.upper)
        np.testing.assert_allclose(found.x.q, expected_q, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.x.v, expected_v, rtol=0, atol=1e-8)
        assert_consistent(ours, found, m)
        acted += found.limit_multipliers.any()
    assert acted >= 20 if at_limit else acted == 0


@pytest.mark.parametrize("name", [FOUR_BAR, "benchmark/a02_four_bars_2", "benchmark/a03_andrews"])
@pytest.mark.parametrize("tight", [False, True])
def test_loops_equal_an_independent_solve(name, tight):
    """`tight`: two joints may only go half the way that they would."""
    scene, ours = projector(name)
    x0 = ours.project(measured(scene.initial.q)).x
    rng = np.random.default_rng(2)
    for _ in range(15):
        q, v = x0.q + 0.01 * rng.normal(size=ours.system.nv), rng.normal(size=ours.system.nv)
        m = measured(q, v)
        lower, upper = np.full(len(q), -9.0), np.full(len(q), 9.0)
        if tight:
            free = ours.project(m).x.q - x0.q
            for i in np.argsort(-np.abs(free))[:2]:
                (upper if free[i] > 0 else lower)[i] = x0.q[i] + 0.5 * free[i]
        limited = StateProjector(ours.system)
        limited.lower[:], limited.upper[:] = lower, upper
        _, limited = projector(name, (lower, upper))
        found = limited.project(m)
        assert_consistent(limited, found, m)
        W = ours.system.mass(q).dense
        expected_q, expected_v = nearest_by_daqp(ours.system, m.x, W, lower, upper)
        np.testing.assert_allclose(found.x.q, expected_q, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.x.v, expected_v, rtol=0, atol=1e-7)  # J by differences
        assert bool(found.limit_multipliers.any()) == tight


def test_large_errors_still_give_the_nearest_state():
    """Up to a tenth of a radian everywhere; redundant rows (Bricard) too."""
    for name, size in ((FOUR_BAR, 0.1), ("benchmark/a03_andrews", 0.1), (BRICARD, 0.05)):
        scene, ours = projector(name, limits=False)
        x0 = ours.project(measured(scene.initial.q)).x
        rng = np.random.default_rng(3)
        for _ in range(20):
            q = x0.q + size * rng.normal(size=ours.system.nv)
            m = measured(q, rng.normal(size=ours.system.nv))
            assert_consistent(ours, ours.project(m), m)


@pytest.mark.parametrize("name", [LEG, ARM, FOUR_BAR])
def test_large_errors_within_limits_still_give_the_nearest_state(name):
    """Half a radian or metre on every joint; linear rows there often contradict the limits."""
    scene, ours = projector(name)
    x0 = ours.project(measured(scene.initial.q)).x
    rng = np.random.default_rng(7)
    acted = 0
    for _ in range(60):
        shift, v = 0.5 * rng.normal(size=ours.system.nv), rng.normal(size=ours.system.nv)
        m = measured(x0.q + shift, v)
        found = ours.project(m)
        assert_consistent(ours, found, m)
        acted += found.limit_multipliers.any()
    assert acted >= 5


@pytest.mark.parametrize("name", [LEG, ARM])
@pytest.mark.parametrize("missing", [(), ("dependent",)])
def test_couplings_in_their_own_coordinates_are_the_same_as_rows(name, missing):
    """At limits and off them; two limits of the arm are one, so that their multipliers differ."""
    scene, ours = projector(name)
    missing = scene.couplings.dependent[:1] if missing else ()
    x0 = ours.project(measured(scene.initial.q)).x
    rng = np.random.default_rng(8)
    for size in np.repeat([1e-4, 1e-2, 0.1], 20):
        q = x0.q + size * rng.normal(size=ours.system.nv)
        m = measured(q, rng.normal(size=ours.system.nv), missing, scene)
        prepared, rows = ours.prepare(m), ours._on_rows.rows(0.0, q)
        metrics = prepared.metric, prepared.velocity_metric
        coupled = ours._coupled.find(m.x, *(metric.W for metric in metrics))
        general = ours._on_rows.find(m.x, *metrics, rows)
        for field in ("q", "v", "lam", "mu")[: 4 if name == LEG else 2]:
            expected = getattr(general, field)
            np.testing.assert_allclose(getattr(coupled, field), expected, rtol=0, atol=1e-9)


def test_chained_couplings_and_their_derivatives():
    """Derivatives by differences; a law that is no spline, so that these are exact to 1e-9."""
    laws = [Polynomial([0.1, 0.5, -0.3]), Polynomial([0.0, 1.0, 2.0]), Linear(-2.0, 0.3)]
    edges = [(1, 0), (3, 1), (4, 3)]  # joints 0 and 2 are free
    links = [CoupledPair(c, c, p, p, law) for (c, p), law in zip(edges, laws, strict=True)]
    joints, h = CoupledJoints(5, links), 1e-4
    assert joints.free.tolist() == [0, 2]
    assert joints.ancestry.argmax(axis=1).tolist() == [0, 0, 1, 0, 0]
    at = [joints.at(np.array([z, 9.0, 0.7, 9.0, 9.0])) for z in (0.4 - h, 0.4, 0.4 + h)]
    before, place, after = at
    follows = joints.ancestry[:, 0] == 1.0
    first = np.where(follows, (after.q - before.q) / (2 * h), 1.0)
    np.testing.assert_allclose(place.slope, first, rtol=0, atol=1e-7)
    second = np.where(follows, (after.slope - before.slope) / (2 * h), 0.0)
    np.testing.assert_allclose(place.curvature, second, rtol=0, atol=1e-7)
    g, rate = joints.violation(place.q, place.slope)
    assert not g.any() and np.abs(rate).max() <= 1e-15
    forces = np.arange(1.0, 6.0)
    J = np.zeros((3, 5))
    for row, (child, parent) in enumerate(edges):
        J[row, [child, parent]] = 1.0, -place.link_slopes[row]
    left = forces - J.T @ joints.multipliers(forces, place.link_slopes)
    np.testing.assert_allclose(left[[1, 3, 4]], 0.0, atol=1e-14)
    G = joints.ancestry * place.slope[:, None]
    np.testing.assert_allclose(left[joints.free], G.T @ forces, rtol=1e-14)


# ---------------------------------------------------------------------- cost of nothing


def test_a_consistent_state_passes_unchanged_and_without_a_qp():
    for name in (LEG, FOUR_BAR, ARM):
        scene, ours = projector(name)
        x = ours.project(measured(scene.initial.q, scene.initial.v)).x
        found = ours.project(measured(x.q, x.v))
        np.testing.assert_allclose(found.x.q, x.q, rtol=0, atol=1e-14)
        np.testing.assert_allclose(found.x.v, x.v, rtol=0, atol=1e-13)
        assert found.iterations == 1
        assert np.abs(found.gap).max() <= 1e-12 and np.abs(found.multipliers).max() <= 1e-11
    assert ours.statistics == (0, Statistics())


def test_without_limits_they_are_left_behind():
    scene, bound = projector(ARM)
    _, free = projector(ARM, limits=False)
    q, v = leg_state(scene, (1.4, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    m = measured(q, v)
    np.testing.assert_allclose(free.project(m).x.q, q, rtol=0, atol=1e-14)
    found = bound.project(m)
    assert_consistent(bound, found, m)
    shoulder = scene.robot.joint("shoulder_flexion")
    assert found.x.q[shoulder.q] == shoulder.upper
    assert found.excess[shoulder.v] == pytest.approx(1.4 - shoulder.upper)
    assert free.statistics == (0, Statistics())


def test_limits_that_are_one_and_the_same_by_their_coupling():
    """The elbow is at 0 exactly where the shoulder is at its lower end."""
    scene, ours = projector(ARM)
    rng = np.random.default_rng(4)
    shoulder, elbow = scene.robot.joint("shoulder_flexion"), scene.robot.joint("elbow")
    both = 0
    for _ in range(100):
        q, v = leg_state(scene, (-0.1, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
        m = measured(q + 0.2 * rng.normal(size=5), v + rng.normal(size=5))
        found = ours.project(m)
        assert_consistent(ours, found, m)
        expected, expected_v = nearest_in_z(scene, ours.system, m, ours.lower, ours.upper)
        np.testing.assert_allclose(found.x.q, expected, rtol=0, atol=1e-8)
        np.testing.assert_allclose(found.x.v, expected_v, rtol=0, atol=1e-8)
        both += found.x.q[shoulder.q] < -0.1 + 1e-9 and found.x.q[elbow.q] < 1e-9
    assert both >= 20


def test_a_state_at_its_limit_does_not_move_out_of_it():
    scene, ours = projector(LEG)
    ankle = scene.robot.joint("ankle")
    for speed, expected in ((2.0, 0.0), (-2.0, None)):
        q, v = leg_state(scene, (0.3, -0.8, ankle.upper + 0.01), (0.0, 0.0, speed))
        found = ours.project(measured(q, v))
        assert found.x.q[ankle.q] == ankle.upper
        assert found.x.v[ankle.v] == pytest.approx(speed if expected is None else expected)


# ---------------------------------------------------------------------- missing joints


@pytest.mark.parametrize("name", ["knee_anterior", "knee_tibial", "knee_posterior"])
def test_a_missing_joint_of_a_loop_is_what_the_others_say(name):
    """Without noise it is exact, wherever the search starts near it."""
    scene, ours = projector(FOUR_BAR)
    x = ours.project(measured(scene.initial.q, np.array([0.1, -1.0, 0.3, 0.2, 0.5]))).x
    for offset in (-0.05, 0.02, 0.05):
        q, v = x.q.copy(), x.v.copy()
        q[scene.robot.joint(name).q] += offset
        v[scene.robot.joint(name).v] = 99.0
        found = ours.project(measured(q, v, [name], scene))
        assert not found.undetermined.any()
        np.testing.assert_allclose(found.x.q, x.q, rtol=0, atol=1e-9)
        np.testing.assert_allclose(found.x.v, x.v, rtol=0, atol=1e-9)
        assert np.abs(found.gap).max() <= 1e-10


def test_what_nothing_determines_stays_and_is_named():
    """The slides tell the knee angle 70 times worse than they are measured themselves."""
    scene, ours = projector(LEG)
    q, v = leg_state(scene)
    for missing, expected in (
        (["ankle"], ["ankle"]),
        (["knee"], ["knee"]),
        (["knee", "knee_slide_x"], ["knee"]),
        (["knee_slide_x", "ankle"], ["ankle"]),
    ):
        found = ours.project(measured(q, v, missing, scene))
        names = [j.name for j in scene.robot.joints if found.undetermined[j.v]]
        assert names == expected
        np.testing.assert_allclose(found.x.q, q, rtol=0, atol=1e-12)
    trusting = StateProjector(ours.system, amplification=1e4)
    assert not trusting.project(measured(q, v, ["knee"], scene)).undetermined.any()


def test_the_violation_is_that_of_what_was_measured():
    scene, ours = projector(LEG)
    q, v = leg_state(scene)
    q[scene.robot.joint("knee_slide_x").q] += 0.003
    v[scene.robot.joint("knee_slide_y").v] += 0.02
    found = ours.project(measured(q, v))
    np.testing.assert_allclose(found.gap, [0.003, 0.0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found.rate, [0.0, 0.02], rtol=0, atol=1e-12)
    found = ours.project(measured(q, v, ["knee_slide_x", "knee_slide_y"], scene))
    np.testing.assert_allclose(found.gap, [0.0, 0.0], rtol=0, atol=1e-12)


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize("size", [1e160, 1e308])
@pytest.mark.parametrize("name", [LEG, FOUR_BAR])
def test_no_answer_is_an_error_and_never_a_nan(name, size):
    scene, ours = projector(name)
    with np.errstate(all="ignore"), pytest.raises(SolveError):
        ours.project(measured(np.full(5, size)))
    speeds = measured(scene.initial.q, np.array([size, -size, size, size, -size]))
    with np.errstate(all="ignore"):
        try:
            x = ours.project(speeds).x
        except SolveError:
            assert size == 1e308  # where sums of speeds overflow
        else:
            assert np.isfinite(x.q).all() and np.isfinite(x.v).all()


def test_limits_that_contradict_the_rows_are_refused():
    scene, ours = projector(LEG)
    q, v = leg_state(scene)
    slide = scene.robot.joint("knee_slide_y")
    lower, upper = ours.lower.copy(), ours.upper.copy()
    lower[slide.v] = upper[slide.v] = 0.004  # the spline never goes there
    _, ours = projector(LEG, (lower, upper))
    with pytest.raises(SolveError, match=r"limits contradict|no consistent state|off its") as e:
        ours.project(measured(q, v))
    assert f"limit of knee_slide_y by {q[slide.q] - 0.004:.3g}" in str(e.value)


def test_pushing_bounds_equal_quadprog_also_where_they_depend():
    """Random problems; every third one with bounds that are copies of one another."""
    rng = np.random.default_rng(5)
    for trial in range(200):
        n = 6
        root = rng.normal(size=(n, n))
        if trial % 3 == 0:
            root[3:] = root[:3]
        root /= np.linalg.norm(root, axis=1)[:, None]
        A = root @ root.T
        gap = root @ rng.normal(size=n)
        force = ComplementarityProblem(n).solve(A, gap)
        left = A @ force + gap
        assert force.min() >= 0.0 and left.min() >= -1e-10
        assert abs(force @ left) <= 1e-10 * (1.0 + force.max())
        moved = qpsolvers.solve_qp(np.eye(n), np.zeros(n), -root, gap, solver="quadprog")
        np.testing.assert_allclose(root.T @ force, moved, rtol=0, atol=1e-8)
