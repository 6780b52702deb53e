"""Learned torques without torch: files, refusals, range, and what scenes make of them."""

from time import process_time

import numpy as np
import pytest
from learned_torque import MEMBERS, content, scales, weights

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import NONE, State
from mbd_ros.errors import SceneError
from mbd_ros.features.identification.learn.onnx_file import onnx_bytes
from mbd_ros.methods.control.contract import ControlledJoints, EffortBox, Reference
from mbd_ros.methods.learned_model import SUM, ZEROS, About, numbers_of, signed
from mbd_ros.parts.controllers.computed_torque import ComputedTorque
from mbd_ros.scene.reading.learned_entries import physics_beside

onnx = pytest.importorskip("onnx", reason="onnx is optional (extra: learn)")
pytest.importorskip("onnxruntime", reason="onnxruntime is optional (extra: learned)")
POINT = [0.3, 0.0, 0.6]
TIERS = {
    ("arm7", "free"): "aba",
    ("arm7", "structured"): "dense",
    ("prosthetic_leg", "structured"): "reduced",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Models of the embedded arm and leg."""
    place = tmp_path_factory.mktemp("learned")
    for name, kind in (("arm7", "free"), ("arm7", "structured"), ("prosthetic_leg", "structured")):
        (place / f"{name}_{kind}.onnx").write_bytes(content(mbd.load_scene(name), kind))
    return place


def with_model(name, path, **more):
    entry = {"type": "learned_torque", "model": str(path), **more}
    return mbd.load_scene(name).with_(forces=[entry])


def states(m, count, seed=1, size=2.0):
    random = np.random.default_rng(seed)
    return random.uniform(-size, size, (2, count, m))


@pytest.mark.parametrize("count", [3000, pytest.param(100_000, marks=pytest.mark.soak)])
def test_a_structured_model_is_a_mechanism(folder, count):
    """M positive definite at random states; v' (M' - 2 C) v is 0; M' is the rate of M."""
    scene = with_model("prosthetic_leg", folder / "prosthetic_leg_structured.onnx")
    session = scene.forces[0]._session
    m = 3
    least, power = np.inf, 0.0
    for q, v in zip(*states(m, count), strict=True):
        (M,) = session.run(["inertia"], {"position": q, "velocity": v})
        least = min(least, float(np.linalg.eigvalsh(M)[0]))
    assert least > 0.0
    for q, v in zip(*states(m, 300, seed=2), strict=True):
        ask = lambda at, u: session.run(["torque", "inertia"], {"position": at, "velocity": u})  # noqa: E731
        (rate,) = session.run(["inertia_rate"], {"position": q, "velocity": v})
        even = 0.5 * (ask(q, v)[0] + ask(q, -v)[0])  # without friction, which is odd
        Cv = even - ask(q, 0.0 * v)[0]
        power = max(power, abs(float(v @ rate @ v - 2.0 * v @ Cv)) / max(1.0, float(v @ v)))
        h = 1e-5
        slope = (ask(q + h * v, v)[1] - ask(q - h * v, v)[1]) / (2.0 * h)
        assert np.abs(slope - rate).max() < 1e-8 * max(1.0, np.abs(rate).max())
    assert power < 1e-10


def test_friction_of_a_structured_model_takes_energy(folder):
    scene = with_model("prosthetic_leg", folder / "prosthetic_leg_structured.onnx")
    session = scene.forces[0]._session
    for q, v in zip(*states(3, 200), strict=True):
        plus, minus = (session.run(["torque"], {"position": q, "velocity": u})[0] for u in (v, -v))
        assert ((plus - minus) * v >= 0.0).all()


