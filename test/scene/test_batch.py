"""Many runs of a scene side by side: each is the run alone."""

import platform

import numpy as np
import pinocchio
import pytest

from mbd_ros.api import load_scene
from mbd_ros.compiled.runs import lane_method
from mbd_ros.errors import DivergedError, SceneError
from mbd_ros.parts.actuators.series_elastic_drive import SeriesElasticDrive
from mbd_ros.scene.runs.batch import Starts

SWING = "package://mbd_ros/config/scenes/benchmark/arm7_swing.yaml"
LOOPS = "package://mbd_ros/config/scenes/benchmark/a02_four_bars_2.yaml"
COUPLED = "package://mbd_ros/config/scenes/benchmark/arm7_swing_coupled.yaml"
METHODS = {
    "rk4": 1e-3,
    "dopri5": 1e-3,
    "dop853": 2e-3,
    "adams": 1e-3,
    "semi_implicit_euler": 1e-3,
}


def starts(scene, n, spread=0.1, seed=3):
    """Configurations and velocities around those of the scene."""
    rng = np.random.default_rng(seed)
    x = scene.initial
    return [one + rng.normal(0.0, spread, (n, len(one))) for one in (x.q, x.v)]


def alone(scene, q, v, duration, **options):
    """The run of one start on the plain tier."""
    simulation = scene.simulation(solver={"type": "plain"}, **options)
    return simulation.sampled(scene.initial._replace(q=q, v=v), duration)


@pytest.fixture(scope="module")
def swing():
    return load_scene(SWING)


@pytest.mark.parametrize("kind", METHODS)
def test_each_run_is_the_run_alone(swing, kind):
    """As many runs as fill no vector; the last interval is shorter."""
    options = {"integrator": {"type": kind}, "dt": METHODS[kind]}
    batch = swing.batch(11, solver={"type": "compiled"}, threads=2, **options)
    q, v = starts(swing, 11)
    found = batch.run(0.1005, q, v)
    assert batch.is_side_by_side and not found.failures
    for i in (0, 7, 8, 10):
        expected = alone(swing, q[i], v[i], 0.1005, **options)
        assert found.states[i].shape == expected.shape
        assert np.abs(found.states[i] - expected).max() < 1e-11
    assert (found.known == found.states.shape[1]).all()


def test_one_run_and_many_threads_give_the_same_bits(swing):
    options = {"integrator": {"type": "rk4"}, "dt": 1e-3}
    q, v = starts(swing, 37)
    runs = [swing.batch(37, threads=n, **options).run(0.02, q, v).states for n in (1, 4)]
    assert np.array_equal(*runs)
    single = swing.batch(1, **options).run(0.02, q[5:6], v[5:6]).states
    assert np.array_equal(single[0], runs[0][5])


@pytest.mark.parametrize(
    ("path", "options"),
    [(LOOPS, {"integrator": {"type": "rk4"}}), (COUPLED, {"integrator": {"type": "dop853"}})],
)
def test_rows_and_couplings_are_kept_in_each_run(path, options):
    scene = load_scene(path)
    options = {"dt": 2e-3, **options}
    batch = scene.batch(5, solver={"type": "compiled"}, **options)
    q, v = starts(scene, 5, 1e-2)
    found = batch.run(0.1, q, v)
    assert batch.is_side_by_side and not found.failures
    for i in range(5):
        expected = alone(scene, q[i], v[i], 0.1, **options)
        assert np.abs(found.states[i] - expected).max() < 1e-10


def test_runs_with_a_tolerance_are_compiled_one_by_one(swing):
    batch = swing.batch(2, solver={"type": "compiled"}, dt=2e-3)
    q, v = starts(swing, 2)
    found = batch.run(0.05, q, v)
    assert not batch.is_side_by_side and "tolerance" in batch.how
    assert np.abs(found.states[1] - alone(swing, q[1], v[1], 0.05, dt=2e-3)).max() < 1e-11


LEG = {
    "robot": {"urdf": "prosthetic_leg.urdf"},
    "forces": [
        {"type": "joint_spring", "joint": "ankle", "stiffness": 30.0, "damping": 0.5},
        {"type": "joint_spring", "joint": "knee", "stiffness": 20.0},
    ],
    "actuators": [
        {"type": "geared_motor", "joint": "hip_flexion", "ratio": 50.0, "rotor_inertia": 1e-5}
    ],
    "integrator": {"type": "rk4"},
    "dt": 1e-3,
}
NAMES = ("ankle_joint_spring.stiffness", "hip_flexion_geared_motor.rotor_inertia")


def with_parameters(**options):
    scene = load_scene("prosthetic_leg").with_(**{k: v for k, v in LEG.items() if k != "robot"})
    return scene, scene.batch(9, parameters=NAMES, **options)


@pytest.mark.parametrize("solver", ["compiled", "plain"])
def test_numbers_of_parts_vary_by_run(solver):
    scene, batch = with_parameters(solver={"type": solver})
    q, v = starts(scene, 9)
    p = np.column_stack((np.linspace(10.0, 90.0, 9), np.linspace(0.0, 4e-5, 9)))
    found = batch.run(0.05, q, v, parameters=p)
    assert batch.is_side_by_side == (solver == "compiled") and not found.failures
    for i in (0, 4, 8):
        other = scene.with_(dict(zip(NAMES, p[i].tolist(), strict=True)))
        assert np.abs(found.states[i] - alone(other, q[i], v[i], 0.05)).max() < 1e-11
    assert np.abs(found.states[0] - found.states[8]).max() > 1e-3


