"""Other packages on the same scenes; nothing fails where they are not installed."""

import importlib.util
import json

import numpy as np
import pytest
from mechanisms import scene_of

from mbd_ros.applications.report.peers import kind as peers
from mbd_ros.applications.report.peers.contenders import compete
from mbd_ros.applications.report.peers.kind import compose, ratio
from mbd_ros.applications.report.peers.translation import common_ground, task_of
from mbd_ros.applications.report.precision.converged import known, motion_of
from mbd_ros.applications.report.precision.reference_problems import SCENES
from mbd_ros.applications.report.precision.work_precision import Point
from mbd_ros.errors import DivergedError, SceneError
from mbd_ros.scene.reader import load_scene

needs_mujoco = pytest.mark.skipif(
    importlib.util.find_spec("mujoco") is None,
    reason="mujoco is not installed: pip install mujoco",
)
needs_drake = pytest.mark.skipif(
    importlib.util.find_spec("pydrake") is None, reason="drake is not installed: pip install drake"
)
needs_exudyn = pytest.mark.skipif(
    importlib.util.find_spec("exudyn") is None,
    reason="exudyn is not installed: pip install exudyn",
)
TIMES = (0.05, 0.1)


def off(name, run):
    """Largest distance of a peer to the converged motion [rad]."""
    motion = known(f"{SCENES}/{name}.yaml", TIMES)
    states, seconds = run.run(TIMES)
    assert seconds > 0
    pairs = zip(states, motion.states, strict=True)
    return max(np.abs(x.q - theirs.q).max() for x, theirs in pairs)


def task(name):
    return task_of(common_ground(load_scene(f"{SCENES}/{name}.yaml")))


