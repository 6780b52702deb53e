"""`mbd-ros check` and `mbd-ros inverse` as a user meets them: words, exit codes, what is left."""

import os
import re
import subprocess
import sys

import numpy as np
import pytest
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.files.tables.csv import read_table, write_table
from mbd_ros.scene.reader import load_scene

SCENES = ROOT / "config/scenes"
FULL = """\
robot: {{urdf: {urdf}, locked: {{ankle: 0.1}}}}
couplings: {{knee_slide_x: {{parent: knee, factor: 0.01}}}}
external_wrenches: {{plate: {{frame: foot, expressed_in: world}}}}
forces: [{{type: joint_spring, joint: knee, stiffness: 3}}]
"""


@pytest.fixture
def motion(tmp_path):
    """A swing of the pendulum at rest at 30 degrees: 0.5 m g sin(30 deg) = 2.4525 N·m."""
    rows = np.column_stack([np.arange(5) / 10, np.full(5, np.pi / 6), np.zeros((5, 2))])
    fields = ("position", "velocity", "acceleration")
    write_table(tmp_path / "m.csv", ["time", *(f"hinge.{f}" for f in fields)], rows)
    return tmp_path / "m.csv"


def called(capsys, *words):
    """Exit code, stdout and stderr."""
    code = main([str(word) for word in words])
    return code, *capsys.readouterr()


def labelled(text):
    """Lines of `check` by label."""
    return dict(
        re.split(r"\s+", line, maxsplit=1) for line in text.replace("left out", "out").splitlines()
    )


def test_check_says_what_is_built_and_what_is_not(capsys, tmp_path):
    urdf = SCENES.parent / "robots/prosthetic_leg.urdf"
    (tmp_path / "s.yaml").write_text(FULL.format(urdf=urdf), encoding="utf-8")
    code, out, err = called(capsys, "check", tmp_path / "s.yaml")
    said = labelled(out)
    assert (code, err) == (0, "")
    assert said["scene"] == str(tmp_path / "s.yaml")
    assert said["robot"] == f"prosthetic_leg from {urdf}, fixed base"
    assert said["gravity"].startswith("[ 0.  ,  0.  , -9.81] m/s^2")
    assert said["joints"] == "4, degrees of freedom 3"
    assert said["independent"] == "hip_flexion, knee_slide_y, knee"
    assert said["dependent"] == "knee_slide_x <- knee (factor)"
    assert said["locked"] == "ankle at 0.1"
    assert said["wrench"] == "plate on foot, expressed in world, topic ~/wrench/plate"
    assert said["force"] == "knee_joint_spring, JointSpring at knee"
    assert said["inverse"].startswith("reduced: dependent joints eliminated exactly")
    assert said["forward"] == (
        "reduced: couplings eliminated exactly, q = F(z); integrator dopri5 by default, dt 0.001 s"
    )
    assert said["out"] == (
        "robots; bodies; paths; constraints; contacts; actuators; muscles; sensors; "
        "phases; stabilization; solver; integrator; dt; initial; safe"
    )
    inverse, forward = said["cost"].split("; ")
    assert re.fullmatch(r"one .* call \d+\.\d us, \d+\.\d x a bare rnea of 4 joints", inverse)
    assert re.fullmatch(r"one acceleration \d+\.\d us, \d+\.\d x a bare aba", forward)


@pytest.mark.parametrize(
    ("name", "joints", "dependent", "tier"),
    [
        ("empty", "1, degrees of freedom 1", "none", "rnea: no dependent joint, one call"),
        ("arm7", "7, degrees of freedom 7", "none", "rnea: no dependent joint, one call"),
        ("prosthetic_arm", "5, degrees of freedom 4", "elbow <- shoulder_flexion (factor)", "red"),
    ],
)
def test_check_of_the_scenes_that_come_along(capsys, name, joints, dependent, tier):
    code, out, _ = called(capsys, "check", SCENES / f"{name}.yaml")
    said = labelled(out)
    assert code == 0
    assert (said["joints"], said["dependent"]) == (joints, dependent)
    assert said["inverse"].startswith(tier)
    assert {"external_wrenches", "forces"} <= set(said["out"].split("; "))


MANY = """\
robot: {{urdf: {robots}/benchmark/four_bar.urdf, gravity: [0, -9.81, 0]}}
actuators: [{{type: ideal, joints: [crank]}}]
constraints:
- {{type: loop_closure, frame_a: world, point_a: [0.99, 0, 0], frame_b: rocker_link,
   point_b: [-1, 0, 0], directions: xy}}
{more}
stabilization: {{type: baumgarte, time_constant: 1e-4}}
integrator: {{type: rk4}}
initial: {{position: {{crank: 1.5707963267948966, coupler: -1.57, rocker: 1.56}}}}
"""


