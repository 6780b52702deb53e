"""u: channels of the parts of a scene, where they stand, and what gives them."""

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

from mbd_ros.api import Scene
from mbd_ros.core.contracts import Actuator, Channel
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.inputs import HeldTable, LinearTable, Polynomials, Sampled
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SceneError
from mbd_ros.files.table import Column, Result, Table

ROBOTS = ROOT / "config/robots"
LEG = f"robot: {{urdf: {ROBOTS / 'prosthetic_leg.urdf'}}}\n"
DRIVES = """actuators:
- {type: ideal, joints: [knee, hip_flexion], limit: 50.0}
- {type: series_elastic, joint: ankle, stiffness: 300.0}
"""


def test_every_input_has_a_unit_bounds_and_a_safe_value():
    inputs = scene_of(LEG + DRIVES).inputs
    assert [channel.unit for channel in inputs.channels] == ["N·m", "N·m", "rad"]
    assert [channel.upper for channel in inputs.channels] == [50.0, 50.0, np.inf]
    assert not inputs.safe.any()


def test_scenes_that_share_parts_have_slots_of_their_own():
    """A section that is kept, beside another number of inputs before it."""
    first = scene_of(LEG + DRIVES)
    elastic = first.actuators[1]
    fewer = first.holding(actuators=(elastic,))
    assert (elastic.u, first.actuators[1].u) == (slice(2, 3), slice(2, 3))
    assert fewer.actuators[0].u == slice(0, 1)
    assert len(fewer.inputs.channels) == 1
    assert first.with_(dt=0.01).actuators == first.actuators
    u = np.array([3.0, 5.0, 0.1])
    loads = first.system().loads
    x = first.initial
    tau = loads.actuator_torque(Kinematics, x, u)
    driven = [first.robot.joint(name).v for name in ("knee", "hip_flexion", "ankle")]
    assert tau[driven] == pytest.approx([3.0, 5.0, 30.0])
    assert loads.command(tau[driven], x) == pytest.approx(u)