def test_a_peer_that_is_missing_is_named_with_its_install_line(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert peers.items([], False) == []
    section = peers.section([])
    assert section.tables == () and section.headline == ()
    text = " ".join(section.text)
    assert "pip install mujoco" in text and "pip install drake" in text
    assert "pip install exudyn" in text


def test_ratio_is_taken_at_equal_error():
    ours = [Point(1.0, 1e-4), Point(2.0, 1e-6)]
    theirs = [Point(4.0, 1e-3), Point(40.0, 1e-5), Point(400.0, 1e-7)]
    assert ratio(ours, theirs, 1e-6) == pytest.approx(40.0 * 10**0.5 / 2.0)
    assert ratio(ours, theirs, 1e-8) is None


def outcome_of(*costs):
    """One run a package, all equally precise; costs in ms per simulated s."""
    runs = []
    for package, cost in costs:
        run = {"package": package, "setup": "x", "solver": "plain", "stabilization": None}
        run |= {"integrator": {"type": "rk4"}, "dt": 1e-3, "seconds": 1e-3 * cost, "spread": 0.0}
        runs.append(run | {"position": 5e-7, "configuration": 5e-7})
    facts = {"left": [], "refused": [], "setups": [], "span": 0.5, "quick": False, "own": True}
    return {"runs": runs, "agreement": 1e-12, "check": "x", **facts}


def test_costs_stand_side_by_side():
    outcome = outcome_of(("mbd_ros", 2.0), ("MuJoCo", 5.0))
    leg = outcome_of(("mbd_ros", 1.0), ("Drake", 3.0))
    section = compose([("arm7_swing", outcome), ("leg", leg)], [])
    table = section.tables[0]
    assert table.title in section.headline
    assert table.columns == ("scene", "span", "error", "mbd_ros", "MuJoCo", "Drake")
    assert table.rows[1] == ["arm7_swing", "0.5 s", "1e-6", "2 ms", "5 ms, 2.5 x", "-"]
    assert table.rows[2][3:] == ["not reached", "reaches 5.0e-07 only", "-"]
    assert table.rows[4] == ["leg", "0.5 s", "1e-6", "1 ms", "-", "3 ms, 3.0 x"]


@pytest.mark.parametrize(
    ("precise", "shown"),
    [
        ((), ["2 ms", "5 ms, 2.5 x"]),
        ((0,), ["≤ 2 ms", "5 ms, ≥ 2.5 x"]),
        ((1,), ["2 ms", "≤ 5 ms, ≤ 2.5 x"]),
        ((0, 1), ["≤ 2 ms", "≤ 5 ms"]),
    ],
)
def test_a_cost_at_more_precision_than_asked_is_marked(precise, shown):
    outcome = outcome_of(("mbd_ros", 2.0), ("MuJoCo", 5.0))
    for i in precise:
        outcome["runs"][i]["position"] = 1e-6 / 3.1
    section = compose([("arm7_swing", outcome)], [])
    assert section.tables[0].rows[1][3:] == shown
    assert any("≤" in text for text in section.text)


def test_runs_that_are_not_repeated_say_nothing_of_the_spread():
    outcome = outcome_of(("mbd_ros", 2.0), ("MuJoCo", 5.0))
    outcome["runs"][0]["spread"], outcome["runs"][1]["spread"] = 0.2, None
    text = compose([("arm7_swing", outcome)], []).text[-1]
    assert "of the 1 runs that were made more than once" in text and "within 20%" in text


class Planted:
    """A contender that ends in what it is told, after a time [s]."""

    package, setup, record = "planted", "x", {}

    def __init__(self, states, seconds):
        self._states, self._seconds = states, seconds

    def run(self, times):
        return self._states, self._seconds


def test_a_run_is_judged_by_all_its_samples_and_by_its_repeats():
    path = f"{SCENES}/arm7_swing.yaml"
    motion = known(path, TIMES)
    lost = [motion.states[0], motion.states[1]._replace(q=np.full(7, np.nan))]
    contenders = [Planted(lost, 1e-3), Planted(motion.states, 1e-3), Planted(motion.states, 9.0)]
    found = compete(load_scene(path), contenders, motion, 3)
    assert found[0]["stopped"] == "far off"  # although its first sample is right
    assert found[1]["spread"] == 0.0 and found[2]["spread"] is None


@pytest.mark.parametrize(("cost", "judged"), [(2.9, "does not hold"), (3.1, "holds")])
def test_a_demand_is_held_against_the_best_peer(cost, judged):
    outcome = outcome_of(("mbd_ros", 1.0), ("MuJoCo", cost), ("Drake", 50.0))
    tables = {table.title: table.rows for table in compose([("arm7_swing", outcome)], []).tables}
    assert tables["Demands"] == [["arm7_swing", "1e-6", f"{cost:.1f}", "3", judged]]
    outcome["runs"][0]["position"] = 1e-3  # less precise than peers
    missed = {t.title: t.rows for t in compose([("arm7_swing", outcome)], []).tables}
    assert missed["Demands"][0][2:] == ["0.0", "3", "does not hold"]
    for fact in ({"quick": True}, {"own": False}):
        other = compose([("arm7_swing", outcome | fact)], [])
        assert "Demands" not in [table.title for table in other.tables]


def test_native_code_is_no_peer_and_has_demands_of_its_own():
    outcome = outcome_of(("mbd_ros", 1.0), ("mbd_ros, compiled", 0.1), ("MuJoCo", 4.0))
    tables = {table.title: table.rows for table in compose([("arm7_swing", outcome)], []).tables}
    assert tables["Demands"] == [
        ["arm7_swing", "1e-6", "4.0", "3", "holds"],
        ["arm7_swing, compiled", "1e-6", "40.0", "20", "holds"],
    ]
    alone = outcome_of(("mbd_ros", 1.0), ("mbd_ros, compiled", 0.1))
    assert "arm: no peer finished a run" in compose([("arm", alone)], []).text


def test_a_section_says_what_is_not_compared():
    told = outcome_of(("mbd_ros", 1.0), ("MuJoCo", 2.0))
    told |= {"left": ["forces[1] (switching_force)"], "refused": ["Drake: no splines"]}
    told["setups"] = ["MuJoCo: RK4"]
    alone = outcome_of(("mbd_ros", 1.0)) | {"refused": ["Drake: no splines"]}
    section = compose([("leg", told), ("arm", alone)], [])
    assert [row[0] for row in section.tables[0].rows] == ["leg"] * 3
    text = " ".join(section.text)
    assert "leg is compared without forces[1] (switching_force)" in text
    assert "leg: not compared with Drake: no splines" in text
    assert "arm: no peer finished a run" in text


MACHINE = """
<robot name="machine">
  <link name="trunk"><inertial><origin xyz="0 0.1 0"/><mass value="2"/>
    <inertia ixx="0.02" iyy="0.02" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="upper"><inertial><origin xyz="0.02 0.01 -0.2" rpy="0.1 0.2 0.3"/><mass value="1.2"/>
    <inertia ixx="0.02" iyy="0.03" izz="0.015" ixy="0.001" ixz="0.002" iyz="0"/></inertial></link>
  <link name="lower"><inertial><origin xyz="0 0 -0.15"/><mass value="0.8"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="slider"><inertial><origin xyz="0 0.01 0"/><mass value="0.5"/>
    <inertia ixx="0.002" iyy="0.003" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="tip"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="first" type="continuous"><parent link="trunk"/><child link="upper"/>
    <origin xyz="0.1 0.2 1.0" rpy="0.3 0 0"/><axis xyz="0 1 0"/></joint>
  <joint name="second" type="revolute"><parent link="upper"/><child link="lower"/>
    <origin xyz="0 0 -0.4" rpy="0 0 0.4"/><axis xyz="0.6 0.8 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
  <joint name="out" type="prismatic"><parent link="upper"/><child link="slider"/>
    <origin xyz="0.05 0 -0.1"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
  <joint name="wrist" type="revolute"><parent link="lower"/><child link="tip"/>
    <origin xyz="0 0 -0.3"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="9" velocity="9"/></joint>
</robot>
"""
ROBOT = "robot: {urdf: machine.urdf, rename: {first: hip}, locked: {wrist: 0.4}}\n"
START = "initial: {position: {second: 0.5}, velocity: {hip: 2.0, out: -0.4}}\n"
LOADS = """
forces:
- {type: joint_spring, joint: out, stiffness: 60.0, rest: 0.05, damping: 0.4}
- {type: joint_spring, joint: out, stiffness: 20.0, rest: -0.02}
- {type: joint_friction, joint: hip, viscous: 0.2}
- {type: joint_torque, joint: second, torque: 0.7}
- {type: point_spring, frame_a: universe, point_a: [0.5, 0, 1], frame_b: lower, stiffness: 30.0,
   damping: 0.5, length: 0.2}
actuators:
- {type: geared_motor, joint: second, ratio: 30.0, rotor_inertia: 1e-5}
"""
ROWS = {  # what it adds -> tolerance of MuJoCo at 0.2 ms and of Drake's discrete plant
    "couplings: {out: {parent: second, factor: 0.1, offset: 0.02}}": (1e-6, 1e-2),
    "constraints: [{type: screw, joint: out, parent: second, pitch: 0.5}]": (1e-6, 1e-2),
    "constraints: [{type: distance, frame_a: universe, point_a: [0.3, 0.3, 1.0], frame_b: lower,"
    " distance: 0.5}]": (1e-5, 1e-2),
    "couplings: {out: {parent: second, polynomial: [0.0, 0.1, 0.05, -0.02]}}": (1e-6, None),
}


def machine(text):
    return scene_of(text.replace("urdf: machine.urdf, ", ""), MACHINE)


def machine_file(folder, text):
    (folder / "machine.urdf").write_text(MACHINE)
    path = folder / "machine.yaml"
    path.write_text(text)
    return path


def furthest(scene, run, times=TIMES):
    """Largest distance of a peer to our motion of the same scene."""
    motion, (states, _) = motion_of(scene, times), run.run(times)
    pairs = list(zip(states, motion.states, strict=True))
    off = max(np.abs(x.q - known.q).max() for x, known in pairs)
    assert max(np.abs(x.v - known.v).max() for x, known in pairs) < 1e3 * max(off, 1e-9)
    return off


@needs_mujoco
@needs_drake
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_peers_take_the_loads_of_a_scene_of_a_user(base):
    """Renamed, locked, tilted, continuous and prismatic joints; springs, dampers, drives."""
    from mbd_ros.applications.report.peers.drake_peer import DrakeRun
    from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun

    robot = ROBOT.replace("{urdf", f"{{base: {base}, urdf")
    scene = machine(robot + START + LOADS)
    told = task_of(common_ground(scene))
    assert furthest(scene, MujocoRun(told, "mjINT_RK4", 2e-4)) < 1e-9
    assert furthest(scene, DrakeRun(told, "runge_kutta5", 1e-10)) < 1e-8


@needs_mujoco
def test_mujoco_takes_links_without_mass():
    from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun

    scene = load_scene("package://mbd_ros/config/scenes/prosthetic_arm.yaml")
    run = MujocoRun(task_of(common_ground(scene)), "mjINT_RK4", 2e-4, 1.0, True)
    assert furthest(scene, run) < 1e-6


@needs_mujoco
@needs_drake
@pytest.mark.parametrize("kind", ["kind: point", "kind: full, orientation: [0, 0, 0]"])
def test_peers_hold_a_free_robot(kind):
    from mbd_ros.applications.report.peers.drake_peer import DrakeRun
    from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun

    anchor = f"{{type: frame_anchor, frame: trunk, position: [0, 0, 0], {kind}}}"
    robot = ROBOT.replace("{urdf", "{base: floating, urdf")
    scene = machine(f"{robot}{START}constraints: [{anchor}]\n")
    told = task_of(common_ground(scene))
    assert furthest(scene, MujocoRun(told, "mjINT_RK4", 2e-4, 1.0, True)) < 1e-4
    assert furthest(scene, DrakeRun(told, "", dt=2e-4)) < 1e-2


@needs_mujoco
@needs_drake
@pytest.mark.parametrize("rows", ROWS)
def test_peers_take_the_rows_of_a_scene_of_a_user(rows):
    from mbd_ros.applications.report.peers.drake_peer import DrakeRun
    from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun

    scene = machine(f"{ROBOT}{rows}\n")
    told, (mujoco, drake) = task_of(common_ground(scene)), ROWS[rows]
    assert furthest(scene, MujocoRun(told, "mjINT_RK4", 2e-4, 1.0, True)) < mujoco
    if drake is None:
        with pytest.raises(SceneError, match="not linear"):
            DrakeRun(told, "", dt=2e-4)
    else:
        assert furthest(scene, DrakeRun(told, "", dt=2e-4)) < drake


def test_loads_that_no_peer_has_are_left_out_for_all():
    text = """
constraints: [{type: joint_stop, joint: hip, upper: 0.4}]
forces:
- {type: joint_friction, joint: hip, coulomb: 0.5}
- {type: joint_spring, joint: out, stiffness: 60.0}
"""
    ground = common_ground(machine(ROBOT + text))
    assert ground.left == ("constraints[0] (joint_stop)", "forces[0] (joint_friction)")
    assert len(ground.scene.forces) == 1 and ground.scene.constraints == ()
    assert [body.stiffness for body in task_of(ground).joints] == [0.0, 60.0, 0.0]


def test_rows_that_no_peer_has_are_refused_by_name():
    knots = "{x: [0, 1, 2], y: [0, 0.1, 0.3]}"
    for text, message in (
        (
            f"couplings: {{out: {{parent: second, spline: {knots}}}}}",
            r"couplings\.out: .* \(spline\)",
        ),
        (
            "constraints: [{type: prescribed_motion, joint: hip, polynomial: [0, 1]}]",
            r"constraints\[0\]: .* not prescribed_motion",
        ),
        (
            "constraints: [{type: loop_closure, frame_a: universe, frame_b: lower, directions: x,"
            " point_a: [0.1, 0.3773, 0.4268], point_b: [0, 0, -0.2]}]",
            r"constraints\[0\]: .* not only x",
        ),
    ):
        scene = machine(f"{ROBOT}{text}\n")
        with pytest.raises(SceneError, match=message):
            task_of(common_ground(scene), motion_of(scene, TIMES).states)


@needs_mujoco
@pytest.mark.parametrize(
    ("name", "allowed"),
    [("arm7_swing", 1e-8), ("arm7_swing_coupled", 1e-7), ("x02_four_bar_1e-2", 1e-5)],
)
def test_mujoco_runs_the_same_scene(name, allowed):
    """Order 4 at 0.2 ms; constraints are as stiff as MuJoCo takes them."""
    from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun

    assert off(name, MujocoRun(task(name), "mjINT_RK4", 2e-4, 1.0, True)) < allowed


@needs_mujoco
def test_the_stiffest_constraints_that_mujoco_bears_are_tried():
    """A share of 0.34 diverges; 0.38 is closer than twice as soft ones."""
    from mbd_ros.applications.report.peers import mujoco_peer

    coupled = task("arm7_swing_coupled")
    shares = mujoco_peer._SHARES
    best = off("arm7_swing_coupled", run := mujoco_run(coupled, min(shares)))
    assert run.setup == "RK4, T = 0.38 dt, exact diagonal"
    assert best < off("arm7_swing_coupled", mujoco_run(coupled, 2.0 * min(shares)))
    with pytest.raises(DivergedError):
        mujoco_run(coupled, 0.34).run((1.0,))


def mujoco_run(of, share):
    from mbd_ros.applications.report.peers.mujoco_peer import MujocoRun

    return MujocoRun(of, "mjINT_RK4", 1e-3, share, True)


@needs_drake
@pytest.mark.parametrize("fineness", [{"accuracy": 1e-9}, {"dt": 1e-3}])
def test_drake_runs_the_same_scene(fineness):
    from mbd_ros.applications.report.peers.drake_peer import DrakeRun

    run = DrakeRun(task("arm7_swing"), "runge_kutta5", **fineness)
    assert off("arm7_swing", run) < 1e-7
    assert ("fixed" in run.setup) == ("dt" in fineness)


@needs_drake
def test_fixed_steps_are_fixed():
    """Order 5: half the step is 32 times as precise, which error control would not be."""
    from mbd_ros.applications.report.peers.drake_peer import DrakeRun

    arm = task("arm7_swing")
    coarse, fine = (off("arm7_swing", DrakeRun(arm, "runge_kutta5", dt=dt)) for dt in (0.01, 5e-3))
    assert 2**4 < coarse / fine < 2**7


@needs_exudyn
@pytest.mark.parametrize("index", [3, 2])
@pytest.mark.parametrize("name", ["arm7_swing_coupled", "x02_four_bar_1e-2"])
def test_exudyn_runs_the_same_scene_with_order_2(name, index):
    from mbd_ros.applications.report.peers.exudyn_peer import ExudynRun

    coarse, fine = (off(name, ExudynRun(task(name), 1.0, dt, index)) for dt in (1e-3, 5e-4))
    assert coarse < 1e-4 and coarse / fine == pytest.approx(4.0, rel=0.1)


@needs_exudyn
def test_exudyn_runs_a_scene_of_one_joint():
    from mbd_ros.applications.report.peers.exudyn_peer import ExudynRun

    assert off("a01_pendulum", ExudynRun(task("a01_pendulum"), 1.0, 1e-3, 3)) < 1e-7


@needs_exudyn
def test_exudyn_takes_loads_of_a_scene_of_a_user_and_names_what_it_lacks():
    from mbd_ros.applications.report.peers.exudyn_peer import ExudynRun

    loads = LOADS[: LOADS.index("- {type: point_spring")]
    scene = machine(ROBOT + START + loads)
    told = task_of(common_ground(scene))
    assert furthest(scene, ExudynRun(told, 1.0, 2e-4)) < 1e-5
    for text, what in ((LOADS, "springs between points, inertias of drives"), ("", "free bodies")):
        robot = ROBOT if text else ROBOT.replace("{urdf", "{base: floating, urdf")
        with pytest.raises(SceneError, match=what):
            ExudynRun(task_of(common_ground(machine(robot + START + text))), 1.0, 1e-3)


@needs_drake
def test_drake_closes_loops_on_the_world():
    """Its discrete plant has order 1."""
    from mbd_ros.applications.report.peers.drake_peer import DrakeRun

    assert off("x02_four_bar_1e-2", DrakeRun(task("x02_four_bar_1e-2"), "", dt=2e-4)) < 1e-3


@needs_mujoco
@pytest.mark.soak
def test_a_report_of_peers_compares_the_scene_of_a_user_or_fails(tmp_path, capsys):
    """One that peers can express, one that they cannot."""
    from mbd_ros.cli import main

    machine_file(tmp_path, ROBOT + START + LOADS)
    words = ["report", str(tmp_path / "machine.yaml"), "--only", "peers", "--quick", "-o"]
    assert main([*words, str(tmp_path / "first")]) == 0
    sections = json.loads((tmp_path / "first/report.json").read_text())["sections"]
    packages = sections["peers"]["tables"][0][1]
    assert packages[3:6] == ["mbd_ros", "mbd_ros, compiled", "MuJoCo"]
    machine_file(
        tmp_path, ROBOT + "couplings: {out: {parent: second, spline: {x: [0, 1], y: [0, 1]}}}"
    )
    capsys.readouterr()
    assert main([*words, str(tmp_path / "second")]) == 1
    said = capsys.readouterr().err
    assert "nothing was measured" in said and "couplings.out" in said
    assert "Pareto" not in said  # how others were compared is no reason