def test_check_says_how_a_closed_chain_is_solved(capsys, tmp_path):
    (tmp_path / "s.yaml").write_text(MANY.format(robots=SCENES / "../robots", more=""))
    code, out, err = called(capsys, "check", tmp_path / "s.yaml")
    said = labelled(out)
    assert (code, err) == (0, "")
    assert said["actuator"] == "crank_ideal, Ideal at crank"
    rows = "force_x [N], force_y [N]"
    assert said["constraint"] == f"rocker_link_loop_closure, LoopClosure, bilateral: {rows}"
    assert said["forward"].startswith(
        "kkt: bilateral rows, one factorised solve, 2 rows; Rk4, dt 0"
    )
    assert said["forward"].endswith("stabilization Baumgarte")
    assert "warning     Baumgarte: time constant 0.0001 s raised to 2 dt = 0.002 s\n" in out
    assert said["joints"] == "3, degrees of freedom 1"
    assert re.fullmatch(r"2 of 2 rows, condition number \d.*", said["rank"])


def test_check_says_redundancy_toggle_bounds_and_missing_authority(capsys, tmp_path):
    robots, scene = SCENES / "../robots", tmp_path / "s.yaml"
    twice = MANY.partition("constraints:\n")[2].partition("{more}")[0].format()
    scene.write_text(MANY.format(robots=robots, more=twice), encoding="utf-8")
    rank = labelled(called(capsys, "check", scene)[1])["rank"]
    assert rank == "rank 2 of 4 rows: redundant, multipliers of smallest norm"
    stop = "- {{type: joint_stop, joint: crank, lower: -9, upper: 9, smoothed: {}}}"
    costs = []
    for smoothed, tier in (("true", "qp over kkt: "), ("false", "kkt: ")):
        more = stop.format(smoothed)
        scene.write_text(MANY.format(robots=robots, more=more), encoding="utf-8")
        said = labelled(called(capsys, "check", scene)[1])
        assert said["forward"].startswith(tier)
        kind = "smoothed" if smoothed == "true" else "exact"
        assert said[kind].startswith("crank_joint_stop; ")
        costs.append(float(re.search(r"one acceleration (\S+) us", said["cost"])[1]))
    assert costs[1] < 5.0 * costs[0]  # in its mode, which took 18 times as long to decide
    urdf = (robots / "pendulum.urdf").read_text(encoding="utf-8")
    (tmp_path / "weak.urdf").write_text(re.sub(r'effort="[^"]*"', 'effort="0"', urdf))
    actuator = "actuators: [{type: ideal, joints: [hinge]}]\n"
    scene.write_text("robot: {urdf: weak.urdf}\n" + actuator, encoding="utf-8")
    warning = labelled(called(capsys, "check", scene)[1])["warning"]
    assert warning == "no authority: effort limit 0 of hinge"
    free = re.sub(r"<limit [^>]*/>", "", urdf).replace("revolute", "continuous")
    (tmp_path / "weak.urdf").write_text(free, encoding="utf-8")
    assert "warning" not in called(capsys, "check", scene)[1]


RUBBING = '<dynamics friction="0.2" damping="0.5"/></joint>'


@pytest.mark.parametrize(
    ("parts", "left"),
    [
        ("", ["friction", "damping"]),
        ("forces: [{type: joint_friction, joint: hinge, coulomb: 0.2, viscous: 0.5}]", []),
        ("forces: [{type: joint_friction, joint: hinge, viscous: 0.5}]", ["friction"]),
        ("forces: [{type: joint_friction, joint: hinge, coulomb: 0.2}]", ["damping"]),
        ("forces: [{type: joint_spring, joint: hinge, stiffness: 0, damping: 1}]", ["friction"]),
        ("forces: [{type: joint_spring, joint: hinge, stiffness: 9}]", ["friction", "damping"]),
        ("constraints: [{type: dry_friction, joint: hinge, limit: 0.2}]", ["damping"]),
    ],
)
def test_check_says_which_friction_of_the_description_is_left_out(capsys, tmp_path, parts, left):
    urdf = (SCENES / "../robots/pendulum.urdf").read_text(encoding="utf-8")
    head, joint, tail = urdf.rpartition("</joint>")
    assert joint
    (tmp_path / "p.urdf").write_text(head + RUBBING + tail, encoding="utf-8")
    (tmp_path / "s.yaml").write_text(f"robot: {{urdf: p.urdf}}\n{parts}\n", encoding="utf-8")
    said = labelled(called(capsys, "check", tmp_path / "s.yaml")[1])["out"]
    assert re.findall(r"<dynamics> (\w+) of hinge", said) == left


