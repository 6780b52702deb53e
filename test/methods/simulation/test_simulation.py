"""Simulations: stabilizations, outputs, commands, divergence, and the gait that is known."""

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.core.dynamics.tiers import tier_of
from mbd_ros.core.loads.inputs import HeldTable
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, SceneError
from mbd_ros.methods.projection.assembly import violation

SCENES = ROOT / "config/scenes"


def run(name, duration, **options):
    loaded = load_scene(SCENES / f"{name}.yaml")
    simulation = loaded.simulation(**options)
    return simulation, list(simulation.run(loaded.initial, duration))


def worst_violation(simulation, states):
    violations = [violation(simulation.system, simulation.system.reduce(x)) for x in states]
    return np.array(violations).max(axis=0)


@pytest.mark.parametrize(
    "name", ["four_bar_leg", "benchmark/a03_andrews", "benchmark/a04_bricard"]
)
def test_projection_keeps_position_and_velocity_at_rounding(name):
    duration = {"benchmark/a03_andrews": 0.01}.get(name, 0.2)
    position, velocity = worst_violation(*run(name, duration))
    assert position <= 1e-12
    assert velocity <= 1e-11


@pytest.mark.parametrize("tier", ["reduced", "kkt", "qp"])
@pytest.mark.parametrize("name", ["prosthetic_arm", "prosthetic_leg"])
def test_couplings_hold_in_every_tier_and_all_move_alike(name, tier):
    loaded = load_scene(SCENES / f"{name}.yaml")
    _, expected = run(name, 0.1)
    _, states = run(name, 0.1, solver={"type": tier})
    for x, y in zip(states, expected, strict=True):
        q, v = x.q.copy(), x.v.copy()
        loaded.couplings.expand(q, v, np.zeros_like(v))
        assert np.abs(q - x.q).max() <= 1e-12
        assert np.abs(v - x.v).max() <= 1e-12 * (1.0 + np.abs(v).max())
        assert np.abs(x.q - y.q).max() <= 1e-9


def test_violation_without_stabilization_with_baumgarte_and_with_projection():
    """Without stabilization violations grow; feedback bounds them; projection removes them."""
    name, options = "four_bar_leg", {"integrator": {"type": "rk4"}, "dt": 5e-3}
    kinds = {
        "none": {"type": "none"},
        "baumgarte": {"type": "baumgarte", "time_constant": 0.05},
        "projection": {"type": "projection"},
    }
    left = {
        k: worst_violation(*run(name, 1.0, stabilization=s, **options)) for k, s in kinds.items()
    }
    assert left["projection"][0] <= 1e-12
    assert left["baumgarte"][0] <= 0.5 * left["none"][0]
    assert left["none"][0] > 1e-10


def test_baumgarte_below_two_steps_is_raised():
    short = {"type": "baumgarte", "time_constant": 1e-4}
    simulation, states = run("four_bar_leg", 0.1, stabilization=short)
    assert simulation.stabilization.floor(simulation.dt) == 2e-3
    assert worst_violation(simulation, states)[0] <= 1e-6


@pytest.mark.parametrize(
    "integrator",
    [
        {"type": "rk4"},
        {"type": "dopri5", "tolerance": 1e-9},
        {"type": "dop853", "tolerance": 1e-9},
    ],
)
def test_states_come_every_dt_and_at_the_end(integrator):
    _, states = run("arm7", 0.0255, integrator=integrator, dt=0.01)
    assert [x.t for x in states] == pytest.approx([0.0, 0.01, 0.02, 0.0255], abs=1e-12)


def test_dense_output_is_as_good_as_the_steps():
    _, fine = run("arm7", 0.3, integrator={"type": "dop853"}, dt=1e-3)
    _, dense = run("arm7", 0.3, integrator={"type": "dop853", "tolerance": 1e-10}, dt=1e-2)
    for x, y in zip(fine[::10], dense, strict=True):
        assert np.abs(x.q - y.q).max() <= 1e-8


def commanded(joint="hinge"):
    urdf = ROOT / "config/robots/pendulum.urdf"
    return scene_of(
        f"robot: {{urdf: {urdf}}}\nactuators: [{{type: ideal, joints: [{joint}], limit: 5.0}}]\n"
    )


@pytest.mark.parametrize("integrator", ["rk4", "adams", "dop853", "semi_implicit_euler"])
def test_commands_are_held_between_outputs(integrator):
    """Two halves with their own command, run as two simulations, are one run with a switch."""
    loaded = commanded()

    def end(start, duration, times, values):
        source = {loaded.actuators[0].name: HeldTable(times, np.array([values]).T)}
        simulation = loaded.simulation(integrator={"type": integrator}, dt=1e-3, sources=source)
        return list(simulation.run(start, duration))[-1]

    expected = end(loaded.initial, 0.2, [0.0, 0.1], [3.0, -2.0])
    middle = end(loaded.initial, 0.1, [0.0], [3.0])
    found = end(middle, 0.1, [0.0], [-2.0])
    tolerance = 1e-7 if integrator == "adams" else 1e-12  # Adams starts anew in the second run
    assert np.abs(found.q - expected.q).max() <= tolerance


def collect(states, seen):
    for x in states:
        seen.append(x)  # one by one, to have those before an error


