"""Cost of the node `muscle_forces` under joint states at a steady rate; prints JSON.

python benchmarks/costs/biomechanics.py [SCENE] [--rate 200] [--seconds 20]
"""

import argparse
import json
import sys

from node_load import measure

from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.locate import find_scene

_SCENE = "muscle_leg"
_ANSWERS = "/muscle_forces/muscle_forces"


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scene", nargs="?", default=_SCENE)
    parser.add_argument("--rate", type=float, default=200.0)
    parser.add_argument("--seconds", type=float, default=20.0)
    asked = parser.parse_args()
    path = find_scene(asked.scene)
    scene = load_scene(path)
    node = ["-m", "mbd_ros.nodes", "muscle_forces", "--ros-args", "-p", f"scene:={path}"]
    joints = scene.couplings.independent
    load = measure(node, joints, seconds=asked.seconds, rate=asked.rate, answers=_ANSWERS)
    found = {"muscles": len(scene.muscles), "rate": asked.rate, **load._asdict()}
    json.dump(found, sys.stdout, indent=2)
    print()
    return 0


if __name__ == "__main__":
    sys.exit(main())
