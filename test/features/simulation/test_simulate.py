"""`mbd-ros simulate` as a user meets it: files, summary, exit codes, what is left."""

import re

import numpy as np
import pytest
from places import RECORDINGS, ROOT

from mbd_ros.api import load_scene
from mbd_ros.cli import main
from mbd_ros.features.simulation.job import diverged_place
from mbd_ros.files.bags.bag_reader import messages
from mbd_ros.files.table import read_result
from mbd_ros.files.tables.csv import read_table, write_table
from mbd_ros.motion.recordings import read_motion

SCENES = ROOT / "config/scenes"
DRIVEN = """\
robot: {{urdf: {robots}/prosthetic_arm.urdf}}
couplings: {{elbow: {{parent: shoulder_flexion, factor: 1.5, offset: 0.1}}}}
actuators: [{{type: ideal, joints: [shoulder_flexion]}}]
"""

STIFF = (
    f"robot: {{urdf: {ROOT / 'config/robots/pendulum.urdf'}}}\n"
    "forces: [{type: joint_spring, joint: hinge, stiffness: 1e9}]\n"
    "initial: {position: {hinge: 0.1}}\nintegrator: {type: rk4}\ndt: 0.1\n"
)


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


def test_table_holds_motion_multipliers_energy_and_violations(capsys, tmp_path):
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
    assert [name.rpartition(".")[2] for name in rest[:-3]] == ["force_x", "force_z"]
    assert table["time"] == pytest.approx(np.linspace(0.0, 0.1, 101), abs=1e-12)
    assert table["drift.position"].max() <= 1e-12
    rates = np.gradient(table["hip_flexion.position"], table["time"])
    assert rates[1:-1] == pytest.approx(table["hip_flexion.velocity"][1:-1], abs=1e-3)
    assert re.search(r"Dopri5, tier kkt: 100 steps, 600 evaluations \(6\.00 a step\)", said)
    assert re.search(r"real-time factor \d", said)
    assert re.search(r"energy -?\d.* J, largest change", said)
    assert re.search(r"largest violation: position \d", said)
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
        assert effort == table[name][-1]
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


@pytest.mark.parametrize(
    ("out", "kept"),
    [
        ("dv.csv", "dv.diverged.csv"),
        ("dv.csv.gz", "dv.diverged.csv.gz"),
        ("d.v.csv.gz", "d.v.diverged.csv.gz"),
        ("dv.mcap", "dv.diverged.mcap"),
        ("dv.db3", "dv.diverged.db3"),
        ("dvbag", "dvbag_diverged"),
    ],
)
def test_divergence_exits_with_1_and_keeps_what_was_reached(capsys, tmp_path, out, kept):
    scene = tmp_path / "stiff.yaml"
    scene.write_text(STIFF, encoding="utf-8")
    out, kept = tmp_path / out, tmp_path / kept
    code, said, err = called(capsys, "simulate", scene, "-t", 100, "-o", out)
    assert (code, said) == (1, "")
    assert re.search(r"diverged at t = .*; last finite state at t = .*: fastest joint hinge", err)
    assert err.endswith(f"states so far are in {kept}\n")
    assert not out.exists()
    position = read_result(kept)["samples"]["hinge.position"]
    assert len(position) > 1
    assert position[0] == pytest.approx(0.1)


def test_a_divergence_that_cannot_be_kept_still_says_why(capsys, tmp_path):
    scene = tmp_path / "stiff.yaml"
    scene.write_text(STIFF, encoding="utf-8")
    (tmp_path / "o.diverged.csv").mkdir()
    code, _, err = called(capsys, "simulate", scene, "-t", 100, "-o", tmp_path / "o.csv")
    assert code == 1
    assert re.search(r"diverged at t = .*; the states so far are lost: .*o\.diverged\.csv", err)


