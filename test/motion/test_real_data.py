"""Recorded motions and robots of others: right to the published digits, wrong ways wrong."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from places import RECORDINGS
from scipy.interpolate import CubicSpline

import mbd_ros
from mbd_ros.api import load_scene, scene_from
from mbd_ros.cli import main
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.tables.csv import read_table, write_table
from mbd_ros.methods.inverse_dynamics.torque_estimator import TorqueEstimator, Tuning
from mbd_ros.motion.recordings import read_motion
from msg_adapters.joint_state import JointStateReader, write_joint_state


def columns(path):
    table = read_table(path)
    return dict(zip(table.columns, table.values.T, strict=True))


def percent(computed, reference):
    """Root mean square of the error over that of the reference."""
    return 100 * np.sqrt(np.mean((computed - reference) ** 2) / np.mean(reference**2))


def torques(folder, motion, out, *options):
    """Columns of what `mbd-ros inverse` writes."""
    words = ["inverse", folder / "scene.yaml", folder / motion, "-o", out, *options]
    assert main([str(word) for word in words]) == 0
    return columns(out)


@pytest.mark.parametrize(
    ("name", "wrenches", "bound"), [("gait10dof/walk", True, 0.005), ("arm26/elbow", False, 0.015)]
)
def test_torques_equal_those_of_opensim(tmp_path, name, wrenches, bound):
    folder = RECORDINGS / name
    options = ("--wrenches", folder / "external_wrenches.csv.gz") if wrenches else ()
    ours = torques(folder, "motion.csv.gz", tmp_path / "out.csv", *options)
    reference = columns(folder / "reference_torques.csv.gz")
    assert ours["time"] == pytest.approx(reference["time"], abs=2e-6)
    efforts = [column for column in reference if column != "time"]
    assert len(efforts) == (10 if wrenches else 2)
    assert max(percent(ours[c], reference[c]) for c in efforts) <= bound


def test_torques_from_the_bag_equal_those_of_opensim(tmp_path):
    """The bag has 200 Hz and no acceleration, the reference 60 Hz; stamps begin at 1000 s."""
    folder = RECORDINGS / "gait10dof/walk"
    ours = torques(folder, "bag", tmp_path / "out.csv", "--derivatives", "zero-phase")
    reference = columns(folder / "reference_torques.csv.gz")
    time = reference["time"] + 1000.0
    inside = (time >= ours["time"][0]) & (time <= ours["time"][-1])
    common = np.arange(0, 150, 3), np.arange(0, 500, 10)  # every 0.05 s
    assert ours["time"][common[1]] == pytest.approx(time[common[0]], abs=3e-6)
    for joint in ("hip_flexion_r", "knee_angle_r", "hip_flexion_l", "knee_angle_l"):
        effort, expected = ours[f"{joint}.effort"], reference[f"{joint}.effort"]
        between = CubicSpline(ours["time"], effort)(time[inside])
        assert percent(between, expected[inside]) <= 0.5
        assert percent(effort[common[1]], expected[common[0]]) <= 0.5


@pytest.fixture(scope="module")
def walk():
    folder = RECORDINGS / "gait10dof/walk"
    return (
        load_scene(folder / "scene.yaml"),
        columns(folder / "motion.csv.gz"),
        columns(folder / "external_wrenches.csv.gz"),
        columns(folder / "reference_torques.csv.gz"),
    )


def walked(walk, wrong):
    """Torques by Pinocchio alone, done right or in one wrong way, in percent of error."""
    scene, motion, loads, reference = walk
    model, data, couplings = scene.robot.model, scene.robot.model.createData(), scene.couplings
    index, slides = couplings.v_index, [scene.robot.joint(d).v for d in couplings.dependent]
    straight = couplings.positions(np.zeros(10))[slides]
    names, tau = couplings.independent, []
    for i in range(len(motion["time"])):
        q, v, a = np.zeros((3, model.nv))
        for row, field in ((q, "position"), (v, "velocity"), (a, "acceleration")):
            row[index] = [motion[f"{name}.{field}"][i] for name in names]
        couplings.expand(q, v, a)
        G = couplings.jacobian(q)
        if wrong == "no drift":
            a = G @ a[index]
        if wrong == "hinge":
            q[slides], v[slides], a[slides], G[slides] = straight, 0.0, 0.0, 0.0
        full = pin.rnea(model, data, q, v, a)
        if wrong != "no plates":
            pin.computeJointJacobians(model, data, q)
            pin.updateFramePlacements(model, data)
            for side, link in (("right", "calcn_r"), ("left", "calcn_l")):
                J = pin.getFrameJacobian(model, data, model.getFrameId(link), pin.WORLD)
                fields = [f"{side}.{f}.{x}" for f in ("force", "torque") for x in "xyz"]
                full -= J.T @ [loads[field][i] for field in fields]
        tau.append(full[index] if wrong == "not mapped" else G.T @ full)
    pairs = zip(names, np.transpose(tau), strict=True)
    return {name: percent(column, reference[f"{name}.effort"]) for name, column in pairs}


@pytest.mark.parametrize(
    ("wrong", "joint", "lowest", "highest"),
    [
        (None, "knee_angle", 0.0, 0.005),
        ("hinge", "knee_angle", 7.0, 8.0),
        ("not mapped", "knee_angle", 9.0, 10.5),
        ("no drift", "hip_flexion", 4.0, 5.5),
        ("no plates", "knee_angle", 97.0, 98.5),
    ],
)
def test_wrong_ways_miss_by_the_stated_amounts(walk, wrong, joint, lowest, highest):
    errors = walked(walk, wrong)
    assert all(lowest <= errors[f"{joint}_{side}"] <= highest for side in "rl"), errors


def test_power_balances_over_random_motions_of_the_gait_model(walk):
    """Joint power = d/dt (kinetic + potential) - external power; the slides do no work."""
    scene = walk[0]
    model, data, couplings = scene.robot.model, scene.robot.model.createData(), scene.couplings
    inverse, rng, h = scene.inverse_dynamics(), np.random.default_rng(1), 1e-5
    w, phase, size = rng.uniform(1, 5, 10), rng.uniform(0, 6, 10), rng.uniform(0.1, 0.5, 10)
    rest = -0.6 * np.array(["knee" in name for name in couplings.independent])
    loads = rng.normal(scale=400.0, size=(2, 6))

    def at(t):
        rows = np.zeros((3, model.nv))
        for k, row in enumerate(rows):
            row[couplings.v_index] = size * w**k * np.sin(w * t + phase + k * np.pi / 2)
        rows[0, couplings.v_index] += rest
        couplings.expand(*rows)
        return rows

    def energy(t):
        q, v, _ = at(t)
        kinetic = pin.computeKineticEnergy(model, data, q, v)
        return kinetic + pin.computePotentialEnergy(model, data, q)

    for t in np.linspace(0, 3, 40):
        q, v, a = at(t)
        z = [row[couplings.v_index] for row in (q, v, a)]
        joint_power = inverse.solve(*z, list(loads)).tau @ z[1]
        full = v * pin.rnea(model, data, q, v, a)
        pin.forwardKinematics(model, data, q, v)
        external = sum(
            w @ pin.getFrameVelocity(model, data, model.getFrameId(link), pin.WORLD).vector
            for link, w in zip(("calcn_r", "calcn_l"), loads, strict=True)
        )
        rise = (energy(t - 2 * h) - 8 * energy(t - h) + 8 * energy(t + h) - energy(t + 2 * h)) / (
            12 * h
        )
        total = np.abs(full).sum() + abs(external)
        assert abs(joint_power + external - rise) <= 1e-6 * total
        assert abs(full.sum() - external - joint_power) <= 1e-10 * total


def test_knee_paths_of_the_gait_scene_have_no_kink(walk):
    """Two sides of every inner break: equal value, slope and curvature, as natural splines."""
    scene, breaks = walk[0], [-1.74533, -1.39626, -1.22173, -1.0472, -0.698132, -0.523599]
    breaks += [-0.349066, -0.174533, 0.159149, 0.197344, 0.337395, 0.490178, 1.52146]
    sides = []
    for shift in (-1e-9, 1e-9):
        q = np.zeros((scene.robot.model.nv, len(breaks)))
        v, a = np.ones_like(q), np.zeros_like(q)
        for name in ("knee_angle_r", "knee_angle_l"):
            q[scene.robot.joint(name).q] = np.array(breaks) + shift
        scene.couplings.expand(q, v, a)
        slides = [scene.robot.joint(name).v for name in scene.couplings.dependent]
        sides.append(np.array([q[slides], v[slides], a[slides]]))
    assert sides[0] == pytest.approx(sides[1], abs=1e-7)


def test_hand_equals_pinocchios_own_mimic_model():
    """Fresh data a call: `crba` and others of mimic models remember too much."""
    path = RECORDINGS / "psyonic_hand/psyonic_ability_hand_right_large.urdf"
    scene, own = scene_from(urdf=path), pin.buildModelFromUrdf(str(path), mimic=True)
    assert len(scene.couplings.dependent) == 4
    assert own.nv == len(scene.couplings.independent) == 6
    order = [own.joints[own.getJointId(name)].idx_v for name in scene.couplings.independent]
    inverse, rng = scene.inverse_dynamics(), np.random.default_rng(2)
    for scale in (0.0, 1.0, 20.0):
        z = rng.uniform(0, 1.7, (30, 6))
        v, a = scale * rng.normal(size=(2, 30, 6))
        batch = inverse.batch(z, v, a).tau
        for i in range(30):
            q, rate, push = np.zeros((3, 6))
            q[order], rate[order], push[order] = z[i], v[i], a[i]
            expected = pin.rnea(own, own.createData(), q, rate, push)[order]
            close = 1e-12 * np.abs(expected).max()
            assert inverse.solve(z[i], v[i], a[i]).tau == pytest.approx(expected, abs=close)
            assert batch[i] == pytest.approx(expected, abs=close)


@pytest.mark.parametrize("form", ["absent", "present", "shuffled"])
def test_prosthetic_hand_from_messages(form):
    """Mimic joints absent from, present in and shuffled within joint states: the same torques."""
    path = RECORDINGS / "psyonic_hand/psyonic_ability_hand_right_large.urdf"
    scene, own = scene_from(urdf=path), pin.buildModelFromUrdf(str(path), mimic=True)
    couplings, rng = scene.couplings, np.random.default_rng(3)
    z, v = rng.uniform(0, 1.7, 6), rng.normal(size=6)
    q, rate, push = couplings.positions(z), np.zeros(10), np.zeros(10)
    rate[couplings.v_index] = v
    couplings.expand(q, rate, push)
    names = [joint.name for joint in scene.robot.joints]
    chosen = {"absent": couplings.v_index, "present": np.arange(10)}.get(form, rng.permutation(10))
    message = write_joint_state(
        new_message("sensor_msgs/msg/JointState"),
        1,
        [names[i] for i in chosen],
        position=q[chosen],
        velocity=rate[chosen],
    )
    estimator = TorqueEstimator(scene.robot, scene.inverse_dynamics(), Tuning())
    reader = JointStateReader(estimator.names)
    sample = reader.read(message)
    x = estimator.observe(sample.stamp, sample.position, sample.velocity, reader.present)
    order = [own.joints[own.getJointId(name)].idx_v for name in couplings.independent]
    own_q, own_v = np.zeros((2, 6))
    own_q[order], own_v[order] = z, v
    expected = pin.rnea(own, own.createData(), own_q, own_v, np.zeros(6))[order]
    assert estimator.solve(x).tau == pytest.approx(expected, abs=1e-12 * np.abs(expected).max())
    assert estimator.violation(x) == pytest.approx(np.zeros(4), abs=1e-15)


def potential(root, angles, gravity):
    """Sum of m g y of a y-up chain whose joints turn about z, from the text alone."""
    placed = {"world": (np.eye(3), np.zeros(3))}
    for joint in root.findall("joint"):  # parents come first in this file
        R, p = placed[joint.find("parent").get("link")]
        origin, axis = joint.find("origin"), joint.find("axis")
        if origin is not None:
            assert origin.get("rpy") == "0 0 0"
            p = p + R @ np.array(origin.get("xyz").split(), dtype=float)
        if axis is not None:
            angle = angles[joint.get("name")] * float(axis.get("xyz").split()[2])
            c, s = np.cos(angle), np.sin(angle)
            R = R @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        placed[joint.find("child").get("link")] = R, p
    total = 0.0
    for link in root.findall("link"):
        if (inertial := link.find("inertial")) is not None:
            R, p = placed[link.get("name")]
            com = p + R @ np.array(inertial.find("origin").get("xyz").split(), dtype=float)
            total += float(inertial.find("mass").get("value")) * gravity * com[1]
    return total


def test_open_source_leg_holds_its_weight(data_dir):
    path = data_dir / "models/osl_v2_knee_ankle.urdf"
    scene = scene_from({"robot": {"gravity": [0, -9.81, 0]}}, urdf=path)
    root = ElementTree.parse(Path(path)).getroot()
    names, h = scene.couplings.independent, 1e-5
    assert names == ("thigh_flexion", "osl_knee_angle_r", "osl_ankle_angle_r")
    for z in np.random.default_rng(3).uniform(-1, 1, (10, 3)):
        slopes = [
            (
                potential(root, dict(zip(names, z + step, strict=True)), 9.81)
                - potential(root, dict(zip(names, z - step, strict=True)), 9.81)
            )
            / (2 * h)
            for step in h * np.eye(3)
        ]
        tau = scene.inverse_dynamics().solve(z, np.zeros(3), np.zeros(3)).tau
        assert tau == pytest.approx(slopes, abs=1e-7)


PANDA = [f"fer_joint{i}" for i in range(1, 8)]


def panda_motion(folder, rate):
    """The Panda's bag, or the same motion at another rate with encoder noise of 0.05 mrad."""
    source = RECORDINGS / "panda"
    urdf, names = source / "panda_nohand.urdf", enumerate(PANDA, 1)
    rename = ", ".join(f"panda_joint{i}: {name}" for i, name in names)
    text = f"robot:\n  urdf: {urdf}\n  rename: {{{rename}}}\n"
    (folder / "panda.yaml").write_text(text, encoding="utf-8")
    recorded = read_motion(source / "bag", PANDA).motion
    t = (recorded.stamps - recorded.stamps[0]) / 1e9
    if rate is None:
        return t, source / "bag", recorded.effort
    dense, rng = np.arange(t[0], t[-1], 1 / rate), np.random.default_rng(rate)
    noise = 5e-5 * rng.normal(size=(len(dense), 7))
    fields = {
        "position": CubicSpline(t, recorded.position)(dense) + noise,
        "velocity": CubicSpline(t, recorded.velocity)(dense),
        "effort": np.transpose([np.interp(dense, t, tau) for tau in recorded.effort.T]),
    }
    return dense, fields, fields["effort"]


