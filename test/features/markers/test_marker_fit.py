"""Fits of markers: derivatives, optima, limits, loops, missing markers, free bodies, tasks."""

import csv
import gzip

import numpy as np
import pinocchio as pin
import pytest
from places import RECORDINGS

import mbd_ros as mbd
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.features.markers.exchanged_labels import exchanged_labels
from mbd_ros.features.markers.marker_kinematics import Mark, MarkerKinematics
from mbd_ros.features.markers.marker_trial import smooth_trial
from mbd_ros.methods.projection.coupled_joints import independent_limits

PLACES = {  # markers on the leg: link -> places [m]; the root moves with a floating base
    "world": [(0.1, 0.0, 0.1), (-0.1, 0.05, 0.0), (0.0, -0.1, 0.02)],
    "residual_limb": [(0.05, 0.0, -0.2), (-0.04, 0.05, -0.1), (0.0, -0.06, -0.15)],
    "shank": [(0.06, 0.02, -0.2), (0.0, -0.05, -0.1), (0.03, 0.06, -0.05)],
    "foot": [(0.12, 0.03, -0.02), (-0.06, 0.0, 0.0), (0.1, -0.05, 0.01)],
}


def leg(urdf="prosthetic_leg", **sections):
    return mbd.scene_from(sections, urdf=urdf)


def kinematics(scene, weights=(1.0, 2.0, 0.5), **options):
    """Three markers of different weight on each link."""
    marks = [
        Mark(f"{frame}{i}", scene.robot.point(frame, xyz), weights[i])
        for frame, places in PLACES.items()
        for i, xyz in enumerate(places)
    ]
    options = {"constraints": scene.constraints, **options}
    return MarkerKinematics(scene.robot, scene.couplings, marks, **options)


def shown(solver, q):
    """Where the markers are in the world, frame by frame, as Pinocchio's kinematics has them."""
    k, v = Kinematics(solver.robot), np.zeros(solver.robot.model.nv)
    places = []
    for each in q:
        k.refresh(each, v)
        places.append([k.position(mark.point) for mark in solver.marks])
    return np.array(places) + solver.robot.origin


def motion(scene, count, seed=0, size=0.3):
    """Smooth motion of the independent joints, couplings kept."""
    rng, t = np.random.default_rng(seed), np.linspace(0.0, 0.02 * (count - 1), count)
    model = scene.robot.model
    step = rng.uniform(-size, size, model.nv) + np.sin(
        3.0 * t[:, None] + rng.uniform(0.0, 6.0, model.nv)
    ) * rng.uniform(0.0, size, model.nv)
    q = np.array([pin.integrate(model, scene.initial.q, each) for each in step])
    for each in q:
        scene.couplings.expand(each, np.zeros(model.nv), np.zeros(model.nv))
    return t, q


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_slope_and_hessian_are_the_derivatives_of_the_objective(base):
    """Central differences in the tangent of a coupled leg, 1e-7 of the largest entry."""
    scene = leg(robot={"base": base})
    solver = kinematics(scene, tasks={scene.couplings.independent[-1]: 0.3})
    cost, rng = solver.solver.cost, np.random.default_rng(1)
    t, q = motion(scene, 2)
    seen = solver.seen(shown(solver, q) + rng.normal(size=(2, 12, 3)) * 0.1, t)
    at, n = cost.at(q, seen), len(scene.couplings.v_index)
    h = 1e-5
    for j, unit in enumerate(np.eye(n)):
        ahead, behind = (cost.at(cost.moved(q, np.tile(s * unit, (2, 1))), seen) for s in (h, -h))
        slope = (ahead.value - behind.value) / (2.0 * h)
        np.testing.assert_allclose(at.slope[:, j], slope, atol=1e-9)
    for j, one in enumerate(np.eye(n)):  # second differences: free bodies turn their own axes
        for k, two in enumerate(np.eye(n)):
            steps = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
            f = [
                cost.at(cost.moved(q, np.tile(1e-4 * (a * one + b * two), (2, 1))), seen).value
                for a, b in steps
            ]
            bend = (f[0] - f[1] - f[2] + f[3]) / 4e-8
            np.testing.assert_allclose(at.hessian[:, j, k], bend, atol=2e-6)


