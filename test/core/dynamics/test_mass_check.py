"""Which masses forward dynamics needs, and what inverse dynamics does without them."""

import re

import numpy as np
import pytest

from mbd_ros.api import load_scene
from mbd_ros.cli import main
from mbd_ros.core.dynamics.mass import _least_resistance
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError, SolveError
from mbd_ros.files.tables.csv import read_table, write_table

JOINT = (
    '<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{2}"/>'
    '<origin xyz="{3}" rpy="{4}"/><axis xyz="{5}"/></joint>'
)
INERTIAL = (
    '<inertial><origin xyz="{1}"/><mass value="{0}"/>'
    '<inertia ixx="{2}" iyy="{3}" izz="{4}" ixy="0" ixz="0" iyz="0"/></inertial>'
)
ROD = INERTIAL.format(2.0, "0.1 0.05 0.3", 0.06, 0.05, 0.04)
# B. Armstrong, O. Khatib, J. Burdick, IEEE ICRA 1986; with the frames of P. Corke.
# a, d, alpha; mass, centre of mass, moments of inertia
PUMA = (
    (0.0, 0.0, np.pi / 2, 0, "0 0 0", (0, 0.35, 0)),
    (0.4318, 0.0, 0.0, 17.4, "-0.3638 0.006 0.2275", (0.13, 0.524, 0.539)),
    (0.0203, 0.15005, -np.pi / 2, 4.8, "-0.0203 -0.0141 0.070", (0.066, 0.086, 0.0125)),
    (0.0, 0.4318, np.pi / 2, 0.82, "0 0.019 0", (1.8e-3, 1.3e-3, 1.8e-3)),
    (0.0, 0.0, -np.pi / 2, 0.34, "0 0 0", (0.3e-3, 0.4e-3, 0.3e-3)),
    (0.0, 0.0, 0.0, 0.09, "0 0 0.032", (0.15e-3, 0.15e-3, 0.04e-3)),
)


def chain(folder, axes, inertials, more="", offsets=None):
    """Scene of a chain of hinges; its links are l1, l2, .. ."""
    text = '<link name="l0"/>'
    for i, (axis, inertial) in enumerate(zip(axes, inertials, strict=True), 1):
        place = "0 0 0" if offsets is None else offsets[i - 1]
        text += f'<link name="l{i}">{inertial}</link>'
        text += JOINT.format(f"j{i}", f"l{i - 1}", f"l{i}", place, "0 0 0", axis)
    (folder / "r.urdf").write_text(f'<robot name="r">{text}</robot>', encoding="utf-8")
    (folder / "s.yaml").write_text(f"robot: {{urdf: r.urdf}}\n{more}\n", encoding="utf-8")
    return folder / "s.yaml"


def puma(folder):
    """The arm with its published inertias, links by standard Denavit-Hartenberg parameters."""
    text, last = '<link name="base"/>', "base"
    for i, (a, d, alpha, mass, com, moments) in enumerate(PUMA, 1):
        text += f'<link name="turn{i}"/><link name="link{i}">'
        text += INERTIAL.format(mass, com, *moments) + "</link>"
        text += JOINT.format(f"j{i}", last, f"turn{i}", "0 0 0", "0 0 0", "0 0 1")
        place = f"{a} 0 {d}", f"{alpha} 0 0", "0 0 1"
        fixed = JOINT.format(f"f{i}", f"turn{i}", f"link{i}", *place)
        text += fixed.replace('"continuous"', '"fixed"')
        last = f"link{i}"
    (folder / "r.urdf").write_text(f'<robot name="puma">{text}</robot>', encoding="utf-8")
    (folder / "s.yaml").write_text("robot: {urdf: r.urdf}\n", encoding="utf-8")
    return folder / "s.yaml"


def called(capsys, *words):
    """Exit code, stdout and stderr."""
    code = main([str(word) for word in words])
    return code, *capsys.readouterr()


def columns(path):
    table = read_table(path)
    return dict(zip(table.columns, table.values.T, strict=True))


def motion(path, joints):
    """A smooth motion of all joints, with its derivatives."""
    t, phase = np.linspace(0.0, 0.5, 26), np.arange(len(joints))[:, None]
    names, values = ["time"], [t]
    angle, rate = 3.0 * t + phase, 3.0
    for kind, rows in (
        ("position", np.sin(angle)),
        ("velocity", rate * np.cos(angle)),
        ("acceleration", -(rate**2) * np.sin(angle)),
    ):
        names += [f"{joint}.{kind}" for joint in joints]
        values += list(rows)
    write_table(path, names, np.array(values).T)


