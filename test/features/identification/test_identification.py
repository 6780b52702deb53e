"""Identification: base parameters, consistent bodies, friction, and what is refused."""

import time

import numpy as np
import pinocchio as pin
import pytest
from identification_data import flown, fourier, moved, others, recording

from mbd_ros.api import Scene, load_scene, scene_from
from mbd_ros.cli import main
from mbd_ros.core.model.inertial_parameters import (
    is_consistent,
    moving_bodies,
    parameters_of,
)
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.errors import DataError
from mbd_ros.features.identification.job import identify
from mbd_ros.features.identification.regressor import (
    Regressor,
    base_parameters,
    format_expressions,
    random_states,
)
from mbd_ros.motion.recordings import read_motion

pytest.importorskip("clarabel", reason="clarabel is optional (extra: identification)")
LEG = """<robot name="two_links">
 <link name="ground"/>
 <link name="thigh"><inertial><origin xyz="0 0 -0.2"/><mass value="8"/>
  <inertia ixx="0.1" iyy="0.1" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial></link>
 <link name="shank"><inertial><origin xyz="0 0 -0.15"/><mass value="3"/>
  <inertia ixx="0.04" iyy="0.04" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
 <joint name="hip" type="revolute"><parent link="ground"/><child link="thigh"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="10" effort="100"/></joint>
 <joint name="knee" type="revolute"><parent link="thigh"/><child link="shank"/>
  <origin xyz="0 0 -0.4"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" velocity="10" effort="100"/></joint>
</robot>"""


def base_of(scene):
    """Base parameters, and rows of 1 000 random states."""
    regressor = Regressor(scene.robot, scene.inverse_dynamics())
    states = random_states(scene.robot, scene.couplings, 1000)
    rows = regressor.rows(*states).reshape(-1, regressor.size)
    return base_parameters(rows), rows


@pytest.mark.parametrize(
    ("name", "known"), [("arm7", 43), ("prosthetic_arm", None), ("prosthetic_leg", None)]
)
def test_there_are_as_many_base_parameters_as_random_states_have_ranks(name, known):
    """43 of a 7-joint arm with a vertical first axis: Khalil, Dombre, 2002, section 9.4."""
    base, rows = base_of(load_scene(name))
    size = np.linalg.norm(rows, axis=0)
    seen = size > 1e-9 * size.max()
    assert len(base.chosen) == np.linalg.matrix_rank(rows[:, seen] / size[seen], tol=1e-8)
    assert known is None or len(base.chosen) == known
    assert np.allclose(rows, rows[:, base.chosen] @ base.matrix, atol=1e-9 * size.max())


def test_base_parameters_of_a_leg_are_those_of_the_textbook():
    """m1 c1 + m2 l, I1 + m1 c1^2 + m2 l^2, m2 c2, I2 + m2 c2^2 and the parts across."""
    scene = scene_from({}, urdf=LEG)
    base, _ = base_of(scene)
    names = [body.name for body in moving_bodies(scene.robot)]
    found = format_expressions(base, names)
    about = "shank.Iyy + shank.mass (shank.cx^2 + shank.cz^2)"
    assert found == [
        "thigh.mass thigh.cx",
        "thigh.mass thigh.cz - 0.4 shank.mass",
        "thigh.Iyy + thigh.mass (thigh.cx^2 + thigh.cz^2) + 0.16 shank.mass",
        "shank.mass shank.cx",
        "shank.mass shank.cz",
        about,
    ]
    values = base.values(parameters_of(scene.robot.model).ravel())
    assert values == pytest.approx([0, -2.8, 0.1 + 0.32 + 0.48, 0, -0.45, 0.04 + 0.0675])


@pytest.mark.parametrize("name", ["arm7", "prosthetic_arm", "prosthetic_leg"])
def test_without_noise_base_parameters_are_exact(name):
    scene = load_scene(name)
    if scene.wrenches:
        scene = scene.with_(external_wrenches=None)
    true, t = others(scene), np.arange(0.0, 15.0, 0.01)
    found = identify(scene, moved(scene, true, t))
    base = base_of(scene)[0]
    expected = base.values(parameters_of(true.robot.model).ravel())
    table = found.tables["base_parameters"]
    assert np.abs(table["estimate"] - expected).max() < 1e-8
    assert found.tables["friction"].rows == 0
    assert found.errors["identified"] < 1e-4 < found.errors["given"]
    bodies = parameters_of(found.scene.robot.model)
    assert all(is_consistent(numbers) for numbers in bodies if numbers[0] > 0.0)