@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_exact_markers_give_the_motion_back(base):
    scene = leg(robot={"base": base})
    solver = kinematics(scene, limits=False)
    t, q = motion(scene, 30, seed=2)
    fit = solver.trial(scene.initial.q, solver.seen(shown(solver, q), t))
    off = [
        np.abs(pin.difference(scene.robot.model, *pair)).max()
        for pair in zip(fit.q, q, strict=True)
    ]
    assert fit.settled.all() and max(off) < 1e-9
    assert fit.objective.max() < 1e-15 and np.abs(fit.misses).max() < 1e-7  # before the last step


def test_optimum_of_noisy_markers_is_that_of_a_general_minimizer():
    """scipy's minimizer on the objective, written out here, finds nothing lower nearby."""
    from scipy.optimize import minimize

    scene = leg()
    solver, rng = kinematics(scene, limits=False), np.random.default_rng(3)
    t, q = motion(scene, 4)
    seen_at = shown(solver, q) + 0.03 * rng.normal(size=(4, 12, 3))
    fit = solver.trial(scene.initial.q, solver.seen(seen_at, t))
    weights = np.array([mark.weight for mark in solver.marks])

    def objective(y, i):
        places = shown(solver, scene.couplings.positions(y)[None])[0]
        squares = ((places - seen_at[i]) ** 2).sum(axis=1)
        return weights @ squares / (2.0 * weights.sum())

    for i, found in enumerate(fit.q):
        y = found[scene.couplings.q_index]
        best = minimize(objective, y, args=(i,), method="BFGS", options={"gtol": 1e-10})
        assert objective(y, i) == pytest.approx(fit.objective[i], rel=1e-12)
        assert fit.objective[i] <= best.fun * (1.0 + 1e-12)
        np.testing.assert_allclose(y, best.x, atol=1e-6)


def test_limits_are_kept_and_the_rest_is_best_beside_them():
    scene = leg()
    solver = kinematics(scene)
    cost, (low, high) = solver.solver.cost, independent_limits(scene.robot, scene.couplings)
    t, q = motion(scene, 20, seed=4)
    y_of_q = cost.y_of_q
    q[:, y_of_q] = np.clip(q[:, y_of_q], low, high)
    q[:, y_of_q[-1]] = high[-1] + 0.2 * np.sin(np.linspace(0.0, 6.0, 20))
    q = cost.coupled(q)
    fit = solver.trial(scene.initial.q, solver.seen(shown(solver, q), t))
    y = fit.q[:, y_of_q]
    assert fit.settled.all() and (y >= low).all() and (y <= high).all()
    held = y == high
    assert held[:, -1].any() and not held[:, -1].all()
    slope = cost.at(fit.q, solver.seen(shown(solver, q), t)).slope
    free = (y > low) & (y < high)
    assert np.abs(slope[free]).max() < 1e-9 and (slope[held] <= 1e-12).all()


def test_limits_of_dependent_joints_hold_back_the_joint_that_they_follow():
    """q_d = 2 z - 0.5 within -1 .. 0.3 leaves -0.25 .. 0.4 to z."""
    description = leg().robot.model_sources[0].text
    scene = leg(urdf=description)
    names = scene.couplings.independent
    parent, child = names[0], names[1]
    joint = scene.robot.joint(child)
    coupled = leg(couplings={child: {"parent": parent, "factor": 2.0, "offset": -0.5}})
    low, high = independent_limits(coupled.robot, coupled.couplings)
    expected = (joint.lower + 0.5) / 2.0, (joint.upper + 0.5) / 2.0
    own = scene.robot.joint(parent)
    assert low[0] == pytest.approx(max(own.lower, expected[0]), abs=1e-8)
    assert high[0] == pytest.approx(min(own.upper, expected[1]), abs=1e-8)


def test_loops_stay_closed_and_the_rest_is_best_on_them():
    """A bar holds shank and world together: the slope has no share along the loop."""
    bar = {"type": "distance", "frame_a": "world", "frame_b": "foot", "distance": 0.75}
    scene = leg(constraints=[bar])
    solver, rng = kinematics(scene, limits=False), np.random.default_rng(5)
    t, q = motion(scene, 5, size=0.2)
    seen = solver.seen(shown(solver, q) + 0.01 * rng.normal(size=(5, 12, 3)), t)
    fit = solver.trial(scene.initial.q, seen)
    assert fit.settled.all() and fit.open.max() < 1e-12
    cost, (part,), k = (
        solver.solver.cost.at(fit.q, seen),
        scene.constraints,
        Kinematics(scene.robot),
    )
    for i, each in enumerate(fit.q):
        k.refresh(each, np.zeros(len(each)))
        row = part.jacobian(k, State(0.0, each, np.zeros(len(each)))) @ cost.G[i]
        along = cost.slope[i] - row[0] * (row[0] @ cost.slope[i]) / (row[0] @ row[0])
        assert np.abs(along).max() < 1e-9
    far = leg(constraints=[{**bar, "distance": 7.5}])
    with pytest.raises(SolveError, match=r"does not close: row foot_distance\.force"):
        kinematics(far).trial(far.initial.q, seen)


