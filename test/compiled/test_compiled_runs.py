"""Runs in native code against the plain tier, which integrates the same equations in Python."""

import pickle
import time

import numpy as np
import pytest

from mbd_ros.api import load_scene
from mbd_ros.compiled.runs.compiled_method import CompiledMethod
from mbd_ros.compiled.symbols.untraceable import Untraceable
from mbd_ros.core.loads.inputs import HeldTable, LinearTable, Polynomials
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.parts.integrators.adams import Adams
from mbd_ros.parts.integrators.dop853 import Dop853
from mbd_ros.parts.integrators.dopri5 import Dopri5
from mbd_ros.parts.integrators.gauss_legendre import GaussLegendre
from mbd_ros.parts.integrators.rattle import Rattle
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.parts.integrators.semi_implicit_euler import SemiImplicitEuler
from mbd_ros.parts.stabilization.baumgarte import Baumgarte
from mbd_ros.parts.stabilization.none import NoStabilization
from mbd_ros.parts.stabilization.projection import Projection

SWING = "package://mbd_ros/config/scenes/benchmark/arm7_swing.yaml"
METHODS = {
    "rk4": (Rk4(), 1e-3),
    "dopri5": (Dopri5(), 1e-3),
    "dop853": (Dop853(), 2e-3),
    "adaptive dopri5": (Dopri5(tolerance=1e-8), 1e-3),
    "adaptive dop853": (Dop853(tolerance=1e-9), 1e-3),
    "adams 2": (Adams(order=2), 1e-3),
    "adams 5": (Adams(order=5), 1e-3),
    "adams 8": (Adams(order=8), 5e-4),
    "semi_implicit_euler": (SemiImplicitEuler(), 1e-3),
}
METHODS["rattle"] = (Rattle(), 1e-3)
STABILIZATIONS = {
    "projection": Projection(),
    "none": NoStabilization(),
    "baumgarte": Baumgarte(time_constant=0.02),
}
DURATION = 0.2


def simulations(scene, method, dt):
    """The compiled one and the plain one."""
    fix = Projection()
    both = (CompiledMethod(method, fix), method)
    return [Simulation(scene.system(), each, fix, dt) for each in both]


def bits(states):
    return [(x.t, *(each.tobytes() for each in x[1:4])) for x in states]


def off(states, others):
    """Largest difference between two runs, time included."""
    rows = [
        np.array([np.concatenate(([x.t], *x[1:4])) for x in each]) for each in (states, others)
    ]
    assert rows[0].shape == rows[1].shape
    return np.abs(rows[0] - rows[1]).max()


@pytest.mark.parametrize("name", [name for name in METHODS if name != "rattle"])
def test_samples_are_those_of_the_plain_tier(name):
    """Rounding, which a swing of 43 rad/s multiplies by some hundred in this time."""
    scene = load_scene(SWING)
    compiled, plain = simulations(scene, *METHODS[name])
    states, others = (list(each.run(scene.initial, DURATION)) for each in (compiled, plain))
    assert off(states, others) < 1e-11
    assert compiled.steps == plain.steps
    rows = compiled.sampled(scene.initial, DURATION)
    assert bits(states) == [(r[0], r[1:8].tobytes(), r[8:].tobytes(), b"") for r in rows]


BENCHMARK = "package://mbd_ros/config/scenes/benchmark"
SCENES = {  # what is integrated, how rows are kept, how far apart the tiers may be
    "benchmark/arm7_swing_coupled": ("rk4", "projection", 1e-12),
    "benchmark/a01_pendulum_maximal": ("adams 5", "projection", 1e-11),
    "benchmark/a02_four_bars_2": ("adaptive dop853", "projection", 1e-12),
    "benchmark/ts_andrews": ("adaptive dopri5", "projection", 1e-8),
    "benchmark/x02_four_bar_1e-2": ("rk4", "baumgarte", 1e-12),
    "benchmark/p01_spherical_pendulum": ("rattle", "none", 1e-7),
    "benchmark/x08_elastic_1e6": ("dop853", "none", 1e-12),
    "four_bar_leg": ("semi_implicit_euler", "projection", 1e-8),
    "free_flyer": ("adaptive dopri5", "none", 1e-12),
}