def test_divergence_names_joint_time_and_last_finite_state():
    urdf = ROOT / "config/robots/pendulum.urdf"
    loaded = scene_of(
        f"robot: {{urdf: {urdf}}}\n"
        "forces: [{type: joint_spring, joint: hinge, stiffness: 1e9}]\n"
        "initial: {position: {hinge: 0.1}}\nintegrator: {type: rk4}\ndt: 0.1\n"
    )
    seen = []
    message = r"diverged at t = .*; last finite state at t = .*: fastest joint hinge"
    with pytest.raises(DivergedError, match=message):
        collect(loaded.simulation().run(loaded.initial, 100.0), seen)
    assert len(seen) > 1
    assert all(np.isfinite([*x.q, *x.v]).all() for x in seen)


BEAD = (  # on a spoke of a disc, which throws it outwards
    "<robot name='r'><link name='base'/>"
    + "".join(
        f"<link name='{link}'><inertial><mass value='1'/><inertia ixx='.1' iyy='.1' izz='.1' "
        "ixy='0' ixz='0' iyz='0'/></inertial></link>"
        f"<joint name='{joint}' type='{kind}'><parent link='{parent}'/><child link='{link}'/>"
        f"<axis xyz='{axis}'/><limit lower='-9' upper='9' effort='1' velocity='1'/></joint>"
        for joint, kind, parent, link, axis in (
            ("turn", "revolute", "base", "disc", "0 0 1"),
            ("slide", "prismatic", "disc", "bead", "1 0 0"),
        )
    )
    + "</robot>"
)


@pytest.mark.parametrize("method", ["semi_implicit_euler", "rk4"])
def test_a_divergence_is_not_blamed_on_the_masses_of_a_sound_robot(method):
    """At 1e50 m a mass matrix is rounding; velocities that are finite are not called lost."""
    loaded = scene_of(
        "initial: {position: {slide: 0.1}, "
        "velocity: {turn: 1000.0, slide: 1000.0}}\n"
        f"integrator: {{type: {method}}}\ndt: 1e-2\n",
        BEAD,
    )
    with pytest.raises(DivergedError, match="diverged at t = ") as told:
        collect(loaded.simulation().run(loaded.initial, 1.0), [])
    assert "try a smaller dt" in str(told.value)
    assert "mass" not in str(told.value) and " 0 of " not in str(told.value)


def test_dt_that_is_none_is_refused():
    loaded = load_scene(SCENES / "arm7.yaml")
    for dt in (0.0, -1e-3, float("nan")):
        with pytest.raises(SceneError, match=r"arm7\.yaml: dt .* s must be > 0"):
            loaded.simulation(dt=dt)


@pytest.mark.parametrize(
    "name", ["prosthetic_arm", "arm7", "four_bar_leg", "benchmark/a04_bricard"]
)
def test_stops_out_of_reach_leave_the_simulation_as_it_is(name):
    text = (SCENES / f"{name}.yaml").read_text(encoding="utf-8")
    text = text.replace("../../robots", "../robots").replace(
        "../robots", str(ROOT / "config/robots")
    )
    stop = "- {type: joint_stop, joints: [all], lower: -50.0, upper: 50.0}\n"
    head = "" if "constraints:" in text else "constraints:\n"
    lines = text.rstrip().partition("constraints:\n")
    stopped = (
        f"{lines[0]}constraints:\n{stop}{lines[2]}\n" if not head else f"{text}\n{head}{stop}"
    )
    ends, tiers = [], []
    for sections in (text, stopped):
        loaded = scene_of(sections)
        simulation = loaded.simulation(integrator={"type": "rk4"}, dt=1e-3)
        ends.append(list(simulation.run(loaded.initial, 0.1))[-1])
        tiers.append(tier_of(simulation.system))
    assert tiers[1] == tiers[0]
    assert np.array_equal(ends[0].q, ends[1].q)
    assert np.array_equal(ends[0].v, ends[1].v)


@pytest.mark.parametrize("tier", ["reduced", "kkt"])
@pytest.mark.parametrize(
    ("integrator", "order", "dt"),
    [
        ({"type": "rk4"}, 4, 2e-3),
        ({"type": "dopri5"}, 5, 5e-3),
        ({"type": "adams", "order": 6}, 6, 1e-3),
        ({"type": "gauss_legendre", "stages": 2}, 4, 4e-3),
    ],
)
def test_coupled_arm_keeps_the_order_of_every_method(integrator, order, dt, tier):
    """Elbow coupled to the shoulder; error of the end against DOP853 with a tenth of the step."""
    loaded = load_scene(SCENES / "prosthetic_arm.yaml")
    x = loaded.initial._replace(v=loaded.initial.v + 1.0)

    def end(method, step):
        simulation = loaded.simulation(integrator=method, dt=step, solver={"type": tier})
        return list(simulation.run(x, 0.2))[-1].q

    exact = end({"type": "dop853"}, dt / 10)
    errors = [np.abs(end(integrator, step) - exact).max() for step in (2 * dt, dt)]
    assert errors[1] > 1e-13
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.6)


def test_run_starts_from_the_nearest_consistent_state():
    loaded = load_scene(SCENES / "four_bar_leg.yaml")
    simulation = loaded.simulation()
    x = State(0.0, loaded.initial.q + 0.02, loaded.initial.v + 0.5)
    first = next(iter(simulation.run(x, 0.01)))
    left = violation(simulation.system, first)
    assert max(left) <= 1e-12
