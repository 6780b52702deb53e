"""The constrained acceleration on one page, and every formulation that computes the same."""

import numpy as np
import pinocchio as pin
import pytest
from places import ROOT

from mbd_ros.api import load_scene, scene_from
from mbd_ros.core.contact_modes.event_rows import bounds_in_mode
from mbd_ros.core.dynamics.mechanism import Mechanism
from mbd_ros.core.dynamics.step import constrained_acceleration
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.rows.constraint_rows import ConstraintRows, CouplingRows, RowLayout
from mbd_ros.core.state import State
from mbd_ros.methods.projection.assembly import assemble

SCENES = ROOT / "config/scenes"
ROUNDING = 1.0e-12  # of the largest entry, beside the condition of the rows
ARM = {"robot": {"urdf": "package://mbd_ros/config/robots/arm7.urdf"}}
STOPS = {"type": "joint_stop", "joints": ["joint2", "joint4"], "lower": -0.3, "upper": 0.3}
FRICTION = [
    {"type": "dry_friction", "joint": f"joint{i}", "limit": 2.0, "smoothed": True}
    for i in range(1, 8)
]
BALL = {
    "bodies": {"ball": {"shape": {"sphere": 0.1}, "mass": 2.0}},
    "contacts": [{"type": "rigid", "between": ["ball", "ground"], "friction": 0.3}],
    "initial": {"pose": {"ball": {"xyz": [0.0, 0.0, 0.1]}}},
}


def state(scene, system, seed):
    """A consistent state near the initial one, moving."""
    rng = np.random.default_rng(seed)
    x = scene.initial
    q = pin.integrate(system.model, x.q, 0.05 * rng.normal(size=len(x.v)))
    y = system.reduce(State(x.t, q, x.v + rng.normal(size=len(x.v)), x.z))
    return system.expand(assemble(system, y))


def rows_of(scene, system):
    """All rows of a scene, couplings among them, in the order of its multipliers."""
    couplings = [CouplingRows(system.robot, scene.couplings)] if scene.couplings.dependent else []
    layout = RowLayout([*couplings, *scene.constraints])
    assert [row.name for row in layout.rows] == [row.name for row in system.multiplier_rows]
    return ConstraintRows(layout.blocks, system.model.nv)


def assert_same(a, lam, solution, condition=1.0):
    for found, expected in ((solution.a, a), (solution.lam, lam)):
        size = 1.0 + np.abs(expected).max(initial=0.0)
        assert np.abs(found - expected).max(initial=0.0) <= ROUNDING * condition * size


@pytest.mark.parametrize(
    ("name", "solver", "tier"),
    [
        ("arm7", "auto", "aba"),
        ("prosthetic_arm", "auto", "reduced"),
        ("prosthetic_leg", "auto", "reduced"),
        ("prosthetic_leg", "kkt", "kkt"),
        ("prosthetic_leg", "qp", "qp over aba"),
        ("four_bar_leg", "auto", "kkt"),
        ("four_bar_leg", "qp", "qp over aba"),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_every_tier_computes_the_step(name, solver, tier, seed):
    scene = load_scene(SCENES / f"{name}.yaml")
    system = scene.system(solver={"type": solver})
    assert tier_of(system) == tier
    x = state(scene, system, seed)
    solution = system.evaluate(x)
    a, lam = constrained_acceleration(
        Mechanism(system.robot, system.loads), rows_of(scene, system), x
    )
    M = system.mass(system.reduce(x).q).dense
    assert_same(a, lam, solution, condition=10.0 * max(system.condition, np.linalg.cond(M)) ** 0.5)


@pytest.mark.parametrize("seed", range(5))
def test_bounded_rows_compute_the_step(seed):
    entry = {**STOPS, "smoothed": True}
    scene = scene_from({**ARM, "constraints": [entry, *FRICTION]})
    system, rng = scene.system(), np.random.default_rng(seed)
    assert tier_of(system) == "qp over aba"
    q = np.where(rng.random(7) < 0.5, 0.31, -0.31)
    x = State(0.0, q, 0.01 * rng.normal(size=7))
    a, lam = constrained_acceleration(
        Mechanism(system.robot, system.loads), rows_of(scene, system), x
    )
    solution = system.evaluate(x)
    assert system.bounded.acts
    assert_same(a, lam, solution, condition=100.0)


@pytest.mark.parametrize("side", [0, 1])
def test_stops_in_a_mode_compute_the_step(side):
    """Active rows are equations, open ones are not there."""
    scene = scene_from({**ARM, "constraints": [STOPS]})
    system = scene.system()
    rows = rows_of(scene, system)
    mode = (side, side)
    bounds = bounds_in_mode(rows, np.arange(2), mode, ())
    x = State(0.0, np.array([0.1, -0.3, 0.2, 0.3, 0.1, 0.2, 0.0]), np.zeros(7), mode=mode)
    stiff = ConstraintRows([block._replace(gains=(np.zeros(2),) * 2) for block in rows.blocks], 7)
    a, lam = constrained_acceleration(
        Mechanism(system.robot, system.loads), stiff, x, None, bounds
    )
    assert (np.abs(lam).max() > 0.0) == (side == 0)
    assert_same(a, lam, system.evaluate(x), condition=100.0)


@pytest.mark.parametrize("mode", [(0, 0, 0), (1, 1, 1)])
def test_a_contact_that_sticks_or_is_open_computes_the_step(mode):
    scene = scene_from(BALL)
    system = scene.system()
    rows = rows_of(scene, system)
    x = scene.initial._replace(v=np.array([0.0, 0.0, 0.0, 1.0, 2.0, 3.0]), mode=mode)
    bounds = bounds_in_mode(rows, np.arange(3), mode, ())
    a, lam = constrained_acceleration(Mechanism(system.robot, system.loads), rows, x, None, bounds)
    assert_same(a, lam, system.evaluate(x), condition=10.0)