@pytest.mark.parametrize(
    "drive",
    [
        "{type: ideal, joints: [knee, ankle], limit: 50.0}",
        "{type: geared_motor, joint: knee, ratio: -50.0, viscous: 1.0e-3, limit: 0.4}",
        "{type: series_elastic, joint: ankle, stiffness: 300.0, damping: 2.0}",
    ],
)
def test_columns_are_the_slopes_of_an_affine_force_within_its_bounds(drive):
    """force(u) = force(0) + columns u, at random states and inputs."""
    scene = scene_of(f"{LEG}actuators: [{drive}]\n")
    (part,), rng, nv = scene.actuators, np.random.default_rng(1), scene.robot.model.nv
    lower, upper = (np.clip([c[i] for c in part.inputs], -9.0, 9.0) for i in (2, 3))
    for q, v in rng.normal(size=(20, 2, nv)):
        x, u = State(0.0, q, v), rng.uniform(lower, upper)
        columns = part.columns(Kinematics, x)
        assert columns.shape == (nv, len(part.inputs))
        expected = part.force(Kinematics, x, np.zeros(len(u))) + columns @ u
        np.testing.assert_allclose(part.force(Kinematics, x, u), expected, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize(
    "drive",
    [
        "{type: geared_motor, joint: knee, ratio: 50.0, efficiency: 0.8}",
        "{type: series_elastic, joint: ankle, stiffness: 300.0, limit: 20.0}",
    ],
)
def test_a_force_that_is_not_affine_has_no_columns(drive):
    (part,) = scene_of(f"{LEG}actuators: [{drive}]\n").actuators
    assert part.columns(Kinematics, scene_of(LEG).initial) is None


SLIDE = """<robot name="slide"><link name="world"/><link name="cart"><inertial><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="slide" type="prismatic"><parent link="world"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-9" upper="9" effort="99" velocity="99"/></joint></robot>"""
CART = "actuators: [{type: ideal, joints: [slide], name: pull}]\n"
METHODS = ["rk4", "dopri5", "adams", "gauss_legendre", "generalized_alpha"]


def pulled(source, method, dt=0.01, duration=0.1, **more):
    """States of a cart of 2 kg under a force."""
    scene = scene_of(f"{CART}integrator: {{type: {method}}}\n", SLIDE)
    simulation = scene.simulation(dt=dt, sources={"pull": source}, **more)
    return list(simulation.run(scene.initial, duration))


@pytest.mark.parametrize("method", METHODS)
def test_steps_end_where_a_held_input_jumps(method):
    """Closed form of two constant accelerations, the switch between two outputs."""
    switch = 0.0537
    states = pulled(HeldTable([0.0, switch], [[4.0], [-2.0]]), method)
    assert [x.t for x in states] == pytest.approx(np.arange(11) * 0.01, abs=1e-15)
    for x in states:
        late = max(x.t - switch, 0.0)
        assert x.v[0] == pytest.approx(2.0 * x.t - 3.0 * late, abs=1e-14)
        assert x.q[0] == pytest.approx(x.t**2 - 1.5 * late**2, abs=1e-14)


@pytest.mark.parametrize("jump", [0.0537, 0.05])
@pytest.mark.parametrize("method", METHODS)
def test_steps_end_where_a_smooth_input_jumps_and_see_the_values_of_their_side(method, jump):
    """Closed form of F = 12 t before and 8 - 4 (t - jump) after it."""
    source = Polynomials([0.0, jump], [[[0.0], [12.0]], [[8.0], [-4.0]]])
    last = pulled(source, method)[-1]
    late = last.t - jump
    assert last.t == pytest.approx(0.1, abs=1e-15)
    second = 1e-3 if method == "generalized_alpha" else 1e-13  # of order 2
    speed = 3.0 * jump**2 + 4.0 * late - late**2
    assert last.v[0] == pytest.approx(speed, abs=second)
    way = jump**3 + 3.0 * jump**2 * late + 2.0 * late**2 - late**3 / 3.0
    assert last.q[0] == pytest.approx(way, abs=second)


def test_a_linear_table_acts_to_its_end_and_ends_there():
    """F = 10 (1 + t) from 0.02 s to 0.06 s: the run that ends there sees it all."""
    source = LinearTable([0.02, 0.06], [[10.2], [10.6]])
    work = 5.0 * (0.04 + (0.06**2 - 0.02**2) / 2.0)
    assert pulled(source, "rk4", duration=0.06)[-1].v[0] == pytest.approx(work, abs=1e-13)
    assert pulled(source, "rk4")[-1].v[0] == pytest.approx(work, abs=1e-13)
    assert source.at(0.06).tolist() == [10.6]
    assert list(source.jumps(0.0, 1.0)) == [0.02, 0.06]
    ramp = LinearTable([0.0, 0.5, 1.0], [[0.0], [1.0], [0.0]])
    assert list(ramp.jumps(-1.0, 2.0)) == []  # continuous
    assert ramp.at(0.25).tolist() == [0.5]


def test_jumps_are_those_of_the_rows_and_samples():
    held = HeldTable(np.arange(4.0), [[1.0], [2.0], [2.0], [3.0]])
    assert list(held.jumps(0.0, 3.0)) == [1.0, 2.0]
    assert [held.at(t)[0] for t in (-1.0, 0.9, 1.0, 7.0)] == [1.0, 1.0, 2.0, 3.0]
    assert list(Sampled(np.zeros, 0.5).jumps(1.0, 2.5)) == [1.5, 2.0]


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: HeldTable([1.0, 0.0], [[1.0], [2.0]]), "must be finite and increasing"),
        (lambda: HeldTable([0.0], [[np.nan]]), "values at 0 s must be finite"),
        (lambda: HeldTable([0.0], [1.0]), r"values have shape \(1,\), but must have 1 rows"),
        (lambda: LinearTable([0.0], [[1.0]]), "accepted: 2 or more"),
        (lambda: LinearTable([0.0, 0.0], [[1.0], [2.0]]), "strictly increasing"),
        (lambda: Polynomials([0.0], [[1.0]]), r"accepted: \(m, powers, n\)"),
    ],
)
def test_a_table_that_is_none_is_refused(make, message):
    with pytest.raises(ModelError, match=message):
        make()