@pytest.mark.parametrize(
    ("integrator", "dt", "warned"),
    [("rk4", 1e-3, True), ("rk4", 1e-4, False), ("gauss_legendre", 1e-3, False)],
)
def test_check_says_which_step_a_stiff_scene_needs(capsys, tmp_path, integrator, dt, warned):
    """A spring on a joint: rate = sqrt(stiffness / inertia) = sqrt(1e7 / inertia)."""
    (tmp_path / "s.yaml").write_text(
        f"robot: {{urdf: {SCENES}/../robots/pendulum.urdf}}\ndt: {dt}\n"
        "forces: [{type: joint_spring, joint: hinge, stiffness: 1e7}]\n"
        f"integrator: {{type: {integrator}}}\n",
        encoding="utf-8",
    )
    out = called(capsys, "check", tmp_path / "s.yaml")[1]
    inertia = load_scene(tmp_path / "s.yaml").system().mass(np.zeros(1)).dense[0, 0]
    rate = (1e7 / inertia) ** 0.5
    assert (f"stiff: fastest rate {rate:.3g} 1/s at dt {dt:g} s" in out) == warned
    assert (f"need dt < {8**0.5 / rate:.2g} s" in out) == warned, "RK4 on the imaginary axis"


def test_check_refuses_a_mechanism_that_does_not_close(capsys, tmp_path):
    text = MANY.format(robots=SCENES / "../robots", more="").replace("[0.99", "[9.0")
    (tmp_path / "s.yaml").write_text(text, encoding="utf-8")
    code, _, err = called(capsys, "check", tmp_path / "s.yaml")
    assert code == 2
    assert "cannot be assembled near this position: row rocker_link_loop_closure.force_x" in err


def test_inverse_writes_torques_and_says_so(capsys, tmp_path, motion):
    code, out, err = called(
        capsys, "inverse", SCENES / "empty.yaml", motion, "-o", tmp_path / "o.csv"
    )
    assert (code, err) == (0, "")
    assert out == f"5 samples, given derivatives -> {tmp_path / 'o.csv'}\n"
    table = read_table(tmp_path / "o.csv")
    effort = table.values[:, table.columns.index("hinge.effort")]
    assert effort == pytest.approx(np.full(5, 0.5 * 9.81 * np.sin(np.pi / 6)), abs=1e-12)


