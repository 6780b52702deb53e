"""The launch files under the real `ros2 launch`, where launch_ros is installed."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from deadline import DEADLINE, until
from places import ROOT
from sensor_msgs.msg import JointState

NEEDED = ("launch.actions", "launch_ros.actions", "ros2launch")


def is_missing(name):
    """Whether a module is not installed; the folder `launch` of a checkout is none."""
    try:
        return importlib.util.find_spec(name) is None
    except ImportError:
        return True


LACKING = [name for name in NEEDED if is_missing(name)]
pytestmark = [
    pytest.mark.soak,
    pytest.mark.skipif(bool(LACKING), reason=f"not installed: {', '.join(LACKING)}"),
]
NODES = (
    *("simulator", "inverse_dynamics", "joint_state_projector"),
    *("qp_controller", "sliding_mode_controller", "state_estimator", "digital_twin", "web_view"),
)
TWO = """from launch import LaunchDescription
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource as Source
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    files = [FindPackageShare("mbd_ros"), "/launch/"]
    first = Source([*files, "simulator.launch.py"])
    second = Source([*files, "sliding_mode_controller.launch.py"])
    given = {{"simulator_parameters": "{parameters}"}}.items()
    return LaunchDescription(
        [
            IncludeLaunchDescription(first, launch_arguments=given),
            IncludeLaunchDescription(second),
        ]
    )
"""


@pytest.fixture(scope="module")
def prefix(tmp_path_factory):
    """What `colcon build` installs, as far as ros2 looks at it."""
    root = tmp_path_factory.mktemp("install")
    index, library = root / "share/ament_index/resource_index/packages", root / "lib/mbd_ros"
    for folder in (index, library):
        folder.mkdir(parents=True)
    shutil.copy(ROOT / "resource/mbd_ros", index)
    for name in ("launch", "config"):
        shutil.copytree(ROOT / name, root / "share/mbd_ros" / name)
    for name in (*NODES, "reference_player"):
        script = library / name
        code = f"import sys\nfrom mbd_ros.programs import {name}\nsys.exit({name}())\n"
        script.write_text(f"#!{sys.executable}\n{code}", encoding="utf-8")
        script.chmod(0o755)
    return root


class Launched:
    """A running `ros2 launch`, and what it says."""

    def __init__(self, prefix, domain, words, folder):
        path = os.pathsep.join([str(prefix), sys.prefix, os.environ.get("AMENT_PREFIX_PATH", "")])
        environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            **{"AMENT_PREFIX_PATH": path, "ROS_HOME": str(folder), "PYTHONPATH": str(ROOT)},
        }
        program = Path(sys.executable).with_name("ros2")
        self.process = subprocess.Popen(
            [program, "launch", *words],
            env=environment,
            cwd=folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
        )
        self.lines = []
        self._reader = threading.Thread(target=lambda: self.lines.extend(self.process.stdout))
        self._reader.start()

    @property
    def log(self):
        return "".join(self.lines)

    def wait_for(self, *texts):
        """Until all of these were said."""
        until(lambda: self.process.poll() is not None or all(t in self.log for t in texts))
        assert all(text in self.log for text in texts), self.log

    def end(self):
        """Ctrl-C as a terminal sends it: to all processes; launch sends another one."""
        os.killpg(self.process.pid, signal.SIGINT)
        self.process.wait(DEADLINE)
        self._reader.join(DEADLINE)
        assert "process has died" not in self.log
        assert "Traceback" not in self.log
        assert self.log.count("process has finished cleanly") == self.log.count("process started")


@pytest.fixture
def launched(prefix, domain, tmp_path):
    """Start `ros2 launch` with these words; ends as it should at the end of the block."""

    @contextmanager
    def start(*words):
        running = Launched(prefix, domain, words, tmp_path)
        try:
            yield running
            running.end()
        finally:
            if running.process.poll() is None:
                os.killpg(running.process.pid, signal.SIGKILL)

    return start


@pytest.mark.parametrize("name", NODES)
def test_each_launch_file_starts_its_node_in_a_namespace(launched, probe, name):
    with launched("mbd_ros", f"{name}.launch.py", "namespace:=left") as running:
        running.wait_for("]: active")
        probe.wait_health(lambda h: h.name == f"/left/{name}" and h.values["state"] == "active")


def test_autostart_is_an_argument(launched, probe):
    with launched("mbd_ros", "simulator.launch.py", "autostart:=false"):
        health = probe.wait_health(lambda h: h.name == "/simulator")
        assert health.values["state"] == "unconfigured"


@pytest.mark.parametrize("use_sim_time", ["false", "true"])
def test_the_bring_up_moves_by_itself(launched, probe, use_sim_time):
    states = []
    probe.node.create_subscription(JointState, "/joint_states", states.append, 100)
    with launched("mbd_ros", "bringup.launch.py", f"use_sim_time:={use_sim_time}") as running:
        running.wait_for("trajectory of 10 s sent")
        probe.wait_health(lambda h: h.name == "/inverse_dynamics" and h.level == 0)
        probe.wait_health(lambda h: h.values.get("reference") == "trajectory")

        def moved():
            return np.ptp([s.position for s in states], axis=0).max() > 0.2 if states else False

        probe.spin_until(moved)


def test_the_parameters_of_one_included_file_are_not_those_of_the_next(launched, probe, tmp_path):
    parameters, both = tmp_path / "slow.yaml", tmp_path / "both.launch.py"
    parameters.write_text("/**:\n  ros__parameters:\n    rate: 250.0\n", encoding="utf-8")
    both.write_text(TWO.format(parameters=parameters), encoding="utf-8")
    with launched(str(both)) as running:
        running.wait_for("[simulator]: active", "[sliding_mode_controller]: active")
        health = probe.wait_health(lambda h: h.name == "/sliding_mode_controller")
        assert "is unknown" not in running.log
        assert health.values["state"] == "active"


def test_the_live_demo_gets_its_reference_and_can_be_started_again(launched, probe, tmp_path):
    made = [sys.executable, "-m", "mbd_ros.cli", "demo", "-o", "demo_out", "--time", "2"]
    code = "import sys; from mbd_ros.cli import main; sys.exit(main())"
    made[1:3] = ["-c", code]
    subprocess.run(made, cwd=tmp_path, check=False, capture_output=True)
    assert (tmp_path / "demo_out/bag").is_dir()
    for _ in range(2):
        seen = len(probe.health)
        with launched("mbd_ros", "demo.launch.py") as running:
            running.wait_for("[reference_player]: trajectory of")
            followed = lambda h: h.values.get("reference") == "trajectory"  # noqa: E731
            probe.wait_health(followed)
            assert len(probe.health) > seen
