"""Payloads, friction and offsets of sensors as states of an estimator."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros import load_scene, scene_from
from mbd_ros.errors import SceneError
from mbd_ros.features.estimation.estimation import build_estimation, prepare_scene
from mbd_ros.features.estimation.task import EstimateTask
from mbd_ros.features.estimation.tracker import Tracker
from mbd_ros.files.table import MAIN, Column, Result, Table

STEP = 0.002


def names_of(scene):
    return [joint.name for joint in scene.robot.joints]


def rubbing(coulomb, viscous):
    friction = {
        **{"type": "joint_friction", "name": "knee_friction", "joint": "knee"},
        **{"coulomb": coulomb, "viscous": viscous},
    }
    start = {"position": {"knee": -1.0, "hip_flexion": 0.8}}
    return scene_from({"forces": [friction], "dt": 0.005, "initial": start}, urdf="prosthetic_leg")


def noisy(table, joints, rng, **offsets):
    """A recording of joint positions with 0.1 mrad of noise, and no efforts."""
    columns = [Column("time", table["time"], "s")]
    for joint in joints:
        values = table[f"{joint}.position"] + 1e-4 * rng.standard_normal(table.rows)
        columns.append(Column(f"{joint}.position", values + offsets.get(joint, 0.0), "rad"))
    return Result({MAIN: Table(columns)}, {})


def carrying(scene, link, mass):
    """The scene whose link has a point mass more at its origin, with efforts as inputs."""
    heavy = scene.robot.inertias()[link] + pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
    found = scene.with_inertias({link: (heavy.mass, heavy.lever, heavy.inertia)})
    return prepare_scene(found, EstimateTask(), ())


@pytest.mark.parametrize("kind", ["extended_kalman", "moving_horizon"])
def test_a_payload_is_found_within_two_seconds(kind):
    """1 kg in the hand of the 7-joint arm, by encoders at 500 Hz and the efforts of its drives."""
    base, samples = load_scene("arm7"), 1000 if kind == "extended_kalman" else 150
    link = base.robot.model.frames[-1].name
    estimator = {"type": kind} if kind == "extended_kalman" else {"type": kind, "samples": 5}
    task = EstimateTask(estimator, parameters={f"{link}.payload": 1.0}, limits=False)
    found = build_estimation(base, task, names_of(base), [])
    truth = carrying(base, link, 1.0)
    simulation, rng = truth.simulation(), np.random.default_rng(1)
    y = simulation.start(truth.initial)
    found.estimator.begin(found.process.start, found.prior, 0.0)
    tracker, at = Tracker(found.estimator, found.process.sensors), list(found.parameters.values())
    masses = []
    for k in range(1, samples + 1):
        u = 5.0 * np.sin(3.0 * k * STEP + np.arange(7)) * found.scale
        y = simulation.advance(y, u, k * STEP)
        tracker.add_sample(k * STEP, y.q + 1e-4 * rng.standard_normal(7), u)
        masses.append(tracker.belief.x.z[at][0])
    assert abs(masses[-1] - 1.0) <= 0.05 and abs(masses[0]) < 0.9
    assert tracker.restarts == 0 and not tracker.faults.active_faults()
    spread = np.sqrt(tracker.belief.P[-1, -1])
    assert abs(masses[-1] - 1.0) < 3.0 * spread < 0.15


def test_friction_of_a_joint_is_found():
    truth, rng = rubbing(0.4, 0.3), np.random.default_rng(2)
    recording = noisy(truth.simulate(2.0)[MAIN], ("hip_flexion", "knee", "ankle"), rng)
    asked = {"knee_friction.viscous": 0.3, "knee_friction.coulomb": 0.3}
    found = rubbing(0.1, 0.1).estimate(recording, parameters=asked)[MAIN]
    for name, true in (("viscous", 0.3), ("coulomb", 0.4)):
        value, spread = (found[f"knee_friction.{name}{end}"][-1] for end in ("", "_deviation"))
        assert abs(value - true) < 2.5 * spread < 0.2
    assert found.column("knee_friction.viscous").unit == "N·m·s/rad or N·s/m"


def test_the_offset_of_an_encoder_shows_where_others_know_better():
    """Three encoders determine a four-bar knee; a fourth one reads 20 mrad too much."""
    scene, rng = load_scene("four_bar_leg").with_(dt=0.01), np.random.default_rng(3)
    joints = ("hip_flexion", "knee_anterior", "knee_posterior", "ankle")
    recording = noisy(scene.simulate(0.5)[MAIN], joints, rng, knee_posterior=0.02)
    found = scene.estimate(recording, parameters={"knee_posterior.position.offset": 0.1})[MAIN]
    name = "knee_posterior.position.offset"
    assert found[name][-1] == pytest.approx(0.02, abs=5e-4)
    assert found[f"{name}_deviation"][-1] < 3e-4


def test_the_offset_of_a_gyroscope_shows_beside_encoders():
    gyro = {"type": "gyroscope", "frame": "shank", "offset": [0.1, -0.2, 0.05]}
    scene = scene_from({"sensors": {"gyro": gyro}}, urdf="prosthetic_leg")
    plain = scene.with_(sensors={"gyro": {**gyro, "offset": [0.0, 0.0, 0.0]}})
    found = build_estimation(
        plain, EstimateTask(parameters={"gyro.offset": 0.5}), ["hip_flexion", "knee", "ankle"], []
    )
    assert list(found.parameters) == [f"gyro.offset_{axis}" for axis in "xyz"]
    estimator, process = found.estimator, found.process
    estimator.begin(process.start, found.prior, 0.0)
    simulation, rng = scene.simulation(), np.random.default_rng(4)
    y = simulation.start(scene.initial)
    for k in range(1, 200):
        y = simulation.advance(y, None, k * STEP)
        x = simulation.system.expand(y)
        simulation.system.k.refresh(x.q, x.v)
        turning = scene.sensors[0].measure(simulation.system.k, x, None)
        angles = [x.q[scene.robot.joint(name).q] for name in ("hip_flexion", "knee", "ankle")]
        values = np.concatenate((turning + 0.01 * rng.standard_normal(3), angles))
        Tracker(estimator, process.sensors).add_sample(k * STEP, values, None)
    z = estimator.belief.x.z[list(found.parameters.values())]
    np.testing.assert_allclose(z, gyro["offset"], atol=0.005)


def differences(function, process, y, step, last=0):
    """Central ones, by all steps or by the last ones."""
    columns = []
    for d in step * np.eye(process.n)[-last:]:
        columns.append(function(process.plus(y, d)) - function(process.plus(y, -d)))
    return np.array(columns).T / (2.0 * step)


@pytest.mark.parametrize("name", ["leg", "four_bar_leg"])
def test_derivatives_by_unknown_numbers_are_those_of_motion_and_sensors(name):
    sensors = {"push": {"type": "accelerometer", "frame": "foot"}}
    scene = rubbing(0.0, 0.3) if name == "leg" else load_scene(name)
    scene = scene.with_(sensors=sensors)
    asked = {"foot.mass": 0.5, "shank.payload": 0.5, "push.offset": 0.1}
    if name == "leg":
        asked["knee_friction.viscous"] = 0.2
    found = build_estimation(scene, EstimateTask(parameters=asked), names_of(scene), [])
    process, rng = found.process, np.random.default_rng(5)
    y = process.plus(process.start, 0.1 * rng.random(process.n))
    seen = process.observe(y, None)
    values = differences(lambda x: process.sensors.values(x, None), process, y, 1e-5)
    size = 1.0 + np.abs(values).max()
    np.testing.assert_allclose(seen.H, values, rtol=0, atol=1e-4 * size)
    going = process.advance(y, None, y.t + 2e-6)
    nz = len(y.z)

    def moved(x):
        return process.minus(process.advance(x, None, y.t + 2e-6).x, going.x)

    after = differences(moved, process, y, 0.001, last=nz)
    moves, by_z = after[:-nz], going.F[:-nz, -nz:]
    size = np.maximum(np.abs(moves).max(axis=0), 1e-9)
    np.testing.assert_allclose(by_z / size, moves / size, rtol=0, atol=0.02)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        ({"knee_frict.viscous": 0.1}, "'knee_frict.viscous' cannot be estimated.*knee_friction"),
        ({"knee_friction.viscos": 0.1}, "'knee_friction.viscos' cannot.*viscous"),
        ({"fot.mass": 0.1}, "'fot.mass' cannot be estimated; accepted are foot"),
        ({"knee.position.offst": 0.1}, "knee.position.offset"),
        ({"foot.mass": 0.0}, "foot.mass: deviation is 0, but must be > 0"),
        ({"knee_friction.joint": 0.1}, "'knee_friction.joint' cannot"),
    ],
)
def test_numbers_that_nobody_can_estimate_are_named(parameters, said):
    scene = rubbing(0.1, 0.1)
    with pytest.raises(SceneError, match=said):
        build_estimation(scene, EstimateTask(parameters=parameters), names_of(scene), [])
