"""`mbd-ros simulate`, `inverse` and `check` on a leg with a four-bar knee."""

import re
from collections import Counter

import numpy as np
import pytest
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.core.state import Motion
from mbd_ros.errors import DataError, SolveError
from mbd_ros.files.bags.bag_reader import messages
from mbd_ros.files.recording import Recording
from mbd_ros.files.tables.csv import read_table, write_table
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.motion.samples import close_loops
from mbd_ros.scene.reader import load_scene

SCENES = ROOT / "config/scenes"
KNEE = ("knee_anterior", "knee_tibial", "knee_posterior")
JOINTS = ("hip_flexion", "knee_anterior", "knee_tibial", "ankle", "knee_posterior")
MOTION = ("position", "velocity", "acceleration")
ROWS = tuple(f"shank_loop_closure.force_{axis}" for axis in "xz")


def called(capsys, *words):
    """Exit code, stdout and stderr."""
    code = main([str(word) for word in words])
    return code, *capsys.readouterr()


def columns(path):
    table = read_table(path)
    return dict(zip(table.columns, table.values.T, strict=True))


def part(path, motion, joints, fields=MOTION, noise=0.0):
    """A table with some columns of a motion."""
    rng = np.random.default_rng(0)
    kept = [f"{joint}.{field}" for field in fields for joint in joints]
    values = np.column_stack([motion["time"], *(motion[name] for name in kept)])
    values[:, 1:] += noise * rng.normal(size=values[:, 1:].shape)
    write_table(path, ["time", *kept], values)
    return path


def driven(folder, *joints, more=""):
    """The four-bar leg with ideal actuators."""
    text = (SCENES / "four_bar_leg.yaml").read_text(encoding="utf-8")
    text = text.replace("../robots", str(SCENES.parent / "robots"))
    file = folder / f"{'_'.join(joints)}.yaml"
    actuators = f"actuators: [{{type: ideal, joints: [{', '.join(joints)}]}}]\n"
    file.write_text(text + actuators + more, encoding="utf-8")
    return file


@pytest.fixture
def leg(tmp_path):
    return driven(tmp_path, "knee_anterior")


@pytest.fixture
def swing(capsys, tmp_path, leg):
    """Table of a simulated swing with a commanded knee."""
    times = np.linspace(0.0, 0.4, 401)
    commands = np.column_stack([times, 3.0 * np.sin(9.0 * times) + 1.0])
    write_table(tmp_path / "u.csv", ["time", "knee_anterior.effort"], commands)
    out = tmp_path / "swing.csv"
    words = ["-t", 0.4, "-o", out, "--efforts", tmp_path / "u.csv"]
    assert called(capsys, "simulate", leg, *words)[0] == 0
    return out


def test_inverse_of_a_simulation_returns_commands_and_multipliers(capsys, tmp_path, leg, swing):
    back = tmp_path / "back.csv"
    code, said, err = called(capsys, "inverse", leg, swing, "-o", back)
    assert (code, err) == (0, "")
    found, simulated = columns(back), columns(swing)
    motion = [f"{joint}.{field}" for field in MOTION for joint in JOINTS]
    assert list(found) == ["time", *motion, "knee_anterior.effort", *ROWS]
    for name in list(found):
        assert found[name] == pytest.approx(simulated[name], rel=1e-9, abs=1e-9), name
    assert "null space" not in said
    assert "moved onto the constraints by at most" in said


def test_bag_holds_the_motion_the_efforts_and_the_multipliers(capsys, tmp_path, leg, swing):
    assert called(capsys, "inverse", leg, swing, "-o", tmp_path / "bag")[0] == 0
    topics = ("/joint_states", "/joint_torques", "/constraint_forces")
    kinds = dict.fromkeys(topics, "sensor_msgs/msg/JointState")
    last = {topic: message for topic, _, message in messages(tmp_path / "bag", kinds)}
    simulated = columns(swing)
    assert tuple(last["/joint_states"].name) == JOINTS
    assert last["/joint_states"].position[2] == pytest.approx(
        simulated["knee_tibial.position"][-1]
    )
    assert list(last["/joint_torques"].name) == ["knee_anterior"]
    torque = simulated["knee_anterior.effort"][-1]
    assert last["/joint_torques"].effort[0] == pytest.approx(torque, abs=1e-9)
    forces = [simulated[name][-1] for name in ROWS]
    assert last["/constraint_forces"].effort == pytest.approx(forces, abs=1e-9)


@pytest.mark.parametrize("known", ["knee_anterior", "knee_posterior"])
def test_loop_gives_the_joints_that_the_motion_lacks(capsys, tmp_path, leg, swing, known):
    simulated = columns(swing)
    some = part(tmp_path / "some.csv", simulated, ("ankle", "hip_flexion", known))
    code, said, _ = called(capsys, "inverse", leg, some, "-o", tmp_path / "back.csv")
    assert code == 0
    found = columns(tmp_path / "back.csv")
    for name in found:
        assert found[name] == pytest.approx(simulated[name], rel=1e-8, abs=1e-8), name
    lacking = [joint for joint in KNEE if joint != known]
    assert all(f"{joint} is reconstructed from the loops" in said for joint in lacking)