def test_a_four_bar_is_weighed_by_the_joints_that_drive_it():
    """Torques by the solver for closed loops with multipliers, which knows no regressor."""
    scene = Scene.of(load_scene("four_bar_leg"))
    true, driven = others(scene, shift=0.002), ["hip_flexion", "knee_anterior", "ankle"]
    t = np.arange(0.0, 10.0, 0.02)
    q, v, a = fourier(3, t, 1, amplitude=0.15)
    q = q + np.array([0.3, -0.75, 0.0])
    moving = Scene.of(true).with_(actuators=[{"type": "ideal", "joints": driven}])
    solved = moving.inverse(recording(driven, t, position=q, velocity=v, acceleration=a))
    every = scene.couplings.independent
    fields = {
        field: np.transpose([solved["samples"][f"{name}.{field}"] for name in every])
        for field in ("position", "velocity", "acceleration")
    }
    effort = np.full_like(fields["position"], np.nan)
    for name in driven:
        effort[:, every.index(name)] = solved["samples"][f"{name}.effort"]
    found = identify(scene, recording(every, t, **fields, effort=effort))
    known = identify(true, recording(every, t, **fields, effort=effort))
    table, expected = (one.tables["base_parameters"] for one in (found, known))
    assert table.rows == 14
    assert np.abs(table["estimate"] - expected["given"]).max() < 1e-8


def test_a_body_that_floats_is_weighed_by_what_carries_it():
    """No effort of any joint: the six rows of the base and a measured wrench."""
    entries = {
        "robot": {"base": "floating"},
        "external_wrenches": {"push": {"frame": "trunk", "expressed_in": "trunk"}},
    }
    scene = scene_from(entries, urdf="free_flyer")
    true = others(scene)
    motion, loads = flown(scene, true, np.arange(0.0, 12.0, 0.01))
    found = identify(scene, motion, wrenches=loads)
    base = identify(true, motion, wrenches=loads).tables["base_parameters"]
    table = found.tables["base_parameters"]
    assert table.rows >= 20
    assert np.abs(table["estimate"] - base["given"]).max() < 1e-8
    mass = pin.computeTotalMass(true.robot.model)
    assert found.tables["bodies"]["mass"].sum() == pytest.approx(mass, rel=1e-4)


def test_couplings_left_out_are_missed_and_the_tendon_force_is_predicted():
    """A body-powered arm: its elbow follows the shoulder by a tendon."""
    scene = load_scene("prosthetic_arm")
    true, t, noise = others(scene), np.arange(0.0, 20.0, 0.01), 0.05
    data = moved(scene, true, t, noise=noise)
    found = identify(scene, data)
    assert found.errors["identified as measured"] < 0.03
    q, v, a = fourier(len(scene.couplings.independent), t, 5)
    solvers = [one.inverse_dynamics() for one in (true, found.scene)]
    forces = [solver.batch(q, v, a, []).multipliers for solver in solvers]
    assert np.sqrt(np.mean((forces[0] - forces[1]) ** 2)) < noise
    free = scene.with_(couplings=None)
    names = free.couplings.independent
    solved = {field: np.zeros((len(t), len(names))) for field in ("position", "velocity")}
    solved |= {field: np.zeros((len(t), len(names))) for field in ("acceleration", "effort")}
    for i, name in enumerate(names):
        for field, values in solved.items():
            column = f"{name}.{field}"
            source = name if column in data["samples"] else "shoulder_flexion"
            factor = 1.0 if source == name else 1.75
            if source == name or field != "effort":
                values[:, i] = factor * data["samples"][f"{source}.{field}"]
    solved["position"][:, names.index("elbow")] += 0.175
    solved["effort"][0, names.index("elbow")] = 1e-9  # measured, and nearly 0
    missed = identify(free, recording(names, t, **solved), partial=True)
    assert missed.errors["identified"] > 5.0 * found.errors["identified"]


