"""How long large scenes take until they are compiled, and how much memory."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCENES = Path(__file__).parents[1] / "config/scenes/benchmark"
CHILD = """
import json, resource, sys, time
from mbd_ros.scene.reader import load_scene
scene = load_scene(sys.argv[1])
start = time.perf_counter()
simulation = scene.simulation(solver={"type": "compiled"})
took = time.perf_counter() - start
asked = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
memory = max(resource.getrusage(who).ru_maxrss for who in asked)
print(json.dumps([took, memory / 1024, simulation.how]))
"""


@pytest.mark.soak
@pytest.mark.parametrize(("name", "longest"), [("a02_four_bars_40", 15.0), ("x06_chain", 30.0)])
def test_large_scenes_are_compiled_in_time(tmp_path, monkeypatch, name, longest):
    """40 four-bars, and 100 links that turn in space, each with nothing in the cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    words = [sys.executable, "-c", CHILD, SCENES / f"{name}.yaml"]
    ran = subprocess.run(words, capture_output=True, text=True, check=True)
    took, memory, how = json.loads(ran.stdout.splitlines()[-1])
    assert how.startswith("compiled: ")
    assert took <= longest and memory <= 500.0
