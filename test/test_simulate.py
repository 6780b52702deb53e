"""`mbd-ros simulate` as a user meets it: files, summary, exit codes, what is left."""

import re
from pathlib import Path

import numpy as np
import pytest

from mbd_ros.bags import messages
from mbd_ros.cli import main
from mbd_ros.scene import load_scene
from mbd_ros.tables import read_table, write_table

ROOT = Path(__file__).parents[1]
SCENES = ROOT / "config/scenes"
DRIVEN = """\
robot: {{urdf: {robots}/prosthetic_arm.urdf}}
couplings: {{elbow: {{parent: shoulder_flexion, factor: 1.5, offset: 0.1}}}}
actuators: [{{type: ideal, joints: [shoulder_flexion]}}]
"""


def called(capsys, *words):
    """Exit code, stdout and stderr."""
    code = main([str(word) for word in words])
    return code, *capsys.readouterr()


def columns(path):
    table = read_table(path)
    return dict(zip(table.columns, table.values.T, strict=True))


@pytest.fixture
def driven(tmp_path):
    file = tmp_path / "driven.yaml"
    file.write_text(DRIVEN.format(robots=ROOT / "config/robots"), encoding="utf-8")
    return file


def test_table_holds_motion_multipliers_energy_and_drift(capsys, tmp_path):
    out = tmp_path / "out.csv"
    code, said, err = called(
        capsys, "simulate", SCENES / "four_bar_leg.yaml", "-t", 0.1, "-o", out
    )
    assert (code, err) == (0, "")
    table = columns(out)
    joints = [joint.name for joint in load_scene(SCENES / "four_bar_leg.yaml").robot.joints]
    fields = ("position", "velocity", "acceleration", "effort")
    expected = ["time", *(f"{j}.{f}" for f in fields for j in joints)]
    assert list(table)[: len(expected)] == expected
    rest = list(table)[len(expected) :]
    assert rest[-3:] == ["energy", "drift.position", "drift.velocity"]
    assert [name.rpartition(".")[2] for name in rest[:-3]] == ["multiplier"] * 2
    assert table["time"] == pytest.approx(np.linspace(0.0, 0.1, 101), abs=1e-12)
    assert table["drift.position"].max() <= 1e-12
    rates = np.gradient(table["hip_flexion.position"], table["time"])
    assert rates[1:-1] == pytest.approx(table["hip_flexion.velocity"][1:-1], abs=1e-3)
    assert re.search(r"Dopri5, tier kkt: 100 steps, 600 evaluations \(6\.00 a step\)", said)
    assert re.search(r"real-time factor \d", said)
    assert re.search(r"energy -?\d.* J, largest change", said)
    assert re.search(r"largest drift: position \d", said)
    assert said.endswith(f"101 states -> {out}\n")


def test_toggle_is_said(capsys, tmp_path):
    """Both four-bars stretch at 0.71436 s; the condition number grows as 1 / distance."""
    scene = SCENES / "benchmark/a02_four_bars_2.yaml"
    words = ["-t", 0.8, "-o", tmp_path / "out.csv", "--dt"]
    said = called(capsys, "simulate", scene, *words, 1e-3)[1]
    (found,) = re.findall(r"rows up to (\S+), at t = (\S+) s$", said, flags=re.MULTILINE)
    assert float(found[1]) == pytest.approx(0.7143555, abs=1e-3)
    assert 1e2 < float(found[0]) < 1e6