def test_friction_of_a_joint_is_chosen_and_found():
    """Two joints that rub in different ways, one that does not: names and values."""
    bare = scene_from({}, urdf="arm7")
    names, t = bare.couplings.independent, np.arange(0.0, 30.0, 0.005)
    rubbing = [
        {"type": "gear_friction", "joint": names[0], "coulomb": 3.0, "viscous": 2.0},
        {"type": "gear_friction", "joint": names[1], "coulomb": 1.5, "offset": 0.7},
    ]
    rubbing = [{**entry, "smoothing": 0.03} for entry in rubbing]
    true = others(bare).with_(forces=rubbing)
    found = identify(bare, moved(bare, true, t, noise=0.05, amplitude=0.4))
    table = found.tables["friction"]
    rows = {str(name): i for i, name in enumerate(table["joint"])}
    assert set(rows) >= {names[0], names[1]}
    assert table["coulomb"][rows[names[0]]] == pytest.approx(3.0, abs=0.1)
    assert table["viscous"][rows[names[0]]] == pytest.approx(2.0, abs=0.1)
    assert table["coulomb"][rows[names[1]]] == pytest.approx(1.5, abs=0.1)
    assert table["offset"][rows[names[1]]] == pytest.approx(0.7, abs=0.05)
    rest = [i for name, i in rows.items() if name not in names[:2]]
    assert np.abs(table["coulomb"][rest]).max(initial=0.0) < 0.1


def test_a_delay_of_the_efforts_is_found_and_said():
    scene = scene_from({}, urdf="arm7")
    names, t = scene.couplings.independent, np.arange(0.0, 20.0, 0.004)
    q, v, a = fourier(7, t, 1)
    late = fourier(7, t - 0.05, 1)
    tau = scene.inverse_dynamics().batch(*late, []).tau
    said = []
    data = recording(names, t, position=q, velocity=v, acceleration=a, effort=tau)
    found = identify(scene, data, say=said.append)
    assert found.delay == pytest.approx(0.05, abs=5e-4)
    assert any("50" in line and "later" in line for line in said)


def changed(data, names, field, change):
    """A recording whose column of each joint is changed."""
    samples = data["samples"]
    columns = [
        column._replace(values=change(column.values))
        if column.name in {f"{name}.{field}" for name in names}
        else column
        for column in samples.columns
    ]
    return type(data)({"samples": type(samples)(columns)})


def short(data):
    """Every tenth sample of the first 1.5 s."""
    samples = data["samples"].first(150)
    rows = [column._replace(values=column.values[::10]) for column in samples.columns]
    return type(data)({"samples": type(samples)(rows)})


BAD = {
    "no effort": (lambda d, n: changed(d, n, "effort", lambda x: x * np.nan), "no effort of"),
    "zeros": (lambda d, n: changed(d, n[:1], "effort", lambda x: 0.0 * x), "is 0 in every"),
    "currents": (lambda d, n: changed(d, n, "effort", lambda x: 0.08 * x), "currents"),
    "another sign": (lambda d, n: changed(d, n, "effort", lambda x: -x), "of the other sign"),
    "too short": (lambda d, n: short(d), "too short"),
    "in phase": (lambda d, n: in_phase(n), "in one phase, does not show .*link1"),
    "a joint at rest": (lambda d, n: rested(d, n[3]), "moves by only 0"),
}


def in_phase(names):
    """All joints by one sine, without noise."""
    t, scene = np.arange(0.0, 10.0, 0.01), scene_from({}, urdf="arm7")
    far, w = np.array([0.7, 0.6, 0.9, 0.7, 0.6, 1.0, 0.7]), 2.5
    q = np.outer(np.sin(w * t), far) + 0.3
    v, a = np.outer(w * np.cos(w * t), far), np.outer(-(w**2) * np.sin(w * t), far)
    tau = scene.inverse_dynamics().batch(q, v, a, []).tau
    return recording(names, t, position=q, velocity=v, acceleration=a, effort=tau)


def rested(data, name):
    for field in ("position", "velocity", "acceleration"):
        data = changed(data, [name], field, lambda x: 0.0 * x)
    return data


@pytest.mark.parametrize("case", BAD)
def test_recordings_that_say_nothing_are_refused_with_the_reason(case):
    scene, t = scene_from({}, urdf="arm7"), np.arange(0.0, 10.0, 0.01)
    data, names = moved(scene, scene, t), scene.couplings.independent
    spoil, said = BAD[case]
    with pytest.raises(DataError, match=said):
        identify(scene, spoil(data, names))


def test_a_joint_at_rest_is_named_with_what_it_hides():
    scene, t = scene_from({}, urdf="arm7"), np.arange(0.0, 10.0, 0.01)
    data = rested(moved(scene, scene, t), scene.couplings.independent[3])
    with pytest.raises(DataError, match=r"link4\.mass link4\.cx"):
        identify(scene, data)


