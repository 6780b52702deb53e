"""Derivatives of compiled systems beside references without symbols, and methods that use them."""

import numpy as np
import pytest
from test_traced_parameters import FORCES, MOTOR
from test_traced_scenes import scene_of, states

from mbd_ros.scene.compiling import compiled_system

STIFF = "joint_spring"
DRIVE = {
    "type": "series_elastic_drive", "joint": "knee", "stiffness": 300.0, "rotor_inertia": 1e-4,
    "ratio": 50.0,
}  # fmt: skip
WEIGHTS = np.array([2100.0, -600.0, 150.0, -25.0, 2.0]) / 2520.0  # of differences of order 10
NAMES = ("arm7", "prosthetic_arm", "coupled by mimic", "four_bar_leg", "free_flyer", "driven")


@pytest.fixture(scope="module", autouse=True)
def own_cache(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


def given(name):
    """A scene, and the solver that is asked for."""
    if name == "driven":
        leg = scene_of("prosthetic_leg")
        motors = [{**MOTOR, "efficiency": 0.8}, DRIVE]
        return leg.with_(actuators=motors, forces=FORCES, constraints=None), None
    if name == "coupled by mimic":
        return scene_of("benchmark/arm7_swing_coupled"), {"type": "mimic"}
    return scene_of(name), None


@pytest.fixture(scope="module")
def systems():
    made = {}

    def system(name):
        if name not in made:
            scene, solver = given(name)
            made[name] = compiled_system(scene, solver=solver)
        return made[name]

    return system


def rates(system, y, u):
    """Accelerations and rates of the plain tier."""
    a, zdot = np.zeros(system.nv), np.zeros(len(y.z))
    write = system.accelerator()
    if len(y.z):
        write(y.t, y.q, y.v, y.z, u, a, zdot)
    else:
        write(y.t, y.q, y.v, u, a)
    return np.concatenate((a, zdot))


def steep(field, n, h):
    """Slopes of a field of n steps, by differences of order 10, which know no expressions."""
    columns = []
    for unit in np.eye(n):
        pairs = ((field(k * h * unit), field(-k * h * unit)) for k in range(1, 6))
        terms = (w * (a - b) for w, (a, b) in zip(WEIGHTS, pairs, strict=True))
        columns.append(sum(terms) / h)
    return np.array(columns).T


def expected(system, y, u, h=0.01):
    """Slopes by q, v, z together, and by u."""
    n = 2 * system.nv + len(y.z)
    by_y = steep(lambda d: rates(system, system.chart.plus(y, d), u), n, h)
    return by_y, steep(lambda d: rates(system, y, u + d), len(u), h)


def stacked(derivatives):
    by_y = np.hstack((derivatives.q, derivatives.v, derivatives.z))
    if derivatives.rates is None:
        return by_y, derivatives.u
    more, by_u = stacked(derivatives.rates)
    return np.vstack((by_y, more)), np.vstack((derivatives.u, by_u))


def apart(found, wanted):
    return np.abs(found - wanted).max(initial=0.0) / max(1e-300, np.abs(wanted).max(initial=0.0))


@pytest.mark.parametrize("name", NAMES)
def test_derivatives_are_exact(systems, name):
    system = systems(name)
    plain = system.system
    for y, u in states(plain, 2):
        found, by_u = stacked(system.derivatives(y, u))
        wanted, wanted_by_u = expected(plain, y, u)
        nearly, _ = stacked(plain.derivatives(y, u))
        assert apart(found, wanted) <= 1e-9
        assert apart(by_u, wanted_by_u) <= 1e-9
        assert apart(nearly, wanted) <= 1e-5
        assert system.derivatives(y, u, inputs=False).u.shape == (plain.nv, 0)


def test_the_tiers_are_all_there(systems):
    assert {systems(name).tier for name in NAMES} == {"aba", "reduced", "mimic", "kkt"}
    assert systems("driven").internals.nz
    assert not systems("free_flyer").chart.is_flat