def test_a_number_that_no_part_takes_is_named_with_its_run():
    _, batch = with_parameters()
    p = np.full((9, 2), 1.0)
    p[3, 0] = -1.0
    with pytest.raises(SceneError, match=r"run 3: .*stiffness: -1 is out of range"):
        batch.run(0.01, parameters=p)


@pytest.mark.parametrize("solver", ["compiled", "plain"])
def test_a_run_that_diverges_leaves_the_others_alone(swing, solver):
    options = {"integrator": {"type": "rk4"}, "dt": 1e-3}
    batch = swing.batch(9, solver={"type": solver}, **options)
    q, v = starts(swing, 9)
    v[4] *= 1e150
    found = batch.run(0.02, q, v)
    assert list(found.failures) == [4] and isinstance(found.failures[4], DivergedError)
    assert "joint" in str(found.failures[4]) and found.known[4] < 21
    assert np.isnan(found.states[4, found.known[4] :]).all()
    for i in (3, 5, 8):
        assert np.abs(found.states[i] - alone(swing, q[i], v[i], 0.02, **options)).max() < 1e-12


def test_arrays_that_do_not_fit_are_named(swing):
    with pytest.raises(SceneError, match="batch: expected a number of runs > 0, got 0"):
        swing.batch(0)
    batch = swing.batch(3, solver={"type": "plain"}, dt=1e-3)
    with pytest.raises(SceneError, match=r"positions: shape \(2, 7\), expected \(3, 7\)"):
        batch.run(0.1, np.zeros((2, 7)))
    with pytest.raises(SceneError, match="velocities of run 1 are not finite"):
        batch.run(0.1, velocities=np.array([[0.0] * 7, [np.nan] * 7, [0.0] * 7]))


@pytest.mark.parametrize(("lanes", "word"), [(2, "-mno-avx"), (4, "-mno-avx512f")])
def test_older_processors_give_each_run_too(swing, monkeypatch, lanes, word):
    """The compiler is kept from instructions that SSE2 and AVX2 do not have."""
    monkeypatch.setenv("CC", f"cc {word}" if platform.machine() == "x86_64" else "cc")
    monkeypatch.setattr(lane_method, "lanes", lambda: lanes)
    options = {"integrator": {"type": "rk4"}, "dt": 1e-3}
    batch = swing.batch(5, solver={"type": "compiled"}, **options)
    assert batch.how == f"compiled, {lanes} runs an instruction"
    q, v = starts(swing, 5)
    v[4] *= 1e150
    found = batch.run(0.02, q, v)
    assert list(found.failures) == [4]
    for i in range(4):
        expected = alone(swing, q[i], v[i], 0.02, **options)
        assert np.abs(found.states[i] - expected).max() < 1e-11


def test_free_bodies_turn_in_each_run():
    scene = load_scene("free_flyer")
    options = {"integrator": {"type": "rk4"}, "dt": 2e-3}
    batch = scene.batch(3, solver={"type": "compiled"}, **options)
    rng = np.random.default_rng(5)
    v = rng.normal(0.0, 1.0, (3, scene.robot.model.nv))
    q = np.array([pinocchio.integrate(scene.robot.model, scene.initial.q, 0.3 * w) for w in v])
    found = batch.run(0.1, q, v)
    assert batch.is_side_by_side and not found.failures
    for i in range(3):
        expected = alone(scene, q[i], v[i], 0.1, **options)
        assert np.abs(found.states[i] - expected).max() < 1e-11


def test_internal_states_start_and_end_as_in_runs_alone():
    """Given ones, and those that are left open."""
    drive = {"type": "series_elastic_drive", **SeriesElasticDrive.example, "joint": "joint2"}
    scene = load_scene(SWING).with_(actuators=[drive])
    options = {"integrator": {"type": "rk4"}, "dt": 1e-3}
    batch = scene.batch(3, solver={"type": "compiled"}, **options)
    z = np.random.default_rng(2).normal(0.0, 0.1, (3, scene.internals.nz))
    z[2] = np.nan
    assert z.size
    found = batch.run(0.03, internals=z)
    assert batch.is_side_by_side and not found.failures
    simulation = scene.simulation(solver={"type": "plain"}, **options)
    for i in range(3):
        expected = simulation.sampled(scene.initial._replace(z=z[i]), 0.03)
        assert np.abs(found.states[i] - expected).max() < 1e-11 * np.abs(expected).max()


def test_a_run_near_dependent_rows_goes_to_the_plain_tier():
    """A threshold between the healths of two runs stands for a toggle that one of them passes."""
    scene = load_scene(LOOPS)
    options = {"integrator": {"type": "rk4"}, "dt": 2e-3}
    batch = scene.batch(4, solver={"type": "compiled"}, **options)
    q, v = starts(scene, 4, 0.05)
    before = batch.run(0.1, q, v)
    lanes = batch._lanes
    known = []
    for least in np.geomspace(1e-3, 1.0, 40):
        lanes._options.value.least_health = least
        due = before.states[0, :, 0]
        y = batch._begun([scene] * 4, Starts(q, v, np.zeros((4, 0))), 0.0, {})
        known = lanes.samples(y, np.zeros((4, 0)), due, 1).known
        if (known < len(due)).any():
            break
    assert 0 < known.min() < len(due)  # at least one run leaves its lane on the way
    found = batch.run(0.1, q, v)
    assert not found.failures and (found.known == len(due)).all()
    assert np.abs(found.states - before.states).max() < 1e-10