def test_missing_markers_weigh_nothing():
    scene = leg()
    solver, rng = kinematics(scene, limits=False), np.random.default_rng(6)
    t, q = motion(scene, 12)
    places = shown(solver, q) + 0.01 * rng.normal(size=(12, 12, 3))
    gappy = places.copy()
    gappy[4:8, 4] = np.nan
    gappy[5, 3, 1] = np.inf  # one coordinate that is none makes the marker missing
    fit, full = (solver.trial(scene.initial.q, solver.seen(each, t)) for each in (gappy, places))
    alone = MarkerKinematics(
        scene.robot,
        scene.couplings,
        [m for i, m in enumerate(solver.marks) if i != 4],
        limits=False,
    )
    there = np.delete(places, 4, axis=1)
    expected = alone.trial(scene.initial.q, alone.seen(there, t))
    np.testing.assert_allclose(fit.q[6], expected.q[6], atol=1e-8)
    np.testing.assert_allclose(fit.q[8:], full.q[8:], atol=1e-8)
    assert fit.objective[6] == pytest.approx(expected.objective[6], rel=1e-9)


def test_coordinates_that_nothing_shows_keep_their_start():
    scene = leg()
    marks = [mark for mark in kinematics(scene).marks if mark.label.startswith("residual_limb")]
    solver = MarkerKinematics(scene.robot, scene.couplings, marks, limits=False)
    t, q = motion(scene, 6)
    start = scene.initial.q + 0.1
    scene.couplings.expand(start, np.zeros(len(start)), np.zeros(len(start)))
    fit = solver.trial(start, solver.seen(shown(solver, q), t))
    unseen = solver.solver.cost.reached == 0.0
    assert unseen.any() and not unseen.all()
    at = solver.solver.cost.y_of_q[unseen]
    np.testing.assert_array_equal(fit.q[:, at], np.tile(start[at], (6, 1)))
    assert np.isinf(fit.loose[:, unseen]).all() and np.isfinite(fit.loose[:, ~unseen]).all()


def test_a_coordinate_task_weighs_as_opensim_defines_it():
    """Without markers a task is met; with weight w beside one hinge's markers f'= 0 by hand."""
    scene = leg()
    name = scene.couplings.independent[-1]
    joint = scene.robot.joint(name)
    alone = MarkerKinematics(scene.robot, scene.couplings, [], tasks={name: 2.0})
    t = np.array([0.0, 0.1])
    asked = {name: np.array([0.1, 0.2])}
    fit = alone.trial(scene.initial.q, alone.seen(np.zeros((2, 0, 3)), t, asked))
    np.testing.assert_allclose(fit.q[:, joint.q], asked[name], atol=1e-12)
    both = kinematics(scene, tasks={name: 0.02}, limits=False)
    seen = both.seen(shown(both, np.tile(scene.initial.q, (2, 1))), t, asked)
    found = both.trial(scene.initial.q, seen)
    weights = np.array([mark.weight for mark in both.marks])
    squares = (found.misses**2).sum(axis=2) @ weights / (2.0 * weights.sum())
    off = 0.02 * (found.q[:, joint.q] - asked[name]) ** 2 / 2.0
    np.testing.assert_allclose(found.objective, squares + off, rtol=1e-12)
    assert found.settled.all() and (found.q[:, joint.q] > 1e-3).all()


def test_nothing_to_fit_is_refused():
    scene = leg()
    with pytest.raises(ModelError, match="needs a marker"):
        MarkerKinematics(scene.robot, scene.couplings, [])


def table(path):
    """Names and numbers of a CSV."""
    with gzip.open(path, "rt") as file:
        names, *rows = csv.reader(file)
    return names, np.array(rows, dtype=np.float64)