def test_samples_that_lack_a_joint_now_and_then_are_left_out(leg):
    scene, names = load_scene(leg), JOINTS
    order = [scene.couplings.independent.index(name) for name in names]
    position = np.tile(scene.initial.q[[scene.robot.joint(n).q for n in names]], (4, 1))[:, order]
    position[2, 0] = np.nan
    motion = Motion(names, np.arange(4) * 1000, position, velocity=0.0 * position)
    recording, said = close_loops(scene, leg, Recording(motion, Counter()))
    assert recording.motion.stamps.tolist() == [0, 1000, 3000]
    assert recording.motion.velocity.shape == (3, 5)
    assert recording.dropped == {"the position of a joint is missing": 1}
    assert said == []
    position[:, 0] = np.where(np.arange(4) % 2, np.nan, 0.0)
    position[:, 1] = np.where(np.arange(4) % 2, 0.0, np.nan)
    with pytest.raises(DataError, match="no sample has positions of all measured joints"):
        close_loops(scene, leg, Recording(motion, Counter()))


def test_joint_that_lacks_in_a_scene_without_loops_is_named():
    scene = load_scene(SCENES / "cart_pole.yaml")
    names = scene.couplings.independent
    position = np.zeros((3, 2))
    position[:, 1] = np.nan
    motion = Motion(names, np.arange(3) * 1000, position, velocity=np.zeros((3, 2)))
    with pytest.raises(DataError, match=f"no position of {names[1]}, and no loop determines it"):
        close_loops(scene, "m.parquet", Recording(motion, Counter()))


def test_fold_of_the_loop_is_reported(capsys, tmp_path, swing):
    """The tibial joint turns back while the others go on: it does not tell where they are."""
    every = driven(tmp_path, "hip_flexion", "knee_anterior", "ankle")
    some = part(tmp_path / "some.csv", columns(swing), ("ankle", "hip_flexion", "knee_tibial"))
    _, said, _ = called(capsys, "inverse", every, some, "-o", tmp_path / "back.csv")
    assert re.search(r"the loops fold near 0\.0\d* s \(condition number", said)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        (("hip_flexion", "knee_tibial"), "no position of ankle, and no loop determines it"),
        (("hip_flexion", "ankle"), "no position of knee_.*, knee_.*, knee_"),
        ((), "no position of any of hip_flexion, knee_anterior"),
    ],
)
def test_joint_that_no_loop_gives_is_named(capsys, tmp_path, leg, swing, joints, words):
    some = part(
        tmp_path / "some.csv", {**columns(swing), "x.position": 0.0 * np.ones(401)}, joints
    )
    if not joints:
        write_table(some, ["time", "other.position"], np.ones((3, 2)) * [[1], [2], [3]])
    code, _, err = called(capsys, "inverse", leg, some, "-o", tmp_path / "back.csv")
    assert code == 2
    assert re.search(words, err)
    assert not (tmp_path / "back.csv").exists()


@pytest.mark.parametrize("source", ["zero-phase", "causal"])
def test_measured_motion_is_moved_onto_the_loop(capsys, tmp_path, swing, source):
    """Noise of 0.01 mrad on five joints: the result is on the loop, and the commands are found."""
    whole = driven(tmp_path, "hip_flexion", "knee_anterior", "ankle")
    simulated = columns(swing)
    noisy = part(tmp_path / "noisy.csv", simulated, JOINTS, ["position"], noise=1e-5)
    words = ["--derivatives", source, "-o", tmp_path / "b.csv"]
    words += ["--cutoff", 8] if source == "causal" else []
    code, said, err = called(capsys, "inverse", whole, noisy, *words)
    assert (code, err) == (0, "")
    found, loops = columns(tmp_path / "b.csv"), load_scene(whole)
    system = loops.system()
    for row in range(0, 401, 40):
        q, v = (np.array([found[f"{j}.{f}"][row] for j in JOINTS]) for f in MOTION[:2])
        at = [loops.robot.joint(joint).q for joint in JOINTS]
        q[at], v[at] = q.copy(), v.copy()
        assert np.abs(system.residual(0.0, q)).max() <= 1e-12
        assert np.abs(system.jacobian(0.0, q) @ v).max() <= 1e-11
    moved = float(said.split("by at most ")[1].split()[0])
    assert 1e-6 < moved < 1e-4
    if source == "zero-phase":
        inner = slice(30, -30)
        error = found["knee_anterior.effort"] - simulated["knee_anterior.effort"]
        assert np.sqrt(np.mean(error[inner] ** 2)) < 0.1  # N·m, of commands up to 4