@pytest.mark.parametrize(
    ("name", "kind"),
    TIERS,
)
def test_forward_and_inverse_dynamics_agree(folder, name, kind):
    """Open chain and couplings: torques of the accelerations that torques make."""
    scene = with_model(name, folder / f"{name}_{kind}.onnx")
    system, solver, couplings = scene.system(), scene.inverse_dynamics(), scene.couplings
    assert system.tier == TIERS[name, kind]
    for y, rate in zip(*states(len(couplings.independent), 5), strict=True):
        q, v, a = np.zeros((3, scene.robot.model.nv))
        q[couplings.q_index], v[couplings.v_index] = y, rate
        couplings.expand(q, v, a)
        now = system.evaluate(State(0.0, q, v)).a[couplings.v_index]
        tau = solver.solve(y, rate, now).tau
        assert np.abs(tau).max() < 1e-9
        assert np.allclose(solver.batch(y[None], rate[None], now[None]).tau[0], tau, atol=1e-11)


def test_energy_of_a_free_swing_holds(folder):
    """Without friction, offset and V a structured model is an inertia: energy is constant."""
    scene = mbd.load_scene("prosthetic_leg")
    joints, m = scene.couplings.independent, 3
    made = weights("structured", m)
    made |= {"friction": np.full_like(made["friction"], -60.0), "offset": np.zeros((MEMBERS, m))}
    made["W3"][:, -1] = 0.0
    wall = np.full(2 * m, 50.0)
    said = About("structured", "leg", joints, -wall, wall, numbers_of(scene.robot))
    said = said._replace(physics=physics_beside(scene, said))
    path = folder / "conservative.onnx"
    path.write_bytes(onnx_bytes(said, made, scales(m), np.ones(m)))
    heavy = with_model("prosthetic_leg", path)
    run = heavy.simulate(duration=0.2, integrator="dopri5", tolerance=1e-9)
    energy = run["samples"]["energy"]
    assert run["samples"]["knee.velocity"].min() < -0.1
    assert np.ptp(energy) < 1e-6 * np.abs(energy).max()


def test_it_fades_outside_of_what_it_learned_from_and_says_so(folder):
    scene = with_model("arm7", folder / "arm7_free.onnx", fade=0.5)
    (part,) = scene.forces
    q, v = np.full(7, 1.0), np.zeros(7)
    inside = part.force(None, State(0.0, q, v), NONE)
    assert inside.any() and part.doubt(State(0.0, q, v)) == ""
    edge = np.array([3.0, *np.zeros(6)])
    shares = []
    for far in np.linspace(0.0, 0.6, 13):
        x = State(0.0, edge * (1.0 + far), v)
        share, spread = part.show(None, x, NONE, None)
        shares.append(share)
        assert spread > 0.0
    assert shares[0] == 1.0 and shares[-1] == shares[-2] == 0.0
    assert (np.diff(shares) <= 0.0).all() and shares[5] == pytest.approx(0.5)
    x = State(0.0, 1.25 * edge, v)
    assert "position of" in part.doubt(x) and "50 % of the learned torque acts" in part.doubt(x)
    assert not part.force(None, State(0.0, q, np.full(7, 9.0)), NONE).any()
    assert "velocity of" in part.doubt(State(0.0, q, np.full(7, 9.0)))


def damaged(data):
    return data[:5000] + bytes([data[5000] ^ 1]) + data[5001:]


def resigned(data, change, texts=(b"", b"")):
    """A file that was changed by somebody who knows how its sum is made."""
    model = onnx.load_from_string(data)
    change(model)
    for prop in model.metadata_props:
        if prop.key == SUM:
            prop.value = ZEROS
    return signed(model.SerializeToString().replace(*texts))


def versioned(data):
    return resigned(data, lambda model: None, (b'{"version": 1,', b'{"version": 9,'))


def other_numbers(data):
    """Words in the place of numbers, in a file that is whole."""
    return resigned(data, lambda model: None, (b'"gravity": [0.0,', b'"gravity": ["x",'))


def foreign_operator(data):
    """A file that is whole, with an operator that no ONNX has."""

    def change(model):
        model.graph.node[0].op_type = "RunCode"

    return resigned(data, change)


def endless(data):
    def change(model):
        node = next(node for node in model.graph.node if node.op_type == "Tanh")
        node.op_type = "Loop"

    return resigned(data, change)


def foreign_domain(data):
    def change(model):
        next(node for node in model.graph.node if node.op_type == "Tanh").domain = "com.other"

    return resigned(data, change)


