"""The node under a stream of 1 kHz for a minute, and the benchmark that measures it."""

import json
import subprocess
import sys

import pytest
from places import ROOT

from mbd_ros.scene.reader import load_scene

pytestmark = pytest.mark.alone


@pytest.mark.soak
@pytest.mark.parametrize("name", ["arm7", "prosthetic_arm"])
def test_no_message_is_lost_at_1_khz_for_60_s(name):
    from node_load import measure

    scene = load_scene(ROOT / "config" / "scenes" / f"{name}.yaml")
    node = ["-m", "mbd_ros.nodes", "inverse_dynamics", "--ros-args", "-p", f"scene:={scene.path}"]
    load = measure(node, scene.couplings.independent, rate=1000.0, seconds=60.0)
    assert load.sent == 60_000
    assert load.answered == load.sent


@pytest.mark.soak
def test_the_benchmark_prints_its_ratios_as_json():
    command = [sys.executable, "benchmarks/costs/inverse.py", "--seconds", "1"]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=ROOT)
    assert ran.returncode == 0, ran.stderr
    result = json.loads(ran.stdout)
    assert result["arm"]["joints"] == 7
    assert result["leg"]["wrenches"] == 1
    for load in result["node"].values():
        for key in ("main_thread_us", "process_us", "round_trip_us"):
            assert 0.0 < load[f"{key}_over_echo"] < 2.0
    assert result["node"]["at 1 kHz"]["last inverse_dynamics"]["answered"] == 1000
