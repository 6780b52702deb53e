"""Recorded motions to torques: sources of derivatives, loads, what is left out and said."""

from pathlib import Path

import numpy as np
import pytest
from offline import SCENES

from mbd_ros.core.loads.external_loads import WrenchBuffer
from mbd_ros.errors import DataError
from mbd_ros.features.inverse_dynamics.job import inverse_to
from mbd_ros.files.bags.bag_types import new_message
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.tables.csv import read_table, write_table
from mbd_ros.methods.inverse_dynamics.torque_estimator import Observation, TorqueEstimator, Tuning
from mbd_ros.motion.derivatives import Derivatives
from mbd_ros.motion.samples import Task
from mbd_ros.scene.from_python import scene_from
from mbd_ros.scene.reader import load_scene
from msg_adapters.joint_state import write_joint_state
from msg_adapters.wrench import write_wrench

STANCE = SCENES / "prosthetic_leg_stance.yaml"
JOINT_STATE, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"
BEGIN, MS = 1_760_000_000_000_000_000, 1_000_000
NAMES = ["ankle", "hip_flexion", "knee"]
W, REST = np.array([2.0, 3.0, 5.0]), np.array([0.0, 0.2, -0.8])


def motion(t, order=0):
    """Ankle, hip and knee, or their derivatives in time."""
    return 0.3 * W**order * np.sin(W * t + order * np.pi / 2) + REST * (order == 0)


def load(t):
    return np.array([30 * np.sin(t), 0.0, 700 + 50 * np.sin(9 * t), 1.0, 80 * np.sin(3 * t), 0])