def test_divergence_is_kept_beside_a_folder_with_a_point_in_its_name(tmp_path):
    (tmp_path / "run.v1").mkdir()
    assert diverged_place(tmp_path / "run.v1") == tmp_path / "run_v1_diverged"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("-t", -1), "-t: -1 s must be finite and > 0"),
        (("-t", "nan"), "-t: nan s must be finite and > 0"),
        (("-t", "inf"), "-t: inf s must be finite and > 0"),
        (("-t", 1, "--integrator", "rk45"), "te: --integrator: unknown type 'rk45', accepted: "),
        (("-t", 1, "--solver", "kktt"), "te: --solver: unknown solver type 'kktt', accepted: "),
        (("-t", 1, "--dt", 0), "--dt: 0 s must be finite and > 0"),
        (("-t", 1, "--dt", -1), "--dt: -1 s must be finite and > 0"),
        (("-t", 1, "--dt", "inf"), "--dt: inf s must be finite and > 0"),
        (("-t", 1, "--dt", "nan"), "--dt: nan s must be finite and > 0"),
        (("-t", 1, "--dt", 1e-310), "--dt: 1e-310 s, accepted: 1e-09 .. 9e+09 s, since stamps"),
        (("-t", 1e-7, "--dt", 9.9e-10), "--dt: 9.9e-10 s, accepted: 1e-09 .. 9e+09 s"),
        (("-t", 1, "--dt", 1e300), "--dt: 1e+300 s, accepted: 1e-09 .. 9e+09 s"),
        (("-t", 1e-15), "-t: 1e-15 s, accepted: 1e-09 .. 9e+09 s"),
        (("-t", 1e300), "-t: 1e+300 s, accepted: 1e-09 .. 9e+09 s"),
        (("-t", 8e9, "--start", 8e9), "--start: 8e+09 s must be finite, and the end within"),
        (("-t", 1e5), "SCENE: dt: 0.001 s: 1e+08 rows in -t 100000 s, accepted are 1e+07"),
        (("-t", 1, "--start", "nan"), "--start: nan s must be finite"),
        (("-t", 1, "--start", "inf"), "--start: inf s must be finite"),
        (("-t", 1, "--start", 1e17), "--start: 1e+17 s must be finite, and the end within"),
        (("-t", 1, "--start", 8e9, "--dt", 1e-7), "--dt: 1e-07 s is lost in rounding"),
        (("-t", 1, "--wrenches", "no.csv"), "no.csv: SCENE has no external_wrenches to take it"),
        (("-t", 1, "--tolerance", 1), "--tolerance: tolerance 1 is outside 1e-13 .. 0.1"),
        (("-t", 1, "--tolerance", "nan"), "--tolerance: nan is not finite"),
        (
            ("-t", 1, "--integrator", "rk4", "--tolerance", 1e-6),
            "--tolerance: the integrator rk4 you chose takes steps of dt and has none; "
            "--integrator takes dop853, dopri5, filippov, gauss_legendre, generalized_alpha, "
            "rattle, shake, which",
        ),
        (("-t", 1, "--solver", "aba"), "solver: solver aba takes no rows, the scene has elbow"),
        (("-t", 1, "--from", "no.csv"), "no.csv: cannot be read"),
        (("-t", 1, "--efforts", "no.csv"), "no.csv: cannot be read"),
    ],
)
def test_bad_input_exits_with_2_and_leaves_nothing(capsys, tmp_path, driven, words, message):
    code, said, err = called(capsys, "simulate", driven, *words, "-o", tmp_path / "out.csv")
    assert (code, said) == (2, "")
    assert message.replace("SCENE", str(driven)) in err
    assert [p.name for p in tmp_path.iterdir()] == ["driven.yaml"]


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        ("", "Dopri5"),
        ("integrator: {type: dop853}\n", "Dop853"),
        ("integrator: {type: dopri5, tolerance: 1e-3}\n", "Dopri5"),
        ("integrator: {type: gauss_legendre, stages: 3}\n", "GaussLegendre"),
    ],
)
def test_a_tolerance_goes_to_the_integrator_of_the_scene(capsys, tmp_path, driven, entry, said):
    driven.write_text(driven.read_text(encoding="utf-8") + entry, encoding="utf-8")
    words = ["simulate", driven, "-t", 0.2, "--dt", 0.02, "-o"]
    assert called(capsys, *words, tmp_path / "fine.csv", "--dt", 1e-3)[0] == 0
    code, text, err = called(capsys, *words, tmp_path / "o.csv", "--tolerance", 1e-11)
    assert (code, err) == (0, "")
    assert text.startswith(f"{said}, tier")
    assert ("10 steps" in text) == (said == "GaussLegendre"), "the others choose their steps"
    fine, found = columns(tmp_path / "fine.csv"), columns(tmp_path / "o.csv")
    error = np.abs(found["elbow.position"] - fine["elbow.position"][::20]).max()
    assert error <= (1e-5 if "dopri5" in entry else 1e-7)


