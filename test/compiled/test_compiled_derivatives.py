"""Derivatives of compiled systems beside references without symbols, and methods that use them."""

import numpy as np
import pinocchio as pin
import pytest
from traced_parameters import FORCES, MOTOR
from traced_scenes import scene_of, states

from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.code.emit import emit
from mbd_ros.compiled.runs.compiled_system import CompiledSystem
from mbd_ros.compiled.runs.implicit_method import verify_slopes
from mbd_ros.compiled.symbols.trace import trace
from mbd_ros.core.dynamics.linearization import Balance
from mbd_ros.errors import ModelError
from mbd_ros.methods.integration.newton import converge
from mbd_ros.scene.runs.compiling import compiled_system

DRIVE = {
    "type": "series_elastic_drive", "joint": "knee", "stiffness": 300.0, "rotor_inertia": 1e-4,
    "ratio": 50.0,
}  # fmt: skip
WEIGHTS = np.array([2100.0, -600.0, 150.0, -25.0, 2.0]) / 2520.0  # of differences of order 10
NAMES = ("arm7", "prosthetic_arm", "four_bar_leg", "free_flyer", "driven")


def given(name):
    """A scene; `driven` has internal states, and a joint that bends with another one."""
    if name == "driven":
        leg = scene_of("prosthetic_leg")
        motors = [{**MOTOR, "efficiency": 0.8}, DRIVE]
        return leg.with_(actuators=motors, forces=FORCES, constraints=None)
    return scene_of(name)


@pytest.fixture(scope="module")
def systems():
    made = {}

    def system(name):
        if name not in made:
            made[name] = compiled_system(given(name))
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
    """Those that eliminate joints by functions and by ratios are called alike."""
    plain = [systems(name).system for name in NAMES]
    assert {type(one._motion).__name__ for one in plain} == {"Aba", "Reduced", "Mimic", "Kkt"}
    assert systems("driven").internals.nz
    assert not systems("free_flyer").chart.is_flat


def test_an_open_arm_has_the_derivatives_of_pinocchio(systems):
    system = systems("arm7")
    model, data = system.model, system.model.createData()
    for y, _ in states(system.system, 3):
        found = system.derivatives(y)
        pin.computeABADerivatives(model, data, y.q, y.v, np.zeros(7))
        assert apart(found.q, data.ddq_dq) <= 1e-11
        assert apart(found.v, data.ddq_dv) <= 1e-11


@pytest.mark.parametrize("name", ["free_flyer", "four_bar_leg"])
def test_slopes_of_the_balance_are_exact(name):
    """What lacks for the equation of motion at given accelerations and multipliers."""
    plain = given(name).system()
    traced, rng = trace(plain), np.random.default_rng(4)
    names = "accelerate", "balance", "balance_slopes"
    system = CompiledSystem(plain, traced, load(emit([traced.function(one) for one in names])))
    own, balance = system.balance(system), Balance(plain)
    for y, u in states(plain, 2):
        a, lam = rng.normal(size=plain.nv), rng.normal(size=len(plain.bilateral.rows))
        force = own.force(y.t, y.q, y.v, u, a, lam)
        assert apart(force, balance.force(y.t, y.q, y.v, u, a, lam)) <= 1e-12

        def lacking(d, y=y, more=(u, a, lam)):
            x = plain.chart.plus(y, d)
            return balance.force(x.t, x.q, x.v, *more)

        wanted = steep(lacking, 2 * plain.nv, 0.01)
        assert apart(np.hstack(own.slopes(y.t, y.q, y.v, u, a, lam)), wanted) <= 1e-9


def test_derivatives_by_parameters_are_exact():
    scene = given("driven")
    values = {"ankle_joint_spring.stiffness": 41.0, "ankle_joint_spring.rest": -0.2}
    system = compiled_system(scene, values)
    y, u = states(system.system, 1)[0]

    def field(d):
        moved = dict(zip(values, np.array(list(values.values())) + d, strict=True))
        return rates(scene.with_(moved).system(), y, u)

    found = system.derivatives(y, u)
    wanted = steep(field, 2, 0.01)
    assert apart(np.vstack((found.p, found.rates.p)), wanted) <= 1e-9


def test_derivatives_of_another_scene_are_refused(systems):
    own, heavy = systems("arm7"), scene_of("arm7").with_(gravity=[0.0, 0.0, -19.0]).system()
    with pytest.raises(BuildError, match="compiled derivatives differ by"):
        verify_slopes(CompiledSystem(heavy, own._traced, own._library), ("derivatives",))


def test_rows_that_give_way_have_none():
    with pytest.raises(ModelError, match="unilateral and bounded constraints"):
        compiled_system(scene_of("controlled_leg"))


class Counted:
    """How often a method corrects."""

    def __init__(self, patch):
        self.corrections = 0
        for module in ("gauss_legendre", "generalized_alpha"):
            patch.setattr(f"mbd_ros.parts.integrators.{module}.converge", self.converge)

    def converge(self, correct, tolerance):
        def counted():
            self.corrections += 1
            return correct()

        return converge(counted, tolerance)


@pytest.mark.parametrize("name", ["driven", "four_bar_leg"])
@pytest.mark.parametrize("method", ["gauss_legendre", "generalized_alpha"])
def test_implicit_methods_take_the_same_steps(name, method, monkeypatch):
    """As many corrections as with differences, to the same end."""
    scene, counted = given(name), Counted(monkeypatch)
    ends, counts = [], []
    for solver in ("plain", "compiled"):
        counted.corrections = 0
        entries = {"integrator": {"type": method}, "solver": {"type": solver}}
        simulation = scene.simulation(dt=0.005, **entries)
        ends.append(list(simulation.run(scene.initial, 0.2))[-1])
        counts.append(counted.corrections)
    assert simulation.how.startswith("compiled: ")
    for one in ("q", "v", "z"):
        assert apart(getattr(ends[1], one), getattr(ends[0], one)) <= 1e-9
    assert counts[1] <= 1.1 * counts[0]
