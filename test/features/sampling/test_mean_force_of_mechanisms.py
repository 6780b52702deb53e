"""Mean forces and free energies along joints of mechanisms."""

import numpy as np
import pytest
from scipy.special import i0e, i1e

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.features.sampling.joint_space import JointSpace


def profile_of(scene, **asked):
    return scene.sample({"components": False, "seed": 2, **asked}, workers=1)["profile"]


@pytest.mark.parametrize("fixman", [False, True])
def test_a_four_bar_has_the_free_energy_of_its_one_freedom(fixman):
    """Energy and density along the curve of configurations, differentiated; nothing scatters."""
    scene, kT, at = mbd.load_scene("heat_bath"), 10.0, [0.8, 1.0, 1.2, 1.3, 1.4, 1.5]
    asked = {"thermal_energy": kT, "coordinate": "crank", "at": at, "fixman": fixman}
    profile = profile_of(scene, **asked, chains=2, samples=8, warmup=1, steps=1)
    system = scene.system()
    y = system.reduce(scene.initial)
    space = JointSpace(system, y, scene.couplings.independent)

    def free_energy(crank):
        q = y.q.copy()
        for level in np.linspace(q[0], crank, 20):
            for _ in range(12):
                J = np.vstack((system.jacobian(0.0, q), [1.0, 0.0, 0.0]))
                q = q - np.linalg.solve(J, [*system.residual(0.0, q), q[0] - level])
        energy, M = space.potential(q[:, None])[0], system.mass(q).dense
        if fixman:
            return energy - kT * np.log(np.sqrt(np.linalg.det(M)) / abs(np.linalg.det(J)))
        along = np.linalg.solve(J, [0.0, 0.0, 1.0])
        return energy - 0.5 * kT * np.log(along @ M @ along)

    h = 1e-4
    slopes = [(free_energy(a + h) - free_energy(a - h)) / (2.0 * h) for a in at]
    assert profile["mean_force"] == pytest.approx(slopes, rel=1e-6, abs=1e-6)
    rise = free_energy(at[-1]) - free_energy(at[0])
    assert profile["free_energy"][-1] == pytest.approx(rise, abs=5e-3)
    assert np.abs(profile["multiplier"] - slopes).max() > 0.5  # the correction is no trifle


def test_a_particle_on_a_sphere_by_three_sliders():
    """Heights are evenly spread on a sphere: dA/dz = m g; along x Bessel functions."""
    scene, kT = mbd.load_scene("benchmark/p01_spherical_pendulum"), 4.0
    few = {"chains": 2, "samples": 8, "warmup": 1, "steps": 1}
    up = profile_of(scene, thermal_energy=kT, coordinate="z", at=[-0.7, -0.2, 0.3], **few)
    assert up["mean_force"] == pytest.approx(9.81, rel=1e-7)
    x, r, kT = 0.6, 0.8, 5.0
    many = {"chains": 8, "samples": 60, "warmup": 10, "steps": 10}
    aside = profile_of(scene, thermal_energy=kT, coordinate="x", at=[x], **many)
    expected = 9.81 * x / r * i1e(9.81 * r / kT) / i0e(9.81 * r / kT)
    error = aside["mean_force.standard_error"][0]
    assert abs(aside["mean_force"][0] - expected) < 3.0 * error
    assert error < 0.1 * expected


def test_a_joint_of_an_arm_beside_a_quadrature_over_the_other():
    """Two links whose mass matrix depends on the elbow: sqrt(det M) is part of the density."""
    urdf = "package://mbd_ros/config/robots/benchmark/four_bar.urdf"
    robot = {"urdf": urdf, "gravity": [0.0, -9.81, 0.0], "locked": {"rocker": 0.0}}
    scene, kT, shoulder = mbd.scene_from({"robot": robot}), 5.0, 0.7
    system = scene.system()
    names = list(scene.couplings.independent)
    space = JointSpace(system, system.reduce(scene.initial), names)
    elbow = np.linspace(-np.pi, np.pi, 200, endpoint=False)

    def free_energy(angle):
        q = np.vstack((np.full(elbow.size, angle), elbow))
        density = [np.sqrt(np.linalg.det(system.mass(one).dense)) for one in q.T.copy()]
        return -kT * np.log((density * np.exp(-space.potential(q) / kT)).sum())

    slope = (free_energy(shoulder + 1e-4) - free_energy(shoulder - 1e-4)) / 2e-4
    asked = {"thermal_energy": kT, "coordinate": names[0], "at": [shoulder]}
    profile = profile_of(scene, **asked, chains=32, samples=60, warmup=20, steps=6)
    error = profile["mean_force.standard_error"][0]
    assert abs(profile["mean_force"][0] - slope) < 3.0 * error
    assert error < 0.03 * abs(slope)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("heat_bath", "--coordinate", "crank", "--at", 9.0), "cannot move"),
        (("heat_bath", "--coordinate", "knee", "--at", 1.0), "not a quantity, the nearest"),
        (("controlled_leg", "--coordinate", "ankle", "--at", 0.1), "a scene without"),
    ],
)
def test_what_has_no_mean_force_is_one_clear_error(words, expected, capsys):
    code = main(["sample", *map(str, words), "--thermal-energy", "10"])
    error = capsys.readouterr().err
    assert code == 2
    assert expected in error
    assert len(error.splitlines()) == 1