def test_a_tolerance_for_a_scene_with_fixed_steps_is_refused(capsys, tmp_path, driven):
    text = driven.read_text(encoding="utf-8") + "integrator: {type: rk4}\n"
    driven.write_text(text, encoding="utf-8")
    words = ["-t", 1, "-o", tmp_path / "o.csv", "--tolerance", 1e-6]
    code, _, err = called(capsys, "simulate", driven, *words)
    assert code == 2
    assert f"--tolerance: the integrator rk4 of {driven} takes steps of dt and has none" in err


@pytest.mark.parametrize("name", ["o.csv", "bag"])
@pytest.mark.parametrize(
    ("dt", "duration", "start", "rows"),
    [
        (2e-9, 1e-7, 0, 51),
        (1.5e-9, 1.5e-7, 1, 101),
        (1e-3, 1e-2 + 3e-10, 0, 11),
        (1e-3, 1e-2 + 3e-9, 0, 12),
        (7e3, 1e-2, 0, 2),
        (1e-3, 0.05, 1_700_000_000, 51),
    ],
)
def test_every_row_has_a_stamp_of_its_own(capsys, tmp_path, name, dt, duration, start, rows):
    """What is written can be read, to the last row."""
    out = tmp_path / name
    words = ["-t", duration, "--dt", dt, "--start", start, "--integrator", "rk4", "-o", out]
    code, said, err = called(capsys, "simulate", SCENES / "empty.yaml", *words)
    assert (code, err) == (0, "")
    assert f"{rows} states -> " in said
    stamps = read_motion(out, ["hinge"]).motion.stamps
    assert len(stamps) == rows
    assert (np.diff(stamps) > 0).all()
    assert stamps[-1] == pytest.approx((start + duration) * 1e9, abs=300 if start > 1 else 1)


def test_the_shortest_step_is_for_tables_and_later_starts(capsys, tmp_path):
    words = ["simulate", SCENES / "empty.yaml", "-t", 1e-8, "--dt", 1e-9, "-o"]
    assert called(capsys, *words, tmp_path / "o.csv")[0] == 0
    assert len(read_motion(tmp_path / "o.csv", ["hinge"]).motion.stamps) == 11
    code, _, err = called(capsys, *words, tmp_path / "bag")
    assert code == 2
    assert "--dt: 1e-09 s: must be >= 2e-09 s, the stamps of a bag start with 1 ns" in err
    code, _, err = called(capsys, *words, tmp_path / "bag", "--start", -1)
    assert code == 2
    assert "--start: -1 s: the stamps of a bag are >= 0" in err


@pytest.mark.parametrize("method", ["rk4", "adams", "dopri5", "gauss_legendre", "rattle"])
@pytest.mark.parametrize("dt", [1e-3, 1e-5])
def test_a_start_at_unix_time_is_the_motion_of_one_at_zero(method, dt):
    """Times there are multiples of 0.24 us: sums of steps must not miss the output times."""
    scene, ends = load_scene(SCENES / "prosthetic_arm.yaml"), []
    for start in (0.0, 1.7e9):
        simulation = scene.simulation(integrator={"type": method}, dt=dt)
        states = list(simulation.run(scene.initial._replace(t=start), 100 * dt))
        assert (len(states), simulation.steps) == (101, 100)
        ends.append(states[-1].q)
    assert np.array_equal(*ends)


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
    assert "u.csv: commands of shoulder_flexion are missing" in err


