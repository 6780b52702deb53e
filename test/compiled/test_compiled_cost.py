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
from mbd_ros.api import load_scene
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


def spatial(links, folder):
    """Scene of such an arm."""
    folder.mkdir()
    (folder / "arm.urdf").write_text(arm_of_turns(links))
    (folder / "arm.yaml").write_text("robot: {urdf: arm.urdf}\nintegrator: {type: rk4}\n")
    return folder / "arm.yaml"


def compiled(scene, folder, monkeypatch):
    """CPU seconds of a scene with nothing in the cache; it takes at most 500 MB."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / f"cache_of_{scene.stem}"))
    words = [sys.executable, "-c", CHILD, scene]
    ran = subprocess.run(words, capture_output=True, text=True, check=True)
    took, memory, how = json.loads(ran.stdout.splitlines()[-1])
    assert how.startswith("compiled: ") and memory <= 500.0
    return took


@pytest.mark.soak
@pytest.mark.alone
def test_twice_the_links_are_compiled_in_twice_the_time(tmp_path, monkeypatch):
    """Measured 1.8, and 1.6 for forty four-bars beside fifty links in any direction."""
    half = compiled(spatial(50, tmp_path / "half"), tmp_path / "half", monkeypatch)
    bars = compiled(SCENES / "a02_four_bars_40.yaml", tmp_path, monkeypatch)
    whole = compiled(spatial(100, tmp_path / "whole"), tmp_path / "whole", monkeypatch)
    assert whole <= 2.6 * half
    assert bars <= 3.0 * half