def test_currents_become_torques_by_gains_and_a_lost_sample_is_no_matter():
    scene, t = scene_from({}, urdf="arm7"), np.arange(0.0, 12.0, 0.01)
    names, true = scene.couplings.independent, others(scene)
    currents = changed(moved(scene, true, t, noise=0.01), names, "effort", lambda x: x / 20.0)
    lost = changed(currents, names[2:3], "effort", lambda x: np.where(t == t[400], np.nan, x))
    found = identify(scene, lost, gains=dict.fromkeys(names, 20.0))
    assert found.errors["identified"] < 2e-3 < 0.02 < found.errors["given"]
    assert any("1 samples without an effort" in line for line in found.remarks)
    with pytest.raises(DataError, match="no such joint"):
        identify(scene, currents, gains={"elbow": 1.0})


CART = """<robot name="cart"><link name="rail"/><link name="cart"/><link name="pole"/>
 <joint name="slide" type="prismatic"><parent link="rail"/><child link="cart"/>
  <axis xyz="1 0 0"/><limit lower="-2" upper="2" velocity="2" effort="100"/></joint>
 <joint name="hinge" type="continuous"><parent link="cart"/><child link="pole"/>
  <axis xyz="0 1 0"/></joint></robot>"""


def test_a_description_without_any_mass_gets_its_masses_from_the_motion():
    """As a prosthesis without a drawing: what moves is weighed, whatever nothing was known of."""
    scene, t = scene_from({}, urdf=CART), np.arange(0.0, 12.0, 0.01)
    cart, pole = np.diag([0.1, 0.1, 0.1]), np.diag([0.1, 0.1, 0.01])
    true = scene.with_inertias({"cart": (5.0, [0, 0, 0], cart), "pole": (1.2, [0, 0, 0.5], pole)})
    found = identify(scene, moved(scene, true, t, noise=0.02, amplitude=0.3))
    table = found.tables["base_parameters"]
    assert table["consistent"] == pytest.approx([6.2, 0.0, 0.6, 0.4], abs=0.02)
    assert found.errors["identified"] < 2e-3


@pytest.mark.soak
def test_a_million_samples_take_a_minute_of_one_core():
    scene, t = scene_from({}, urdf="arm7"), np.arange(10**6) * 1e-3
    names = scene.couplings.independent
    q, v, a = fourier(7, t, 1, frequency=0.1, amplitude=0.4)
    tau = others(scene).inverse_dynamics().batch(q, v, a, []).tau + np.tanh(v / 0.02)
    data = recording(names, t, position=q, velocity=v, effort=tau)
    before = time.process_time()
    found = identify(scene, data)
    assert time.process_time() - before < 60.0
    assert found.errors["identified"] < 0.01


def test_joints_that_lack_are_named(tmp_path, capsys):
    scene = load_scene("arm7")
    names, t = scene.couplings.independent, np.arange(0.0, 10.0, 0.01)
    q, v, a = fourier(7, t, 1)
    data = recording(names[:-1], t, position=q, velocity=v, acceleration=a, effort=q)
    data.to(tmp_path / "motion.csv")
    words = ["identify", "arm7", str(tmp_path / "motion.csv"), "-o", str(tmp_path / "out")]
    assert main(words) == 2
    assert names[-1] in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_command_writes_a_scene_that_explains_the_recording(tmp_path, capsys):
    scene, t = load_scene("arm7"), np.arange(0.0, 12.0, 0.01)
    moved(scene, others(scene), t, noise=0.02).to(tmp_path / "motion.csv")
    out = tmp_path / "out"
    assert main(["identify", "arm7", str(tmp_path / "motion.csv"), "-o", str(out)]) == 0
    assert "43 base parameters" in capsys.readouterr().out
    page = (out / "report.html").read_text(encoding="utf-8")
    assert "link7.Izz" in page and "data:image/png" in page
    read = read_robot((out / "identified.urdf").read_text(encoding="utf-8"))
    assert pin.computeTotalMass(read.model) > 0.0
    result = Scene.of(load_scene(out / "scene.yaml")).inverse(str(tmp_path / "motion.csv"))
    given = recording_of(tmp_path / "motion.csv", scene.couplings.independent)
    found = np.transpose([result["samples"][f"{n}.effort"] for n in scene.couplings.independent])
    assert np.sqrt(np.mean((found - given) ** 2)) < 0.025


def recording_of(path, names):
    return read_motion(path, names).motion.effort
