"""CPU time that large scenes take until they are compiled, and memory."""

import json
import subprocess
import sys

import numpy as np
import pytest
from places import ROOT

SCENES = ROOT / "config/scenes/benchmark"
CHILD = """
import json, resource, sys, time
from mbd_ros.scene.reader import load_scene
scene = load_scene(sys.argv[1])
start = time.process_time()
simulation = scene.simulation(solver={"type": "compiled"})
compilers = resource.getrusage(resource.RUSAGE_CHILDREN)
took = time.process_time() - start + compilers.ru_utime + compilers.ru_stime
memory = max(compilers.ru_maxrss, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
print(json.dumps([took, memory / 1024, simulation.how]))
"""


def arm_of_turns(links):
    """An arm whose joints and bodies stand in any direction, as URDF."""
    rng = np.random.default_rng(5)
    told = ['<robot name="arm"><link name="l0"/>']
    for k in range(1, links + 1):
        axis, lever = (" ".join(map(str, rng.normal(0.0, 0.3, 3))) for _ in range(2))
        turn, place = (" ".join(map(str, rng.uniform(-1.0, 1.0, 3))) for _ in range(2))
        told.append(f'''<link name="l{k}"><inertial><origin xyz="{lever}" rpy="{turn}"/>
<mass value="{rng.uniform(0.5, 2.0)}"/><inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001"
ixz="0.002" iyz="0.003"/></inertial></link><joint name="j{k}" type="continuous">
<parent link="l{k - 1}"/><child link="l{k}"/><axis xyz="{axis}"/>
<origin xyz="{place}" rpy="{turn}"/></joint>''')
    return "".join([*told, "</robot>"])


@pytest.fixture
def spatial(tmp_path):
    (tmp_path / "arm.urdf").write_text(arm_of_turns(100))
    (tmp_path / "arm.yaml").write_text("robot: {urdf: arm.urdf}\nintegrator: {type: rk4}\n")
    return tmp_path / "arm.yaml"


def compiled(scene, folder, monkeypatch):
    """CPU seconds and memory [MB] of a scene with nothing in the cache, and what is said."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    words = [sys.executable, "-c", CHILD, scene]
    ran = subprocess.run(words, capture_output=True, text=True, check=True)
    return json.loads(ran.stdout.splitlines()[-1])


@pytest.mark.soak
@pytest.mark.alone
def test_forty_four_bars_are_compiled_in_time(tmp_path, monkeypatch):
    took, memory, how = compiled(SCENES / "a02_four_bars_40.yaml", tmp_path, monkeypatch)
    assert how.startswith("compiled: ") and took <= 15.0 and memory <= 500.0


@pytest.mark.soak
@pytest.mark.alone
def test_a_hundred_spatial_links_are_compiled_in_time(spatial, tmp_path, monkeypatch):
    took, memory, how = compiled(spatial, tmp_path, monkeypatch)
    assert how.startswith("compiled: ") and took <= 30.0 and memory <= 500.0
