"""Parts, imports and cost of one scene, measured in a process of its own.

python -m mbd_ros.applications.report.left_out.probe SCENE [--allow-code]
"""

import json
import sys

from mbd_ros.scene.runs.simulation import build_simulation

LIBRARIES = (
    "proxsuite",
    "qpsolvers",
    "scipy",
    "rosbags",
    "rclpy",
    "matplotlib",
    "daqp",
    "quadprog",
    "casadi",
)


def main() -> int:
    """Build a scene and a simulation, take one step, and print the imports."""
    from mbd_ros.scene.reader import load_scene
    from mbd_ros.scene.schema.code_permission import permitting
    from mbd_ros.scene.schema.registry import PARTS

    with permitting("--allow-code" in sys.argv[2:]):
        scene = load_scene(sys.argv[1])
    simulation = build_simulation(scene)
    y = simulation.start(scene.initial)
    simulation.advance(y, None, y.t + scene.dt)
    known = {target.split(":")[0] for parts in PARTS.values() for target in parts.values()}
    loaded = [name for name in sys.modules if name.startswith("mbd_ros.")]
    measured = {
        "modules": len(loaded),
        "parts": sorted(name.split(".", 1)[1] for name in loaded if name in known),
        "not_imported": len(known - set(loaded)),
        "libraries": [name for name in LIBRARIES if name in sys.modules],
    }
    sys.stdout.write(json.dumps(measured) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