@pytest.mark.parametrize(
    ("rate", "fields", "bound"),
    [
        (None, ("position", "velocity"), 5.5),
        (500, ("position", "velocity"), 6.0),
        pytest.param(1000, ("position", "velocity"), 6.0, marks=pytest.mark.soak),
        pytest.param(500, ("position",), 8.0, marks=pytest.mark.soak),
        (1000, ("position",), 8.0),
    ],
)
def test_zero_phase_of_a_real_robot_at_any_rate(tmp_path, capsys, rate, fields, bound):
    """The command of the README; the first 0.5 s of the recording show the robot starting."""
    t, motion, effort = panda_motion(tmp_path, rate)
    if rate is not None:
        given = (*fields, "effort")
        names = ["time", *(f"{name}.{field}" for field in given for name in PANDA)]
        table = np.column_stack([t, *(motion[field] for field in given)])
        write_table(tmp_path / "motion.csv", names, table)
        motion = tmp_path / "motion.csv"
    words = ["inverse", tmp_path / "panda.yaml", motion, "-o", tmp_path / "torques.csv"]
    assert main([*map(str, words), "--derivatives", "zero-phase"]) == 0
    said = capsys.readouterr().out
    ours = columns(tmp_path / "torques.csv")
    found, started = np.transpose([ours[f"{name}.effort"] for name in PANDA]), t > 0.5
    off = np.linalg.norm((found - effort)[started]) / np.linalg.norm(effort[started])
    assert 100 * off <= bound
    assert float(said.split("off the measured effort by ")[1].split(" %")[0]) <= bound