def test_the_published_puma_is_warned_of_by_link_and_used(capsys, tmp_path):
    """Inverse dynamics takes it, forward dynamics too: its mass matrix is regular."""
    scene = puma(tmp_path)
    code, said, err = called(capsys, "check", scene)
    assert (code, err) == (0, "")
    assert re.findall(r"^warning     link '(\w+)': (.*?)[:,\n]", said, re.MULTILINE) == [
        ("link1", "inertia without mass"),
        ("link3", "inertia misses the triangle inequality"),
    ]
    joints = [f"j{i}" for i in range(1, 7)]
    motion(tmp_path / "m.csv", joints)
    words = ["inverse", scene, tmp_path / "m.csv", "-o", tmp_path / "t.csv"]
    code, said, err = called(capsys, *words)
    assert (code, err) == (0, "")
    assert said.startswith("warning: link 'link1': inertia without mass\nwarning: link 'link3': ")
    torques, loaded = columns(tmp_path / "t.csv"), load_scene(scene)
    system = loaded.system()
    for k in range(26):
        x = [np.array([torques[f"{j}.{f}"][k] for j in joints]) for f in ("position", "velocity")]
        effort = np.array([torques[f"{j}.effort"][k] for j in joints])
        a = system.evaluate(State(0.0, *x)).a + np.linalg.solve(system.mass(x[0]).dense, effort)
        wanted = [torques[f"{j}.acceleration"][k] for j in joints]
        assert a == pytest.approx(wanted, abs=1e-8)
    words = ["-t", 0.05, "-o", tmp_path / "o.csv", "--integrator", "dop853"]
    code, said, err = called(capsys, "simulate", scene, *words)
    assert (code, err) == (0, "")
    assert said.startswith("warning: link 'link1': inertia without mass\n")


MASSLESS = [
    (["0 1 0", "1 0 0"], [ROD, ""], "j2"),
    (["0 1 0", "1 0 0", "1 0 0"], [ROD, ROD, INERTIAL.format(0, "0 0 1", 0, 0, 0)], "j3"),
    (["0 1 0", "0 0 1"], [ROD, INERTIAL.format(0.5, "0 0 0.2", 0, 0, 0)], "j2"),
    (["0 1 0", "0 0 1"], [ROD, INERTIAL.format(0.5, "0 0 0.2", 1e-4, 1e-4, -1e-8)], "j2"),
]


@pytest.mark.parametrize(("axes", "inertials", "joint"), MASSLESS)
def test_a_joint_without_inertia_is_refused_forward_and_answered_inverse(
    capsys, tmp_path, axes, inertials, joint
):
    scene = chain(tmp_path, axes, inertials)
    reason = f"joint '{joint}' moves nothing that has mass: the mass matrix is singular"
    code, said, err = called(capsys, "check", scene)
    assert (code, err) == (0, "")
    assert f"forward     refused: {reason}" in said
    assert f"warning     link 'l{joint[1]}'" in said
    words = ["-t", 0.1, "-o", tmp_path / "o.csv"]
    code, _, err = called(capsys, "simulate", scene, *words)
    assert code == 2
    assert f"{scene}: {reason}" in err
    assert not (tmp_path / "o.csv").exists()
    with pytest.raises(SceneError, match=reason):
        load_scene(scene).controlled_joints()
    joints = [f"j{i + 1}" for i in range(len(axes))]
    motion(tmp_path / "m.csv", joints)
    code, _, err = called(capsys, "inverse", scene, tmp_path / "m.csv", "-o", tmp_path / "t.csv")
    assert (code, err) == (0, "")
    assert np.abs(columns(tmp_path / "t.csv")["j1.effort"]).max() > 0.1


def test_a_joint_that_is_tied_to_one_with_mass_needs_none(capsys, tmp_path):
    """G' M G is regular: the tip without mass follows the first joint."""
    tied = "couplings: {j3: {parent: j1, factor: 2.0}}"
    axes, inertials = ["0 1 0", "1 0 0", "1 0 0"], [ROD, ROD, ""]
    scene = chain(tmp_path, axes, inertials, tied)
    code, said, err = called(capsys, "check", scene)
    assert (code, err) == (0, "")
    assert "forward     reduced: " in said
    words = ["simulate", scene, "-t", 0.5, "-o", tmp_path / "o.csv"]
    assert called(capsys, *words, "--integrator", "dop853")[0] == 0
    found = columns(tmp_path / "o.csv")
    bare = chain(tmp_path, axes[:2], inertials[:2])
    assert called(capsys, "simulate", bare, *words[2:-1], tmp_path / "b.csv")[0] == 0
    other = columns(tmp_path / "b.csv")
    for joint in ("j1", "j2"):
        assert found[f"{joint}.position"] == pytest.approx(other[f"{joint}.position"], abs=1e-9)
    assert np.abs(found["j1.position"]).max() > 0.05
    scene = chain(tmp_path, axes, inertials, tied)
    code, _, err = called(capsys, *words, "--solver", "kkt")
    assert code == 2
    assert "joint 'j3' moves nothing that has mass: tier kkt starts from the mass matrix" in err


EULER = ["0 0 1", "0 1 0", "0 0 1"]