@pytest.mark.parametrize("name", ["o.csv", "o.csv.gz", "bag", "b.mcap", "b.db3"])
def test_every_kind_of_output_holds_the_same_torques(capsys, tmp_path, motion, name):
    words = "inverse", SCENES / "empty.yaml", motion, "--parts", "-o", tmp_path / name
    assert called(capsys, *words)[0] == 0
    if name.startswith("o.csv"):
        table = read_table(tmp_path / name)
        efforts = table.values[:, table.columns.index("hinge.gravity")]
    else:
        from mbd_ros.motion.recordings import read_motion

        efforts = read_motion(tmp_path / name, ["hinge"], topic="/joint_torques").motion.effort
    assert efforts.ravel() == pytest.approx(np.full(5, 2.4525), abs=1e-9)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("check none.yaml", "mbd-ros check: none.yaml: scene file cannot be read: No such file"),
        ("inverse none.yaml m.csv -o o.csv", "mbd-ros inverse: none.yaml: scene file cannot be"),
        ("inverse SCENE none.csv -o o.csv", "none.csv: cannot be read (No such file or direc"),
        ("inverse SCENE m.txt -o o.csv", "m.txt: no format has this suffix; accepted: .csv"),
        ("inverse SCENE m.csv -o o.txt", "o.txt: no format has this suffix; accepted: .csv"),
        ("inverse SCENE m.csv -o no/o.csv", "no/o.csv: directory no does not exist"),
        ("inverse SCENE no/bag -o o.csv", "no/bag"),
        ("inverse SCENE m.csv -o m.csv", "-o m.csv: the result would take the place of m.csv"),
        ("inverse SCENE m.csv -o ./x.csv", "-o x.csv: the result would take the place of m.csv"),
        ("inverse STANCE m.csv --wrenches w.csv -o w.csv", "would take the place of w.csv, which"),
        ("inverse SCENE m.csv --wrenches w.csv -o o.csv", "empty.yaml has no external_wrenches"),
        ("inverse SCENE m.csv p.csv --wrenches out/m.csv -o out", "e the place of out/m.csv"),
        ("inverse SCENE bad.csv -o o.csv", "bad.csv: line 2, column hinge.position: 'x' is not a"),
        ("inverse SCENE p.csv -o o.csv", "p.csv: no velocity of hinge; choose --derivatives caus"),
        ("inverse LEG m.csv -o o.csv", "m.csv: no column hip_flexion.position, knee.position, an"),
        ("inverse SCENE m.csv -o o.csv --derivatives causal --cutoff 0", "cutoff 0.0 Hz must be"),
        ("inverse SCENE m.csv -o o.csv --derivatives causal --cutoff nan", "cutoff nan Hz must"),
        (
            "inverse SCENE m.csv -o o.csv --derivatives zero-phase",
            "at least 6 samples, there are 5",
        ),
        ("inverse SCENE p.csv -o o.csv --derivatives zero-phase --half-width 1", "width 1 need"),
        (
            "inverse SCENE m.csv -o o.csv --derivatives zero-phase --half-width 2 --cutoff 3",
            "--half-width and --cutoff are not accepted together; give one of them",
        ),
        ("inverse SCENE m.csv -o o.csv --derivatives zero-phase --cutoff -1", "cutoff -1.0 Hz mu"),
    ],
)
def test_bad_input_is_2_with_one_line_on_stderr_and_nothing_left(
    capsys, tmp_path, motion, monkeypatch, words, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.csv").write_text("time,hinge.position\n0,x\n")
    (tmp_path / "p.csv").write_text("time,hinge.position\n0,1\n1,2\n")
    (tmp_path / "x.csv").symlink_to("m.csv")
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    named = {"SCENE": "empty", "LEG": "prosthetic_leg", "STANCE": "prosthetic_leg_stance"}
    named = {word: SCENES / f"{name}.yaml" for word, name in named.items()}
    code, out, err = called(capsys, *(named.get(word, word) for word in words.split()))
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_failure_leaves_the_old_output_as_it_was(capsys, tmp_path, motion):
    out = tmp_path / "o.csv"
    out.write_text("mine")
    assert called(capsys, "inverse", SCENES / "empty.yaml", tmp_path / "n.csv", "-o", out)[0] == 2
    assert out.read_text() == "mine"
    assert called(capsys, "inverse", SCENES / "empty.yaml", motion, "-o", out)[0] == 0
    assert out.read_text().startswith("time,hinge.position")


@pytest.mark.parametrize(
    ("command", "options"),
    [
        (
            "inverse",
            {"--topic": "/joint_states", "--stance-gap": "0.001", "--stance-speed": "0.02"},
        ),
        ("replay", {"--cutoff": "5.0", "--skip": "0.5", "--rate": "1"}),
        ("simulate", {"--start": "0.0"}),
    ],
)
def test_help_shows_the_defaults(capsys, command, options):
    with pytest.raises(SystemExit):
        main([command, "--help"])
    words = " ".join(capsys.readouterr().out.partition("options:")[2].split())
    for option, default in options.items():
        told = words.partition(f" {option} ")[2].partition(" --")[0]
        assert f"(default: {default}" in told


@pytest.mark.parametrize(
    "words",
    [
        "",
        "fly",
        "check",
        "inverse a b",
        "inverse a b -o c --derivatives best",
        "check a --cutoff x",
    ],
)
def test_words_that_make_no_command_are_2_with_the_usage(capsys, words):
    with pytest.raises(SystemExit) as caught:
        main(words.split())
    assert caught.value.code == 2
    assert capsys.readouterr().err.startswith("usage: mbd-ros")


def test_the_process_itself_ends_with_those_codes(tmp_path, motion):
    """A real process: no traceback, and a closed pipe at stdout is no reason for one."""
    environment = {**os.environ, "PYTHONPATH": str(SCENES.parents[1])}

    def run(*words):
        command = [sys.executable, "-m", "mbd_ros.cli", *map(str, words)]
        return subprocess.run(
            command, capture_output=True, text=True, env=environment, check=False
        )

    bad = run("check", tmp_path / "none.yaml")
    assert (bad.returncode, bad.stdout) == (2, "")
    assert "Traceback" not in bad.stderr
    good = run("inverse", SCENES / "empty.yaml", motion, "-o", tmp_path / "o.csv")
    assert (good.returncode, good.stderr) == (0, "")
