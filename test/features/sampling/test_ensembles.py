"""Ensembles against closed forms: configurations, velocities and mean forces."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.features.sampling.chains import default_step
from mbd_ros.features.sampling.ensemble import (
    Ensemble,
    Manifold,
    degrees_of_freedom,
    kinetic_after_step,
    stream,
)
from mbd_ros.features.sampling.joint_space import JointSpace
from mbd_ros.features.sampling.mean_force import average
from mbd_ros.features.sampling.particle_space import ParticleSpace

# W. Kramers 1946, M. Fixman 1974: cosine of the angle of two rigid bonds, equal masses
BINS = np.array([0.0932920940352883, 0.0978707090754773, 0.1011681956478589, 0.1033078423119392])
BINS = np.concatenate((BINS, [0.1043611589294364], [0.1043611589294364], BINS[::-1]))
RIGID, STIFF = 0.32102105387422875, 1.0 / 3.0
CHI_SQUARE = 27.88  # of nine degrees of freedom, at p = 1e-3

# Mean forces along x^2 + y^2/4 in V = x^2/2 + x y/4 + y^4/4 at kT = 1, by quadrature
ELLIPSE = {0.25: (0.9651184999140348, -1.153202823), 1.0: (1.1952717302894427, 0.5504267515)}
FREE_POINT = {
    "units": "reduced",
    "particles": {
        "molecules": {
            "point": {
                "atoms": {"P": {"mass": 1.0, "at": [0.5, 0.0, 0.0]}},
                "surfaces": [{"atom": "P", "type": "plane", "normal": [0.0, 0.0, 1.0]}],
            }
        },
        "fields": [
            {
                "type": "polynomial",
                "terms": [
                    {"coefficient": 0.5, "powers": [2, 0, 0]},
                    {"coefficient": 0.25, "powers": [1, 1, 0]},
                    {"coefficient": 0.25, "powers": [0, 4, 0]},
                ],
            }
        ],
    },
}


def judged(result):
    """Chi-square against the rigid bins, deviations of <c^2> in standard errors, its samples."""
    samples = result["samples"]
    chains = int(samples["chain"].max())
    c = samples["cosine_A_B_C"].reshape(chains, -1)
    square = average(c**2)
    n = min(average(c).effective, square.effective)
    shares = np.histogram(c, np.linspace(-1.0, 1.0, 11))[0] / c.size
    chi = n * ((shares - BINS) ** 2 / BINS).sum()
    return chi, *((square.mean - one) / square.error for one in (RIGID, STIFF)), n


def sampled(scene="particles/trimer", **task):
    asked = {"temperature": 1.0, "chains": 256, "samples": 200, "components": False, **task}
    return mbd.load_scene(scene).sample(asked, workers=1)


LANGEVIN = {"method": "langevin", "steps": 10, "dt": 0.05}


@pytest.mark.parametrize(
    ("options", "fixman"), [pytest.param({}, False, marks=pytest.mark.soak), (LANGEVIN, True)]
)
def test_two_rigid_bonds_and_two_stiff_ones(options, fixman):
    """Two ensembles that differ by 0.012 in <c^2>."""
    chi, rigid, stiff, n = judged(sampled(samples=90, warmup=40, fixman=fixman, **options))
    assert n > 8.0e3
    assert fixman or chi < CHI_SQUARE
    assert abs(stiff if fixman else rigid) < 3.0 < abs(rigid if fixman else stiff)


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_two_rigid_bonds_with_a_million_samples():
    for fixman in (False, True):
        chi, rigid, stiff, n = judged(sampled(chains=1024, samples=1700, steps=4, fixman=fixman))
        assert n > 1.0e6
        assert (chi < CHI_SQUARE) is not fixman
        assert abs(stiff if fixman else rigid) < 3.0 < abs(rigid if fixman else stiff)


def test_two_bonds_divide_their_energy_by_degrees_of_freedom():
    averages = sampled(kinetics=True, samples=40, warmup=20, steps=3)["averages"]
    for part, degrees in (("translation", 3), ("rotation", 3), ("internal", 1)):
        off = averages[f"trimer.{part}.mean"][0] - 0.5 * degrees
        assert abs(off) < 3.0 * averages[f"trimer.{part}.standard_error"][0]
    scene = mbd.load_scene("particles/trimer")
    assert degrees_of_freedom(ParticleSpace(scene.system().kinds), scene.initial.q) == 7


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_langevin_dynamics_divide_the_energy_alike():
    """Of two bonds, with close to a million independent samples."""
    asked = {"kinetics": True, "method": "langevin", "dt": 0.01, "friction": 20.0, "seed": 11}
    averages = sampled(**asked, chains=512, samples=2000, warmup=40, steps=10)["averages"]
    for part, degrees in (("translation", 3), ("rotation", 3), ("internal", 1)):
        off = averages[f"trimer.{part}.mean"][0] - 0.5 * degrees
        assert abs(off) < 3.0 * averages[f"trimer.{part}.standard_error"][0]
        assert averages[f"trimer.{part}.effective_samples"][0] > 5.0e5


def test_velocities_of_shake_are_too_warm_by_the_forces_of_the_bonds():
    """The part normal to the rows carries h^2/8 f . M^-1 f, f the forces of the rows."""
    scene, h = mbd.load_scene("particles/trimer"), 0.025
    system = scene.system()
    ensemble = Ensemble(ParticleSpace(system.kinds), 1.0)
    q = np.repeat(scene.initial.q[:, None], 400, axis=1)
    at = ensemble.at(q, ensemble.draw_velocities(stream(1, 0, 0), ensemble.manifold.at(q), 400))
    rattle, shake = kinetic_after_step(ensemble, at, h)
    after, _ = ensemble.step(at, h)
    expected = []
    for q, v in zip(after.q.T, after.v.T, strict=True):
        q, v = np.ascontiguousarray(q), np.ascontiguousarray(v)
        force = system.pushed(q, system.multipliers(q, v, np.zeros(9)))
        expected.append(h**2 / 8.0 * force.dot(force))
    assert (shake - rattle).mean() == pytest.approx(np.mean(expected), rel=0.03)


def test_central_differences_are_warm_in_fourth_order_only():
    scene = mbd.load_scene("particles/trimer")
    ensemble = Ensemble(ParticleSpace(scene.system().kinds), 1.0)
    q = np.repeat(scene.initial.q[:, None], 200, axis=1)
    start = ensemble.at(q, ensemble.draw_velocities(stream(2, 0, 0), ensemble.manifold.at(q), 200))

    def excess(h):
        ahead, _ = ensemble.step(start, h)
        behind, _ = ensemble.step(start, -h)
        central = (ahead.q - behind.q) / (2.0 * h)
        along = ensemble.manifold.project(start.places, central)
        return (ensemble.kinetic(central) - ensemble.kinetic(along)).mean()

    assert np.log2(excess(0.05) / excess(0.025)) == pytest.approx(4.0, abs=0.1)


@pytest.mark.parametrize("level", ELLIPSE)
def test_mean_force_on_an_ellipse(level):
    """With its metric correction, which the plain multiplier lacks."""
    asked = {"temperature": 1.0, "coordinate": "quadratic P 1 0.25 0", "at": [level]}
    profile = mbd.scene_from(FREE_POINT).sample({**asked, "samples": 80, "warmup": 40})["profile"]
    force, plain = ELLIPSE[level]
    error = profile["mean_force.standard_error"][0]
    assert profile["effective_samples"][0] > 2.0e3
    assert abs(profile["mean_force"][0] - force) < 3.0 * error
    assert abs(profile["multiplier"][0] - plain) < 3.0 * profile["multiplier.standard_error"][0]
    assert abs(profile["multiplier"][0] - force) > 30.0 * error


def test_mean_force_and_free_energy_of_a_dimer():
    """10 (r - 1) - 2 / r for any masses; the gradient of the potential alone is another one."""
    at = np.linspace(0.5, 2.0, 9)
    asked = {"temperature": 1.0, "coordinate": "distance A B", "at": at.tolist(), "chains": 4}
    asked |= {"samples": 10, "warmup": 5}
    profile = mbd.load_scene("particles/dimer").sample(asked, workers=1)["profile"]
    assert profile["mean_force"] == pytest.approx(10.0 * (at - 1.0) - 2.0 / at, abs=1e-8)
    assert profile["free_energy"][-1] == pytest.approx(0.9774112777602187, abs=5e-3)


@pytest.mark.soak
def test_a_robot_on_a_sphere_hangs_as_langevin_says():
    """A particle of three prismatic joints on a sphere: <z> = 1/a - coth a, a = m g R / kT."""
    scene = mbd.load_scene("benchmark/p01_spherical_pendulum")
    result = scene.sample(
        {"thermal_energy": 9.81, "chains": 64, "samples": 100, "warmup": 50, "components": False},
        workers=1,
    )
    averages = result["averages"]
    off = averages["z.position.mean"][0] - (1.0 - 1.0 / np.tanh(1.0))
    assert abs(off) < 3.0 * averages["z.position.standard_error"][0] < 0.05


@pytest.mark.parametrize(
    "samples", [pytest.param(800, marks=[pytest.mark.soak, pytest.mark.timeout(900)])]
)
def test_a_four_bar_in_a_heat_bath(samples):
    """Against a quadrature along its one degree of freedom, with the mass that it has there."""
    scene, kT = mbd.load_scene("heat_bath"), 10.0
    energy, weight = walked(scene, kT)
    asked = {"thermal_energy": kT, "chains": 32, "samples": samples, "warmup": 100, "steps": 8}
    averages = scene.sample(asked | {"components": False}, workers=1)["averages"]
    off = averages["energy.potential.mean"][0] - (weight * energy).sum() / weight.sum()
    assert abs(off) < 3.0 * averages["energy.potential.standard_error"][0] < 3.0


def walked(scene, kT, ds=0.02):
    """Energy and weight of points along the closed curve of a loop with one freedom."""
    system = scene.system()
    space = JointSpace(system, system.reduce(scene.initial), scene.couplings.independent)
    manifold = Manifold(space)
    q = system.reduce(scene.initial).q[:, None]
    q, _ = manifold.close(manifold.at(q), q)
    begin, along, energy, weight = q, np.ones((len(q), 1)), [], []
    for _ in range(100_000):
        J = manifold.at(q)[0].J[:, :, 0]
        tangent = np.linalg.svd(J)[2][-1]
        along = tangent * np.sign(tangent @ along)
        energy.append(space.potential(q)[0])
        mass = system.mass(q[:, 0]).dense
        weight.append(np.sqrt(along @ mass @ along) * np.exp(-energy[-1] / kT))
        q, _ = manifold.close(manifold.at(q), q + ds * along[:, None])
        turned = np.abs(np.exp(1j * q) - np.exp(1j * begin)).max()
        if len(energy) > 50 and turned < 0.75 * ds:
            break
    return np.array(energy), np.array(weight)


def test_steps_are_chosen_by_the_scale_of_the_scene():
    kinds = mbd.load_scene("particles/trimer").system().kinds
    warm, hot = (default_step(Ensemble(ParticleSpace(kinds), kT)) for kT in (1.0, 4.0))
    assert warm == pytest.approx(2.0 * hot)


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_mean_forces_with_ten_thousand_samples():
    """All values of the ellipse, and the free energy between them, by quadrature."""
    levels = np.linspace(0.25, 1.5, 11)
    asked = {"temperature": 1.0, "coordinate": "quadratic P 1 0.25 0", "at": levels.tolist()}
    profile = mbd.scene_from(FREE_POINT).sample({**asked, "samples": 600})["profile"]
    assert profile["effective_samples"].min() > 1.0e4
    known = {0.25: 0.9651184999, 0.5: 1.4077969217, 1.0: 1.1952717303, 1.5: 0.8794091316}
    for level, force in known.items():
        (k,) = np.flatnonzero(levels == level)
        off = profile["mean_force"][k] - force
        assert abs(off) < 3.0 * profile["mean_force.standard_error"][k]
    rise = -0.18333619897080125 + 1.683823364248756
    off = profile["free_energy"][-1] - rise
    assert abs(off) < 3.0 * profile["free_energy.standard_error"][-1]
