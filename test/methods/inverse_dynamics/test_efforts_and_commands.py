"""`.effort` is joint torque, `.command` what an actuator takes: results can be fed back."""

import numpy as np
import pytest
from actuators import FIXED
from offline import SCENES

from mbd_ros.cli import main
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State
from mbd_ros.files.tables.csv import read_table, write_table
from mbd_ros.parts.actuators.geared_motor import GearedMotor
from mbd_ros.parts.actuators.ideal import Ideal
from mbd_ros.parts.actuators.series_elastic import SeriesElastic
from mbd_ros.scene.reader import load_scene

URDF = SCENES.parent / "robots/pendulum.urdf"
GEAR = "geared_motor, joint: hinge, ratio: -50.0, rotor_inertia: 1.0e-5, efficiency: 0.7, "
GEAR += "viscous: 1.0e-5"
SPRING = "series_elastic, joint: hinge, stiffness: 200.0, damping: 1.5"
IDEAL = "ideal, joints: [hinge]"
TAKES = {GEAR: "torque of the motor [N·m]", SPRING: "position of the motor side of the spring"}


def columns(path):
    table = read_table(path)
    return dict(zip(table.columns, table.values.T, strict=True))


def scene(folder, actuator, limit=None):
    path = folder / "scene.yaml"
    limited = "" if limit is None else f", limit: {limit}"
    text = f"robot: {{urdf: {URDF}}}\nactuators:\n- {{type: {actuator}{limited}}}\n"
    path.write_text(text, encoding="utf-8")
    return path


def motion(path, step=5e-4, speed=1.0):
    """A swing with reversals."""
    t = np.arange(0, 2, step)
    w = 5.0
    fields = [0.6 * w**k * np.sin(w * t + k * np.pi / 2) for k in range(3)]
    fields[1] *= speed
    names = [f"hinge.{field}" for field in ("position", "velocity", "acceleration")]
    write_table(path, ["time", *names], np.column_stack([t, *fields]))
    return path


def run(*words):
    return main([str(word) for word in words])


@pytest.mark.parametrize("part", ["gear", "spring", "ideal"])
def test_demanded_commands_give_the_torque_whatever_the_losses(part):
    made = {
        "gear": GearedMotor(FIXED, joint="ankle", ratio=-50.0, efficiency=0.6, viscous=1e-4),
        "spring": SeriesElastic(FIXED, joint="ankle", stiffness=300.0, damping=2.0),
        "ideal": Ideal(FIXED, joints=["ankle"]),
    }[part]
    v_index, rng = FIXED.joint("ankle").v, np.random.default_rng(1)
    for scale in (1e-3, 1e-2, 1.0, 1.0, 1.0, 30.0) * 5:
        x = State(0.0, rng.normal(size=5), scale * rng.normal(size=5))
        tau = rng.normal(scale=20.0, size=1)
        given = made.force(Kinematics, x, made.demanded(tau, x))[v_index]
        assert given == pytest.approx(tau[0], rel=1e-12)


@pytest.mark.parametrize("actuator", [GEAR, SPRING, IDEAL])
def test_inverse_fed_to_simulate_gives_the_motion_back(tmp_path, actuator):
    """Commands are held between samples: the motion comes back to first order in their step."""
    path, off = scene(tmp_path, actuator), []
    for step in (1e-3, 5e-4):
        wanted = motion(tmp_path / "m.csv", step)
        assert run("inverse", path, wanted, "-o", tmp_path / "tau.csv") == 0
        found = columns(tmp_path / "tau.csv")
        assert ("hinge.command" in found) == (actuator != IDEAL)
        words = ["-t", 1.0, "--dt", step, "--from", wanted, "--efforts", tmp_path / "tau.csv"]
        assert run("simulate", path, *words, "-o", tmp_path / "again.csv") == 0
        again = columns(tmp_path / "again.csv")["hinge.position"]
        off.append(np.abs(again - columns(wanted)["hinge.position"][: len(again)]).max())
    assert off[1] < 5e-3
    assert off[1] / off[0] == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize("limit", [None, 1.0])
@pytest.mark.parametrize("actuator", [GEAR, SPRING, IDEAL])
def test_simulation_fed_to_simulate_is_that_simulation(tmp_path, actuator, limit):
    """Bit for bit, drives at their limit too; and `inverse` finds its efforts and commands."""
    if limit is not None and actuator == GEAR:
        limit = 0.02
    path, t = scene(tmp_path, actuator, limit), np.arange(0, 1, 1e-3)
    rest = 0.03 if actuator == GEAR else 0.0
    size = {GEAR: 0.03, SPRING: 0.2, IDEAL: 2.0}[actuator]
    given = np.column_stack([t, rest + size * np.sin(7 * t)])
    write_table(tmp_path / "u.csv", ["time", "hinge.command"], given)
    words = ["simulate", path, "-t", 0.5, "--dt", 1e-3]
    assert run(*words, "--efforts", tmp_path / "u.csv", "-o", tmp_path / "one.csv") == 0
    assert run(*words, "--efforts", tmp_path / "one.csv", "-o", tmp_path / "two.csv") == 0
    one, two = columns(tmp_path / "one.csv"), columns(tmp_path / "two.csv")
    assert all(np.array_equal(one[name], two[name]) for name in one)
    assert run("inverse", path, tmp_path / "one.csv", "-o", tmp_path / "back.csv") == 0
    back = columns(tmp_path / "back.csv")
    assert back["hinge.effort"] == pytest.approx(one["hinge.effort"], abs=1e-9)
    if actuator != IDEAL and limit is None:
        assert back["hinge.command"] == pytest.approx(one["hinge.command"], abs=1e-9)


