"""Nodes under a stream of 1 kHz for a minute and under hostile messages, and their benchmark."""

import json
import subprocess
import sys

import pytest
from fuzz.subjects import SUBJECTS
from places import ROOT

from mbd_ros.scene.reader import load_scene

pytestmark = pytest.mark.alone
HOSTILE = 100_000  # messages between two looks at memory
OF_EACH_NODE = {subject.node: name for name, subject in SUBJECTS.items()}


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


@pytest.mark.soak
@pytest.mark.parametrize("name", OF_EACH_NODE.values())
def test_hostile_messages_do_not_fill_the_memory(domain, tmp_path, record_property, name):
    from fuzz.nodes import under_fire

    with under_fire(name, domain, tmp_path) as target:
        before, sizes = target.exchange(), [target.memory()]
        for seed in range(3):
            target.fire(seed, HOSTILE)
            sizes.append(target.memory())
        record_property("MB", sizes)
        assert target.exchange() == before
    assert sizes[-1] - sizes[0] <= 200.0, sizes
    assert sizes[-1] - sizes[-2] <= 20.0, sizes