def elsewhere(data):
    """Numbers of a network in a file of somebody else."""

    def change(model):
        constant = model.graph.initializer[0]
        constant.ClearField("raw_data")
        constant.data_location = onnx.TensorProto.EXTERNAL
        entry = constant.external_data.add()
        entry.key, entry.value = "location", "/dev/zero"

    return resigned(data, change)


def with_function(data):
    def change(model):
        model.functions.add().name = "Tanh"

    return resigned(data, change)


def product_of_gigabytes(data):
    """Two vectors of 200 kB whose outer product has 5 GB."""

    def change(model):
        graph, n = model.graph, 25_000
        for name, shape in (("tall", (n, 1)), ("wide", (1, n))):
            graph.initializer.append(onnx.numpy_helper.from_array(np.ones(shape), name))
        graph.node.append(onnx.helper.make_node("MatMul", ["tall", "wide"], ["huge"]))
        graph.node.append(
            onnx.helper.make_node("ReduceMean", ["huge"], ["small"], axes=[0, 1], keepdims=0)
        )
        last = next(node for node in graph.node if "torque" in node.output)
        last.output[0] = "bare"
        graph.node.append(onnx.helper.make_node("Mul", ["bare", "small"], ["torque"]))

    return resigned(data, change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (damaged, "damaged"),
        (lambda data: data[:3000], "damaged|not a file of mbd-ros learn"),
        (lambda data: b"\x80\x04\x95cos\nsystem\n", "not a file of mbd-ros learn"),
        (lambda data: b"", "not a file of mbd-ros learn"),
        (versioned, "version 9 .* accepted: 1"),
        (foreign_operator, "the network cannot be evaluated: operator 'RunCode', accepted: Add,"),
        (endless, "the network cannot be evaluated: operator 'Loop'"),
        (foreign_domain, "operator 'Tanh' of com.other, accepted"),
        (elsewhere, "has numbers that are sparse or in another file"),
        (with_function, "has functions of its own"),
        (product_of_gigabytes, "the network cannot be evaluated: .*[Mm]emory"),
        (other_numbers, "has no valid description of its model"),
    ],
)
def test_a_file_that_is_none_is_refused_by_name(folder, tmp_path, change, message):
    path = tmp_path / "model.onnx"
    path.write_bytes(change((folder / "arm7_free.onnx").read_bytes()))
    with pytest.raises(SceneError, match=f"model.onnx.*({message})"):
        with_model("arm7", path)


@pytest.mark.parametrize(
    ("name", "message"),
    [("prosthetic_leg", "another robot"), ("prosthetic_arm", "another robot")],
)
def test_the_model_of_another_robot_is_refused(folder, name, message):
    with pytest.raises(SceneError, match=f"arm7_free.onnx was learned on arm7, {message}"):
        with_model(name, folder / "arm7_free.onnx")


def test_the_model_of_other_masses_is_refused(folder):
    scene = mbd.load_scene("arm7")
    link, one = next((k, i) for k, i in reversed(scene.robot.inertias().items()) if i.mass > 0)
    other = scene.with_inertias({link: (1.2 * one.mass, one.lever, one.inertia)})
    with pytest.raises(SceneError, match=f"another inertia or place of '{link}'"):
        other.with_(forces=[{"type": "learned_torque", "model": str(folder / "arm7_free.onnx")}])


def test_beside_rigid_rows_inertia_is_refused(folder):
    anchor = {
        "type": "frame_anchor",
        "frame": "flange",
        "kind": "point",
        "position": [0.3, 0.0, 0.6],
    }
    scene = with_model("arm7", folder / "arm7_structured.onnx")
    held = scene.with_(constraints=[anchor])
    with pytest.raises(SceneError, match="adds inertia that changes with the posture"):
        held.system()


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(
        SceneError, match=r"forces\[0\].model: .*nosuch.onnx cannot be read: No such file"
    ):
        with_model("arm7", tmp_path / "nosuch.onnx")