def compensated(scene, motion, recorded, t, cutoff):
    """Torques by the causal filter at a cutoff, all of a motion as late as its acceleration."""
    found = scene.inverse(motion, derivatives="causal", cutoff=cutoff)["samples"]
    a = np.transpose([found[f"{name}.acceleration"] for name in PANDA])
    lag = 2.0 * np.sqrt(np.sqrt(2.0) - 1.0) / (2.0 * np.pi * cutoff)
    q, v = (CubicSpline(t, part)(t - lag) for part in (recorded.position, recorded.velocity))
    model, data = scene.robot.model, scene.robot.model.createData()
    return lag, np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])


def test_estimated_torques_beside_a_causal_filter_of_the_same_delay(tmp_path):
    """Both against the torques of the same model by the zero-phase motion, not the measured ones.

    Positions count little: stamps jitter by 1.5 ms. The filter is at the cutoff of that delay.
    """
    _, bag, _ = panda_motion(tmp_path, None)
    scene = mbd_ros.load_scene(tmp_path / "panda.yaml").with_(dt=0.01)  # 3 to 4 steps a sample
    recorded = read_motion(bag, PANDA).motion
    t = (recorded.stamps - recorded.stamps[0]) / 1e9
    clean = scene.inverse(bag, derivatives="zero-phase")["samples"]
    clean = np.transpose([clean[f"{name}.effort"] for name in PANDA])
    noise = {"position_noise": 5e-3, "velocity_noise": 0.01, "model_noise": 0.02}
    unknown = {"disturbance": PANDA, "drifting": True, "disturbance_noise": 50.0}
    found = scene.estimate(bag, inputs="none", lag=0.034, **noise, **unknown)["samples"]
    ours = np.transpose([found[f"disturbance.{name}"] for name in PANDA])
    lag, filtered = compensated(scene, bag, recorded, t, 6.2)
    assert 0.032 < lag < 0.034
    moved = t > 0.7
    late = CubicSpline(t, clean)(t - lag)
    error = percent(ours[moved], clean[moved])
    assert error <= 1.15 and error <= 0.7 * percent(filtered[moved], late[moved])