@pytest.mark.parametrize("actuator", [GEAR, SPRING])
def test_joint_torque_is_refused_where_a_command_is_wanted(tmp_path, capsys, actuator):
    path, t = scene(tmp_path, actuator), np.arange(0, 1, 0.1)
    write_table(tmp_path / "u.csv", ["time", "hinge.effort"], np.column_stack([t, t]))
    words = ["--efforts", tmp_path / "u.csv", "-o", tmp_path / "o.csv"]
    assert run("simulate", path, "-t", 0.1, *words) == 2
    said = capsys.readouterr().err
    assert f"u.csv: no column hinge.command: its actuator takes the {TAKES[actuator]}" in said
    assert "hinge.effort is the torque of the joint" in said
    assert not (tmp_path / "o.csv").exists()


def test_joint_torque_of_a_bag_is_refused_and_serves_ideal_actuators(tmp_path, capsys):
    path = scene(tmp_path, IDEAL)
    assert run("simulate", path, "-t", 0.1, "-o", tmp_path / "bag") == 0
    words = ["--efforts", tmp_path / "bag", "-o", tmp_path / "o.csv"]
    assert run("simulate", path, "-t", 0.1, *words) == 0
    assert run("simulate", scene(tmp_path, GEAR), "-t", 0.1, *words) == 2
    assert "bag: no column hinge.command" in capsys.readouterr().err


@pytest.mark.parametrize(("actuator", "limit"), [(GEAR, 0.01), (SPRING, 0.5), (IDEAL, 0.5)])
def test_efforts_beyond_the_limit_of_a_drive_are_said(tmp_path, capsys, actuator, limit):
    path = scene(tmp_path, actuator, limit)
    words = ["-o", tmp_path / "tau.csv"]
    assert run("inverse", path, motion(tmp_path / "m.csv"), *words) == 0
    said = capsys.readouterr().out
    assert "hinge: " in said and "are beyond the limit of its actuator" in said
    assert run("inverse", scene(tmp_path, actuator), tmp_path / "m.csv", *words) == 0
    assert "cannot give" not in capsys.readouterr().out


def test_losses_of_the_motor_are_in_the_command_and_not_in_the_effort(tmp_path):
    """Effort is what the joint gets; the rotor's inertia is a load of the joint."""
    found = {}
    for name, more in (("bare", ""), ("lossy", ", efficiency: 0.5, viscous: 1.0e-4")):
        path = scene(tmp_path, f"geared_motor, joint: hinge, ratio: 50.0{more}")
        out = tmp_path / f"{name}.csv"
        assert run("inverse", path, motion(tmp_path / "m.csv"), "-o", out) == 0
        found[name] = columns(out)
    assert np.array_equal(found["bare"]["hinge.effort"], found["lossy"]["hinge.effort"])
    bare = found["bare"]
    assert bare["hinge.command"] == pytest.approx(bare["hinge.effort"] / 50.0, rel=1e-14)
    off = found["lossy"]["hinge.command"] - bare["hinge.command"]
    assert np.abs(off).max() > 0.5 * np.abs(bare["hinge.command"]).max()
    heavy = scene(tmp_path, "geared_motor, joint: hinge, ratio: 50.0, rotor_inertia: 1.0e-4")
    assert load_scene(heavy).actuators[0].armature() == pytest.approx([0.25])
    assert run("inverse", heavy, tmp_path / "m.csv", "-o", tmp_path / "heavy.csv") == 0
    inertia = columns(tmp_path / "heavy.csv")["hinge.effort"] - bare["hinge.effort"]
    acceleration = columns(tmp_path / "m.csv")["hinge.acceleration"]
    assert inertia == pytest.approx(0.25 * acceleration, abs=1e-9)


def test_a_velocity_that_no_command_can_follow_is_refused(tmp_path, capsys):
    """A spring that hardly is one: its motor would have to wind it up for ever."""
    weak = scene(tmp_path, "series_elastic, joint: hinge, stiffness: 1.0e-30, damping: 1.0e+30")
    out, fast = tmp_path / "out.csv", motion(tmp_path / "motion.csv", 0.1, 1.0e250)
    assert run("inverse", weak, fast, "-o", out) == 2
    told = capsys.readouterr().err
    assert "motion.csv: hinge.velocity is " in told and "size must be at most 1e+30" in told
    assert not out.exists()