def test_learning_without_torch_says_how_to_get_it(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    words = ["learn", "arm7", str(tmp_path / "x.csv"), "-o", str(tmp_path / "out")]
    assert main(words) == 2
    assert "torch is not installed: pip install 'mbd_ros[learn]'" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["free", "structured", "corrected"])
def test_a_sample_costs_less_than_ten_runs_of_the_network(folder, tmp_path, kind):
    """CPU time of inverse dynamics and of the bare model, by turns; the best of several rounds."""
    path = folder / f"arm7_{kind}.onnx"
    if kind == "corrected":
        arm, path = mbd.load_scene("arm7"), tmp_path / "corrected.onnx"
        bodies = {name: [1e-3] * 10 for name in numbers_of(arm.robot) if name != "gravity"}
        friction = {joint.name: [0.1, 0.2, *[1.0, 0.1] * 7] for joint in arm.robot.joints}
        more = {"friction": friction, "stiffness": {name: [1.0, 0.1] for name in friction}}
        path.write_bytes(content(arm, "structured", bodies=bodies, **more))
    scene = with_model("arm7", path)
    solver, session = scene.inverse_dynamics(), scene.forces[0]._session
    q, v, a = np.zeros(7), np.full(7, 0.1), np.ones(7)
    ours, bare = [], []
    for _ in range(20):
        begun = process_time()
        for _ in range(20):
            solver.solve(q, v, a)
        between = process_time()
        for _ in range(20):
            session.run(None, {"position": q, "velocity": v})
        ours.append(between - begun)
        bare.append(process_time() - between)
    assert min(ours) < 10.0 * min(bare)


def test_the_model_of_a_controller_has_it(folder):
    """Tracking of a reference asks the drive for the residual, too."""
    plain = mbd.load_scene("arm7")
    scene = with_model("arm7", folder / "arm7_free.onnx")
    names = [joint.name for joint in scene.robot.joints]
    laws = [
        ComputedTorque(ControlledJoints(one.system(), names), kp=100.0, kd=20.0)
        for one in (plain, scene)
    ]
    (q,), (v,) = states(7, 1)
    x, ref = State(0.0, q, v), Reference(q, v, np.ones(7))
    box = EffortBox(np.full(7, -np.inf), np.full(7, np.inf))
    bare, learned = (law.effort(x, ref, np.zeros(0), box).effort for law in laws)
    expected = -scene.forces[0].force(None, x, NONE)
    assert np.allclose(learned - bare, expected, atol=1e-9)


def test_corrections_of_inertias_are_the_inertias(folder):
    """Coupled leg: a model with corrections against the leg with other inertias, out of range too.

    Both ways of dynamics; the network gives nothing.
    """
    plain, foot = mbd.load_scene("prosthetic_leg"), "foot"
    one, center = plain.robot.inertias()[foot], [0.03, 0.01, -0.05]
    heavy = plain.with_inertias({foot: (one.mass + 0.8, center, one.inertia)})
    numbers = numbers_of(heavy.robot)[foot], numbers_of(plain.robot)[foot]
    added = np.subtract(*(values[:10] for values in numbers)).tolist()
    path = folder / "corrected.onnx"
    path.write_bytes(content(plain, half=0.2, trust=0.0, bodies={foot: added}))
    scene = with_model("prosthetic_leg", path)
    for y, rate in zip(*states(3, 5), strict=True):
        expected = heavy.inverse_dynamics().solve(y, rate, 2.0 - y).tau
        assert np.allclose(scene.inverse_dynamics().solve(y, rate, 2.0 - y).tau, expected)
        q, v, a = np.zeros((3, scene.robot.model.nv))
        q[scene.couplings.q_index], v[scene.couplings.v_index] = y, rate
        scene.couplings.expand(q, v, a)
        here, there = (one.system().evaluate(State(0.0, q, v)) for one in (scene, heavy))
        assert np.allclose(here.a, there.a)
    energy = [one.simulate(duration=0.02)["samples"]["energy"] for one in (scene, heavy)]
    assert np.allclose(*energy)