@pytest.mark.parametrize("option", ["--from", "--efforts", "--wrenches"])
@pytest.mark.parametrize("name", ["own.csv", "own.diverged.csv"])
def test_a_result_never_takes_the_place_of_what_is_read(capsys, tmp_path, driven, option, name):
    read, out = tmp_path / name, tmp_path / "own.csv"
    read.write_text("mine", encoding="utf-8")
    words = ["simulate", driven, "-t", 0.01, option, read, "-o", out]
    code, said, err = called(capsys, *words)
    assert (code, said) == (2, "")
    assert f"the result would take the place of {read}, which is read" in err
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(["driven.yaml", name])
    assert read.read_text(encoding="utf-8") == "mine"


def test_a_bag_is_not_written_over_its_own_file_that_is_read(capsys, tmp_path):
    scene, bag = SCENES / "empty.yaml", tmp_path / "bag"
    assert called(capsys, "simulate", scene, "-t", 0.01, "-o", bag)[0] == 0
    (file,) = bag.glob("*.mcap")
    before = file.read_bytes()
    code, _, err = called(capsys, "simulate", scene, "-t", 0.01, "-o", bag, "--from", file)
    assert code == 2
    assert f"-o {bag}: the result would take the place of {file}" in err
    assert file.read_bytes() == before
    code, _, err = called(capsys, "simulate", scene, "-t", 0.01, "-o", file, "--from", bag)
    assert code == 2
    assert f"-o {file}: the result would take the place of {bag}" in err
    assert file.read_bytes() == before


def test_a_result_without_a_name_is_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    code, _, err = called(capsys, "simulate", SCENES / "empty.yaml", "-t", 0.01, "-o", ".")
    assert code == 2
    assert "exists and is not a bag written by mbd_ros" in err
    assert list(tmp_path.iterdir()) == []


def test_a_state_without_velocities_starts_from_rest_and_says_so(capsys, tmp_path):
    scene, start = SCENES / "prosthetic_arm.yaml", tmp_path / "s.csv"
    free = load_scene(scene).couplings.independent
    names = [f"{joint}.position" for joint in free] + [f"{free[0]}.velocity"]
    write_table(start, ["time", *names], np.array([[0.0, *[0.1] * len(free), 2.0]]))
    words = ["-t", 0.01, "-o", tmp_path / "o.csv", "--from", start]
    code, said, _ = called(capsys, "simulate", scene, *words)
    assert code == 0
    assert said.startswith(f"{start}: no velocity of {', '.join(free[1:])}: they start at rest\n")
    found = columns(tmp_path / "o.csv")
    assert found[f"{free[0]}.velocity"][0] == pytest.approx(2.0)
    assert [found[f"{joint}.velocity"][0] for joint in free[1:]] == [0.0] * (len(free) - 1)


def test_joints_without_an_effort_are_named(capsys, tmp_path):
    scene, efforts = SCENES / "prosthetic_arm.yaml", tmp_path / "u.csv"
    names = [joint.name for joint in load_scene(scene).robot.joints]
    given = f"{names[0]}.effort"
    write_table(efforts, ["time", given], np.array([[0.0, 1.0], [1.0, 1.0]]))
    words = ["-t", 0.01, "-o", tmp_path / "o.csv", "--efforts", efforts]
    code, said, _ = called(capsys, "simulate", scene, *words)
    assert code == 0
    assert said.startswith(f"{efforts}: no effort of {', '.join(names[1:])}: it is 0\n")


def test_commands_of_some_actuators_only_are_refused_with_the_file(capsys, tmp_path, driven):
    two = driven.read_text(encoding="utf-8").replace("joints: [", "joints: [wrist_rotation, ")
    driven.write_text(two, encoding="utf-8")
    efforts = tmp_path / "u.csv"
    write_table(efforts, ["time", "shoulder_flexion.effort"], np.array([[0.0, 1.0]]))
    words = ["-t", 1, "-o", tmp_path / "p.csv", "--efforts", efforts]
    code, _, err = called(capsys, "simulate", driven, *words)
    assert code == 2
    assert f"{efforts}: commands of wrist_rotation are missing" in err