def test_bag_holds_the_same(capsys, tmp_path):
    scene = SCENES / "four_bar_leg.yaml"
    called(capsys, "simulate", scene, "-t", 0.05, "-o", tmp_path / "out.csv")
    code, _, _ = called(capsys, "simulate", scene, "-t", 0.05, "-o", tmp_path / "bag")
    assert code == 0
    table = columns(tmp_path / "out.csv")
    kinds = {
        "/joint_states": "sensor_msgs/msg/JointState",
        "/constraint_forces": "sensor_msgs/msg/JointState",
        "/energy_and_drift": "std_msgs/msg/Float64MultiArray",
    }
    found = {topic: [] for topic in kinds}
    for topic, _, message in messages(tmp_path / "bag", kinds):
        found[topic].append(message)
    assert [len(each) for each in found.values()] == [51, 51, 51]
    last = found["/joint_states"][-1]
    for name, position in zip(last.name, last.position, strict=True):
        assert position == table[f"{name}.position"][-1]
    force = found["/constraint_forces"][-1]
    for name, effort in zip(force.name, force.effort, strict=True):
        assert effort == table[f"{name}.multiplier"][-1]
    assert found["/energy_and_drift"][-1].data[0] == table["energy"][-1]


def test_inverse_dynamics_of_the_output_returns_the_commands(capsys, tmp_path, driven):
    """Forward, then `inverse` on the file: the commanded torque comes back."""
    times = np.linspace(0.0, 0.5, 51)
    commands = np.column_stack([times, 3.0 * np.sin(9.0 * times)])
    write_table(tmp_path / "u.csv", ["time", "shoulder_flexion.effort"], commands)
    out, back = tmp_path / "out.csv", tmp_path / "back.csv"
    words = ["-t", 0.5, "-o", out, "--efforts", tmp_path / "u.csv", "--dt", 0.01]
    assert called(capsys, "simulate", driven, *words, "--integrator", "dop853")[0] == 0
    assert called(capsys, "inverse", driven, out, "-o", back)[0] == 0
    simulated, found = columns(out), columns(back)
    assert simulated["shoulder_flexion.effort"] == pytest.approx(commands[:, 1], abs=1e-15)
    assert found["shoulder_flexion.effort"] == pytest.approx(commands[:, 1], abs=1e-9)
    assert found["elbow.multiplier"] == pytest.approx(simulated["elbow.multiplier"], abs=1e-9)
    for joint in load_scene(driven).couplings.independent:
        if joint != "shoulder_flexion":
            assert np.abs(found[f"{joint}.effort"]).max() <= 1e-9


@pytest.mark.parametrize(
    "options",
    [
        ("--integrator", "rk4", "--dt", 5e-4),
        ("--integrator", "dop853", "--tolerance", 1e-10),
        ("--solver", "kkt"),
        ("--solver", "qp"),
    ],
)
def test_options_take_the_place_of_the_scene(capsys, tmp_path, options):
    scene = SCENES / "prosthetic_arm.yaml"
    called(capsys, "simulate", scene, "-t", 0.2, "-o", tmp_path / "a.csv")
    code, _, err = called(capsys, "simulate", scene, "-t", 0.2, "-o", tmp_path / "b.csv", *options)
    assert (code, err) == (0, "")
    a, b = columns(tmp_path / "a.csv"), columns(tmp_path / "b.csv")
    for name in a:
        if name.endswith((".position", ".multiplier")):
            assert b[name][-1] == pytest.approx(a[name][-1], abs=1e-7)


def test_simulation_continues_from_a_file(capsys, tmp_path):
    scene, whole, half = SCENES / "prosthetic_arm.yaml", tmp_path / "w.csv", tmp_path / "h.csv"
    called(capsys, "simulate", scene, "-t", 0.2, "-o", whole)
    words = ["-t", 0.1, "-o", half, "--from", whole, "--start", 0.1]
    assert called(capsys, "simulate", scene, *words)[0] == 0
    a, b = columns(whole), columns(half)
    assert b["time"][0] == pytest.approx(0.1)
    assert b["elbow.position"] == pytest.approx(a["elbow.position"][100:], abs=1e-12)