def test_axes_that_are_aligned_at_the_neutral_position_only(capsys, tmp_path):
    """Euler angles z, y, z: singular where the second is 0, and nowhere else."""
    away = "initial: {position: {j2: 0.5}, velocity: {j1: 1.0, j2: 2.0, j3: 3.0}}"
    scene = chain(tmp_path, EULER, ["", "", ROD], f"robot: x\n{away}".split("\n")[1])
    code, said, err = called(capsys, "check", scene)
    assert (code, err) == (0, "")
    assert "forward     aba: " in said
    words = ["simulate", scene, "-t", 0.3, "-o", tmp_path / "o.csv", "--integrator", "dop853"]
    code, said, err = called(capsys, *words, "--tolerance", 1e-11)
    assert (code, err) == (0, "")
    energy = columns(tmp_path / "o.csv")["energy"]
    assert np.abs(energy - energy[0]).max() <= 1e-8 * np.abs(energy).max()
    assert len(load_scene(scene).controlled_joints().names) == 3
    scene = chain(tmp_path, EULER, ["", "", ROD])
    reason = "joint 'j1', joint 'j3' can move against one another without resistance"
    code, _, err = called(capsys, *words)
    assert code == 2
    assert reason in err.replace("joint 'j3', joint 'j1'", "joint 'j1', joint 'j3'")
    assert "forward     refused: " in called(capsys, "check", scene)[1]
    assert len(load_scene(scene).controlled_joints().names) == 3


def test_a_start_from_a_file_is_judged_where_it_is(tmp_path):
    loaded = load_scene(chain(tmp_path, EULER, ["", "", ROD]))
    simulation = loaded.simulation()
    with pytest.raises(SolveError, match="without resistance"):
        simulation.start(loaded.initial)
    turned = loaded.initial._replace(q=np.array([0.1, 0.4, 0.2]))
    assert simulation.start(turned).q == pytest.approx(turned.q)


def test_inverse_of_a_loop_with_a_massless_bar(capsys, tmp_path):
    """A parallelogram whose coupler weighs nothing: its crank carries what one with mass does."""
    closed = (
        "constraints: [{type: loop_closure, frame_a: l0, point_a: [1, 0, 0], frame_b: l3, "
        "point_b: [0, 0, -1], directions: xz}]\n"
        "initial: {position: {j1: 0.3, j2: -0.3, j3: 0.3}}\nactuators: "
        "[{type: ideal, joints: [j1]}]"
    )
    bar, light = INERTIAL.format(1.0, "0 0 0.5", 0.1, 0.1, 0.01), INERTIAL
    offsets = ["0 0 0", "0 0 1", "1 0 0"]
    efforts = []
    for coupler in ("", light.format(1e-9, "0.5 0 0", 1e-10, 1e-10, 1e-10)):
        tip = INERTIAL.format(1.0, "0 0 -0.5", 0.1, 0.1, 0.01)
        scene = chain(tmp_path, ["0 1 0"] * 3, [bar, coupler, tip], closed, offsets)
        code, said, err = called(capsys, "check", scene)
        assert (code, err) == (0, ""), said
        t = np.linspace(0.0, 0.5, 26)
        names = ["time", *(f"j{i}.{k}" for k in ("position", "velocity") for i in (1, 2, 3))]
        names += [f"j{i}.acceleration" for i in (1, 2, 3)]
        turn, sign = 0.3 + 0.2 * np.sin(4 * t), np.array([1.0, -1.0, 1.0])[:, None]
        rows = [*(sign * turn), *(sign * 0.8 * np.cos(4 * t)), *(sign * -3.2 * np.sin(4 * t))]
        write_table(tmp_path / "m.csv", names, np.array([t, *rows]).T)
        words = ["inverse", scene, tmp_path / "m.csv", "-o", tmp_path / "t.csv"]
        code, said, err = called(capsys, *words)
        assert (code, err) == (0, "")
        efforts.append(columns(tmp_path / "t.csv")["j1.effort"])
    assert efforts[0] == pytest.approx(efforts[1], rel=1e-6, abs=1e-6)
    assert np.abs(efforts[0]).max() > 1.0


@pytest.mark.parametrize("n", [1, 2, 6, 30])
def test_the_motion_without_mass_is_that_of_the_smallest_eigenvalue(n):
    """Pivots instead of eigenvalues: the same direction, and an eigenvalue of the same size."""
    rng = np.random.default_rng(n)
    for least in (0.0, 1e-14, 1e-12):
        Q, _ = np.linalg.qr(rng.normal(size=(n, n)))
        values = np.concatenate([[least], rng.uniform(0.5, 2.0, n - 1)])
        M = (Q * values).dot(Q.T)
        resistance, motion = _least_resistance(M)
        assert abs(resistance - least) <= 1e-14 * n + 1e-3 * least
        assert abs(motion.dot(Q[:, 0])) == pytest.approx(1.0, abs=1e-9)
    assert _least_resistance(np.eye(n))[0] == pytest.approx(1.0)