def test_motion_out_of_reach_is_refused_with_its_joint_and_time(capsys, tmp_path, leg, swing):
    simulated = columns(swing)
    simulated["hip_flexion.acceleration"] = simulated["hip_flexion.acceleration"] + 0.1
    other = part(tmp_path / "other.csv", simulated, JOINTS)
    code, _, err = called(capsys, "inverse", leg, other, "-o", tmp_path / "back.csv")
    assert code == 2
    assert "at 0 s: the actuators (knee_anterior) cannot produce this motion" in err
    assert "hip_flexion" in err.partition("along ")[2]
    code, _, err = called(capsys, "inverse", leg, swing, "--parts", "-o", tmp_path / "back.csv")
    assert (code, "--parts" in err) == (2, True)


def test_null_space_is_reported_and_its_smallest_norm_taken(capsys, tmp_path, leg, swing):
    pair = driven(tmp_path, "knee_anterior", "knee_posterior")
    code, said, _ = called(capsys, "inverse", pair, swing, "-o", tmp_path / "back.csv")
    assert code == 0
    assert (
        "null space of dimension 1: knee_anterior.effort, knee_posterior.effort, "
        "shank_loop_closure.force_x, shank_loop_closure.force_z are not determined"
    ) in said
    found, alone = columns(tmp_path / "back.csv"), columns(swing)["knee_anterior.effort"]
    efforts = [found[f"{joint}.effort"] for joint in ("knee_anterior", "knee_posterior")]
    assert np.all(np.hypot(*efforts) <= np.abs(alone) + 1e-9)


def test_force_in_time_is_read_at_the_time_of_the_sample(capsys, tmp_path, swing):
    """The command as a prescribed torque leaves nothing for the actuator to do."""
    times = np.linspace(0.0, 0.4, 401)
    table = np.column_stack([times, 3.0 * np.sin(9.0 * times) + 1.0])
    torque = f"times: {times.tolist()}, torque: {table[:, 1:].tolist()}"
    told = driven(tmp_path, "knee_anterior")
    text = told.read_text(encoding="utf-8").replace(
        "forces:\n", f"forces:\n- {{type: prescribed_torque, joints: [knee_anterior], {torque}}}\n"
    )
    told.write_text(text, encoding="utf-8")
    assert called(capsys, "inverse", told, swing, "-o", tmp_path / "back.csv")[0] == 0
    assert np.abs(columns(tmp_path / "back.csv")["knee_anterior.effort"]).max() <= 1e-9


@pytest.mark.parametrize(
    ("scene", "lines"),
    [
        (
            "four_bar_leg",
            [
                "inverse     loops: efforts and multipliers by rank",
                "no actuators section: every independent joint; 3 of 3 motions driven",
                "null space  dimension 2: knee_anterior.effort, knee_tibial.effort",
            ],
        ),
        (
            "benchmark/ts_car_axis",
            [
                "actuated    bar, left_x, left_y, right_x, right_y; no",
                "slider_prescribed_motion.force",
            ],
        ),
        (
            None,
            [
                "actuated    knee_anterior; 1 of 3 motions driven",
                "nothing drives hip_flexion, ankle",
            ],
        ),
    ],
)
def test_check_says_what_the_actuators_reach(capsys, leg, scene, lines):
    code, said, err = called(capsys, "check", leg if scene is None else SCENES / f"{scene}.yaml")
    assert (code, err) == (0, "")
    assert all(line in said for line in lines), said
    assert "one inverse-dynamics call" in said


def test_estimator_solves_loops_as_the_file_does(capsys, tmp_path, swing):
    """What a live node computes: causal filters, independent joints, no efforts elsewhere."""
    whole = driven(tmp_path, "hip_flexion", "knee_posterior", "ankle")
    noisy = part(tmp_path / "n.csv", columns(swing), JOINTS, ["position"], noise=1e-4)
    words = ["--derivatives", "causal", "-o", tmp_path / "back.csv"]
    assert called(capsys, "inverse", whole, noisy, *words)[0] == 0
    found, scene, motion = columns(tmp_path / "back.csv"), load_scene(whole), columns(noisy)
    estimator = TorqueEstimator(scene.robot, scene.inverse_dynamics(), Tuning())
    order, tau = scene.couplings.independent, []
    for i, t in enumerate(motion["time"]):
        position = np.array([motion[f"{joint}.position"][i] for joint in order])
        present = np.ones(5, dtype=bool)
        x = estimator.observe(round(t * 1e9), position, np.full(5, np.nan), present)
        assert isinstance(x, Observation)
        tau.append(estimator.solve(x).tau)
    for joint, torque in zip(order, np.array(tau).T, strict=True):
        expected = found.get(f"{joint}.effort", np.zeros(401))
        assert torque == pytest.approx(expected, rel=1e-9, abs=1e-9)


def test_mechanism_that_cannot_be_assembled_is_refused(leg):
    observed = load_scene(leg).inverse_dynamics()
    with pytest.raises(SolveError, match="cannot be assembled"):
        observed.solve(np.array([0.3, 3.0, 0.2, 0.0, -1.1]), np.zeros(5), np.zeros(5))