def test_corrections_of_friction_hold_everywhere(folder):
    """Offset, viscous and dry friction at ten times the range, in closed form."""
    path = folder / "rubbing.onnx"
    friction = {"joint2": [0.3, 0.5, 2.0, 0.1]}
    path.write_bytes(content(mbd.load_scene("arm7"), half=0.2, trust=0.0, friction=friction))
    (part,) = with_model("arm7", path).forces
    assert not part.has_inertia
    v = np.full(7, 2.0)
    force = part.force(None, State(0.0, np.zeros(7), v), NONE)
    expected = -(0.3 + 0.5 * 2.0 + 2.0 * np.tanh(2.0 / 0.1))
    assert np.allclose(force, [0.0, expected, *np.zeros(5)], atol=1e-12)


def test_corrections_of_stiffness_are_springs(folder):
    """Beside the same springs of the scene itself: torques and energy."""
    arm, path = mbd.load_scene("arm7"), folder / "sprung.onnx"
    path.write_bytes(content(arm, half=0.2, trust=0.0, stiffness={"joint4": [12.0, 0.4]}))
    spring = {"type": "joint_spring", "joint": "joint4", "stiffness": 12.0, "rest": 0.4}
    (learned,), (true,) = with_model("arm7", path).forces, arm.with_(forces=[spring]).forces
    (q,), (v,) = states(7, 1)
    x, k = State(0.0, q, v), Kinematics(arm.robot)
    k.refresh(q, v)
    exerted, expected = (part.force(k, x, NONE) for part in (learned, true))
    assert np.abs(expected).max() > 1.0 and np.allclose(exerted, expected, atol=1e-12)
    assert learned.potential(k, x) == pytest.approx(true.potential(k, x))


@pytest.mark.parametrize(
    ("more", "message"),
    [
        ({"stiffness": {"joint2": [1.0]}}, "needs two numbers: stiffness and rest"),
        ({"bodies": {"nosuch": [0.0] * 10}}, "no body 'nosuch'"),
        ({"bodies": {"link3": [0.0] * 9}}, "'link3' has 9 numbers, accepted: 10"),
        ({"friction": {"joint2": [0.0, 0.0, 1.0, 0.0]}}, "needs offset, viscous, then pairs"),
        ({"friction": {"nosuch": [0.0, 0.0]}}, "nosuch"),
    ],
)
def test_corrections_of_another_form_are_refused(folder, tmp_path, more, message):
    path = tmp_path / "model.onnx"
    path.write_bytes(content(mbd.load_scene("arm7"), **more))
    with pytest.raises(SceneError, match=message):
        with_model("arm7", path)


RUBBING = {"type": "gear_friction", "joint": "joint2", "coulomb": 2.0}
BEND = {"parent": "joint1", "factor": 0.5}


@pytest.mark.parametrize(
    ("learned_in", "used_in", "message"),
    [
        ({"forces": [RUBBING]}, {}, "which had force 'joint2_gear_friction'; this scene has not"),
        ({}, {"forces": [RUBBING]}, "which had no force 'joint2_gear_friction'; this scene has"),
        (
            {"forces": [RUBBING]},
            {"forces": [{**RUBBING, "coulomb": 2.5}]},
            "with another force 'joint2_gear_friction'",
        ),
        (
            {"couplings": {"joint7": BEND}},
            {"couplings": {"joint7": {**BEND, "factor": 0.6}}},
            "with another coupling of 'joint7'",
        ),
    ],
)
def test_the_model_of_other_forces_and_couplings_is_refused(
    tmp_path, learned_in, used_in, message
):
    """And taken by the scene that it was learned on, whatever its forces are called there."""
    arm, path = mbd.load_scene("arm7"), tmp_path / "model.onnx"
    own = arm.with_(**learned_in)
    path.write_bytes(content(own))
    entry = {"type": "learned_torque", "model": str(path)}
    renamed = [{**one, "name": "belt"} for one in learned_in.get("forces", ())]
    own.with_(forces=[entry, *renamed])
    other = arm.with_(**{key: value for key, value in used_in.items() if key != "forces"})
    with pytest.raises(SceneError, match=f"model.onnx was learned on arm7, {message}"):
        other.with_(forces=[*used_in.get("forces", ()), entry])