def test_divergence_exits_with_1_and_keeps_what_was_reached(capsys, tmp_path):
    scene = tmp_path / "stiff.yaml"
    scene.write_text(
        f"robot: {{urdf: {ROOT / 'config/robots/pendulum.urdf'}}}\n"
        "forces: [{type: joint_spring, joint: hinge, stiffness: 1e9}]\n"
        "initial: {position: {hinge: 0.1}}\nintegrator: {type: rk4}\ndt: 0.1\n",
        encoding="utf-8",
    )
    out = tmp_path / "out.csv"
    code, said, err = called(capsys, "simulate", scene, "-t", 100, "-o", out)
    assert (code, said) == (1, "")
    assert re.search(r"diverged at t = .*; last finite state at t = .*: fastest joint hinge", err)
    assert str(tmp_path / "out.diverged.csv") in err
    assert not out.exists()
    kept = read_table(tmp_path / "out.diverged.csv")
    assert len(kept.values) > 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-t", -1), "duration -1 s must be > 0"),
        (("-t", "nan"), "duration nan s must be > 0"),
        (("-t", 1, "--integrator", "euler"), "integrator.type: unknown type 'euler', accepted: "),
        (("-t", 1, "--dt", 0), "dt 0 s must be > 0"),
        (("-t", 1, "--tolerance", 1e-6), "--tolerance goes with --integrator"),
        (("-t", 1, "--integrator", "rk4", "--tolerance", 1e-6), "unknown key 'tolerance'"),
        (("-t", 1, "--solver", "aba"), "solver: solver aba takes no rows, the scene has elbow"),
        (("-t", 1, "--from", "no.csv"), "no.csv: cannot be read"),
        (("-t", 1, "--efforts", "no.csv"), "no.csv: cannot be read"),
    ],
)
def test_bad_input_exits_with_2_and_leaves_nothing(capsys, tmp_path, driven, words, message):
    code, said, err = called(capsys, "simulate", driven, *words, "-o", tmp_path / "out.csv")
    assert (code, said) == (2, "")
    assert message in err
    assert [p.name for p in tmp_path.iterdir()] == ["driven.yaml"]


def test_state_that_is_not_in_the_file_is_named(capsys, tmp_path, driven):
    called(capsys, "simulate", driven, "-t", 0.01, "-o", tmp_path / "o.csv")
    words = ["-t", 1, "-o", tmp_path / "p.csv", "--from", tmp_path / "o.csv", "--start", 7]
    code, _, err = called(capsys, "simulate", driven, *words)
    assert code == 2
    assert "o.csv: no sample at 7 s; it holds 0 .. 0.01 s" in err


def test_commands_that_lack_are_named(capsys, tmp_path, driven):
    write_table(tmp_path / "u.csv", ["time", "elbow.effort"], np.array([[0.0, 1.0], [1.0, 1.0]]))
    words = ["-t", 1, "-o", tmp_path / "p.csv", "--efforts", tmp_path / "u.csv"]
    code, _, err = called(capsys, "simulate", driven, *words)
    assert code == 2
    assert "u.csv: no column <joint>.effort of shoulder_flexion" in err


def test_stored_gait_simulation_is_reproduced(data_dir, tmp_path):
    """OpenSim's forward simulation of a walking human with sliding knees, 1 kHz."""
    folder = data_dir / "gait10dof_forward"
    motion, wrenches = folder / "motion.csv.gz", folder / "external_wrenches.csv.gz"
    words = ["simulate", folder / "scene.yaml", "-t", 0.05, "-o", tmp_path / "out.csv", "--from"]
    words += [motion, "--start", 0.5, "--efforts", motion, "--wrenches", wrenches]
    assert main([str(word) for word in words]) == 0
    ours, stored = columns(tmp_path / "out.csv"), columns(motion)
    row = int(np.argmin(np.abs(stored["time"] - 0.55)))
    first = int(np.argmin(np.abs(stored["time"] - 0.5)))
    free = load_scene(folder / "scene.yaml").couplings.independent
    for joint in free:
        assert abs(ours[f"{joint}.position"][-1] - stored[f"{joint}.position"][row]) <= 5e-5
        error = ours[f"{joint}.acceleration"][0] - stored[f"{joint}.acceleration"][first]
        assert abs(error) <= 3e-3