@pytest.mark.parametrize("name", SCENES)
def test_other_tiers_and_stabilizations_give_the_same_samples(name):
    """Couplings, loops, free bodies, elastic drives; the bound is rounding times growth."""
    kind, stabilization, bound = SCENES[name]
    scene = load_scene(f"package://mbd_ros/config/scenes/{name}.yaml")
    method, more = METHODS[kind][0], STABILIZATIONS[stabilization]
    both = (CompiledMethod(method, more), method)
    compiled, plain = (Simulation(scene.system(), each, more, scene.dt) for each in both)
    states, others = (list(each.run(scene.initial, 40.5 * scene.dt)) for each in (compiled, plain))
    size = max(np.abs(np.hstack(x[1:4])).max() for x in others)
    assert off(states, others) < bound * max(size, 1.0)
    assert compiled.steps == plain.steps
    assert compiled.stepper.handed_over == 0


@pytest.mark.parametrize("name", ["rk4", "adaptive dop853"])
def test_redundant_rows_stay_on_the_plain_tier(name):
    """Native code has no solver that finds ranks."""
    scene = load_scene(f"{BENCHMARK}/x09_cranks.yaml")
    compiled, plain = simulations(scene, METHODS[name][0], scene.dt)
    states, others = (list(each.run(scene.initial, 10 * scene.dt)) for each in (compiled, plain))
    assert off(states, others) == 0.0
    assert compiled.stepper.handed_over == compiled.steps == plain.steps


def test_steps_near_a_toggle_are_handed_over_and_back():
    """A threshold in the middle of the motion stands for a toggle that is passed closely."""
    scene = load_scene(f"{BENCHMARK}/x02_four_bar_1e-2.yaml")
    compiled, plain = simulations(scene, Dopri5(tolerance=1e-8), scene.dt)
    run = compiled.stepper._run
    list(compiled.run(scene.initial, 1.0))
    healths = [run.health(x, np.zeros(0)) for x in plain.run(scene.initial, 1.0)]
    run.least_health = run._options.value.least_health = float(np.quantile(healths, 0.3))
    assert healths[0] > run.least_health
    states, others = (list(each.run(scene.initial, 1.0)) for each in (compiled, plain))
    assert 0 < compiled.stepper.handed_over < len(states)
    assert off(states, others) < 1e-6
    kept = compiled.run(scene.initial, 1.0)
    for _ in range(700):
        next(kept)
    again = bits(compiled.run(compiled.checkpoint(), 1.0))
    assert again == bits(states)[700:]


def test_no_run_leaves_the_branch_at_a_toggle():
    """IFToMM A02 for 10 s: all bars of the four-bars are in line twice a turn."""
    scene = load_scene(f"{BENCHMARK}/a02_four_bars_2.yaml")
    compiled, plain = simulations(scene, Dop853(tolerance=1e-9), 0.1)
    rows = compiled.sampled(scene.initial, 10.0)
    others = np.array([np.hstack(x[:4]) for x in plain.run(scene.initial, 10.0)])
    assert np.abs(rows[:, 1:6] - others[:, 1:6]).max() < 1e-5


def torques():
    """Torques of a polynomial and of a table, which jump at 0.03 and 0.0515 s."""
    lines = Polynomials([0.0, 0.03], np.array([[[0.0], [20.0]], [[3.0], [-9.0]]]))
    table = LinearTable([0.01, 0.0515], np.array([[0.0], [4.0]]))
    held = HeldTable([0.0, 0.02, 0.0333], np.array([[1.0], [-1.0], [2.0]]))
    return {"joint1_torque": lines, "joint2_torque": table, "joint4_torque": held}


