"""Numbers of parts as arguments: a traced scene is the scene with these numbers."""

import numpy as np
import pytest
from complex_steps import slopes
from traced_parameters import FORCES, MOTOR
from traced_scenes import EXACT, scene_of, states

from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.errors import SceneError
from mbd_ros.scene.runs.compiling import traced

DRIVE = {"type": "series_elastic_drive", "joint": "knee", "stiffness": 300.0}
VALUES = {
    "ankle_joint_spring.stiffness": 41.0,
    "ankle_joint_spring.rest": -0.2,
    "hip_flexion_joint_friction.coulomb": 0.7,
    "foot_point_spring.stiffness": 320.0,
    "ankle_geared_motor.ratio": 35.0,
    "ankle_geared_motor.rotor_inertia": 4e-5,
    "ankle_geared_motor.efficiency": 0.7,
    "knee_series_elastic_drive.stiffness": 450.0,
}


@pytest.fixture(scope="module")
def driven():
    motors = [{**MOTOR, "efficiency": 0.8}, {**DRIVE, "rotor_inertia": 1e-4, "ratio": 50.0}]
    return scene_of("prosthetic_leg").with_(actuators=motors, forces=FORCES, constraints=None)


def test_parameters_are_the_numbers_of_parts(driven):
    names = {part.name for part in (*driven.forces, *driven.actuators)}
    values = {key: value for key, value in VALUES.items() if key.split(".")[0] in names}
    assert len(values) >= 6, names
    own, p = traced(driven, parameters=list(values)), np.array(list(values.values()))
    system = driven.with_(values).system()
    for y, u in states(system):
        given = np.array([y.t]), y.q, y.v, y.z, u, p
        a, zdot, _ = own.function("accelerate").call(list(given))
        expected = system.evaluate(system.expand(y), u)
        size = np.abs(expected.a).max()
        assert np.abs(np.array(a).ravel() - system.integrated(expected.a)).max() <= 1e-10 * size
        np.testing.assert_allclose(np.array(zdot).ravel(), expected.zdot, rtol=1e-12)
        by_p = np.array(own.function("derivatives").call(list(given))[4])
        steps = slopes(own.function("accelerate"), 5, *given)[: own.nv + own.nz]
        assert np.abs(by_p - steps).max() <= 1e-9 * np.abs(steps).max()


def test_rows_have_parameters():
    scene = scene_of("benchmark/p01_spherical_pendulum")
    name = f"{scene.constraints[0].name}.distance"
    own = traced(scene, parameters=[name])
    y, _ = states(scene.system(), 1)[0]
    longer = scene.with_({name: 1.3}).system()
    g = own.function("gap").call([y.t, y.q, np.array([1.3])])[0]
    assert np.array(g).ravel() == pytest.approx(longer.residual(y.t, y.q), abs=EXACT)


def test_what_is_no_parameter_is_named(driven):
    with pytest.raises(SceneError, match="nothing is called 'nobody'"):
        traced(driven, parameters=["nobody.stiffness"])
    with pytest.raises(SceneError, match="is no number of a part"):
        traced(driven, parameters=["integrator.dt"])
    with pytest.raises(Untraceable, match="point"):
        traced(driven, parameters=["foot_applied_wrench.point"]).function("accelerate")
