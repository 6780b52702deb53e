"""Estimators of mechanisms: tangents, derivatives, faults, recordings."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros import load_scene, scene_from
from mbd_ros.errors import DataError, SceneError, SolveError
from mbd_ros.features.estimation import tracker as tracker_module
from mbd_ros.features.estimation.estimation import build_estimation, prepare_scene
from mbd_ros.features.estimation.faults import FaultNaming
from mbd_ros.features.estimation.mechanism_process import MechanismProcess
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import LagWindow, SampleOutcome, Tracker
from mbd_ros.files.table import MAIN, Column, Result, Table
from mbd_ros.methods.estimation.horizon_chain import HorizonChain
from mbd_ros.methods.estimation.horizon_window import HorizonProgram
from mbd_ros.methods.estimation.kalman_filter import smooth_with_lag
from mbd_ros.methods.estimation.process import Measurement
from mbd_ros.parts.estimators.extended_kalman import ExtendedKalman
from mbd_ros.parts.estimators.moving_horizon import MovingHorizon

STEP = 0.002
IMUS = {
    "gyro": {"type": "gyroscope", "frame": "shank"},
    "push": {"type": "accelerometer", "frame": "foot", "xyz": [0.1, 0.0, -0.05]},
    "both": {"type": "imu", "frame": "socket"},
    "heel": {"type": "marker", "frame": "foot", "xyz": [-0.05, 0.0, 0.0]},
    "rate": {"type": "tachometer", "joint": "knee"},
}
FLYING = {
    "gyro": {"type": "gyroscope", "frame": "lower"},
    "both": {"type": "imu", "frame": "trunk", "xyz": [0.1, 0.0, 0.2]},
    "tip": {"type": "marker", "frame": "lower", "xyz": [0.0, 0.0, -0.4]},
    "corner": {"type": "marker", "frame": "box", "xyz": [0.05, 0.15, 0.25]},
}
SCENES = {
    "arm7": (lambda: load_scene("arm7"), 14),
    "coupled_leg": (lambda: scene_from({"sensors": IMUS}, urdf="prosthetic_leg"), 10),
    "sliding_knee": (lambda: load_scene("prosthetic_leg"), 6),
    "four_bar": (lambda: load_scene("four_bar_leg"), 6),
    "free_flyer": (lambda: load_scene("free_flyer").with_(sensors=FLYING), 40),
}


def prepared(name, **task):
    scene = SCENES[name][0]()
    joints = [joint.name for joint in scene.robot.joints]
    return build_estimation(scene, EstimateTask(**{"disturbance": (), **task}), joints, joints)


def moving(process, rng):
    """A state near the start that moves."""
    return process.plus(process.start, 0.3 * rng.standard_normal(process.n))


def differences(function, process, y, step=1e-5):
    columns = []
    for d in step * np.eye(process.n):
        columns.append(function(process.plus(y, d)) - function(process.plus(y, -d)))
    return np.array(columns).T / (2.0 * step)


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_are_those_of_motion_and_sensors(name):
    found, rng = prepared(name), np.random.default_rng(2)
    process: MechanismProcess = found.process
    assert process.n == SCENES[name][1]
    y = moving(process, rng)
    seen = process.observe(y, None)
    values = differences(lambda x: process.sensors.values(x, None), process, y)
    size = 1.0 + np.abs(values).max()
    np.testing.assert_allclose(seen.H, values, rtol=0, atol=2e-5 * size)
    going = process.advance(y, None, y.t + 2e-5)
    after = differences(
        lambda x: process.minus(process.advance(x, None, y.t + 2e-5).x, going.x), process, y
    )
    np.testing.assert_allclose(going.F, after, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", SCENES)
def test_steps_of_the_tangent_add_up(name):
    process, rng = prepared(name).process, np.random.default_rng(3)
    y = moving(process, rng)
    d = 1e-4 * rng.standard_normal(process.n)
    np.testing.assert_allclose(process.minus(process.plus(y, d), y), d, rtol=0, atol=1e-6)


def simulated(found, steps, rng=None, *, step=STEP):
    """States of a simulation, and what the sensors of the estimator see of them."""
    simulation, process = found.scene.simulation(), found.process
    y = simulation.start(found.scene.initial, None)
    noise = np.sqrt(process.sensors.covariance(y).diagonal())
    for k in range(1, steps + 1):
        y = simulation.advance(y, None, k * step)
        values = process.sensors.values(y, None)
        if rng is not None:
            values = values + noise * rng.standard_normal(len(noise))
        yield k * step, y, values


def tracked(found, **options):
    estimator = found.estimator
    estimator.begin(found.process.start, found.prior, 0.0)
    return Tracker(estimator, found.process.sensors, **options)


@pytest.mark.parametrize("name", ["arm7", "sliding_knee", "four_bar"])
def test_a_horizon_that_no_bound_touches_is_the_filter(name):
    found, rng = prepared(name, limits=False), np.random.default_rng(4)
    horizon = MovingHorizon(found.process, samples=5, iterations=2)
    states = []
    for estimator in (found.estimator, horizon):
        estimator.begin(found.process.start, 1e-4 * found.prior, 0.0)
    for t, _, values in simulated(found, 15, rng):
        for estimator in (found.estimator, horizon):
            estimator.predict(None, t)
            estimator.correct(Measurement(t, values))
        states.append(found.process.minus(horizon.belief.x, found.estimator.belief.x))
    deviation = np.sqrt(horizon.belief.P.diagonal())
    assert np.abs(np.array(states) / deviation).max() < 0.02


def test_limits_hold_where_the_filter_breaks_them():
    """A leg that rests at the stop of its knee: noise takes the filter beyond it."""
    rng, upper = np.random.default_rng(5), None
    worst = {}
    for kind in ("extended_kalman", "moving_horizon"):
        scene = load_scene("prosthetic_leg")
        upper = scene.robot.joint("knee").upper
        start = {"position": {"knee": upper}}
        scene = scene.with_(initial=start, robot={**scene.entries["robot"], "gravity": [0, 0, 0]})
        task = EstimateTask({"type": kind}, position_noise=0.01)
        found = build_estimation(scene, task, ["hip_flexion", "knee", "ankle"], [])
        estimator = found.estimator
        estimator.begin(found.process.start, 0.01 * found.prior, 0.0)
        at = scene.robot.joint("knee").q
        over = []
        for k in range(1, 60):
            estimator.predict(None, k * 0.01)
            values = found.process.sensors.values(found.process.start, None)
            noisy = values + 0.01 * rng.standard_normal(len(values))
            belief = estimator.correct(Measurement(k * 0.01, noisy))
            x = found.process.simulation.system.expand(belief.x)
            over.append(x.q[at] - upper)
        worst[kind] = max(over)
    assert worst["extended_kalman"] > 1e-3
    assert worst["moving_horizon"] <= 1e-9


@pytest.mark.parametrize(("name", "step"), [("arm7", 0.002), ("sliding_knee", 0.033)])
def test_an_unknown_effort_is_found_within_a_fifth_of_a_second(name, step):
    found, rng = prepared(name, disturbance=None), np.random.default_rng(6)
    tracker, process = tracked(found), found.process
    at = [found.scene.robot.joint(joint).v for joint in found.disturbed]
    planted = 10.0 * found.scale[at]
    simulation = found.scene.simulation()
    y = simulation.start(found.scene.initial, None)
    begin = round(0.3 / step)
    errors = []
    for k in range(1, begin + round(0.6 / step)):
        if k == begin:
            x = simulation.system.expand(y)
            y = simulation.start(x._replace(z=planted), None)
        y = simulation.advance(y, None, k * step)
        values = process.sensors.values(y, None)
        noise = np.sqrt(process.sensors.covariance(y).diagonal())
        tracker.add_sample(k * step, values + noise * rng.standard_normal(len(values)), None)
        if k * step > (begin + 1) * step + 0.2:
            x = process.simulation.system.expand(tracker.belief.x)
            errors.append(np.abs(found.unknown_efforts(x) / planted - 1.0))
    assert np.median(errors, axis=0).max() <= 0.05
    assert tracker.restarts == 0 and not tracker.faults.active_faults()


def test_late_samples_go_where_they_belong():
    found, rng = prepared("sliding_knee"), np.random.default_rng(7)
    samples = [(t, v) for t, _, v in simulated(found, 60, rng)]
    tracker = tracked(found)
    for t, values in samples:
        tracker.add_sample(t, values, None)
    expected = tracker.belief
    order = np.arange(60)
    for k in range(0, 50, 7):  # 6 .. 25 samples late
        order[k : k + 10] = order[k : k + 10][np.r_[1:10, 0]]
    tracker = tracked(found)
    taken = [tracker.add_sample(*samples[k], None) for k in order]
    late = sum(k < max(order[: i + 1]) for i, k in enumerate(order))
    assert taken.count(SampleOutcome.PLACED) == late > 5 and tracker.belief.t == expected.t
    assert np.array_equal(tracker.belief.x.q, expected.x.q)
    assert np.array_equal(tracker.belief.P, expected.P)
    assert tracker.add_sample(-1.0, samples[0][1], None) is SampleOutcome.OLD


def test_estimates_that_wait_are_those_of_the_smoother_with_that_lag():
    """Each comes once, in the order of time, also where samples come in another one."""
    found, rng, lag = prepared("sliding_knee"), np.random.default_rng(7), 6.0 * STEP
    samples = [(t, v) for t, _, v in simulated(found, 40, rng)]
    tracker, filtered = tracked(found), []
    for t, values in samples:
        tracker.add_sample(t, values, None)
        filtered.append(found.estimator.sample)
    expected = smooth_with_lag(found.process, filtered, lag + 1e-6)
    order = np.arange(40)
    order[10:14], order[20:25] = order[[11, 12, 13, 10]], order[[21, 22, 23, 24, 20]]
    told = waited(found, [samples[k] for k in order], lag)
    assert [one.t for one in told] == [one.t for one in expected[:34]]
    without = {*range(4, 8), *range(14, 19)}  # of a sample that was still missing, 10 or 20
    for k, (one, other) in enumerate(zip(told, expected, strict=False)):
        assert np.array_equal(one.x.q, other.x.q) is (k not in without)
        assert np.array_equal(one.P, other.P) is (k not in without)
    odd = np.arange(len(samples[0][1])) % 2 == 1
    halves = [(t, np.where(odd == i, v, np.nan)) for t, v in samples for i in (True, False)]
    once = waited(found, halves, lag)
    assert [one.t for one in once] == [one.t for one in told]
    assert np.abs(once[20].x.q - told[20].x.q).max() < 2e-5


def waited(found, samples, lag):
    """Beliefs of samples that have waited for a lag."""
    tracker, told = tracked(found), []
    tracker.window = LagWindow(found.process, lag)
    for t, values in samples:
        tracker.add_sample(t, values, None)
        told += [one.belief for one in tracker.window.due()]
    return told


@pytest.mark.parametrize("kind", ["extended_kalman", "moving_horizon"])
def test_faults_are_named_and_errors_stay_bounded(kind):
    """30 % dropouts all the time; one encoder freezes, another one jumps, and both recover."""
    task = {"type": kind} if kind == "extended_kalman" else {"type": kind, "samples": 8}
    scene = load_scene("prosthetic_leg")
    joints = "knee", "ankle"
    sensors = {f"second_{joint}": {"type": "encoder", "joint": joint} for joint in joints}
    scene = scene.with_(sensors=sensors)
    found = build_estimation(scene, EstimateTask(task, limits=False), ["hip_flexion"], [])
    more = [*found.process.sensors.names]
    tracker, rng = tracked(found), np.random.default_rng(8)
    seen, frozen, errors = set(), None, []
    for k, (t, y, values) in enumerate(simulated(found, 500, rng)):
        values[rng.random(len(values)) < 0.3] = np.nan
        if 100 <= k < 200:
            frozen = values[0] if frozen is None and np.isfinite(values[0]) else frozen
            values[0] = values[0] if frozen is None else frozen
        if 300 <= k < 320:
            values[1] += 0.2
        tracker.add_sample(t, values, None)
        seen |= {
            (name, what.split(" ")[0]) for name, what in tracker.faults.active_faults().items()
        }
        errors.append(np.abs(found.process.minus(y, tracker.belief.x)[:3]).max())
    assert (more[0], "frozen") in seen
    assert max(errors[20:]) < 0.3 and max(errors[450:]) < 2e-3
    assert not tracker.faults.active_faults()


def recorded(result, keep):
    table = result[MAIN]
    return Result({MAIN: Table([c for c in table.columns if c.name in ("time", *keep)])}, {})


def test_a_recording_of_some_joints_gives_all_of_a_loop():
    scene = load_scene("four_bar_leg")
    run = scene.simulate(0.4)
    given = ("hip_flexion.position", "knee_anterior.position", "ankle.position")
    found = scene.estimate(recorded(run, given))
    for name in ("knee_posterior.position", "knee_tibial.velocity"):
        np.testing.assert_allclose(found[MAIN][name], run[MAIN][name], rtol=0, atol=1e-9)
    name = "shank_loop_closure.force_z"
    np.testing.assert_allclose(found[MAIN][name], run[MAIN][name], rtol=0, atol=1e-7)
    assert np.isfinite([found[MAIN][name] for name in found[MAIN]]).all()
    assert set(found["innovations"]) == {"time", *given, "nis"}


def test_the_smoother_is_nearer_than_the_filter():
    """By noisy positions at 100 Hz, velocities of the smoother are the better ones."""
    scene = load_scene("prosthetic_leg").with_(dt=0.01)
    run, rng = scene.simulate(1.0), np.random.default_rng(9)
    table = run[MAIN]
    noisy = [Column("time", table["time"], "s")]
    for joint in ("hip_flexion", "knee", "ankle"):
        values = table[f"{joint}.position"] + 0.002 * rng.standard_normal(table.rows)
        noisy.append(Column(f"{joint}.position", values, "rad"))
    task = EstimateTask(position_noise=0.002, disturbance=None)
    found = scene.estimate(Result({MAIN: Table(noisy)}, {}), task=task)
    error = found[MAIN]["knee.velocity"] - table["knee.velocity"]
    spread = found[MAIN]["knee.velocity_deviation"]
    assert np.sqrt(np.mean(error[5:] ** 2)) < 0.1
    assert 0.3 < np.mean(np.abs(error[5:] / spread[5:]) < 1.96) <= 1.0


def test_bad_recordings_and_tasks_are_named(tmp_path):
    scene = load_scene("prosthetic_leg")
    empty = Result({MAIN: Table([Column("time", np.arange(3.0), "s")])}, {})
    with pytest.raises(SceneError, match="nothing is measured"):
        scene.estimate(empty)
    table = Table([Column("time", np.arange(3.0)), Column("knee.position", np.zeros(3))])
    with pytest.raises(SceneError, match="elbow"):
        scene.estimate(Result({MAIN: table}, {}), disturbance=("elbow",))
    task = tmp_path / "task.yaml"
    task.write_text("estimate: {estimator: {type: extended_kalmann}}\n")
    with pytest.raises(SceneError, match="extended_kalman"):
        scene.estimate(Result({MAIN: table}, {}), task=task)
    task.write_text("estimate: {model_nois: 1.0}\n")
    with pytest.raises(SceneError, match="model_nois"):
        scene.estimate(Result({MAIN: table}, {}), task=task)
    with pytest.raises(DataError):
        scene.estimate(tmp_path / "nothing.csv")


def test_a_late_horizon_gives_way_to_the_filter():
    found = prepared("sliding_knee", estimator={"type": "moving_horizon", "samples": 5})
    tracker = tracked(found)
    for k, (t, _, values) in enumerate(simulated(found, 10, np.random.default_rng(1))):
        found.estimator.is_late = k == 7
        tracker.add_sample(t, values, None)
        assert tracker.belief.is_trusted is (k != 7)
    assert isinstance(prepared("sliding_knee").estimator, ExtendedKalman)


@pytest.mark.parametrize("late", ["always", "in turns"])
def test_a_horizon_without_time_follows_the_motion_as_the_filter_does(late):
    """Alone, the filter is the extended Kalman filter; windows begin again from what it left."""
    kinds = {"type": "moving_horizon", "samples": 5}, {"type": "extended_kalman"}
    horizon, filtered = (prepared("sliding_knee", estimator=k, limits=False) for k in kinds)
    one, other = tracked(horizon), tracked(filtered)
    for k, (t, _, values) in enumerate(simulated(horizon, 60, np.random.default_rng(1))):
        horizon.estimator.is_late = late == "always" or (k // 10) % 2 == 1
        one.add_sample(t, values, None)
        other.add_sample(t, values, None)
        apart = horizon.process.minus(one.belief.x, other.belief.x)
        deviations = np.sqrt(other.belief.P.diagonal())
        assert np.abs(apart).max() < 1e-9 or late == "in turns"
        assert (np.abs(apart) < 0.1 * deviations).all()


@pytest.mark.parametrize("kind", ["extended_kalman", "moving_horizon"])
@pytest.mark.parametrize("gap", [0.15, 0.3, 0.6, 5.0])
def test_an_arm_that_was_not_seen_for_a_while_is_followed_again_at_once(gap, kind):
    """What the drives did in the gap is not known; two samples later the arm is found again."""
    found = estimated_arm(kind)
    tracker, rng, end = tracked(found), np.random.default_rng(5), 0.4 + gap
    seen = (k * STEP for k in range(round((end + 0.05) / STEP)))
    for t in (t for t in seen if t < 0.4 or t > end):
        q, v, tau = swung(found.scene.robot.model, t)
        tracker.add_sample(t, q + 1e-4 * rng.standard_normal(7), tau)
        if t > end + 2.5 * STEP:
            x = tracker.belief.x
            assert np.abs(x.q - q).max() < 1e-3
            assert np.abs(x.v - v).max() < 0.3
    assert tracker.restarts == 0


def estimated_arm(kind):
    """The 7-joint arm with encoders and seven unknown efforts."""
    task, scene = EstimateTask({"type": kind}, disturbance=None), load_scene("arm7")
    return build_estimation(scene, task, [joint.name for joint in scene.robot.joints], [])


def swung(model, t):
    """A motion of the arm within its limits, and its torques half a sample earlier."""
    w = 2.0 * np.pi * np.linspace(0.1, 0.3, 7)

    def at(t):
        return 0.8 * np.sin(w * t), 0.8 * w * np.cos(w * t), -0.8 * w * w * np.sin(w * t)

    tau = pin.rnea(model, model.createData(), *at(t - 0.5 * STEP))
    return *at(t)[:2], np.array(tau)


def test_limits_that_measurements_contradict_are_given_up_by_name():
    """An elbow that stands 0.2 rad beyond the limit of its URDF, and comes back."""
    found = estimated_arm("moving_horizon")
    tracker, robot, names = tracked(found), found.scene.robot, found.process.bounded_names
    upper, rng = robot.model.upperPositionLimit, np.random.default_rng(2)
    for k in range(1, 61):
        q = np.where(np.arange(7) == 3, upper + (0.2 if k < 31 else -0.2), 0.0)
        if k == 31:
            assert [names[i] for i in found.estimator.given_up] == ["joint4.position"]
            assert tracker.belief.x.q[3] == pytest.approx(upper[3] + 0.2, abs=1e-3)
            found.estimator.begin(tracker.belief.x._replace(q=q), found.prior, (k - 1) * STEP)
        tau = np.array(pin.rnea(robot.model, robot.model.createData(), q, 0.0 * q, 0.0 * q))
        tracker.add_sample(k * STEP, q + 1e-4 * rng.standard_normal(7), tau)
    assert not found.estimator.given_up


@pytest.mark.parametrize("wrist", ["known at the start", "locked"])
def test_two_encoders_of_a_coupled_arm_show_the_torque_of_a_push(wrist):
    """On the elbow, which follows the shoulder by its tendon, and on the abduction beside it.

    No encoder sees the wrist. The unknown torques are known to 5 % after 0.2 s.
    """
    scene, step, rng = load_scene("prosthetic_arm"), 0.002, np.random.default_rng(11)
    scene, prior = scene.with_(initial={"position": {"shoulder_flexion": 0.4}}), 1e-6
    if wrist == "locked":
        locked, prior = {"wrist_rotation": 0.0, "wrist_flexion": 0.0}, 1.0
        scene = scene.with_(robot={**scene.entries["robot"], "locked": locked})
    pushed = ("shoulder_flexion", "shoulder_abduction")
    task = EstimateTask(disturbance=pushed)
    found = build_estimation(scene, task, ["elbow", "shoulder_abduction"], [])
    assert found.process.sensors.m == 2 and "elbow" in scene.couplings.dependent
    simulation, process = found.scene.simulation(), found.process
    found.estimator.begin(process.start, prior * found.prior, 0.0)
    tracker = Tracker(found.estimator, process.sensors)
    y = simulation.start(found.scene.initial, None)
    planted = 10.0 * found.scale[[scene.robot.joint(name).v for name in pushed]]
    errors = []
    for k in range(1, 280):
        if k == 100:
            x = simulation.system.expand(y)
            y = simulation.start(x._replace(z=planted), None)
        y = simulation.advance(y, None, k * step)
        values = process.sensors.values(y, None) + 1e-4 * rng.standard_normal(2)
        tracker.add_sample(k * step, values, None)
        if k >= 200:
            x = process.simulation.system.expand(tracker.belief.x)
            errors.append(np.abs(found.unknown_efforts(x) / planted - 1.0))
    assert np.median(errors, axis=0).max() <= 0.05
    assert tracker.restarts == 0 and not tracker.faults.active_faults()


def beyond_limits(joints, x):
    """The most by which a joint is outside of its limits, in position or velocity."""
    found = []
    for joint in joints:
        q, v = x.q[joint.q], abs(x.v[joint.v])
        found += [joint.lower - q, q - joint.upper, v - joint.max_velocity]
    return max(found)


def test_a_coupled_arm_keeps_its_limits_where_the_filter_breaks_them():
    """It rests with the shoulder at its stop and the elbow, which follows, at its own."""
    rng, worst = np.random.default_rng(12), {}
    scene = load_scene("prosthetic_arm")
    robot = {**scene.entries["robot"], "gravity": [0, 0, 0]}
    scene = scene.with_(initial={"position": {"shoulder_flexion": -0.1}}, robot=robot)
    q = scene.system().expand(scene.simulation().start(scene.initial)).q
    true = np.array([q[scene.robot.joint(name).q] for name in ("elbow", "shoulder_abduction")])
    assert true[0] == pytest.approx(0.0, abs=1e-12)
    for kind in ("extended_kalman", "moving_horizon"):
        estimator = {"type": kind} | ({"samples": 6} if kind == "moving_horizon" else {})
        task = EstimateTask(estimator, position_noise=0.002)
        found = build_estimation(scene, task, ["elbow", "shoulder_abduction"], [])
        tracker, over, joints = tracked(found), [], scene.robot.joints
        for k in range(1, 40):
            tracker.add_sample(k * 0.01, true + 0.002 * rng.standard_normal(2), None)
            x = found.process.simulation.system.expand(tracker.belief.x)
            over.append(beyond_limits(joints, x))
        worst[kind] = max(over)
    assert worst["extended_kalman"] > 1e-3
    assert worst["moving_horizon"] <= 1e-9


def test_a_chain_finds_the_optimum_of_the_whole_program():
    """Beside the dense program of the same window, with bounds that act at its newest node."""
    found, rng = prepared("arm7"), np.random.default_rng(13)
    process, none = found.process, np.full(found.process.nw, np.inf)
    horizon = MovingHorizon(process, samples=6)
    horizon.begin(process.start, 1e-4 * found.prior, 0.0)
    chain, program = HorizonChain(process, -none, none), HorizonProgram(process, -none, none)
    acting = []
    for t, y, values in simulated(found, 20, rng):
        horizon.predict(None, t)
        horizon.correct(Measurement(t, values))
        true, room = process.bounds(y).values, np.repeat((1e-4, 0.01), 7)
        nodes = []
        for node in horizon._nodes:
            bounds = process.bounds(node.x)._replace(can_be_released=None)
            if node is horizon._nodes[-1]:
                bounds = bounds._replace(lower=true - 0.1 * room, upper=true + room)
            nodes.append(replace(node, bounds=bounds))
        ours, theirs = (one.solve(nodes, horizon._arrival_cost()) for one in (chain, program))
        size = np.sqrt(theirs.P.diagonal())
        assert (np.abs(ours.steps - theirs.steps) / size).max() < 1e-7
        acting.append(ours.active)
        assert ours.active == theirs.active
    assert max(acting) > 3


def test_estimates_with_a_lag_stand_between_filter_and_smoother():
    """An effort that nobody knows and that swings at 1 Hz, by encoders at 100 Hz."""
    scene, rng = load_scene("prosthetic_leg").with_(dt=0.01), np.random.default_rng(14)
    simulation = prepare_scene(scene, EstimateTask(disturbance=("knee",)), ("knee",)).simulation()
    x, rows = scene.initial, []
    unknown = 5.0 * np.sin(2.0 * np.pi * np.arange(120) * 0.01)
    y = simulation.start(x._replace(z=np.array([0.0])), None)
    for k, effort in enumerate(unknown):
        now = simulation.system.expand(y)
        rows.append([now.q[scene.robot.joint(n).q] for n in ("hip_flexion", "knee", "ankle")])
        y = simulation.start(now._replace(z=np.array([effort])), None)
        y = simulation.advance(y, None, (k + 1) * 0.01)
    values = np.transpose(rows) + 1e-4 * rng.standard_normal((3, 120))
    columns = [Column("time", np.arange(120) * 0.01, "s")]
    pairs = zip(("hip_flexion", "knee", "ankle"), values, strict=True)
    columns += [Column(f"{name}.position", row, "rad") for name, row in pairs]
    recording, off = Result({MAIN: Table(columns)}, {}), {}
    for lag, drifting in ((0.0, False), (0.0, True), (0.03, True), (None, True)):
        task = {"disturbance": ("knee",), "drifting": drifting, "disturbance_noise": 100.0}
        found = scene.estimate(recording, lag=lag, **task)[MAIN]
        error = found["disturbance.knee"] - unknown
        off[lag, drifting] = float(np.sqrt(np.mean(error[30:90] ** 2)))
    assert off[0.0, True] > 1.2 * off[0.03, True] > 1.2 * off[None, True]
    assert off[None, True] < 0.5 < off[0.0, False]


def test_a_tracker_remembers_so_many_samples_and_a_window_lets_the_oldest_go(monkeypatch):
    """Samples of one moment never leave by their age."""
    monkeypatch.setattr(tracker_module, "MOST_SAMPLES", 20)
    found = prepared("four_bar")
    tracker, values = tracked(found, memory=1.0), np.full(found.process.sensors.m, np.nan)
    tracker.window = LagWindow(found.process, 1.0)
    told = []
    for k in range(1, 31):
        assert tracker.add_sample(1e-3 * k, values, None) is SampleOutcome.USED
        told += tracker.window.due()
    assert [delayed.belief.t for delayed in told] == [1e-3 * k for k in range(1, 11)]
    assert tracker.add_sample(5.5e-3, values, None) is SampleOutcome.OLD
    assert tracker.add_sample(25.5e-3, values, None) is SampleOutcome.PLACED
    tracker.is_hurried = True
    assert tracker.add_sample(28.5e-3, values, None) is SampleOutcome.OLD


def test_an_interval_that_is_too_long_is_not_simulated():
    found = prepared("four_bar")
    tracker = tracked(found, longest=0.5)
    values = found.process.sensors.values(found.process.start, None)
    tracker.add_sample(1e9, values, None)  # 30 years: simulating them would not end
    assert tracker.belief.t == 1e9
    assert np.isfinite(tracker.belief.P).all()


def test_a_measurement_that_is_too_far_away_is_refused():
    found = prepared("four_bar")
    values = found.process.sensors.values(found.process.start, None)
    far = np.where(np.arange(len(values)) == 0, 1e6, values)
    with pytest.raises(SolveError, match=r"e\+0. rad or m away from the state, but at most 1000"):
        found.process.fit_state(found.process.start, far, found.prior)


def test_an_innovation_that_is_not_finite_says_nothing():
    found = prepared("four_bar")
    tracker = tracked(found)
    values = found.process.sensors.values(found.process.start, None)
    tracker.add_sample(1e-3, values, None)
    innovation, before = tracker.belief.innovation, tracker.watch.consistency()
    tracker.watch.add(innovation._replace(squared=np.inf))
    assert tracker.watch.consistency() == before


def test_samples_of_one_moment_are_one_to_the_naming_of_faults():
    found = prepared("arm7")
    naming = FaultNaming(found.process.simulation.system, {}, np.array([0]))
    for _ in range(5):
        naming.add(found.process.start, None, np.ones(1), np.ones(1))
    assert len(naming._samples) == 1
