"""Node `sliding_mode_controller`: see `controller`."""

import sys

from mbd_ros.nodes.controller import ControllerNode
from mbd_ros.nodes.controller_parameters import SLIDING_MODE
from mbd_ros.nodes.process import run


class SlidingModeControllerNode(ControllerNode):
    """Sliding mode, super-twisting and their simpler relatives."""

    NAME = "sliding_mode_controller"
    PARAMETERS = SLIDING_MODE


def main() -> int:
    """Entry point `sliding_mode_controller`."""
    return run(SlidingModeControllerNode)


if __name__ == "__main__":
    sys.exit(main())