def test_a_source_of_an_unknown_part_is_refused_by_name():
    scene = scene_of(CART, SLIDE)
    with pytest.raises(SceneError, match=r"no part 'push' has inputs; accepted: pull"):
        scene.simulation(sources={"push": Sampled(np.zeros, 0.1)})


PLATE = """external_wrenches:
  plate: {frame: foot, expressed_in: universe, point: [0.1, 0.0, 0.2]}
"""
ARM = f"""robot: {{urdf: {ROBOTS / "arm7.urdf"}}}
external_wrenches:
  plate: {{frame: link3, point: [0.1, 0.0, 0.2]}}
"""


def test_an_external_wrench_is_a_load_with_six_inputs_after_those_of_actuators():
    scene = scene_of(LEG + DRIVES + PLATE)
    assert scene.inputs.names[3:] == tuple(
        f"plate.{c}" for c in ("Fx", "Fy", "Fz", "Mx", "My", "Mz")
    )
    assert [channel.unit for channel in scene.inputs.channels[3:]] == ["N"] * 3 + ["N·m"] * 3
    assert scene.wrenches["plate"].u == slice(3, 9)
    assert scene.with_(actuators=None).wrenches["plate"].u == slice(0, 6)
    assert scene.wrenches["plate"].u == slice(3, 9)


def test_columns_of_a_wrench_are_its_slopes_and_its_force_that_of_inverse_dynamics():
    """tau without the load less tau with it, at random states: the force of the load."""
    scene = scene_of(LEG + PLATE)
    part, inverse, rng = (
        scene.wrenches["plate"],
        scene.inverse_dynamics(),
        np.random.default_rng(2),
    )
    k = Kinematics(scene.robot)
    for q, v, a in rng.normal(size=(10, 3, scene.robot.model.nv)):
        x, w = State(0.0, q, v), rng.normal(scale=50.0, size=6)
        k.refresh(q, v)
        force = part.force(k, x, w)
        np.testing.assert_allclose(part.columns(k, x) @ w, force, rtol=1e-12, atol=1e-11)
        less = inverse.solve(q, v, a).tau - inverse.solve(q, v, a, [w]).tau
        np.testing.assert_allclose(force, less, rtol=0, atol=1e-10)
        assert not part.force(k, x, np.zeros(6)).any()


def test_a_wrench_with_a_threshold_has_no_columns():
    scene = scene_of(LEG + PLATE.replace("0.2]", "0.2], threshold: 5.0"))
    assert scene.wrenches["plate"].columns(Kinematics, scene.initial) is None


@pytest.mark.parametrize("more", ["", "couplings: {joint4: {parent: joint2, factor: 0.5}}\n"])
def test_a_simulated_wrench_is_what_inverse_dynamics_is_given(more):
    """No joint is driven: with the load of the file, inverse dynamics finds no torque."""
    scene, times = Scene.of(scene_of(ARM + more)), np.linspace(0.0, 0.3, 31)
    load = 3.0 * np.sin(np.outer(times, np.arange(3.0, 9.0)) + 1.0)
    axes = [f"plate.{kind}.{axis}" for kind in ("force", "torque") for axis in "xyz"]
    columns = [Column("time", times, "s"), *map(Column, axes, load.T)]
    loads = Result({"samples": Table(columns)}, {})
    motion = scene.simulate(0.3, wrenches=loads, dt=0.01, integrator="dop853")
    torques = scene.inverse(motion, wrenches=loads)["samples"]
    for joint in scene.couplings.independent:
        assert np.abs(torques[f"{joint}.effort"]).max() < 1e-9
    free = scene.simulate(0.3, dt=0.01, integrator="dop853")["samples"]
    assert np.abs(free["joint2.position"] - motion["samples"]["joint2.position"]).max() > 0.01