def test_gait_is_the_exact_optimum_of_an_independent_program():
    """151 frames of planar gait, 31 markers that miss by 29 mm: objective 1e-9, joints 1e-6."""
    folder = RECORDINGS / "gait10dof/marker_ik"
    scene = mbd.load_scene(str(RECORDINGS / "gait10dof/walk" / "scene.yaml"))
    rows = list(csv.DictReader((folder / "model_markers.csv").open()))
    tasks = list(csv.DictReader((folder / "tasks.csv").open()))
    weights = {row["name"]: float(row["weight"]) for row in tasks if row["kind"] == "marker"}
    names, numbers = table(folder / "markers.csv.gz")
    used = [r for r in rows if r["marker"] in weights and f"{r['marker']}.x" in names]
    marks = [
        Mark(
            row["marker"],
            scene.robot.point(row["body"], [float(row[axis]) for axis in "xyz"]),
            weights[row["marker"]],
        )
        for row in used
    ]
    solver = MarkerKinematics(scene.robot, scene.couplings, marks, limits=False)
    at = [[names.index(f"{mark.label}.{axis}") for axis in "xyz"] for mark in marks]
    fit = solver.trial(scene.initial.q, solver.seen(numbers[:, at], numbers[:, 0]))
    joints, exact = table(folder / "ik_exact.csv.gz")
    total = sum(mark.weight for mark in marks)
    assert (fit.objective * 2.0 * total <= exact[:, -1] * (1.0 + 1e-9)).all()
    for column, name in enumerate(joints[1:-1], start=1):
        q = fit.q[:, scene.robot.joint(name.removesuffix(".position")).q]
        np.testing.assert_allclose(q, exact[:, column], atol=1e-6)
    assert len(marks) == 31 and fit.remainder.max() <= 1e-8


def test_exchanged_labels_are_found_where_they_are_and_nowhere_else():
    """Noise of 5 mm; a pair on one link and one on two links, each for a while."""
    scene = leg()
    solver, rng = kinematics(scene, limits=False), np.random.default_rng(7)
    t, q = motion(scene, 40)
    places = shown(solver, q) + 0.005 * rng.normal(size=(40, 12, 3))
    clean = solver.seen(places, t)
    assert not exchanged_labels(solver.solver, solver.trial(scene.initial.q, clean), clean)
    places[10:20, [6, 7]] = places[10:20, [7, 6]]
    places[25:38, [3, 9]] = places[25:38, [9, 3]]
    seen = solver.seen(places, t)
    found = exchanged_labels(solver.solver, solver.trial(scene.initial.q, seen), seen)
    assert [(one.first, one.second, one.frames) for one in found] == [
        (6, 7, (10, 19)),
        (3, 9, (25, 37)),
    ]
    assert all(one.after < 0.3 * one.before for one in found)


def test_smooth_motion_is_the_optimum_of_the_whole_trial():
    """Every slope of the sum of objectives and accelerations is 0; smoother than frames alone."""
    scene = leg()
    solver, rng = kinematics(scene, limits=False), np.random.default_rng(8)
    t, q = motion(scene, 25)
    t = t + 0.004 * rng.uniform(size=25)  # uneven times
    seen = solver.seen(shown(solver, q) + 0.01 * rng.normal(size=(25, 12, 3)), t)
    alone, s = solver.trial(scene.initial.q, seen), 1e-4
    fit = smooth_trial(solver.solver, alone, seen, s)
    cost = solver.solver.cost

    def whole(each):
        y = each[:, cost.y_of_q]
        rates = np.diff(y, axis=0) / np.diff(t)[:, None]
        a = 2.0 * np.diff(rates, axis=0) / (t[2:] - t[:-2])[:, None]
        return cost.at(each, seen).value.sum() + 0.5 * s**2 * (a**2).sum()

    assert whole(fit.q) < whole(alone.q)
    for k, j in [(0, 0), (1, 3), (12, 2), (24, 4)]:
        step = np.zeros((25, 5))
        step[k, j] = 1e-5
        slope = (whole(cost.moved(fit.q, step)) - whole(cost.moved(fit.q, -step))) / 2e-5
        assert abs(slope) < 1e-8
    both = [np.abs(np.diff(each.q - q, n=2, axis=0)).mean() for each in (fit, alone)]
    assert both[0] < 0.5 * both[1]
    none = smooth_trial(solver.solver, alone, seen, 0.0)
    np.testing.assert_allclose(none.q, alone.q, atol=1e-8)