def bag(path, *, frame="world", extra=None, wrench_end=1010, names=NAMES):
    """One second of joint states at jittered 200 Hz and of the plate at 333 Hz, in log order."""
    jitter = np.random.default_rng(0).integers(0, 3 * MS, 200)
    states = [(i * 5 * MS + int(j), "/joint_states", JOINT_STATE) for i, j in enumerate(jitter)]
    plate = [(i * 3 * MS, "/force_plate", WRENCH) for i in range(wrench_end // 3)]
    with BagWriter(path) as writer:
        for t, topic, msgtype in sorted(states + plate):
            msg, stamp = new_message(msgtype), BEGIN + t
            if topic == "/force_plate":
                write_wrench(msg, stamp, frame, load(t / 1e9))
            else:
                values = motion(t / 1e9)
                columns = names + list(extra or {})
                position = np.r_[values, [f(values) for f in (extra or {}).values()]]
                write_joint_state(msg, stamp, columns, position=position)
            writer.write(topic, msgtype, stamp, msg)
    return path


def table(path, fields=("position", "velocity", "acceleration"), shift=0.0):
    time = np.arange(100) * 0.01
    rows = [np.array([motion(t, k) for t in time]) + shift * (k == 0) for k in range(len(fields))]
    columns = [f"{name}.{field}" for field in fields for name in NAMES]
    write_table(path, ["time", *columns], np.column_stack([time, *rows]))
    return path


def plate_table(path, times=(-0.1, 1.0)):
    columns = [f"ground_reaction.{f}.{x}" for f in ("force", "torque") for x in "xyz"]
    write_table(path, ["time", *columns], np.array([[t, *load(0.0)] for t in times]))
    return path


def run(scene, source, out, kind="given", **options):
    """Lines that are said, and columns that are written."""
    scene = scene if not isinstance(scene, Path) else load_scene(scene)
    lines = []
    inverse_to(scene, Task(source, Derivatives(kind), **options), out, lines.append)
    result = read_table(out)
    return lines, dict(zip(result.columns, result.values.T, strict=True))


def test_causal_result_is_that_of_the_estimator_fed_message_by_message(tmp_path):
    """What a live node computes, with stamps of this century and loads between the samples."""
    source = bag(tmp_path / "bag")
    lines, ours = run(STANCE, source, tmp_path / "out.csv", "causal")
    scene = load_scene(STANCE)
    estimator = TorqueEstimator(scene.robot, scene.inverse_dynamics(), Tuning())
    buffer = WrenchBuffer(100 * MS, 1000 * MS)
    jitter, tau, multipliers = np.random.default_rng(0).integers(0, 3 * MS, 200), [], []
    waiting = [(i * 3 * MS, load(i * 3 * MS / 1e9)) for i in range(336)]
    order = [NAMES.index(name) for name in scene.couplings.independent]
    for i, j in enumerate(jitter.tolist()):
        t = i * 5 * MS + j
        while not buffer.covers(BEGIN + t):
            at, wrench = waiting.pop(0)
            buffer.add(BEGIN + at, wrench)
        position = np.r_[motion(t / 1e9)[order], np.nan, np.nan]
        present = np.array([True] * 3 + [False] * 2)
        x = estimator.observe(BEGIN + t, position, np.full(5, np.nan), present)
        assert isinstance(x, Observation)
        torques = estimator.solve(x, [buffer.at(x.stamp)])
        tau.append(torques.tau)
        multipliers.append(torques.multipliers)
    for names, rows, field in (
        (scene.couplings.independent, tau, "effort"),
        (scene.couplings.dependent, multipliers, "multiplier"),
    ):
        for name, column in zip(names, np.transpose(rows), strict=True):
            assert ours[f"{name}.{field}"] == pytest.approx(column, abs=1e-9)
    assert any(line.startswith("causal derivatives at 5 Hz lag by 0.0487 s and") for line in lines)
    assert any(
        line.endswith("200 samples, causal derivatives -> " + str(tmp_path / "out.csv"))
        for line in lines
    )


@pytest.mark.parametrize("name", ["out.csv", "out.csv.gz"])
def test_given_derivatives_give_the_torques_of_the_solver(tmp_path, name):
    source, plate = table(tmp_path / "m.csv"), plate_table(tmp_path / "w.csv")
    _, ours = run(STANCE, source, tmp_path / name, wrenches=plate, parts=True)
    scene = load_scene(STANCE)
    order = [NAMES.index(joint) for joint in scene.couplings.independent]
    for i in (0, 57, 99):
        z, v, a = (motion(i * 0.01, k)[order] for k in range(3))
        expected = scene.inverse_dynamics().solve(z, v, a, [load(0.0)])
        for j, joint in enumerate(scene.couplings.independent):
            assert ours[f"{joint}.effort"][i] == pytest.approx(expected.tau[j], abs=1e-9)
            causes = ("gravity", "coriolis", "inertial", "external")
            total = sum(ours[f"{joint}.{cause}"][i] for cause in causes)
            assert total == pytest.approx(expected.tau[j], abs=1e-9)
        for j, joint in enumerate(scene.couplings.dependent):
            assert ours[f"{joint}.multiplier"][i] == pytest.approx(expected.multipliers[j])


def test_zero_phase_is_close_to_the_exact_derivatives_and_does_not_lag(tmp_path):
    scene = load_scene(SCENES / "prosthetic_leg.yaml")
    exact = run(scene, table(tmp_path / "m.csv"), tmp_path / "a.csv")[1]
    bare = table(tmp_path / "p.csv", fields=("position",))
    smooth = run(scene, bare, tmp_path / "b.csv", "zero-phase")[1]
    causal = run(scene, bare, tmp_path / "c.csv", "causal")[1]
    for joint in NAMES:
        effort = exact[f"{joint}.effort"]
        error = np.abs(smooth[f"{joint}.effort"] - effort) / np.ptp(effort)
        assert error.max() < 3e-3  # at the ends, where no window is centred
        assert error[4:-4].max() < 1e-5
    assert np.abs(causal["knee.effort"] - exact["knee.effort"]).max() > 0.01


def test_continuous_joint_that_wraps_in_the_recording_is_unwrapped(tmp_path):
    text = (SCENES.parent / "robots/pendulum.urdf").read_text(encoding="utf-8")
    scene = scene_from(urdf=text.replace('"revolute"', '"continuous"'))
    time = np.arange(300) * 0.01
    angle = 6.0 * time
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    for name, column in (("plain", angle), ("wrapped", wrapped)):
        rows = np.column_stack([time, column])
        write_table(tmp_path / f"{name}.csv", ["time", "hinge.position"], rows)
    for kind in ("zero-phase", "causal"):
        plain, wrapped = (
            run(scene, tmp_path / f"{name}.csv", tmp_path / "out.csv", kind)[1]
            for name in ("plain", "wrapped")
        )
        assert wrapped["hinge.velocity"][1:] == pytest.approx(6.0, abs=1e-6)
        assert wrapped["hinge.effort"] == pytest.approx(plain["hinge.effort"], abs=1e-6)


def test_dependent_joints_are_reconstructed_or_compared(tmp_path):
    """knee_slide_y comes 2 mm off, knee_slide_x not at all."""
    scene = load_scene(STANCE)
    law = [0.0, 0.0022, -0.00844, -0.00162]
    source = bag(
        tmp_path / "bag", extra={"knee_slide_y": lambda z: np.polyval(law[::-1], z[2]) + 0.002}
    )
    lines, ours = run(scene, source, tmp_path / "out.csv", "zero-phase")
    assert "knee_slide_y is off its coupling by at most 0.002" in lines
    assert "knee_slide_x is reconstructed from knee (spline)" in lines
    plain = run(scene, bag(tmp_path / "b2"), tmp_path / "o2.csv", "zero-phase")[1]
    assert np.array_equal(ours["knee.effort"], plain["knee.effort"])


def test_glitches_are_left_out_and_counted(tmp_path):
    source = table(tmp_path / "p.csv", fields=("position",))
    values = read_table(source)
    values.values[50, 1:] += 30.0
    write_table(source, values.columns, values.values)
    lines, ours = run(SCENES / "prosthetic_leg.yaml", source, tmp_path / "out.csv", "causal")
    assert "1 samples left out: jump beyond the velocity limit" in lines
    assert len(ours["time"]) == 99


@pytest.mark.parametrize(
    ("make", "options", "message"),
    [
        (lambda d: table(d / "m.csv"), {}, "external_wrenches ground_reaction: a table of joints"),
        (lambda d: bag(d / "bag"), {}, "no velocity of hip_flexion, knee, ankle; choose --deriv"),
        (
            lambda d: bag(d / "bag", frame="foot"),
            {"kind": "causal"},
            "is in frame 'foot', the sce",
        ),
        (
            lambda d: bag(d / "bag", wrench_end=600),
            {"kind": "causal"},
            "wrench 'ground_reaction' c",
        ),
        (lambda d: bag(d / "bag", names=["a", "b", "c"]), {"kind": "causal"}, "no joint hip_flex"),
        (lambda d: d / "none", {"kind": "causal"}, "none"),
        (lambda d: bag(d / "bag"), {"kind": "causal", "topic": "/a"}, "no topic /a; there are: "),
    ],
)
def test_motion_that_does_not_fit_is_refused_and_nothing_is_left(tmp_path, make, options, message):
    source = make(tmp_path)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(DataError) as caught:
        run(STANCE, source, tmp_path / "out.csv", **options)
    assert message in str(caught.value)
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("motion_ends", "message"),
    [((0.5, 1.0), "wrench 'ground_reaction' covers 0.5 to 1.0 s, not the motion at 0.0 s")],
)
def test_load_that_does_not_cover_the_motion_is_refused(tmp_path, motion_ends, message):
    plate = plate_table(tmp_path / "w.csv", motion_ends)
    with pytest.raises(DataError) as caught:
        run(STANCE, table(tmp_path / "m.csv"), tmp_path / "out.csv", wrenches=plate)
    assert message in str(caught.value)
    assert not (tmp_path / "out.csv").exists()


def test_numbers_whose_products_are_no_numbers_are_refused(tmp_path):
    with pytest.raises(
        DataError, match=r"m\.csv: .* is 1e\+200 in row 1, but its size must be at most"
    ):
        run(
            SCENES / "prosthetic_leg.yaml",
            table(tmp_path / "m.csv", shift=1e200),
            tmp_path / "out.csv",
        )
    assert not (tmp_path / "out.csv").exists()