@pytest.mark.parametrize("kind", ["rk4", "adaptive dop853"])
def test_inputs_jump_where_they_do_in_the_plain_tier(kind):
    """Steps end where inputs jump; what is smooth is asked at every stage."""
    driven = [{"type": "ideal", "name": name, "joints": [name[:6]]} for name in torques()]
    scene = load_scene(SWING).with_(actuators=driven)
    method = METHODS[kind][0]
    both = (CompiledMethod(method, Projection()), method)
    compiled, plain = (
        Simulation(scene.system(sources=torques()), each, Projection(), 1e-3) for each in both
    )
    states, others = (list(each.run(scene.initial, 0.06)) for each in (compiled, plain))
    # A kink inside a step leaves an error that depends on the length of the step. Adapted lengths
    # depend on rounding, so that two such runs agree to the tolerance of the method.
    assert off(states, others) < (getattr(method, "tolerance", None) or 1e-10)
    assert compiled.steps == plain.steps
    states = compiled.run(scene.initial, 0.06)
    for _ in range(34):
        next(states)
    kept = compiled.checkpoint()
    assert bits(compiled.run(kept, 0.06)) == bits(list(plain_rest(scene, both[0], kept)))


def plain_rest(scene, method, kept):
    """The rest of a run by a simulation of its own."""
    other = Simulation(scene.system(sources=torques()), method, Projection(), 1e-3)
    return other.run(kept, 0.06)


@pytest.mark.parametrize("name", ["rk4", "adaptive dop853", "adams 8"])
def test_ticks_are_those_of_the_plain_tier(name):
    """Steps end at every tick, as those of a live simulation do."""
    scene = load_scene(SWING)
    both = simulations(scene, *METHODS[name])
    ends = []
    for simulation in both:
        y = simulation.start(scene.initial)
        for tick in range(1, 101):
            y = simulation.advance(y, None, tick * 2e-3)
        ends.append(y)
    assert off(*([end] for end in ends)) < 1e-11


@pytest.mark.parametrize("name", ["adaptive dop853", "adams 8"])
def test_a_checkpoint_continues_with_the_same_bits(name):
    """Inside a block too, and in another simulation."""
    scene = load_scene(SWING)
    compiled, _ = simulations(scene, *METHODS[name])
    states = compiled.run(scene.initial, DURATION)
    for _ in range(77):
        next(states)
    kept = pickle.dumps(compiled.checkpoint())
    rest = bits(states)
    other, _ = simulations(scene, *METHODS[name])
    assert bits(other.run(pickle.loads(kept), DURATION)) == rest


def test_what_has_no_native_steps_is_named():
    scene = load_scene(SWING)
    with pytest.raises(Untraceable, match="gauss_legendre"):
        CompiledMethod(GaussLegendre(), Projection()).prepare(scene.system(), 1e-3)


@pytest.mark.parametrize(
    ("name", "kind", "mujoco_steps", "error", "ratio"),
    [
        ("arm7_swing", Dop853(tolerance=1e-7), (2e-4, 2.0, False), 1e-6, 60.0),
        ("a02_four_bars_2", Dop853(tolerance=5e-9), (1e-3, 0.7, True), 1e-8, 100.0),
    ],
)
def test_runs_take_less_than_those_of_mujoco(name, kind, mujoco_steps, error, ratio):
    """Warm runs, measured 130 and 270: of 100 runs of 50 us and of 5 of 13 ms the shortest.

    The first run after MuJoCo's, which empties the caches, takes several times as long.
    """
    peers = pytest.importorskip("mbd_ros.applications.report.peers.mujoco_peer")
    from mbd_ros.applications.report.peers.translation import common_ground, task_of

    scene = load_scene(f"{BENCHMARK}/{name}.yaml")
    none = STABILIZATIONS["none"]
    compiled = Simulation(scene.system(), CompiledMethod(kind, none), none, 1.0 / 400)
    plain = scene.simulation(integrator={"type": "dop853", "tolerance": 1e-12}, dt=0.1)
    known = np.array([x.q for x in plain.run(scene.initial, 1.0)])
    peer = peers.MujocoRun(task_of(common_ground(scene)), "mjINT_RK4", *mujoco_steps)
    ours, theirs = [], []
    for _ in range(5):
        for _ in range(20):
            begin = time.process_time()
            rows = compiled.sampled(scene.initial, 1.0)
            ours.append(time.process_time() - begin)
        states, used = peer.run((np.arange(1, 11) * 0.1).tolist())
        theirs.append(used)
    assert rows.shape[0] == 401
    assert np.abs(rows[::40, 1 : 1 + known.shape[1]] - known).max() < error
    assert np.abs(np.array([x.q for x in states]) - known[1:]).max() > 0.1 * error
    assert min(theirs) > ratio * min(ours)