@pytest.mark.parametrize("method", [*METHODS, "semi_implicit_euler", "dop853"])
@pytest.mark.parametrize("stop", [2, 5, 6, 9])
def test_a_checkpoint_continues_between_and_at_jumps_of_inputs_with_the_same_bits(method, stop):
    """Samples of a function, a held table off the samples, and polynomials with a jump."""
    drives = "{type: ideal, joints: [slide], name: NAME}"
    names = ("held", "smooth", "sampled")
    text = ", ".join(drives.replace("NAME", name) for name in names)
    scene = scene_of(f"actuators: [{text}]\nintegrator: {{type: {method}}}\n", SLIDE)
    sources = {
        "held": HeldTable([0.0, 0.0137, 0.0537], [[4.0], [1.0], [-2.0]]),
        "smooth": Polynomials([0.0, 0.05], [[[0.0], [12.0]], [[8.0], [-4.0]]]),
        "sampled": Sampled(lambda t: np.array([np.sin(40.0 * t)]), 0.01),
    }

    def simulation():
        return scene.simulation(dt=0.01, sources=sources)

    run = simulation()
    seen, kept = [], None
    for k, x in enumerate(run.run(scene.initial, 0.1)):
        seen.append(x)
        if k == stop:
            kept = run.checkpoint()
    for x, expected in zip(simulation().run(kept, 0.1), seen[stop + 1 :], strict=True):
        assert x.t == expected.t
        assert x.q.tobytes() + x.v.tobytes() == expected.q.tobytes() + expected.v.tobytes()


class Pair(Actuator):
    """Two cords on one joint, of which each only pulls."""

    joints = ("slide",)
    inputs = (Channel("pull", "N", 0.0, 50.0), Channel("back", "N", 0.0, 50.0))

    def force(self, k, x, u):
        pull, back = np.clip(u[self.u], 0.0, 50.0)
        return np.array([pull - back])

    def command(self, torque, x):
        return np.array([max(torque[0], 0.0), max(-torque[0], 0.0)])


def test_commands_of_several_inputs_a_joint_go_by_the_names_of_the_inputs():
    """They come from a file, stand in the result, and inverse dynamics finds them again."""
    scene = Scene.of(scene_of("dt: 0.01\n", SLIDE).holding(actuators=(Pair(),)))
    assert scene.inputs.names == ("pair.pull", "pair.back")
    times = np.linspace(0.0, 0.1, 11)
    given = {"pair.pull": np.full(11, 6.0), "pair.back": 20.0 * times}
    columns = [Column(f"{name}.command", values) for name, values in given.items()]
    efforts = Result({"samples": Table([Column("time", times, "s"), *columns])}, {})
    samples = scene.simulate(0.1, dt=0.01, efforts=efforts)["samples"]
    for name, values in given.items():
        assert samples[f"{name}.command"].tolist() == values.tolist()
    assert samples["slide.effort"] == pytest.approx(6.0 - 20.0 * times, abs=1e-12)
    back = scene.inverse(Result({"samples": samples}, {}))["samples"]
    assert back["pair.pull.command"] == pytest.approx(6.0 - 20.0 * times, abs=1e-9)
    assert back["pair.back.command"] == pytest.approx(0.0, abs=1e-9)


def test_two_drives_of_a_joint_have_commands_of_their_own():
    two = (
        "actuators: [{type: ideal, joints: [slide]}, {type: ideal, joints: [slide], name: aid}]\n"
    )
    scene, times = Scene.of(scene_of(two, SLIDE)), np.array([0.0, 0.1])
    columns = [Column("slide_ideal.command", times + 1.0), Column("aid.command", times + 2.0)]
    efforts = Result({"samples": Table([Column("time", times, "s"), *columns])}, {})
    samples = scene.simulate(0.1, dt=0.05, efforts=efforts)["samples"]
    assert samples["slide.effort"] == pytest.approx([3.0, 3.0, 3.2])
    assert samples["aid.command"] == pytest.approx([2.0, 2.0, 2.1])
