"""`mbd-ros demo walking`: its page, its checks, and what the simulation knows."""

import subprocess
import sys

import numpy as np
import pytest

from mbd_ros.applications.demo import walking
from mbd_ros.applications.demo.walking import JOINTS
from mbd_ros.cli import main
from mbd_ros.files.table import read_result

ROS = "rclpy", "rosbags", "std_msgs"


@pytest.fixture(scope="module")
def numbers():
    return walking.WalkingNumbers()


@pytest.fixture
def demo(numbers, tmp_path, monkeypatch):
    """A function that makes the page from one simulation for all tests; exit code and folder."""
    monkeypatch.setattr(walking, "WalkingNumbers", lambda: numbers)
    return lambda: (main(["demo", "walking", "-o", str(tmp_path / "out")]), tmp_path / "out")


def test_the_page_says_what_was_found(demo, capsys):
    code, folder = demo()
    assert code == 0
    html = (folder / "demo.html").read_text(encoding="utf-8")
    assert "All checks are met." in html
    assert html.count("<figure>") == 6
    assert "<script" not in html and "https:" not in html
    tables = {path.name for path in folder.glob("*.csv")}
    assert tables == {"swing.csv", "markers.csv", "motion.csv", "moments.csv", "forces.csv"}
    assert read_result(folder / "forces.csv")["samples"].rows == 85
    said = capsys.readouterr().out
    assert "Load of the knee in body weights of 737 N" in said
    assert demo()[0] == 0  # in the place of the first one


def test_a_check_that_is_not_met_is_exit_code_1_and_keeps_the_page(demo, monkeypatch, capsys):
    monkeypatch.setattr(walking, "_LOAD", 0.01)
    code, folder = demo()
    assert code == 1
    assert "<strong>Not met:</strong>" in (folder / "demo.html").read_text(encoding="utf-8")
    assert "error of the knee load" in capsys.readouterr().err


def test_simulated_tensions_are_the_moments_of_the_simulated_motion(numbers):
    """By moment arms, against inverse dynamics of the swing without muscles."""
    arms = numbers.scene.moment_arms(numbers.swing)["samples"]
    none = np.zeros(len(numbers.time))
    for joint in JOINTS:
        exerted = sum(
            arms.get(f"{muscle}.{joint}", none) * numbers.swing["samples"][f"{muscle}.tension"]
            for muscle in numbers.muscles
        )
        known = numbers.known["samples"][f"{joint}.effort"]
        np.testing.assert_allclose(exerted, known, rtol=0, atol=1e-9 * np.abs(known).max())


def test_the_swing_is_one_of_walking(numbers):
    """The knee bends to about 60 degrees and is straight in the end; the thigh swings forward."""
    hip, knee, _ = np.degrees(walking.columns(numbers.swing, JOINTS, "position")).T
    assert -65.0 < knee.min() < -50.0
    assert abs(knee[-1]) < 5.0
    assert hip[0] < -10.0 and hip[-1] > 20.0


def test_times_and_laws_are_for_robots(tmp_path, capsys):
    assert main(["demo", "walking", "--time", "3", "-o", str(tmp_path / "out")]) == 2
    assert "walking: its time is that of a swing" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_it_needs_no_ros():
    code = "import sys, mbd_ros.applications.demo.walking; "
    code += f"print([m for m in {ROS} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"