def test_degrees_for_radians_and_a_violated_stop_are_said_before_anything(capsys, tmp_path):
    scene = tmp_path / "s.yaml"
    scene.write_text(
        f"robot: {{urdf: {ROOT / 'config/robots/arm7.urdf'}}}\n"
        "initial: {position: {joint2: 90, joint4: 0.5}}\n"
        "constraints: [{type: joint_stop, joint: joint4, lower: -0.2, upper: 0.2}]\n",
        encoding="utf-8",
    )
    joint = load_scene(scene).robot.joint("joint2")
    limits = f"{joint.lower:g} .. {joint.upper:g}"
    far = f"joint2 starts at 90 rad, outside its limits {limits}; radians?"
    stop = "joint4 starts 0.3 rad beyond its JointStop"
    said = called(capsys, "simulate", scene, "-t", 0.002, "-o", tmp_path / "o.csv")[1]
    assert said.startswith(f"warning: {stop}\nwarning: {far}\n")
    checked = called(capsys, "check", scene)[1]
    assert f"warning     {stop}\nwarning     {far}\n" in checked
    assert "warning" not in checked.partition(stop)[0].removesuffix("warning     ")


def test_a_mechanism_that_does_not_close_is_an_error_of_the_scene(capsys, tmp_path):
    text = (SCENES / "four_bar_leg.yaml").read_text(encoding="utf-8")
    text = text.replace("../robots", str(ROOT / "config/robots"))
    text = re.sub(r"point_a: \[[^]]*\]", "point_a: [9, 9, 9]", text, count=1)
    scene = tmp_path / "open.yaml"
    scene.write_text(text, encoding="utf-8")
    code, _, err = called(capsys, "simulate", scene, "-t", 0.01, "-o", tmp_path / "o.csv")
    assert code == 2
    assert err.startswith(f"mbd-ros simulate: {scene}: the mechanism cannot be assembled near")
    code, _, err = called(capsys, "check", scene)
    assert code == 2
    assert err.startswith(f"mbd-ros check: {scene}: the mechanism cannot be assembled near")


SWITCHING = (
    "forces: [{type: switching_force, above: {hinge: -1}, below: {hinge: 1}, "
    "velocity: {hinge: [0, 1]}}]\n"
)


@pytest.mark.parametrize(
    ("integrator", "more"), [("rattle", ""), ("generalized_alpha", ""), ("filippov", SWITCHING)]
)
def test_check_refuses_what_simulate_refuses(capsys, tmp_path, integrator, more):
    scene = tmp_path / "s.yaml"
    scene.write_text(
        f"robot: {{urdf: {ROOT / 'config/robots/pendulum.urdf'}}}\n"
        f"integrator: {{type: {integrator}}}\n{more}"
        "constraints: [{type: joint_stop, joint: hinge, lower: -1, upper: 1, smoothed: true}]\n",
        encoding="utf-8",
    )
    code, _, checked = called(capsys, "check", scene)
    assert code == 2
    words = ["-t", 0.01, "-o", tmp_path / "o.csv"]
    code, _, simulated = called(capsys, "simulate", scene, *words)
    assert code == 2
    assert checked.replace("check", "simulate", 1) == simulated


def test_a_bag_begins_with_a_stamp_that_ros_takes_for_one(capsys, tmp_path):
    """A stamp of 0 means no stamp: readers would fall back to the log times."""
    called(capsys, "simulate", SCENES / "empty.yaml", "-t", 0.003, "-o", tmp_path / "bag")
    recording = read_motion(tmp_path / "bag", ["hinge"])
    assert recording.motion.stamps.tolist() == [1, 1_000_000, 2_000_000, 3_000_000]
    assert not recording.by_log_time


def test_stored_gait_simulation_is_reproduced(tmp_path):
    """OpenSim's forward simulation of a walking human with sliding knees, 1 kHz."""
    folder = RECORDINGS / "gait10dof/forward"
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
