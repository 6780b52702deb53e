"""`mbd-ros demo` as a user runs it: processes over DDS, and numbers that are those of the bag."""

import re

import numpy as np
import pytest
import yaml
from demo import LAM, Task
from nodes.demo_command import demo
from scipy.interpolate import BPoly

from mbd_ros.applications.demo.files import GAINS, MASS_SCALE, PLANT, RATE
from mbd_ros.applications.demo.task import ROBOTS
from mbd_ros.files.bags.bag_reader import messages
from mbd_ros.scene.reader import load_scene
from msg_adapters.time import read_time

pytestmark = pytest.mark.alone

FILES = {"bag", "demo.png", "demo.html", "plant.yaml", "model.yaml", "model.urdf", GAINS}
OWN = "/sliding_mode_controller"
TORQUES, FORCES = "/inverse_dynamics/joint_torques", "/simulator/constraint_forces"


def row(text, title, name):
    """Numbers of a row of a table in the output."""
    table = text[text.index(title) :].split("\n\n")[0]
    (line,) = [line for line in table.splitlines() if line.strip().startswith(f"{name} ")]
    return [float(x) for x in re.findall(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?", line.split(name)[1])]


class Bag:
    """A recording, read without the code of the demo."""

    def __init__(self, folder):
        self.rows = {}
        for topic, log, message in messages(folder / "bag"):
            self.rows.setdefault(topic, []).append((log, message))

    def stamped(self, topic, field, names=None):
        """Stamps [s] and values of a JointState topic."""
        rows = [message for _, message in self.rows[topic]]
        columns = [list(rows[0].name).index(n) for n in names or rows[0].name]
        stamps = np.array([read_time(m.header.stamp) for m in rows]) * 1e-9
        return stamps, np.array([getattr(m, field) for m in rows])[:, columns]

    def reference(self, times):
        """Quintics through the points of the trajectory: positions at times [s]."""
        ((_, message),) = self.rows[f"{OWN}/joint_trajectory"]
        since = [p.time_from_start.sec + p.time_from_start.nanosec * 1e-9 for p in message.points]
        points = [np.stack([p.positions, p.velocities, p.accelerations]) for p in message.points]
        return BPoly.from_derivatives(since, points)(times)


@pytest.fixture(scope="module")
def four_bar(tmp_path_factory):
    """A demo of another robot and law: output and folder."""
    out = tmp_path_factory.mktemp("demo") / "out"
    return demo("four_bar", "--time", 2, "--controller", "super_twisting", "-o", out), out


@pytest.fixture(scope="module")
def arm(four_bar):
    """A demo of 3 s into the folder of an older one: output and folder."""
    _, out = four_bar
    return demo("--time", 3, "-o", out), out


def test_it_leaves_recording_scenes_picture_and_page(arm):
    text, out = arm
    assert [path.name for path in out.parent.iterdir()] == ["out"]
    assert {path.name for path in out.iterdir()} == FILES
    assert (out / "demo.png").read_bytes().startswith(b"\x89PNG\r\n\x1a\n")
    bag = Bag(out)
    counts = {topic: len(rows) for topic, rows in bag.rows.items()}
    assert counts["/joint_states"] >= 3 * RATE + 1
    (shown, _), (answered, _) = (
        bag.stamped(t, "effort") for t in ("/joint_states", f"{OWN}/state")
    )
    assert set(answered) >= set(shown[:-1])  # a state may be shown again until it is answered
    for topic in ("/simulator/commands", TORQUES, "/inverse_dynamics/constraint_forces", FORCES):
        assert counts[topic] >= 0.98 * len(set(shown))
    assert "/clock" in counts and "/diagnostics" in counts
    assert "NO" not in text[text.index("Checks") :]


def test_time_is_that_of_the_simulation_tick_by_tick(arm):
    """Nothing is skipped, and what the actuators exert is what was commanded the tick before.

    A state may be repeated, as it was, for listeners that come late and for lost messages.
    """
    bag = Bag(arm[1])
    stamps, effort = bag.stamped("/joint_states", "effort", ROBOT_JOINTS)
    is_new = np.diff(stamps) != 0.0
    np.testing.assert_array_equal(effort[1:][~is_new], effort[:-1][~is_new])
    stamps, effort = (rows[np.r_[True, is_new]] for rows in (stamps, effort))
    np.testing.assert_allclose(np.diff(stamps), 1 / RATE, atol=2e-9)
    assert stamps[0] == 1e-9  # ROS reads 0 as no time at all
    commands = np.array([m.data for _, m in bag.rows["/simulator/commands"]])
    if len(commands) == len(stamps):
        np.testing.assert_array_equal(effort[1:], commands[:-1])


ROBOT_JOINTS = load_scene(ROBOTS["arm"].scene).actuated


def test_the_tracking_errors_are_those_of_reference_and_joint_states(arm):
    text, out = arm
    bag = Bag(out)
    stamps, position = bag.stamped("/joint_states", "position", ROBOT_JOINTS)
    late = stamps >= 1.0
    error = (position - bag.reference(stamps))[late]
    for i, joint in enumerate(ROBOT_JOINTS):
        rms, largest = row(text, "Tracking error", joint)[:2]
        assert rms == pytest.approx(1e3 * np.sqrt(np.mean(error[:, i] ** 2)), rel=6e-3)
        assert largest == pytest.approx(1e3 * np.abs(error[:, i]).max(), rel=6e-3)


def test_the_steady_errors_are_within_the_boundary_layer_bound(arm, tmp_path):
    """|e| <= phi d / (k g lambda), d along the reference, 10 % for moving off it and the hold."""
    task = Task("arm", tmp_path, 3.0)
    d = np.abs([m.disturbance for m in task.mismatches()]).max(axis=0)
    gain, layer = (np.array(task.gains[f"gains.{n}"]) for n in ("gain", "boundary_layer"))
    bound = 1.1 * layer * d / (gain * MASS_SCALE * LAM)
    stamps, error = Bag(arm[1]).stamped(f"{OWN}/state", "position")
    largest = np.abs(error[stamps >= 1.0]).max(axis=0)
    assert np.all(largest < bound)
    assert np.all(largest > 0.3 * bound)  # the bound is not idle


def test_the_torque_numbers_are_those_of_the_bag(arm):
    text, out = arm
    bag = Bag(out)
    stamps, estimate = bag.stamped(TORQUES, "effort", ROBOT_JOINTS)
    states, effort = bag.stamped("/joint_states", "effort", ROBOT_JOINTS)
    commands = {round(t * RATE): u for t, u in zip(states - 1 / RATE, effort, strict=True)}
    late = [k for k, t in enumerate(stamps) if t >= 1.0 and round(t * RATE) in commands]
    command = np.array([commands[round(stamps[k] * RATE)] for k in late])
    part = yaml.safe_load((out / PLANT).read_text(encoding="utf-8"))["forces"][-1]
    assert part["joints"] == list(ROBOT_JOINTS)
    known = np.array(part["torque"]).T
    added = np.array([np.interp(stamps[late], part["times"], column) for column in known]).T
    difference = estimate[late] - command
    for i, joint in enumerate(ROBOT_JOINTS):
        span, rms, share, disturbance, rest, left = row(text, "Torque estimate", joint)
        expected = [
            np.sqrt(np.mean(x[:, i] ** 2)) for x in (difference, added, difference - added)
        ]
        assert [rms, disturbance] == pytest.approx(expected[:2], rel=6e-3)
        assert rest == pytest.approx(expected[2], rel=6e-2)  # a difference of nearly equal curves
        assert span == pytest.approx(np.ptp(command[:, i]), rel=2e-2)  # the last one acts no more
        assert share == pytest.approx(100 * rms / span, rel=2e-2)
        assert rest < 0.1 * rms and left < 3.0  # the disturbance explains it


def test_coupling_forces_and_rates_are_those_of_the_bag(arm):
    text, out = arm
    bag = Bag(out)
    stamps, force = bag.stamped(FORCES, "effort", ["elbow"])
    late = force[stamps >= 1.0]
    low, high, error = row(text, "Coupling and loop forces", "elbow [N·m]")
    assert [low, high] == pytest.approx([late.min(), late.max()], rel=1e-3)
    assert 0.0 < error < 0.05 * late.max()
    logs = [log for log, _ in bag.rows["/joint_states"]]
    states, _ = bag.stamped("/joint_states", "effort")
    count, rate, simulated = row(text, "Topics", "/joint_states")
    assert count == len(logs)
    assert simulated == pytest.approx((count - 1) / np.ptp(states), rel=1e-3)
    assert rate == pytest.approx((count - 1) / (logs[-1] - logs[0]) * 1e9, rel=1e-3)
    answers = [log for log, _ in bag.rows["/simulator/commands"]]
    if len(answers) == len(logs):
        took = (np.array(answers) - logs) * 1e-6
        (median,) = row(text, "Loop", "joint state -> command, median")
        assert median == pytest.approx(np.median(took), abs=6e-4)
        assert median > 0.0


def test_the_page_shows_the_same_numbers_and_needs_nothing_else(arm):
    text, out = arm
    html = (out / "demo.html").read_text(encoding="utf-8")
    frame = re.search(r'<iframe [^>]*srcdoc="[^"]*"', html)  # test/browser looks into it
    assert frame and 'sandbox="allow-scripts"' in frame[0]
    html = html.replace(frame[0], "<iframe")
    sources = re.findall(r"""(?:src|href|url|srcset)\s*[=(]\s*["']?([^"'\s>)]+)""", html)
    assert sources and all(source.startswith("data:") for source in sources)
    assert "<script" not in html and "@import" not in html
    assert html.count("data:image/png;base64,") == 4
    shown = re.sub(r"<[^>]+>", "\n", html.replace("<wbr>", ""))
    for line in text.splitlines():
        if line.startswith("  ") and not line.strip().startswith(("joint ->", "row ")):
            for cell in re.split(r"\s{2,}", line.strip()):
                assert cell.replace(">", "&gt;").replace("<", "&lt;") in shown


def assert_follows(text, limit):
    """All checks are met, and the ankle follows within so much [mrad]."""
    assert "NO" not in text[text.index("Checks") :]
    assert row(text, "Tracking error", "ankle")[0] < limit


def test_a_four_bar_with_super_twisting(four_bar):
    assert_follows(four_bar[0], 0.5)


@pytest.mark.soak
def test_a_leg_with_qp_tracking(tmp_path):
    text = demo("leg", "--time", 2, "--controller", "qp_tracking", "-o", tmp_path / "out")
    assert_follows(text, 300.0)
